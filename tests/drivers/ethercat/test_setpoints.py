"""What a master commands: the way to a motion, pauses, the motion; nothing of it copied while drives wait."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.ethercat.setpoints import APPROACH_SPEED, SETTLE, SetpointPlan
from drivers.motion import Planner, Trajectory
from schemas.errors import BusError
from schemas.robot import load_robot

PERIOD = 4e-3
RANGE = [-1.6, 2.2]
PAUSE = round(SETTLE / PERIOD)


@pytest.fixture(scope="module")
def motion() -> Trajectory:
    planner = Planner(load_robot("d3-1200"), PERIOD)
    return planner.pick_and_place(np.random.default_rng(1), 2.5, (1.5,), speed=0.3)


def test_from_where_the_drives_hold_through_the_motion(motion: Trajectory) -> None:
    course = SetpointPlan(motion, RANGE)
    for start in (motion.position[0] + [0.3, -0.5, 0.1], np.full(3, RANGE[0]), motion.position[0]):
        plan = course.begin(start)
        end = plan.begin + len(motion.position)
        assert len(plan) == len(plan.velocity) == len(plan.grip) == end + PAUSE <= len(course)
        np.testing.assert_array_equal(plan.position[plan.begin : end], motion.position)
        np.testing.assert_array_equal(plan.velocity[plan.begin : end], motion.velocity)
        np.testing.assert_array_equal(plan.acceleration[plan.begin : end], motion.acceleration)
        np.testing.assert_allclose(plan.position[plan.begin - PAUSE - 1], motion.position[0])
        assert (plan.position[plan.begin - PAUSE : plan.begin] == motion.position[0]).all()
        assert (plan.position[end:] == motion.position[-1]).all()
        assert not plan.velocity[end:].any()
        way = np.diff(np.vstack([start, plan.position[: plan.begin]]), axis=0) / PERIOD
        assert np.abs(way).max() < 1.01 * APPROACH_SPEED
        held = [range(round(p.pick / PERIOD), round(p.release / PERIOD)) for p in motion.payloads]
        assert (np.flatnonzero(plan.grip) - plan.begin).tolist() == [k for cycles in held for k in cycles]


def test_the_motion_is_not_copied_while_the_drives_wait(motion: Trajectory) -> None:
    course = SetpointPlan(motion, RANGE)
    first, second = course.begin(motion.position[0]), course.begin(motion.position[0] + 0.2)
    for name in ("position", "velocity", "acceleration", "grip"):
        assert np.shares_memory(getattr(first, name), getattr(second, name))


def test_a_start_out_of_reach_is_named(motion: Trajectory) -> None:
    with pytest.raises(BusError, match=r"^joints at 9, 9, 9 rad: further from the motion's start than geometry\."):
        SetpointPlan(motion, RANGE).begin(np.full(3, 9.0))
