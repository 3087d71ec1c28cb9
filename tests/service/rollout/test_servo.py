"""Logs of MuJoCo's closed loop: the drives found in them, the simulated robot that follows, and what it carries."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.motion import MotionLimits, Payload, Planner
from drivers.simulated.plant.plant import Plant
from drivers.simulated.plant.plant_trace import simulate
from schemas.errors import DataError
from schemas.fitted import JointParameter
from schemas.messages import Gripper, SampleFlag
from schemas.robot import Robot, Servo
from schemas.trace import Trace
from service.rollout.gap import PLAIN, cut_up, plain, rollout, run
from service.rollout.kernel import Drives, Runs
from service.rollout.packed import stretch
from service.rollout.rollout_page import document, sentences
from service.rollout.servo import commands_of, gains_of
from tests.service.subject import Hypothesis, described, segments
from tests.service.world import BASE, COULOMB, PERIOD, ROBOT, TRANSITION, TRUTH, VISCOUS

HERTZ, SPEED_HERTZ = 8.0, 30.0
MASS = 2.5  # kg


@pytest.fixture(scope="module")
def plant() -> Plant:
    truth = TRUTH.model_copy(
        update={
            "coulomb_friction_nm": COULOMB.tolist(),
            "viscous_friction_nms": VISCOUS.tolist(),
            "creep_radps": TRANSITION,
            "torque_noise_nm": [0.3] * 3,
            "encoder_counts_per_turn": float(2**20),
            "position_bandwidth_hz": HERTZ,
            "velocity_bandwidth_hz": SPEED_HERTZ,
            "integral_time_s": 0.05,
            "peak_torque_nm": 250.0,
        }
    )
    return Plant(ROBOT, truth, (), PERIOD, 1)


@pytest.fixture(scope="module")
def trace(plant: Plant) -> Trace:
    planner = Planner(ROBOT, PERIOD, MotionLimits(speed=8.0, acceleration=200.0, torque=80.0))
    return simulate(plant, planner.multisine(np.random.default_rng(2), 2.0), "log")


def known() -> Robot:
    carrying = described(ROBOT, Hypothesis(BASE), np.zeros(11), np.full(3, 0.3))
    assert isinstance(carrying, Robot)
    assert carrying.identified is not None
    left = carrying.identified.model_copy(update={"model_error_nm": JointParameter(value=[0.05] * 3)})
    return carrying.model_copy(update={"identified": left})


def test_the_drives_are_found_and_the_known_robot_follows_as_the_real_one_does(plant: Plant, trace: Trace) -> None:
    robots = {PLAIN: plain(ROBOT), "known": known()}
    found = rollout(robots, cut_up(robots, [trace]), commands=True)
    servo = found.servo
    assert servo is not None
    np.testing.assert_allclose(servo.velocity_gain_nms, plant.tuning.velocity_gain, rtol=0.1)
    np.testing.assert_allclose(servo.position_gain_ps, 2 * np.pi * HERTZ, rtol=0.15)
    np.testing.assert_allclose(servo.velocity_feedforward, 1.0, atol=0.05)
    drawn, followed = found.deviations
    assert followed.good.all()
    assert followed.platform_mm < 0.3 * drawn.platform_mm
    assert (followed.torque_nm < 0.5 * drawn.torque_nm).all()
    made = document(found, robots, ["log"])
    assert made.servo == servo
    assert len(made.robots[-1].torque_nm) == len(made.floor.torque_nm) == 3


def test_described_drives_are_taken_as_they_are(trace: Trace) -> None:
    soft = Servo(position_gain_ps=[5.0] * 3, velocity_gain_nms=[2.0] * 3)
    robots = {"soft": known().model_copy(update={"servo": soft})}
    found = rollout(robots, cut_up(robots, [trace]), commands=True)
    assert found.servo == soft
    assert found.deviations[0].platform_mm > 1.0  # drives as weak as these do not hold the course


def test_a_log_without_commands_or_whose_torque_does_not_follow_them_is_refused(trace: Trace) -> None:
    robots = {"known": known()}
    with pytest.raises(DataError, match="log: contains no position commands"):
        rollout(robots, cut_up(robots, [replace(trace, position_command=None)]), commands=True)
    assert trace.position_command is not None
    holed = trace.position_command.copy()
    holed[700, 1] = np.nan
    with pytest.raises(DataError, match="row 701: no position command of joint 2"):
        rollout(robots, cut_up(robots, [replace(trace, position_command=holed)]), commands=True)
    with pytest.raises(DataError, match=r"torque of joint 1 does not follow .* describe the drives in \[servo\]"):
        rollout(robots, cut_up(robots, [replace(trace, position_command=trace.position.copy())]), commands=True)


def test_the_drives_begin_with_the_torque_that_there_is_and_hold_no_more_than_their_peak(trace: Trace) -> None:
    robot = known()
    (segment,) = segments(trace)
    seen = stretch(robot, segment, trace.position[segment.rows])
    command = commands_of(trace, segment)
    begin, length = np.array([300, 700, 1100]), 80
    windows = np.stack([command[row : row + length] for row in begin])
    driven = np.stack([segment.torque[row : row + length] for row in begin])
    given = driven[:, 0]
    described = Servo(position_gain_ps=[30.0] * 3, velocity_gain_nms=[20.0] * 3, integral_time_s=[0.05] * 3)
    for peak in (250.0, 8.0):
        gains = gains_of(described.model_copy(update={"peak_torque_nm": peak}), 1.0)
        runs = Runs(seen.start[begin], driven, np.zeros(3), segment.time[begin] - segment.time[0])
        motor, torque = run(seen, runs, segment.period, Drives(gains, windows))
        np.testing.assert_array_equal(motor[:, 0], seen.start[begin, 2])
        np.testing.assert_allclose(torque[:, 0], np.clip(given, -peak, peak), atol=1e-9)
        assert np.abs(torque).max() <= peak
    assert (np.abs(torque) == 8.0).any()
    assert gains_of(described, 7.0).peak == 7.0, "where the drives' own is not described"


@pytest.fixture(scope="module")
def carrying(plant: Plant) -> tuple[Trace, tuple[Payload, ...]]:
    planner = Planner(ROBOT, PERIOD, MotionLimits(speed=8.0, acceleration=200.0, torque=80.0))
    picks = planner.pick_and_place(np.random.default_rng(3), 4.0, (MASS,))
    return simulate(plant, picks, "picks"), picks.payloads


@pytest.mark.parametrize("commands", [False, True])
def test_what_the_log_says_is_carried_hangs_on_the_simulated_robot(carrying, commands: bool) -> None:
    trace, picks = carrying
    robots = {PLAIN: plain(ROBOT), "known": known()}
    found = rollout(robots, cut_up(robots, [trace], 0.1), commands=commands)
    loaded = found.cuts.payload > 0.5
    assert min(loaded.sum(), (~loaded).sum()) >= 4
    np.testing.assert_allclose(found.cuts.payload[loaded], MASS, rtol=0.03)
    assert not found.cuts.payload[~loaded].any()
    assert found.cuts.untold > 0.2 * len(picks), "while a mass changes it is not told"
    off, floor = (
        np.linalg.norm(deviation.platform[:, -1], axis=1) for deviation in (found.deviations[-1], found.floor)
    )
    print(f"{1e3 * np.median(off[loaded]):.3f} mm loaded, {1e3 * np.median(off[~loaded]):.3f} empty")
    assert np.median(off[loaded]) < 3.0 * np.median(floor)
    said = sentences(document(found, robots, ["picks"]))
    assert not any("of another robot" in line for line in said), "the load is no strange torque"
    every = f"In {loaded.sum()} of {len(loaded)} windows every simulated robot carries 2.5"
    assert any(line.startswith(every) for line in said)
    assert any("s are left out, as the data do not show the payload there" in line for line in said)
    full = [(trace, replace(cut, mass=np.full(len(cut.mass), 0.7))) for trace, cut in found.cuts.parts]
    never_empty = replace(found, cuts=replace(found.cuts, parts=full))
    for one, told in ((found, False), (never_empty, True)):
        said = sentences(document(one, robots, ["picks"]))
        assert any("a tool that the description lacks" in line for line in said) == told


def test_what_cannot_be_weighed_is_not_simulated(carrying) -> None:
    trace, picks = carrying
    clock = trace.time[:, None] - trace.time[0]
    held = ((clock >= [pick.pick for pick in picks]) & (clock < [pick.release for pick in picks])).any(axis=1)
    drawn = {"drawn": plain(ROBOT)}
    blind = rollout(drawn, cut_up(drawn, [trace]))
    assert blind.cuts.untold == 0.0
    assert not blind.cuts.payload.any()
    gripping = replace(trace, gripper=np.where(held, Gripper.CLOSED, Gripper.OPEN).astype(np.uint32))
    flagged = replace(trace, flags=trace.flags | (held * np.uint32(SampleFlag.LOADED)))
    for told in (gripping, flagged):
        found = rollout(drawn, cut_up(drawn, [told]))
        assert found.cuts.untold > 1.0
        assert len(found.cuts.runs) < 0.7 * len(blind.cuts.runs)
