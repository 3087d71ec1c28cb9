"""Hostile messages on every topic of a running estimator, monitor and watch, and of a simulated robot."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.bus import open_bus
from drivers.trace import read_trace
from replay.demo import LOG, ROBOT
from schemas.messages import CDR_LITTLE_ENDIAN, OF_DELTA, TOPICS, FeedforwardSource, Role, SampleFlag, topics_of
from schemas.robot import load_robot, save_robot
from service.estimator.bounds import bounds_of

COMMAND = Path(sys.executable).with_name("deltatwin")
GOOD, RECOVERY = 250, 50  # samples at 1 kHz, and of these until the answers are good again: 50 ms
ANSWER_S = 2.0  # for the last of them to be answered
START_S = 400.0  # kernels may have to be compiled
BURST = 64  # hostile messages at once; Zenoh takes 460 for a role that is held up
UNUSABLE = int(SampleFlag.FADING | SampleFlag.NOT_A_NUMBER | SampleFlag.OUT_OF_RANGE | SampleFlag.JUMP)
_OWN = 1 << 40  # where the well-behaved samples count from; the hostile ones count elsewhere

FLOATS = np.array([0.0, -0.0, 1.0, -1.0, 1e-308, 5e-324, 1e9, 1e155, -1e155, 1e308, -1e308, np.inf, -np.inf, np.nan])
INTEGERS = np.array(
    [0, 1, 2, 39, 2**31 - 1, 2**31, 2**32 - 1, 2**53, 2**63 - 1, 2**63, 2**64 - 2, 2**64 - 1], np.uint64
)


def hostile(generator: np.random.Generator, topic: str, count: int) -> list[bytes]:
    """`count` payloads for `topic`: noise, extremes, nearly good ones, wrong lengths, wrong headers."""
    dtype, kind = TOPICS[topic].dtype, generator.integers(8, size=count)
    records, nearly_good = TOPICS[topic].empty(count), kind >= 5
    for name in (dtype.names or ())[1:]:
        shape, base = records[name].shape, dtype[name].base
        if base.kind == "f":
            extremes = generator.choice(FLOATS, shape)
            records[name] = generator.normal(scale=0.5, size=shape)  # what a motion might be
        else:
            extremes = generator.choice(INTEGERS, shape).astype(base)
            if name in ("sequence", "stamp_sec"):
                records[name] = generator.integers(1 << 20, size=shape)
        wrong = ~nearly_good | (generator.random(count) < 0.2)
        records[name][wrong] = extremes[wrong]
    rows = records.view(np.uint8).reshape(count, dtype.itemsize)
    for noise, begin in ((kind == 1, 0), (kind == 2, len(CDR_LITTLE_ENDIAN))):
        rows[noise, begin:] = generator.integers(256, size=(noise.sum(), dtype.itemsize - begin), dtype=np.uint8)
    payloads = [row.tobytes() for row in rows]
    for n in np.flatnonzero(kind == 0).tolist():
        payloads[n] = generator.bytes(int(generator.integers(3 * dtype.itemsize)))
    return payloads


def is_message(payload: bytes, topic: str) -> bool:
    """Whether a role that subscribes to `topic` takes it; the others it rejects."""
    return len(payload) == TOPICS[topic].dtype.itemsize and payload.startswith(CDR_LITTLE_ENDIAN)


class Arrived(NamedTuple):
    """Messages that a role counted, of those that it was sent."""

    counted: int
    sent: int


class Attack:
    """A bus with an estimator, a monitor and a watch, another with a simulated robot, and what disturbs them.

    `round` disturbs, behaves and gives back what was wrong, in words.
    """

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        """folder: for descriptions and what the roles write. stack: ends them.

        Raises:
            AssertionError: a role does not start.
        """
        self._folder = folder
        self._robot = load_robot(ROBOT)
        self._peak = bounds_of(self._robot).peak_nm
        samples = read_trace(LOG, self._robot).samples()
        self._samples = samples[: len(samples) // GOOD * GOOD]  # its seam falls between two rounds, not into one
        self._next = 0
        self._sent: Counter[str] = Counter()  # role -> messages of the topics that its health counts as received
        self._said: dict[str, np.void] = {}  # role -> its last health
        self.processes: dict[str, subprocess.Popen] = {}
        stack.callback(self._kill)
        paths = {name: folder / f"{name}.toml" for name in ("attacked", "attacked-robot")}
        for name, path in paths.items():
            save_robot(self._robot.model_copy(update={"name": name}), path)
        given = ["--robot", str(paths["attacked"])]
        self._start("estimator", "estimate", *given)
        self._start("monitor", "monitor", *given, "--out", str(folder / "run.mcap"))
        self._start("watch", "watch", *given, "--out", str(folder / "findings"))
        self._start("robot", "simulate", "--robot", str(paths["attacked-robot"]), "--live", "--truth", "ideal")
        mine, robots = (
            stack.enter_context(open_bus(name, role))
            for name, role in (("attacked", Role.PLAYER), ("attacked-robot", Role.OBSERVER))
        )
        self._answers, self._moved = mine.subscribe("feedforward", 1 << 17), robots.subscribe("sample", 1 << 17)
        self._healths = mine.subscribe("health"), robots.subscribe("health")
        # who hears what and counts it as received
        self._targets = [
            (topic, mine.publisher(topic).put, ["monitor", *(("estimator", "watch") if topic == "sample" else ())])
            for topic in topics_of(OF_DELTA)
        ]
        self._targets.append(("feedforward", robots.publisher("feedforward").put, ["robot"]))
        give_up = time.monotonic() + START_S
        while not ({Role.ESTIMATOR, Role.MONITOR, Role.WATCH} <= mine.alive and Role.ROBOT in robots.alive):
            assert time.monotonic() < give_up, "a role does not start"
            assert not self.dead(), self.dead()
            time.sleep(0.05)
        self._behave(set())

    def round(self, generator: np.random.Generator, count: int, rate: float) -> list[str]:
        """`count` hostile messages at `rate` a second, then good samples."""
        forged = self._disturb(generator, count, rate)
        answers = self._behave(forged)
        wrong = self.dead() + self._out_of_bounds(answers)
        order = answers["sequence"].astype(np.int64) - _OWN - (self._next - GOOD)
        recovered = answers[(order >= RECOVERY) & (order < GOOD)]
        if len(recovered) != GOOD - RECOVERY:
            wrong.append(f"{len(recovered)} of {GOOD - RECOVERY} samples answered")
        useless = (recovered["flags"] & UNUSABLE != 0) | (recovered["source"] == FeedforwardSource.NONE)
        if useless.any():
            wrong.append(f"{useless.sum()} answers not usable, flags {np.unique(recovered['flags'][useless])}")
        moved = self._moved.take()[0]
        if not np.isfinite(moved["torque"]).all() or np.ptp(moved["position"], axis=0).max(initial=0.0) > np.pi:
            wrong.append("the robot was moved beyond its range")
        self._listen(forged)
        return wrong

    def stop(self) -> list[str]:
        """End the roles as Ctrl-C does, the monitor last; what was wrong."""
        wrong = self.dead()
        for name, process in sorted(self.processes.items(), key=lambda item: item[0] == "monitor"):
            process.send_signal(signal.SIGINT)
            if process.wait(120) != 0 or "Traceback" in self._said_by(name):
                wrong.append(f"{name}: code {process.returncode}: {self._said_by(name)[-500:]}")
        self._listen(set())
        return wrong

    def arrived(self) -> dict[str, Arrived]:
        """Of each role, once they have ended."""
        of_roles = sum(int(self._said[name]["published"]) for name in ("estimator", "watch"))
        healths = sum(int(self._said[name]["sequence"]) + 1 for name in ("estimator", "watch", "monitor"))
        others = {"monitor": of_roles + healths}
        return {
            name: Arrived(int(self._said[name]["received"]), self._sent[name] + others.get(name, 0))
            for name in self.processes
        }

    def dead(self) -> list[str]:
        """Roles that have ended, and what they said last."""
        return [f"{n}: ended: {self._said_by(n)[-1500:]}" for n, p in self.processes.items() if p.poll() is not None]

    def _said_by(self, name: str) -> str:
        return (self._folder / f"{name}.txt").read_text()

    def _start(self, name: str, *arguments: str) -> None:
        with (self._folder / f"{name}.txt").open("w") as out:
            self.processes[name] = subprocess.Popen([COMMAND, *arguments], stdout=out, stderr=out)

    def _kill(self) -> None:
        for process in self.processes.values():
            with suppress(ProcessLookupError):
                process.kill()
            process.wait()

    def _disturb(self, generator: np.random.Generator, count: int, rate: float) -> set[bytes]:
        """Send; what came back to this process's own inboxes of it."""
        order = generator.integers(len(self._targets), size=count)
        payloads = [
            hostile(generator, topic, int(np.count_nonzero(order == n)))
            for n, (topic, _, _) in enumerate(self._targets)
        ]
        for (topic, _, roles), sent in zip(self._targets, payloads, strict=True):
            whole = sum(is_message(payload, topic) for payload in sent)
            self._sent.update(dict.fromkeys(roles, whole))
        following, begin = [iter(sent) for sent in payloads], time.monotonic()
        for n, target in enumerate(order.tolist()):
            self._targets[target][1](next(following[target]))
            if n % BURST == 0:
                time.sleep(max(0.0, begin + n / rate - time.monotonic()))
        return {
            payload
            for (topic, _, _), sent in zip(self._targets, payloads, strict=True)
            if topic in ("feedforward", "health")
            for payload in sent
        }

    def _behave(self, forged: set[bytes]) -> np.ndarray:
        """Publish the next samples of the demo log at 1 kHz; all that the estimator has answered since the last time,
        (N,), but for what is in `forged`."""
        (put,) = (put for topic, put, _ in self._targets if topic == "sample")
        begin = time.monotonic()
        for n in range(self._next, self._next + GOOD):
            sample = self._samples[n % len(self._samples)].copy()
            sample["sequence"] = _OWN + n
            seconds, milliseconds = divmod(n, 1000)
            sample["stamp_sec"], sample["stamp_nanosec"] = 5000 + seconds, milliseconds * 1_000_000
            put(sample.tobytes())
            time.sleep(max(0.0, begin + 0.001 * (n + 1 - self._next) - time.monotonic()))
        self._next += GOOD
        self._sent.update(dict.fromkeys(("monitor", "estimator", "watch"), GOOD))
        answers, give_up = self._answers.take()[0], time.monotonic() + ANSWER_S
        while not (answers["sequence"] == _OWN + self._next - 1).any() and time.monotonic() < give_up:
            time.sleep(0.02)
            answers = np.concatenate((answers, self._answers.take()[0]))
        return _genuine(answers, forged)

    def _listen(self, forged: set[bytes]) -> None:
        for inbox in self._healths:
            for record in _genuine(inbox.take()[0], forged):
                self._said[Role(record["role"]).name.lower()] = record

    def _out_of_bounds(self, answers: np.ndarray) -> list[str]:
        torque = answers["torque"]
        bad = ~np.isfinite(torque).all(axis=1) | (np.abs(torque).max(axis=1, initial=0.0) > self._peak * (1 + 1e-9))
        return [f"{bad.sum()} answers out of bounds, one {torque[bad][0]}"] if bad.any() else []


def _genuine(records: np.ndarray, forged: set[bytes]) -> np.ndarray:
    return records[np.array([record.tobytes() not in forged for record in records], bool)]
