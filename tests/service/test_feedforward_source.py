"""Feed-forward over a real bus: answers that count, and everything else, which must end in no torque."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers.bus import Bus, open_bus
from drivers.ethercat.cia402 import Scale
from drivers.ethercat.setpoints import Setpoints
from drivers.ethercat.soem_master import OffsetRamp
from replay.clock import wait_until
from schemas.messages import FEEDFORWARD, SAMPLE, FeedforwardSource, Role, SampleFlag, set_stamp, stamp_ns
from service.feedforward_source import FRESH_CYCLES, OverBus

PERIOD, FADE, PEAK = 0.01, 0.05, 100.0
FADE_CYCLES = round(FADE / PERIOD)
FIRST_NUMBER = 5_000_000  # the tap has counted samples for hours
HOUR = 3600
TORQUE, AHEAD = np.array([30.0, -20.0, 10.0]), np.array([0.01, -0.02, np.nan])
SCALE = Scale(0, 1e-6, np.full(3, 0.1), None)  # pyright: ignore[reportArgumentType]
MOTION = np.outer(np.arange(400), [1e-3, 2e-3, -1e-3])
COURSE = Setpoints(MOTION, MOTION, MOTION, np.zeros(400, bool), 0)

Reply = Callable[["Talk", np.void], None]


class Talk:
    """A master's cycles at one end of a bus and, in the same thread, the answers to them at the other."""

    def __init__(self, master: Bus, estimator: Bus) -> None:
        self.over = OverBus(master, PEAK, PERIOD)
        self.offset = OffsetRamp(SCALE, PEAK, 1e9, FADE, PERIOD)
        self.references = estimator.subscribe("reference")
        self.publisher = estimator.publisher("feedforward")
        self.number = 0
        self.ahead: np.ndarray | None = None
        self.last = FEEDFORWARD.empty(1)
        self.asked: list[np.void] = []

    def answer(self, target: int, torque: np.ndarray = TORQUE, **fields: int) -> None:
        """To the newest sample, stamped with this host's wall clock, as a tap does where the bus has none."""
        message = self.last
        set_stamp(message, time.time_ns())
        message["sequence"], message["target_sequence"] = FIRST_NUMBER + self.number, target
        message["torque"], message["source"], message["flags"] = torque, FeedforwardSource.REFERENCE, 0
        message["position_offset"] = AHEAD
        for name, value in fields.items():
            message[name] = value
        self.publisher.put(message.tobytes())

    def run(self, cycles: int, reply: Reply) -> np.ndarray:
        """Torque at the drives in each cycle, (cycles, 3) N m. The master's own stamps count from 0."""
        torque, sample = [], SAMPLE.empty(1)
        begin = time.monotonic_ns()
        for cycle in range(cycles):
            wait_until(begin + round(cycle * PERIOD * 1e9))
            set_stamp(sample, round(self.number * PERIOD * 1e9))
            answer = self.over(sample, COURSE, self.number)
            self.ahead = None if answer is None else answer.position_offset
            self.offset.step(None if answer is None else answer.torque)
            torque.append(self.offset.torque)
            self.asked.extend(self.references.take()[0])
            reply(self, self.asked[-1] if self.asked else np.zeros(1, FEEDFORWARD.dtype)[0])
            self.number += 1
        return np.array(torque)


def good(talk: Talk, reference: np.void) -> None:
    talk.answer(int(reference["sequence"]))


@pytest.fixture
def talk(bus_folder: Path, until) -> Iterator[Talk]:
    with open_bus("rig", Role.MASTER) as master, open_bus("rig", Role.ESTIMATOR) as estimator:
        talk = Talk(master, estimator)
        until(lambda: talk.publisher.heard)
        yield talk


def test_answers_to_what_was_asked_reach_the_drives(talk: Talk) -> None:
    torque = talk.run(40, good)
    assert not talk.offset.stale
    np.testing.assert_array_equal(torque[-1], TORQUE)
    np.testing.assert_array_equal(talk.ahead, [0.01, -0.02, 0.0], "what is not said is none")
    asked = talk.asked[-1]
    command = int(asked["sequence"]) - FIRST_NUMBER - 1  # the cycle whose command that sample will carry
    np.testing.assert_array_equal(asked["position"], COURSE.position[command])
    assert int(stamp_ns(asked)) == round((command + 1) * PERIOD * 1e9)


def repeated(talk: Talk, reference: np.void) -> None:
    talk.publisher.put(talk.last.tobytes())


def an_hour_ahead(talk: Talk, reference: np.void) -> None:
    ahead = round(HOUR / PERIOD)
    talk.answer(int(reference["sequence"]) + ahead, stamp_sec=int(time.time()) + HOUR)


def late(talk: Talk, reference: np.void) -> None:
    talk.answer(int(talk.asked[max(0, len(talk.asked) - FRESH_CYCLES - 5)]["sequence"]))


def not_a_number(talk: Talk, reference: np.void) -> None:
    talk.answer(int(reference["sequence"]), np.array([1.0, math.nan, 1.0]))


def beyond_the_peak(talk: Talk, reference: np.void) -> None:
    talk.answer(int(reference["sequence"]), np.array([1.0, 1.0, -1.01 * PEAK]))


def unasked(talk: Talk, reference: np.void) -> None:
    talk.answer(int(reference["sequence"]), source=FeedforwardSource.ESTIMATE)


def fading(talk: Talk, reference: np.void) -> None:
    talk.answer(int(reference["sequence"]), flags=SampleFlag.FADING)


def last_numbers(talk: Talk, reference: np.void) -> None:
    talk.answer((1 << 64) - 1, sequence=(1 << 64) - 1)


@pytest.mark.parametrize(
    ("trouble", "counted"),
    [
        (repeated, None),  # `repeated` while the question is remembered, then `rejected`
        (an_hour_ahead, "rejected"),
        (late, "rejected"),
        (not_a_number, "invalid"),
        (beyond_the_peak, "invalid"),
        (unasked, "rejected"),
        (fading, "rejected"),
        (last_numbers, "rejected"),
    ],
)
def test_whatever_else_comes_ends_in_no_torque_within_the_declared_time_and_good_answers_bring_it_back(
    talk: Talk, trouble: Reply, counted: str | None
) -> None:
    talk.run(30, good)
    assert not talk.offset.stale
    before = dict(talk.over.refused)
    cycles = FRESH_CYCLES + FADE_CYCLES + 2  # what is on its way, and the rounding of two times
    torque = talk.run(cycles + 8, trouble)
    assert (torque[cycles:] == 0).all()
    steps = np.diff(np.abs(torque), axis=0)
    assert (steps <= 0).all()
    assert (np.abs(steps) <= np.abs(TORQUE) / FADE_CYCLES + 1e-9).all()  # faded, not cut
    assert talk.offset.stale
    refused = {name: count - before[name] for name, count in talk.over.refused.items()}
    assert sum(refused.values()) >= cycles
    assert counted is None or refused[counted] >= cycles
    torque = talk.run(30, good)
    np.testing.assert_array_equal(torque[-1], TORQUE)


def test_the_first_answer_to_a_question_counts(talk: Talk) -> None:
    def twice(talk: Talk, reference: np.void) -> None:
        good(talk, reference)
        talk.answer(int(reference["sequence"]), -TORQUE)

    torque = talk.run(40, twice)
    assert (torque[:, 0] >= 0).all(), "nothing of the second answers"
    np.testing.assert_array_equal(torque[-1], TORQUE)
    assert talk.over.refused["repeated"] >= 20
