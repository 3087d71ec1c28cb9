"""Where the master's feed-forward torque comes from: an estimator in its own cycle, or one that answers over Zenoh.

Each gives an `Answer` for the motion that the next frame commands, or None where it has nothing fresh; `OffsetRamp` and
`PositionRamp` then take what the drives had to zero.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from drivers.bus import Bus
from drivers.ethercat.setpoints import Answer, Setpoints
from schemas.messages import NANOSECONDS, REFERENCE, FeedforwardSource, SampleFlag, set_stamp, stamp_ns
from schemas.robot import Robot
from service.model.description import terms_of
from service.model.elastic import leads
from service.model.hypothesis import inside_of

LEAD = 4  # cycles that a motion is published ahead of its command: tap, estimator and Zenoh have that long at any rate
DRIFT = 2  # cycles that the numbering of the samples may be off before it is adjusted; the estimator takes 1 to 8 ahead
FRESH_CYCLES = LEAD + 3  # from question to use; an answer that is late by up to 3 cycles holds until a newer one
_NUMBERS = 1 << 64


def nothing(sample: np.ndarray, setpoints: Setpoints, number: int) -> Answer | None:
    """No feed-forward, and none wanted."""
    return Answer(np.zeros(3), np.zeros(3))


def goes_ahead(robot: Robot) -> bool:
    """Whether an estimator of `robot` says how far motors go before planned positions."""
    return leads(inside_of(terms_of(robot)).two_masses)


class Steps(Protocol):
    """What an `Estimator` does in a cycle, and the library that is exported from it."""

    feedforward: np.ndarray
    payload: np.ndarray

    def warm_up(self) -> None: ...
    def plan(self, reference: np.void) -> None: ...
    def step(self, message: bytes) -> int: ...
    def look_back(self) -> int: ...


class InCycle:
    """tau_FF from an estimator that steps between two frames, for the planned motion of the coming cycle."""

    def __init__(self, estimator: Steps) -> None:
        self._estimator = estimator
        self._reference = REFERENCE.empty(1)[0]
        self._payload: np.void | None = None
        estimator.warm_up()

    def __call__(self, sample: np.ndarray, setpoints: Setpoints, number: int) -> Answer | None:
        reference = self._reference
        reference["sequence"] = sample["sequence"][0] + 1
        _plan(reference, setpoints, number)
        self._estimator.plan(reference)
        estimator = self._estimator
        estimator.step(sample.tobytes())
        weighed = estimator.look_back() >= 0 and estimator.payload["trusted"][0]
        if weighed and estimator.payload["std_dev"][0] > 0.0:  # without doubt is the mass in an open gripper alone
            self._payload = estimator.payload[0].copy()
        answer = estimator.feedforward[0]
        return _said(answer) if _for_the_plan(answer) else None

    def counts(self) -> dict[str, int]:
        """For the health message."""
        return {}

    def summary(self) -> str:
        """The last payload that was trusted, of a gripper not known to be open."""
        if self._payload is None:
            return "payload: none trusted"
        mass, std_dev = self._payload["mass"], self._payload["std_dev"]
        return f"payload last trusted: {mass:.3f} kg (standard deviation {std_dev:.3f} kg)"


@dataclass
class _Question:
    """A motion that was published: for which cycle, when (CLOCK_MONOTONIC, ns), and the answer."""

    cycle: int
    asked_ns: int
    answer: Answer | None = None


class OverBus:
    """tau_FF from an estimator elsewhere that hears a tap on the same wire: question and answer.

    `reference` goes out `LEAD` cycles ahead of its command, each with a number of its own; the estimator's answer
    carries that number back as `target_sequence`. So what counts as fresh is measured by this host's clock alone, from
    question to use, and needs no clock of anybody else's: an answer to no question, to one of another run, to one
    that was asked too long ago, or a second one to the same, is refused. The numbers are those of the tap's samples,
    which are learned from the newest answer, whatever it is worth otherwise.

    Attributes: published: questions. received: messages. refused: of these, by reason: `invalid`, not finite or beyond
    the peak; `repeated`, to a question that was answered; `rejected`, to none of the last ones.
    """

    def __init__(self, bus: Bus, peak: float, period: float) -> None:
        """peak: N m that no answer may exceed. period: s."""
        self._answers, self._put = bus.subscribe("feedforward", 64), bus.publisher("reference").put
        self._peak, self._period_ns = peak, round(period * NANOSECONDS)
        self._reference = REFERENCE.empty(1)
        self._asked: dict[int, _Question] = {}  # by target_sequence
        self._offset: int | None = None  # from our cycles to the numbers of the tap's samples
        self.published = self.received = 0
        self.refused = {"invalid": 0, "repeated": 0, "rejected": 0}
        self._used = self._unanswered = 0

    def __call__(self, sample: np.ndarray, setpoints: Setpoints, number: int) -> Answer | None:
        records, _ = self._answers.take()
        for record in records:
            self._hear(record)
        if len(records):
            self._learn(int(records["sequence"][-1]), number)
        now = time.monotonic_ns()
        answer = self._freshest(number, now)
        if self._offset is not None:
            self._ask(sample, setpoints, number, now)
        if answer is not None:
            self._used += 1
        elif self._used:
            self._unanswered += 1
        return answer

    def _hear(self, answer: np.void) -> None:
        self.received += 1
        said = _said(answer)
        question = self._asked.get(int(answer["target_sequence"]))
        if not (np.abs(said.torque) <= self._peak).all():  # NaN is not
            self.refused["invalid"] += 1
        elif question is None or not _for_the_plan(answer):
            self.refused["rejected"] += 1
        elif question.answer is not None:
            self.refused["repeated"] += 1
        else:
            question.answer = said

    def _learn(self, sequence: int, number: int) -> None:
        offset = sequence + 1 - number  # the newest answer is to the sample of the cycle before
        if self._offset is None or abs(offset - self._offset) > DRIFT:
            self._offset = offset

    def _freshest(self, number: int, now: int) -> Answer | None:
        """The answer for the cycle `number`, else for the nearest one; questions of too long ago are forgotten."""
        oldest = now - FRESH_CYCLES * self._period_ns
        self._asked = {target: question for target, question in self._asked.items() if question.asked_ns >= oldest}
        answered = [question for question in self._asked.values() if question.answer is not None]
        return min(answered, key=lambda question: abs(question.cycle - number)).answer if answered else None

    def _ask(self, sample: np.ndarray, setpoints: Setpoints, number: int, now: int) -> None:
        assert self._offset is not None
        cycle, reference = number + LEAD, self._reference
        target = (self._offset + cycle + 1) % _NUMBERS  # the command goes out with the frame after that cycle's
        set_stamp(reference[0], int(stamp_ns(sample)[0]) + (LEAD + 1) * self._period_ns)
        reference["sequence"] = target
        _plan(reference[0], setpoints, min(cycle, len(setpoints) - 1))  # the last one stands still
        self._asked[target] = _Question(cycle, now)
        self._put(reference.tobytes())
        self.published += 1

    def counts(self) -> dict[str, int]:
        """For the health message: questions, and answers that were not used."""
        return {
            "published": self.published,
            "repeated": self.refused["repeated"],
            "rejected": self.refused["rejected"] + self.refused["invalid"],
        }

    def summary(self) -> str:
        """How much of what came was used."""
        if not self.received:
            return "tau_FF: none was received over Zenoh; are `deltatwin estimate` and a tap running?"
        refused = self.refused
        return (
            f"tau_FF over Zenoh: fresh in {self._used} cycles, none in {self._unanswered} after the first; of "
            f"{self.received} answers {refused['invalid']} were not finite or beyond {self._peak:g} N m, "
            f"{refused['repeated']} repeated, {refused['rejected']} answered none of the last {FRESH_CYCLES} requests"
        )


def _plan(reference: np.void, setpoints: Setpoints, number: int) -> None:
    """Write the motion that cycle `number` of the setpoints ends with."""
    reference["position"] = setpoints.position[number]
    reference["velocity"] = setpoints.velocity[number]
    reference["acceleration"] = setpoints.acceleration[number]


def _said(answer: np.void) -> Answer:
    """What a FEEDFORWARD record says; the offset may be left out."""
    return Answer(answer["torque"].copy(), np.nan_to_num(answer["position_offset"]))


def _for_the_plan(answer: np.void) -> bool:
    """Whether a FEEDFORWARD record answers the planned motion; an estimator that fades out has nothing to say."""
    return bool(answer["source"] == FeedforwardSource.REFERENCE and not answer["flags"] & SampleFlag.FADING)
