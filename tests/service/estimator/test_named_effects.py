"""The online step with effects against the offline prediction of the same description, effect by effect."""

import numpy as np
import pytest

from schemas.errors import RobotError
from schemas.fitted import JointParameter
from schemas.robot import EffectEntry, EffectParameter
from service.estimator.estimator import Estimator
from service.estimator.named_effects import carried, pack_effects
from service.model.description import terms_of
from service.model.effects import CATALOGUE
from service.model.prediction import FULL, motion, predict_along
from service.model.signals import lowpass
from tests.known import PERIOD, trace_of

FOUND = {
    "stribeck_friction": {"f_s": 2.0, "v_s": 0.4},
    "asymmetric_friction": {"delta_c": 1.5, "delta_v": 0.3},
    "load_dependent_friction": {"mu": 0.08},
    "nonlinear_viscous_friction": {"f": 0.4, "p": 1.7},
    "position_dependent_friction": {"cosine": 1.0, "sine": -1.5, "order": 3.0},
    "warmup_friction": {"f": 1.2, "tau": 3.0},
    "rotor_inertia": {"delta_i": 0.05},
    "arm_mass": {"delta_m": 0.6},
    "joint_spring": {"k": 4.0, "preload": -2.0},
    "torque_offset": {"offset": 1.3},
    "torque_scale": {"epsilon": 0.06},
    "cogging": {"cosine": 0.8, "sine": 0.5, "order": 2.0},
    "link_length_error": {"error": 0.006},
    "forearm_length_error": {"error": 0.008},
    "base_radius_error": {"error": -0.006},
    "azimuth_error": {"error": 0.015},
    "joint_offset": {"error": 0.012},
    "tool_mass": {"delta_m": 0.7},
    "base_tilt": {"about_x": 0.02, "about_y": -0.03},
    "hose_spring": {"k": 30.0, "force_x": 4.0, "force_y": -6.0, "force_z": 9.0},
    "air_drag": {"c": 1.5},
    "shaft_friction": {"dry": 5.0, "viscous": 4.0},
    "passive_joint_friction": {
        "dry_elbow": 0.4, "dry_platform": 0.3, "viscous_elbow": 0.2, "viscous_platform": 0.1,
    },
    "angle_scale": {"epsilon": 0.01},
    "encoder_eccentricity": {"cosine": 4e-3, "sine": -3e-3, "order": 3.0},
    "presliding_friction": {"f": 3.0, "distance": 0.02},
    "joint_elasticity": {"natural_hz": 16.0, "damping_ratio": 0.12, "motor_share": 0.3},
    "backlash": {"half": 0.0015, "motor_share": 0.3},
    "torque_delay": {"delay": 0.0037},
    "torque_filter": {"cutoff": 30.0},
    "drive_lag": {"cutoff": 60.0},
}  # fmt: skip
# Not of the torque that a drive is to make, but of the one that is reported; or of what the drive makes of it.
OF_THE_REPORT = ("torque_delay", "torque_filter", "drive_lag")
# A strike's torque to the sample, and a step's through a drive's lag turned round, hang on the motion as each side
# smooths it; what they come to does not.
ROUGH = {"backlash": 20.0, "drive_lag": 20.0}  # Hz, below which they are compared
# Of the effect's own size; of an elastic gear it goes by the fourth derivative of the command, which the filter of the
# command only begins to know, and of a loose one by the moment of a strike.
CLOSE = {"joint_elasticity": 0.1, "backlash": 0.1}
OTHERS_CLOSE = 0.05


def effect(name: str, joints: list[int]) -> EffectEntry:
    parameters = {key: EffectParameter(value=value) for key, value in FOUND[name].items()}
    return EffectEntry(name=name, joints=joints, parameters=parameters)


def with_and_without(robot, name):
    """The robot with the effect and without, deaf to the torque, so that the effect is not taken for a payload."""
    whole = not next(entry for entry in CATALOGUE if entry.name == name).per_joint
    deaf = robot.identified.model_copy(update={"torque_noise_nm": JointParameter(value=[1e6, 1e6, 1e6])})
    plain = robot.model_copy(update={"identified": deaf})
    return plain.model_copy(update={"effect": [effect(name, [1, 2, 3] if whole else [2])]}), plain


def added(corrected, plain, trace):
    """What the effect adds offline, and where its joint's motion is one that both sides know: (N, 3) each."""
    along = motion(trace)
    offline = predict_along(corrected, trace, along)[FULL] - predict_along(plain, trace, along)[FULL]
    row = np.arange(len(trace))
    return offline, (np.abs(along.theta_dot) > 0.05) & ((row > 400) & (row < len(trace) - 60))[:, None]


def is_close(found, offline, known, name):
    if name in ROUGH:
        found, offline = (lowpass(values, PERIOD, ROUGH[name]) for values in (found, offline))
    size = np.sqrt(np.mean(np.where(known, offline, 0) ** 2))
    assert size > 0.05, "the effect shows"
    error = np.where(known, found - offline, 0)
    assert np.sqrt(np.mean(error**2)) < CLOSE.get(name, OTHERS_CLOSE) * size


@pytest.mark.parametrize("name", [name for name in FOUND if name not in (*OF_THE_REPORT, "backlash")])
def test_the_feed_forward_torque_is_the_offline_one(robot, make, name):
    """From commands, against the smoothed prediction."""
    corrected, plain = with_and_without(robot, name)
    trace = trace_of(run := make(2.0))
    online, without = (Estimator(one, PERIOD).run(run.samples).feedforward["torque"] for one in (corrected, plain))
    is_close(online - without, *added(corrected, plain, trace), name)


def reported(run, robot):
    """The samples with the torque that `robot` is said to report along them."""
    samples, trace = run.samples.copy(), trace_of(run)
    samples["torque"] = predict_along(robot, trace, motion(trace))[FULL]
    return samples


@pytest.mark.parametrize("name", FOUND)
def test_a_log_that_is_explained_offline_leaves_no_error_online(robot, make, name):
    """The look back on reports that the offline prediction made."""
    corrected, plain = with_and_without(robot, name)
    run = make(2.0)
    offline, known = added(corrected, plain, trace_of(run))
    error, base = (  # the second: what the base model leaves by its online motion
        Estimator(one, PERIOD).run(reported(run, one)).error for one in (corrected, plain)
    )
    rows, mine, other = np.intersect1d(error["sequence"], base["sequence"], return_indices=True)
    left = error["full"][mine] - base["full"][other]
    is_close(offline[rows] + left, offline[rows], known[rows], name)


def test_no_drive_is_asked_for_the_blow_of_a_loose_gear(robot, make):
    """Offline the blows are there; a loose link takes its own share from the drive while it flies, and no more."""
    corrected, plain = with_and_without(robot, "backlash")
    run = make(2.0)
    offline, _ = added(corrected, plain, trace_of(run))
    online, without = (Estimator(one, PERIOD).run(run.samples).feedforward["torque"] for one in (corrected, plain))
    assert np.abs(offline).max() > 1.5 * np.abs(without).max()
    assert 1.0 < np.abs(online - without)[400:].max() < np.abs(without).max()


@pytest.mark.parametrize("name", OF_THE_REPORT)
def test_what_a_report_does_is_no_part_of_the_torque_that_acts(robot, make, name):
    corrected, plain = with_and_without(robot, name)
    run = make(1.0)
    online, without = (Estimator(one, PERIOD).run(run.samples).feedforward["torque"] for one in (corrected, plain))
    if name == "drive_lag":  # the drive is asked for what it will only reach behind its lag
        lag = 1.0 / (2 * np.pi * FOUND[name]["cutoff"])
        led = without[1:] + lag * np.diff(without, axis=0) / PERIOD
        slides = np.abs(run.theta_dot[100:]) > 0.3  # a reversal's step is led too, as far as the bounds let it
        np.testing.assert_allclose(online[100:][slides], led[99:][slides], atol=0.02)
    else:
        np.testing.assert_array_equal(online, without)


def test_every_effect_of_the_catalogue_is_carried():
    assert {entry.name for entry in CATALOGUE} == {entry.name for entry in CATALOGUE if carried(entry)} == set(FOUND)


def test_several_joints_have_amplitudes_of_their_own(robot):
    parameters = {"f_s_1": 1.0, "f_s_3": 3.0, "v_s": 0.2}
    entry = EffectEntry(
        name="stribeck_friction", joints=[1, 3], parameters={k: EffectParameter(value=v) for k, v in parameters.items()}
    )
    record = pack_effects(terms_of(robot.model_copy(update={"effect": [entry]})))[0]
    assert record["joint"].tolist() == [1, 0, 1]
    assert record["amplitude"][:, 0].tolist() == [1.0, 0.0, 3.0]
    assert record["nonlinear"][0] == 0.2


def test_a_missing_parameter_is_named(robot):
    parameters = {"cosine": EffectParameter(value=1.0), "order": EffectParameter(value=2.0)}
    broken = robot.model_copy(update={"effect": [EffectEntry(name="cogging", joints=[2], parameters=parameters)]})
    with pytest.raises(RobotError, match="effect cogging: parameter 'sine' is missing"):
        Estimator(broken, PERIOD)
