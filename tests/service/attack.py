"""Hostile messages on every topic of a running estimator, monitor and robot."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np

from drivers.bus import Publisher, open_bus
from drivers.trace import read_trace
from replay.demo import LOG, ROBOT
from schemas.messages import CDR_LITTLE_ENDIAN, TOPICS, FeedforwardSource, Role, SampleFlag
from schemas.robot import load_robot, save_robot
from service.estimator.bounds import bounds_of

COMMAND = Path(sys.executable).with_name("deltatwin")
RECOVERY = 50  # samples at 1 kHz until the answers are good again: 50 ms
START_S = 400.0  # kernels may have to be compiled
UNHURRIED_S = 0.0002  # between two hostile messages: 3 000 to 5 000 a second
UNUSABLE = int(SampleFlag.FADING | SampleFlag.NOT_A_NUMBER | SampleFlag.OUT_OF_RANGE | SampleFlag.JUMP)
_OWN = 1 << 40  # where the well-behaved samples count from; the hostile ones count elsewhere

FLOATS = np.array([0.0, -0.0, 1.0, -1.0, 1e-308, 5e-324, 1e9, 1e155, -1e155, 1e308, -1e308, np.inf, -np.inf, np.nan])
INTEGERS = np.array(
    [0, 1, 2, 39, 2**31 - 1, 2**31, 2**32 - 1, 2**53, 2**63 - 1, 2**63, 2**64 - 2, 2**64 - 1], np.uint64
)


def hostile(generator: np.random.Generator, count: int) -> Iterator[tuple[str, bytes]]:
    """`count` messages, (topic, payload): noise, extremes, nearly good ones, wrong lengths, wrong headers."""
    topics = list(TOPICS)
    for _ in range(count):
        topic = topics[generator.integers(len(topics))]
        yield topic, _payload(generator, topic)


def _payload(generator: np.random.Generator, topic: str) -> bytes:
    dtype = TOPICS[topic].dtype
    kind = generator.integers(8)
    if kind == 0:
        return generator.bytes(int(generator.integers(0, 3 * dtype.itemsize)))
    if kind == 1:
        return generator.bytes(dtype.itemsize)  # the right size with a wrong header
    if kind == 2:
        return CDR_LITTLE_ENDIAN + generator.bytes(dtype.itemsize - 4)
    record = TOPICS[topic].empty(1)
    if kind >= 5:  # nearly good: what a motion might be, with one field gone wrong
        for name in dtype.names or ():
            if dtype[name].base.kind == "f":
                record[name] = generator.normal(scale=0.5, size=dtype[name].shape)
        record["sequence"], record["stamp_sec"] = generator.integers(1 << 20), generator.integers(1 << 10)
    for name in (dtype.names or ())[1:]:
        if kind < 5 or generator.random() < 0.2:
            base, shape = dtype[name].base, dtype[name].shape
            if base.kind == "f":
                record[name] = generator.choice(FLOATS, size=shape)
            else:
                record[name] = generator.choice(INTEGERS, size=shape).astype(base)
    return record.tobytes()


class Attack:
    """A bus with an estimator and a monitor, another with a simulated robot, and what is needed to disturb them.

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
        self._samples = read_trace(LOG, self._robot).samples()
        self._next = 0
        self.processes: dict[str, subprocess.Popen] = {}
        stack.callback(self._kill)
        paths = {name: folder / f"{name}.toml" for name in ("attacked", "attacked-robot")}
        for name, path in paths.items():
            save_robot(self._robot.model_copy(update={"name": name}), path)
        given = ["--robot", str(paths["attacked"])]
        self._start("estimator", "estimate", *given)
        self._start("monitor", "monitor", *given, "--out", str(folder / "run.mcap"))
        self._start("robot", "simulate", "--robot", str(paths["attacked-robot"]), "--live", "--truth", "ideal")
        mine, robots = (
            stack.enter_context(open_bus(name, role))
            for name, role in (("attacked", Role.PLAYER), ("attacked-robot", Role.OBSERVER))
        )
        self._answers, self._moved = mine.subscribe("feedforward", 1 << 17), robots.subscribe("sample", 1 << 17)
        self._publishers: list[dict[str, Publisher]] = [
            {topic: mine.publisher(topic) for topic in TOPICS},
            {topic: robots.publisher(topic) for topic in TOPICS if topic != "sample"},  # that is the robot's own
        ]
        give_up = time.monotonic() + START_S
        while not ({Role.ESTIMATOR, Role.MONITOR} <= mine.alive and Role.ROBOT in robots.alive):
            assert time.monotonic() < give_up, "a role does not start"
            assert not self.dead(), self.dead()
            time.sleep(0.05)
        self._behave(400)

    def round(self, generator: np.random.Generator, count: int) -> list[str]:
        """`count` hostile messages, then 400 good samples."""
        forged = self._disturb(generator, count)
        time.sleep(0.2)
        wrong = self.dead()
        given = self._answers.take()[0]
        own = np.array([record.tobytes() not in forged for record in given], bool)
        wrong += self._out_of_bounds(given[own], "while it was disturbed")
        answers, order = self._behave(400)
        wrong += self._out_of_bounds(answers, "after it was disturbed")
        recovered = answers[order >= RECOVERY]
        if len(recovered) != 400 - RECOVERY:
            wrong.append(f"{len(recovered)} of {400 - RECOVERY} samples answered")
        useless = (recovered["flags"] & UNUSABLE != 0) | (recovered["source"] == FeedforwardSource.NONE)
        if useless.any():
            wrong.append(f"{useless.sum()} answers not usable, flags {np.unique(recovered['flags'][useless])}")
        moved = self._moved.take()[0]
        if not np.isfinite(moved["torque"]).all() or np.ptp(moved["position"], axis=0).max(initial=0.0) > np.pi:
            wrong.append("the robot was moved beyond its range")
        return wrong

    def stop(self) -> list[str]:
        """End the roles as Ctrl-C does; what was wrong."""
        wrong = self.dead()
        for name, process in self.processes.items():
            process.send_signal(signal.SIGINT)
            if process.wait(120) != 0 or "Traceback" in self._said(name):
                wrong.append(f"{name}: code {process.returncode}: {self._said(name)[-500:]}")
        return wrong

    def dead(self) -> list[str]:
        """Roles that have ended, and what they said last."""
        return [f"{n}: ended: {self._said(n)[-1500:]}" for n, p in self.processes.items() if p.poll() is not None]

    def _said(self, name: str) -> str:
        return (self._folder / f"{name}.txt").read_text()

    def _start(self, name: str, *arguments: str) -> None:
        with (self._folder / f"{name}.txt").open("w") as out:
            self.processes[name] = subprocess.Popen([COMMAND, *arguments], stdout=out, stderr=out)

    def _kill(self) -> None:
        for process in self.processes.values():
            with suppress(ProcessLookupError):
                process.kill()
            process.wait()

    def _disturb(self, generator: np.random.Generator, count: int) -> set[bytes]:
        forged = set()
        for n, (topic, payload) in enumerate(hostile(generator, count)):
            publisher = self._publishers[n % 2].get(topic)
            if publisher is not None:
                publisher.put(payload)
            if topic == "feedforward":
                forged.add(payload)
            time.sleep(UNHURRIED_S)
        return forged

    def _behave(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Publish the next `count` samples of the demo log at 1 kHz; the (N,) answers and whose they are."""
        first, begin = self._next, time.monotonic()
        for n in range(first, first + count):
            sample = self._samples[n % len(self._samples)].copy()
            sample["sequence"] = _OWN + n
            seconds, milliseconds = divmod(n, 1000)
            sample["stamp_sec"], sample["stamp_nanosec"] = 5000 + seconds, milliseconds * 1_000_000
            self._publishers[0]["sample"].put(sample.tobytes())
            time.sleep(max(0.0, begin + 0.001 * (n + 1 - first) - time.monotonic()))
        self._next += count
        time.sleep(0.3)
        answers = self._answers.take()[0]
        order = answers["sequence"].astype(np.int64) - _OWN - first
        mine = (order >= 0) & (order < count)
        return answers[mine], order[mine]

    def _out_of_bounds(self, answers: np.ndarray, when: str) -> list[str]:
        torque = answers["torque"]
        bad = ~np.isfinite(torque).all(axis=1) | (np.abs(torque).max(axis=1, initial=0.0) > self._peak * (1 + 1e-9))
        return [f"{bad.sum()} answers out of bounds {when}, one {torque[bad][0]}"] if bad.any() else []
