"""The estimator on the bus: takes samples and planned motion, gives feed-forward, payload and errors, in the messages
of the kind of machine, and of a Delta `friction`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np

from drivers.bus import Bus
from drivers.health import Health
from drivers.sequence import SequenceCounter
from schemas.axes_description import Description
from schemas.errors import DataError
from schemas.messages import SEQUENCE_BYTES, TOPICS, HealthFlag, SampleFlag
from service.estimator.estimator import PERIOD_SAMPLES, Estimator, Rate, rate_of
from service.estimator.keep import Keeper
from service.estimator.online import Online, estimator_of, left_out, said_beside

REPORT_PERIOD = 1e-3  # s, shortest between two payload or error messages; nobody steers by them, and they cost as much
STALE_CYCLES = 20  # without a sample the input is stale ...
STALE_NS = 20_000_000  # ... but not before the scheduler of a loaded host may have held it up
POLL_S = 0.02  # how often a silent bus is left to see whether to stop
PERIOD_CHANGE = 0.1  # relative; a source with another sample rate needs other filters
PERIOD_AGREES = 0.01  # relative, of two readings in a row: what garbage among the samples does not do
_INVALID = int(SampleFlag.NOT_A_NUMBER | SampleFlag.OUT_OF_RANGE | SampleFlag.JUMP)


class EstimatorNode:
    """One estimator behind one bus; `step` does what came in since the last call."""

    def __init__(self, robot: Description, bus: Bus, flags: HealthFlag, keeper: Keeper | None = None) -> None:
        self._robot, self._keeper = robot, keeper
        topics = robot.topics
        self._samples, self._references = bus.subscribe(topics.sample), bus.subscribe(topics.reference, capacity=1024)
        self._sample, self._reference = TOPICS[topics.sample].dtype, TOPICS[topics.reference].dtype
        answers = {name: getattr(topics, name) for name in ("feedforward", "payload", "error")}
        answers |= {name: name for name in said_beside(robot)}
        self._put = {name: bus.publisher(topic).put for name, topic in answers.items()}
        self.health, self._flags = Health(bus, flags), flags
        self._counter = SequenceCounter()
        self._waiting: list[bytes] = []  # the first samples, until they tell the period
        self._recent: list[bytes] = []  # the first ones after a report, which tell whether it is still that
        self._suspected: Rate | None = None  # what one reading of another rate gave
        self._estimator: Online | None = None
        self._every = 1  # samples from report to report
        self._published = self._invalid = self._received = 0
        self._heard_ns, self._silent, self._found = time.monotonic_ns(), False, HealthFlag(0)
        self._stale_ns = STALE_NS

    def step(self) -> None:
        """Wait for a sample, at most POLL_S, and answer it."""
        message = self._samples.one(POLL_S)
        if message is not None:
            came = self._heard_ns = time.monotonic_ns()
            sequence = int.from_bytes(message[SEQUENCE_BYTES], "little")
            if self._estimator is not None:
                self._answer(self._estimator, message, sequence, came)
            else:
                self._wait_for_rate(message, came)
            self._received += 1
            self._counter.update(sequence)
            if len(self._recent) < PERIOD_SAMPLES:
                self._recent.append(message)
                if self._estimator is not None and len(self._recent) == PERIOD_SAMPLES:
                    self._follow_rate(self._estimator)
        if message is None or self._silent:
            self._note_silence()
        if self.health.due:
            self.report()

    def _note_silence(self) -> None:
        silent = time.monotonic_ns() - self._heard_ns > self._stale_ns
        if silent != self._silent:
            self._silent = silent
            self._set_flags()

    def _set_flags(self) -> None:
        silence = HealthFlag.STALE_INPUT if self._silent else HealthFlag(0)
        self.health.flags = self._flags | silence | self._found

    def _tell_findings(self, estimator: Online) -> None:
        found = estimator.findings()
        if estimator.friction is not None:
            self._put["friction"](estimator.friction.tobytes())
            self._published += 1
        if found != self._found:
            self._found = found
            self._set_flags()

    def _wait_for_rate(self, message: bytes, came: int) -> None:
        self._waiting.append(message)
        if len(self._waiting) < PERIOD_SAMPLES:
            return
        try:
            self._start(rate_of(self._records(self._waiting)))
        except DataError:  # the stamps stand still: health shows samples coming in and nothing going out
            del self._waiting[0]
            return
        assert self._estimator is not None
        for first in self._waiting:
            self._answer(self._estimator, first, int.from_bytes(first[SEQUENCE_BYTES], "little"), came)

    def _start(self, rate: Rate) -> None:
        self._estimator = estimator_of(self._robot, *rate)
        without = left_out(self._robot, rate.period)
        for name, why in without.items():
            print(f"estimate: the online model does not contain {name}: {why}", file=sys.stderr)
        self._found = HealthFlag.EFFECT_LEFT_OUT if without else HealthFlag(0)
        self._set_flags()
        if self._keeper is not None and isinstance(self._estimator, Estimator):
            print(f"estimate: {self._keeper.begin(self._estimator)}", file=sys.stderr)
        self._every = max(1, round(REPORT_PERIOD / rate.period))
        self._stale_ns = max(STALE_NS, int(STALE_CYCLES * rate.period * 1e9))

    def _answer(self, estimator: Online, message: bytes, sequence: int, came: int) -> None:
        reference = self._references.one()
        if reference is not None:
            newer, _ = self._references.take()
            estimator.plan(newer[-1] if len(newer) else np.frombuffer(reference, self._reference)[0])
        flags = estimator.step(message)
        self._put["feedforward"](estimator.feedforward.tobytes())  # first: somebody steers by it
        self.health.time_one(time.monotonic_ns() - came)
        self._published += 1
        if flags & _INVALID:
            self._invalid += 1
        event = estimator.look_back()
        if event > 0 or (event == 0 and sequence // estimator.stride % self._every == 0):
            if estimator.payload is not None:
                self._put["payload"](estimator.payload.tobytes())
                self._published += 1
            self._put["error"](estimator.error.tobytes())
            self._published += 1

    def report(self) -> None:
        """Publish health."""
        self._recent.clear()  # read the rate anew
        if self._estimator is not None and not self._silent:
            self._tell_findings(self._estimator)
            if self._keeper is not None and isinstance(self._estimator, Estimator):
                self._keeper.note(self._estimator)
        self.health.publish(
            received=self._received,
            published=self._published,
            lost=self._counter.lost,
            repeated=self._counter.repeated,
            out_of_order=self._counter.out_of_order,
            rejected=self._samples.rejected + self._references.rejected,
            invalid=self._invalid,
        )

    def close(self) -> None:
        """Keep what was learnt, if that was asked for.

        Raises:
            StorageError: it cannot be written.
        """
        if self._keeper is not None and isinstance(self._estimator, Estimator):
            self._keeper.close(self._estimator)

    def _records(self, messages: list[bytes]) -> np.ndarray:
        return np.frombuffer(b"".join(messages), self._sample)

    def _follow_rate(self, estimator: Online) -> None:
        """Start anew when two readings in a row agree on another rate than that of `estimator`."""
        before, self._suspected = self._suspected, None
        try:
            found = rate_of(self._records(self._recent))
        except DataError:
            return
        if found.stride == estimator.stride and _close(found.period, estimator.period, PERIOD_CHANGE):
            return
        if before is None or found.stride != before.stride or not _close(found.period, before.period, PERIOD_AGREES):
            self._suspected = found
            self._recent.clear()
            return
        print(
            f"estimate: sample period changed from {estimator.period:g} s to {found.period:g} s; starting again",
            file=sys.stderr,
        )
        self._start(found)


def _close(one: float, other: float, relative: float) -> bool:
    return abs(one / other - 1) <= relative


def run(
    robot: Description,
    bus: Bus,
    flags: HealthFlag,
    stopped: Callable[[], bool] = lambda: False,
    keeper: Keeper | None = None,
) -> None:
    """Answer samples until `stopped` or Ctrl-C.

    Raises:
        StorageError: what was learnt cannot be kept.
    """
    node = EstimatorNode(robot, bus, flags, keeper)
    with node.health:
        try:
            while not stopped():
                node.step()
        finally:
            node.report()
            node.close()
