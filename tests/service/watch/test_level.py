"""What the gap is expected to be, by kind of motion."""

from __future__ import annotations

import numpy as np
import pytest

from service.watch.level import FULL_ROWS, KINDS, KNOWN_ROWS, SEEN_ROWS, Level, kinds

FLOOR = 0.1  # N m
REVERSAL = 0.05  # rad/s


def kind(speed: float, acceleration: float) -> int:
    """Of one joint."""
    return int(kinds(np.array([[speed]]), np.array([[acceleration]]))[0, 0])


def learnt(rows: dict[int, tuple[int, float]]) -> Level:
    """A level of one joint from rows of some kinds: kind -> how many, and their rms, N m."""
    level, square, count = Level(np.array([FLOOR])), np.zeros((KINDS, 1)), np.zeros((KINDS, 1))
    for one, (many, rms) in rows.items():
        square[one], count[one] = many * rms**2, many
    level.learn(square, count)
    return level


def test_a_kind_that_was_seen_for_moments_has_the_level_of_those_next_to_it() -> None:
    """As a fast motion's reversals, each at another acceleration."""
    below, here, above = (kind(REVERSAL, acceleration) for acceleration in (60.0, 100.0, 150.0))
    assert above - here == here - below == 1
    level = learnt({below: (50, 0.4), here: (SEEN_ROWS, 0.3), above: (50, 0.4)})
    assert level.known[here, 0]
    mean = (100 * 0.4**2 + SEEN_ROWS * 0.3**2) / (100 + SEEN_ROWS)
    assert level.mean_square[here, 0] == pytest.approx(mean)


def test_a_kind_that_was_not_seen_is_not_known_whatever_is_next_to_it() -> None:
    below, here, above = (kind(REVERSAL, acceleration) for acceleration in (60.0, 100.0, 150.0))
    level = learnt({below: (5000, 0.4), here: (SEEN_ROWS - 1, 0.3), above: (5000, 0.4)})
    assert not level.known[here, 0]
    assert level.known[below, 0]


def test_neighbours_of_another_speed_or_far_away_do_not_stand_in() -> None:
    here = kind(REVERSAL, 100.0)
    level = learnt({kind(0.15, 100.0): (5000, 0.4), kind(REVERSAL, 1.5): (5000, 0.4), here: (KNOWN_ROWS - 1, 0.3)})
    assert not level.known[here, 0]


def test_the_fastest_kind_is_not_held_against_what_slower_ones_left() -> None:
    """A wrong inertia leaves more the faster the motion is."""
    slow, fast = kind(REVERSAL, 100.0), kind(REVERSAL, 150.0)
    level = learnt({slow: (FULL_ROWS, 0.2), fast: (SEEN_ROWS, 0.5)})
    assert level.known[fast, 0]
    assert level.mean_square[fast, 0] == pytest.approx(0.5**2)


def test_after_so_many_rows_a_kind_is_learnt_no_more() -> None:
    """A level that crept up with a fault would never tell it."""
    here = kind(REVERSAL, 100.0)
    for first, mean in ((600, 0.3**2), (599, (0.3**2 + 0.9**2) / 2)):
        level, square, count = Level(np.array([FLOOR])), np.zeros((KINDS, 1)), np.zeros((KINDS, 1))
        square[here], count[here] = first * 0.3**2, first
        level.learn(square, count)
        square[here] = first * 0.9**2
        level.learn(square, count)
        assert level.mean_square[here, 0] == pytest.approx(mean)


def test_a_kind_that_is_known_well_speaks_for_itself_and_no_level_is_below_the_noise() -> None:
    here, next_ = kind(REVERSAL, 100.0), kind(REVERSAL, 150.0)
    level = learnt({here: (KNOWN_ROWS, 0.3), next_: (FULL_ROWS, FLOOR / 2)})
    assert level.mean_square[here, 0] == pytest.approx(0.3**2)
    assert level.mean_square[next_, 0] == pytest.approx(FLOOR**2)
