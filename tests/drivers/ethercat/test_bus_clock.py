"""What the master makes of a distributed clock, whatever that says."""

from __future__ import annotations

import pytest

from drivers.ethercat.bus_clock import ANEW, BusClock

PERIOD = 1_000_000  # ns
BEGIN = 830_000_000_000_000_000  # a clock that counts from the year 2000


def started() -> BusClock:
    clock = BusClock(PERIOD)
    for number in range(10):
        assert clock.step(1, BEGIN + number * PERIOD) == 1
    assert clock.stamp == BEGIN + 9 * PERIOD
    return clock


def test_the_clock_counts_the_cycles_that_this_host_was_too_late_for() -> None:
    clock = started()
    assert clock.step(4, BEGIN + 13 * PERIOD) == 4
    assert clock.step(4, BEGIN + 14 * PERIOD) == 1  # the bus's own time tells how many there were
    assert clock.step(1, None) == 1
    assert clock.stamp == BEGIN + 15 * PERIOD


@pytest.mark.parametrize("reading", [0, 1, 1 << 62, (1 << 64) - 1, BEGIN + 3600 * 10**9, BEGIN - 3600 * 10**9])
def test_one_reading_that_cannot_be_right_is_counted_and_passed_over(reading: int) -> None:
    clock = started()
    assert clock.step(1, reading) == 1
    assert (clock.stamp, clock.odd, clock.odd_ever) == (BEGIN + 10 * PERIOD, 1, 1)
    assert clock.step(1, BEGIN + 11 * PERIOD) == 1
    assert (clock.stamp, clock.odd, clock.odd_ever) == (BEGIN + 11 * PERIOD, 0, 1)


@pytest.mark.parametrize("slip", [3600 * 10**9, -3600 * 10**9])
def test_a_clock_that_slipped_is_believed_once_it_goes_on_evenly(slip: int) -> None:
    clock = started()
    for number in range(10, 9 + ANEW):
        assert clock.step(1, BEGIN + slip + number * PERIOD) == 1
        assert clock.stamp == BEGIN + number * PERIOD
    assert clock.step(1, BEGIN + slip + (9 + ANEW) * PERIOD) == 1  # the slip is no measure of cycles
    assert clock.stamp == BEGIN + slip + (9 + ANEW) * PERIOD
    assert clock.step(1, BEGIN + slip + (10 + ANEW) * PERIOD) == 1
    assert clock.odd == 0


def test_a_clock_that_cannot_be_stamped_is_never_believed() -> None:
    clock = started()
    for number in range(4 * ANEW):
        clock.step(1, (1 << 63) + number * PERIOD)
    assert clock.stamp == BEGIN + (9 + 4 * ANEW) * PERIOD


def test_a_clock_of_32_bits_goes_on_over_its_wrap() -> None:
    clock, begin = BusClock(PERIOD), (1 << 32) - 3 * PERIOD
    for number in range(8):
        clock.step(1, (begin + number * PERIOD) & 0xFFFFFFFF)
    assert (clock.stamp, clock.odd_ever) == (begin + 7 * PERIOD, 0)
