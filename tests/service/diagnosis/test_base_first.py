"""Is the base right, is the loop open, is the noise known? Asked before any effect is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from schemas.axes_description import Axes, Axis
from schemas.errors import DataError
from schemas.trace import Trace
from service.identification.joint_machines import identify_axes
from tests.service.diagnosis.said import sentences
from tests.service.subject import CATALOGUE, EFFECTS, diagnose, document
from tests.service.world import PERIOD, direction, sines

SECONDS = 5.0


def two_axes(
    seed: int, coupling: float, weight: float = 0.0, noise: float = 0.05, lag: float = 0.0, rubs: float = 0.0
) -> Trace:
    """Two axes of 0.5 kg m^2; `coupling` kg m^2 of the first in the second, `weight` N m on the second. lag: s by which
    first-order drives lag the command, which is what is logged. rubs: share of its weight that the second's gear loses
    as friction, its motor doing the accelerating."""
    time = np.arange(round(SECONDS / PERIOD)) * PERIOD
    theta, speed, acceleration = (signal[:, :2] for signal in sines(seed, 0.8)(time))
    random = np.random.default_rng([seed, 3])
    torque = 0.5 * acceleration + 0.4 * speed + 0.6 * direction(speed)
    torque[:, 1] += coupling * acceleration[:, 0] + weight * np.sin(theta[:, 1])
    torque[:, 1] += rubs * np.abs(weight * np.sin(theta[:, 1])) * direction(speed)[:, 1]
    torque += lag * np.gradient(torque, PERIOD, axis=0)
    torque += noise * random.standard_normal(torque.shape)
    return Trace(Path(f"run_{seed}.csv"), time, theta + 1e-7 * random.standard_normal(theta.shape), torque)


def axes(**keys) -> Axes:
    return Axes(name="two", kind="axes", axis=[Axis(**keys), Axis(**keys)])


def told(robot: Axes, traces: list[Trace], names: tuple[str, ...] | None = None):
    effects = CATALOGUE if names is None else [EFFECTS[name] for name in names]
    return document.document(diagnose.diagnose(robot, traces, effects))


def test_an_axis_that_feels_another_is_a_wrong_base_and_no_effect():
    found = told(axes(), [two_axes(seed, 0.3) for seed in (1, 2, 3)])
    assert found.effects == []
    assert ("other_joints", [2, 1]) in [(one.code, one.joints) for one in found.cannot_tell]
    first = found.follows[0]
    assert (first.joint, first.what, first.other) == (2, "motion", 1)
    assert first.share > 0.8
    assert "follows the motion of joint 1" in " ".join(sentences(found))


def test_axes_that_do_not_feel_each_other_have_no_such_doubt():
    found = told(axes(), [two_axes(seed, 0.0) for seed in (1, 2, 3)], ("cogging", "torque_offset"))
    assert found.verdict == "within_noise"
    assert found.follows == []
    assert {one.code for one in found.cannot_tell} == set()


def test_a_weight_that_the_description_denies_is_not_cogging_of_order_one():
    """Of a swinging arm inertia takes most of the weight's torque: what follows the sine is asked beside it."""
    found = told(axes(gravity=False), [two_axes(seed, 0.0, weight=2.0) for seed in (1, 2, 3)], ("cogging",))
    assert found.effects == []
    assert ("sine_of_angle", [2]) in [(one.code, one.joints) for one in found.cannot_tell]


def test_a_weight_behind_another_gear_ratio_is_not_cogging():
    """Half the angle makes it go twice round where the joint turns once; no such turn is in the logs."""
    runs = [two_axes(seed, 0.0, weight=2.0) for seed in (1, 2, 3)]
    found = told(axes(), [replace(run, position=run.position * [1.0, 0.5]) for run in runs], ("cogging",))
    assert found.effects == []
    assert ("sine_of_angle", [2]) in [(one.code, one.joints) for one in found.cannot_tell]


def test_friction_that_grows_with_the_weight_is_told_from_a_tight_spot():
    """What accelerates the rotor does not load the teeth. Named was friction over the angle, 2.4 periods a turn."""
    runs = [two_axes(seed, 0.0, weight=8.0, rubs=0.12) for seed in (1, 2, 3)]
    found = told(axes(), runs, ("load_dependent_friction", "position_dependent_friction", "stribeck_friction"))
    assert [(effect.name, effect.joints) for effect in found.effects] == [("load_dependent_friction", [2])]
    figures = found.effects[0].parameters
    assert figures["mu"].value == pytest.approx(0.12, rel=0.05)
    assert figures["motor_share"].value == 1.0
    assert found.verdict == "explained"


def test_friction_that_levels_off_is_no_stribeck_friction():
    """Rising as the arc tangent of speed, it was a Stribeck friction above a slow transition, at 100 %."""
    runs = [two_axes(seed, 0.0, noise=0.02) for seed in (1, 2, 3)]
    speeds = [np.gradient(run.position, PERIOD, axis=0) * [0.0, 1.0] for run in runs]

    def more(rubs):
        return [replace(run, torque=run.torque + rubs(v)) for run, v in zip(runs, speeds, strict=True)]

    found = told(axes(), more(lambda v: 2.0 * np.arctan(v / 0.08)), ("stribeck_friction",))
    assert found.effects == []
    assert ("does_not_fall", [2]) in [(one.code, one.joints) for one in found.cannot_tell]
    assert "the fitted friction does not fall as the speed grows" in " ".join(sentences(found))
    falls = told(axes(), more(lambda v: direction(v) * np.exp(-((v / 0.2) ** 2))), ("stribeck_friction",))
    assert [(effect.name, effect.joints) for effect in falls.effects] == [("stribeck_friction", [2])]


def test_friction_over_a_part_of_a_turn_is_no_tight_spot_where_a_weight_may_cause_it():
    runs = [two_axes(seed, 0.0, weight=8.0, rubs=0.12) for seed in (1, 2, 3)]
    found = told(axes(), runs, ("position_dependent_friction",))
    assert found.effects == []
    assert ("by_weight", [2]) in [(one.code, one.joints) for one in found.cannot_tell]
    assert "friction which grows with the weight looks the same" in " ".join(sentences(found))


def test_a_tight_spot_at_one_end_of_the_travel_is_no_doing_of_the_weight():
    runs = [two_axes(seed, 0.0, weight=8.0) for seed in (1, 2, 3)]
    forward = [np.sign(np.gradient(run.position, axis=0)) * [0.0, 1.0] for run in runs]
    tight = [
        replace(run, torque=run.torque + np.sin(1.5 * run.position) * sign)
        for run, sign in zip(runs, forward, strict=True)
    ]
    found = told(axes(), tight, ("load_dependent_friction", "position_dependent_friction"))
    assert [(effect.name, effect.joints) for effect in found.effects] == [("position_dependent_friction", [2])]
    assert found.effects[0].parameters["order"].value == pytest.approx(1.5, rel=0.05)


def test_a_drive_that_lags_its_logged_command_is_no_elastic_gear():
    """At 25 Hz the torque is a delay to first order; which stood in for it at 100 %, or an elastic gear did."""
    names = (
        "drive_lag",
        "torque_filter",
        "torque_delay",
        "joint_elasticity",
        "rotor_inertia",
        "load_dependent_friction",
    )
    found = told(axes(), [two_axes(seed, 0.0, 1.0, lag=0.5 / (25 * np.pi)) for seed in (1, 2, 3)], names)
    assert [effect.name for effect in found.effects] == ["drive_lag"]
    assert found.effects[0].parameters["cutoff"].value == pytest.approx(25.0, rel=0.03)
    assert found.verdict == "explained"


def answered(seed: int, delay: int = 0, uneven: float = 0.0) -> Trace:
    """One axis on a spring drive: torque is 40 N m/rad times the position error, `delay` samples later, and a share of
    it `uneven`."""
    made = two_axes(seed, 0.0, noise=0.0)
    error = made.torque / 40.0 * (1.0 + uneven * np.sin(7.0 * made.time[:, None]))
    command = made.position + np.roll(error, -delay, axis=0)
    return Trace(made.path, made.time, made.position, made.torque, position_command=command)


def test_torque_that_answers_the_position_error_is_a_closed_loop():
    found = told(axes(), [answered(seed) for seed in (1, 2, 3)], ("torque_delay", "torque_filter", "torque_scale"))
    loops = [one for one in found.cannot_tell if one.code == "closed_loop"]
    assert [one.joints for one in loops] == [[1], [2]]
    assert [one.gain for one in loops] == pytest.approx([40.0, 40.0], rel=0.01)
    assert "was not measured" in " ".join(sentences(found))


def test_torque_that_the_base_model_tells_better_than_the_position_error_was_measured():
    found = told(axes(), [answered(seed, uneven=0.1) for seed in (1, 2, 3)], ("torque_delay",))
    assert "closed_loop" not in [one.code for one in found.cannot_tell]


def test_smooth_torque_has_no_floor_to_be_read_and_that_is_said():
    result = told(axes(), [two_axes(seed, 0.0, noise=0.0) for seed in (1, 2, 3)], ("torque_offset",))
    assert [one.code for one in result.cannot_tell] == ["noise_unknown"]
    assert "shows no noise of its own" in " ".join(sentences(result))
    ratio = np.array(result.gap.before_nm) / np.array(result.gap.noise_floor_nm)
    assert (ratio < 10).all()


def test_a_weight_by_degrees_that_were_taken_for_radians_is_no_spring():
    """Over one degree the sine of a weight is a straight line; where the description says that there is no weight, it
    is a spring's. Named was a spring, 100 %."""
    runs = []
    for seed in (1, 2, 3):
        run = two_axes(seed, 0.0)
        time = run.time
        theta, speed, acceleration = (0.02 * signal[:, :2] for signal in sines(seed, 0.8)(time))
        torque = 0.5 * acceleration + 0.4 * speed + 0.1 * direction(speed)
        torque[:, 1] += 6.0 * np.sin(theta[:, 1])
        torque += 0.01 * np.random.default_rng([seed, 4]).standard_normal(torque.shape)
        runs.append(replace(run, position=np.degrees(theta), torque=torque))
    found = told(axes(), runs, ("joint_spring", "cogging"))
    assert found.effects == []
    assert [(one.joints, one.effect) for one in found.cannot_tell if one.code == "degrees"] == [([2], "joint_spring")]
    assert 'unit = "deg"' in " ".join(sentences(found))
    declared = told(axes(gravity=False), runs, ("joint_spring", "cogging"))
    assert [one.name for one in declared.effects] == ["joint_spring"]


@pytest.mark.parametrize("dead", [0.0, 1.3])
def test_a_torque_that_was_not_recorded_is_no_machine_without_friction(dead: float):
    """Was: within the noise, 0 N m between model and robot."""
    good, bad = two_axes(1, 0.0), two_axes(2, 0.0)
    bad.torque[:, 1] = dead
    for answer in (lambda: told(axes(), [good, bad], ()), lambda: identify_axes(axes(), [good, bad])):
        with pytest.raises(DataError, match=r"run_2: joint 2 moves and its torque is .* throughout: was it recorded"):
            answer()
