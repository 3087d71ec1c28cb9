"""Effects that come on while the robot runs."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.motion import Planner
from drivers.simulated.plant.later import changes, later
from drivers.simulated.plant.plant import Plant
from drivers.simulated.plant.plant_trace import simulate
from schemas.errors import DataError
from schemas.robot import Robot

AT = 400  # cycle


def run(robot: Robot, planner: Planner, coming: dict[int, Plant]) -> tuple[np.ndarray, np.ndarray]:
    trace = simulate(Plant(robot), planner.slow(np.random.default_rng(0), 0.8), changes=coming)
    return trace.position, trace.torque


def test_a_plant_that_takes_over_goes_on_as_the_one_before(robot: Robot, planner: Planner) -> None:
    plain, torque = run(robot, planner, {})
    position, handed = run(robot, planner, {AT: Plant(robot)})
    np.testing.assert_allclose(position, plain, atol=1e-6)
    np.testing.assert_allclose(handed, torque, atol=0.05)


def test_an_effect_comes_on_when_it_is_said_to(robot: Robot, planner: Planner) -> None:
    plant = Plant(robot)
    one = later("torque_offset=0.5@0.4s", plant.described, seed=3)
    plain, torque = run(robot, planner, {})
    position, shifted = run(robot, planner, changes(plant, 3, [one]))
    np.testing.assert_array_equal(position[:AT], plain[:AT])
    (joint,) = one.effect.joints
    change = (shifted - torque)[-200:].mean(axis=0)
    assert abs(change[joint]) == pytest.approx(0.5, rel=0.05)
    assert np.abs(np.delete(change, joint)).max() < 0.02


def test_the_value_is_that_of_the_largest_joint_and_keeps_the_others_shares(robot: Robot) -> None:
    truth = Plant(robot).described
    drawn, sized = (later(f"stribeck_friction{value}@60s", truth, 1).effect for value in ("", "=3"))
    mine, theirs = np.array(drawn.breakaway_nm), np.array(sized.breakaway_nm)  # pyright: ignore[reportAttributeAccessIssue]
    assert theirs.max() == pytest.approx(3.0)
    np.testing.assert_allclose(theirs / theirs.max(), mine / mine.max())


def test_what_came_stays_when_more_comes(robot: Robot) -> None:
    """In the order of their times, whatever that of the options; each said with its figures."""
    plant = Plant(robot)
    last, first = (later(text, plant.described, 3) for text in ("backlash@2", "torque_offset=-0.5@0.4s"))
    made = changes(plant, 3, [last, first])
    cycles = [round(at / plant.period) for at in (0.4, 2.0)]
    assert list(made) == cycles
    assert [made[cycle].effects for cycle in cycles] == [(first.effect,), (first.effect, last.effect)]
    shown = [value for value in first.effect.offset_nm if value]  # pyright: ignore[reportAttributeAccessIssue]
    assert shown == [-0.5]
    assert first.in_words.startswith("torque_offset from 0.4 s: offset_nm ")
    assert sorted(first.in_words.split()[-1].split("/")) == ["-0", "-0", "-0.5"]
    drag = later("air_drag=2.5@1", plant.described, 3)
    assert drag.in_words == "air_drag from 1 s: drag_ns2pm2 2.5"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("stribeck_friction", "give NAME@SECONDS"),
        ("gremlins@60s", "unknown effect 'gremlins'"),
        ("backlash@soon", "'soon' is not a number"),
        ("backlash@-1s", "must be above zero"),
        ("backlash=nan@60", "'nan' is not a number"),
    ],
)
def test_what_cannot_be_read_is_said(robot: Robot, text: str, said: str) -> None:
    with pytest.raises(DataError, match=said):
        later(text, Plant(robot).described, 0)
