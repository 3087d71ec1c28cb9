"""The watch on the bus: takes samples and payloads, gives the gap once a second and a finding after a rise."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from drivers.bus import Bus
from drivers.health import Health
from drivers.sequence import SequenceCounter
from schemas.axes_description import Description
from schemas.finding import WatchFinding
from schemas.messages import NANOSECONDS, TOPICS, FindingVerdict, HealthFlag, StopReason, WatchState, set_stamp
from service.monitor.tally import INVALID
from service.watch.examine import report, stand_back
from service.watch.state_machine import RISEN, Rise, Watch

CYCLE_S = 0.1
NICENESS = 19  # of a diagnosis
STALE_NS = 1_000_000_000
DEPTH = 1 << 15  # samples that wait while a look takes its time: 4 s at 8 kHz
LONGEST_S = 900.0  # of a diagnosis; one that was killed never answers


class Examination:
    """One diagnosis under way in a process of its own. Its files go into a folder in `out` that has the time's name."""

    def __init__(self, description: Path, effects: Path | None, out: Path, rise: Rise) -> None:
        self.rise, self.folder = rise, out / time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        self._until = time.monotonic() + LONGEST_S
        self._pool = multiprocessing.get_context("spawn").Pool(1, stand_back, (NICENESS,))
        self._result = self._pool.apply_async(report, (description, effects, self.folder, rise))

    @property
    def done(self) -> bool:
        """Whether it has ended, or has to."""
        return self._result.ready() or time.monotonic() > self._until

    def result(self) -> WatchFinding:
        """What it found; only once.

        Raises:
            DeltatwinError: it gave up.
            TimeoutError: it did not end.
        """
        try:
            return self._result.get(0.0)
        except multiprocessing.TimeoutError:
            raise TimeoutError(f"no answer after {LONGEST_S:g} s") from None
        finally:
            self.end()

    def end(self) -> None:
        """End it."""
        self._pool.terminate()


class WatchNode:
    """Call `step` every `CYCLE_S`, and `close` at the end."""

    def __init__(
        self, watch: Watch, bus: Bus, examination: Callable[[Rise], Examination], say: Callable[[str], object]
    ) -> None:
        self.health = Health(bus)
        self._watch, self._examination_of, self._say = watch, examination, say
        topics, self._own = watch.robot.topics, slice(watch.robot.count)
        self._samples, self._payloads = bus.subscribe(topics.sample, DEPTH), bus.subscribe(topics.payload, DEPTH)
        self._gap, self._finding = bus.publisher(topics.gap).put, bus.publisher(topics.finding).put
        self._counter = SequenceCounter()
        self._examination: Examination | None = None
        self._heard_ns = time.monotonic_ns()
        self._received = self._published = self._found = self._invalid = 0
        self._state = watch.state

    def step(self) -> None:
        """Take what came."""
        samples, payloads = self._samples.take()[0], self._payloads.take()[0]
        if len(samples):
            self._heard_ns = time.monotonic_ns()
            self._received += len(samples)
            self._counter.update_many(samples["sequence"])
            self._invalid += int(np.count_nonzero(samples["flags"] & INVALID))
        for gap in self._watch.add(samples, payloads):
            self._gap(gap.tobytes())
            self._published += 1
            self._tell_state(gap[0])
        self._examine()
        stale = time.monotonic_ns() - self._heard_ns > STALE_NS
        self.health.flags = HealthFlag.STALE_INPUT if stale else HealthFlag(0)
        if self.health.due:
            self.health.publish(**self.counts())

    def _tell_state(self, gap: np.void) -> None:
        before, self._state = self._state, WatchState(int(gap["state"]))
        raised = (WatchState.RAISED, WatchState.DIAGNOSING)
        if before == WatchState.LEARNING != self._state:
            self._say(f"level learnt: {_figures(gap['gap'][self._own])} {torque_unit(self._watch.robot)} rms")
            doubt = beyond_description(self._watch)
            if doubt:
                self._say(f"{doubt}: run `deltatwin diagnose` on a new log")
        elif self._state in raised and before not in raised:
            self._say(f"gap has risen to {_figures(gap['ratio'][self._own])} times its level (by joint)")
        elif before in raised and self._state == WatchState.WATCHING:
            self._say("gap is back at its level")

    def _examine(self) -> None:
        if self._examination is None:
            rise = self._watch.rise()
            if rise is not None:
                self._examination = self._examination_of(rise)
            return
        if not self._examination.done:
            return
        examination, self._examination = self._examination, None
        self._watch.diagnosing = False
        try:
            found = examination.result()
        except Exception as error:  # whatever it was, it is told, and the watch goes on
            text = f"the diagnosis failed: {type(error).__name__}: {error}"
            self._finding(_failed(examination.rise, self._found, self._watch.robot).tobytes())
        else:
            text = found.text
            self._finding(message_of(found, self._found, self._watch.robot).tobytes())
        self._say(f"{text} ({examination.folder})")
        self._found += 1
        self._published += 1

    @property
    def found(self) -> int:
        """How many diagnoses have ended."""
        return self._found

    def counts(self) -> dict[str, int]:
        """Of the health message."""
        return {
            "received": self._received, "published": self._published, "lost": self._counter.lost,
            "repeated": self._counter.repeated, "out_of_order": self._counter.out_of_order,
            "rejected": self._samples.rejected + self._payloads.rejected, "invalid": self._invalid,
        }  # fmt: skip

    def close(self) -> None:
        """End a diagnosis that is under way."""
        if self._examination is not None:
            self._examination.end()


def beyond_description(watch: Watch) -> str:
    """What to say where the level that was learnt is above what the description left when it was made, else nothing."""
    over = watch.beyond_description
    return (
        f"that is {_figures(over)} times the residual of the description when it was made"
        if (over > RISEN).any()
        else ""
    )


def _figures(values: np.ndarray) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def torque_unit(robot: Description) -> str:
    """Of its joints."""
    return "N" if robot.linear else "N m"


def message_of(found: WatchFinding, sequence: int, robot: Description) -> np.ndarray:
    """A finding as a message (1,)."""
    message = _message(found.since_s, found.until_s, sequence, robot)
    for name in ("before", "after", "left", "floor"):
        message[name][:, : robot.count] = getattr(found, f"{name}_nm")
    message["verdict"] = FindingVerdict[found.diagnosis.verdict.upper()]
    for strongest in found.diagnosis.effects[:1]:
        message["probability"] = strongest.probability
        message["joints"] = sum(1 << (joint - 1) for joint in strongest.joints)
        name = strongest.name.encode("ascii", "replace")[: message["effect"].size]
        message["effect"][0, : len(name)] = np.frombuffer(name, np.uint8)
    return message


def _failed(rise: Rise, sequence: int, robot: Description) -> np.ndarray:
    epoch = rise.after.epoch_ns / NANOSECONDS
    message = _message(epoch + rise.since, epoch + float(rise.after.time[-1]), sequence, robot)
    message["verdict"] = FindingVerdict.FAILED
    for name in ("before", "after", "left", "floor"):
        message[name][:, : robot.count] = np.nan
    return message


def _message(since: float, until: float, sequence: int, robot: Description) -> np.ndarray:
    message = TOPICS[robot.topics.finding].empty(1)
    if "count" in (message.dtype.names or ()):
        message["count"] = robot.count
    set_stamp(message, round(until * NANOSECONDS))
    message["sequence"], message["higher_for"] = sequence, until - since
    return message


def run(node: WatchNode, stopped: Callable[[], bool]) -> None:
    """Step until `stopped`."""
    with node.health:
        try:
            while not stopped():
                node.step()
                time.sleep(CYCLE_S)
        finally:
            node.close()
        node.health.stop(StopReason.INTERRUPTED, **node.counts())
