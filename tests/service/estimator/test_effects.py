"""The online step with effects against the offline prediction of the same description, effect by effect."""

import numpy as np
import pytest

from schemas.errors import RobotError
from schemas.robot import EffectEntry, EffectParameter, JointParameter
from service.estimator.effects import carried, pack_effects
from service.estimator.estimator import Estimator
from service.model.description import terms_of
from service.model.effects import CATALOGUE
from service.model.prediction import FULL, motion, predict_along
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
}
NOT_CARRIED = {
    "presliding_friction", "passive_joint_friction", "joint_elasticity", "backlash", "torque_delay", "torque_filter",
    "drive_lag", "encoder_eccentricity", "angle_scale",
}  # fmt: skip


def effect(name: str, joints: list[int]) -> EffectEntry:
    parameters = {key: EffectParameter(value=value) for key, value in FOUND[name].items()}
    return EffectEntry(name=name, joints=joints, parameters=parameters)


@pytest.mark.parametrize("name", FOUND)
def test_the_online_torque_is_the_offline_one(robot, make, name):
    """Feed-forward from commands against the smoothed prediction; both are within a small part of the effect."""
    whole = not next(entry for entry in CATALOGUE if entry.name == name).per_joint
    # deaf to the torque, so that the effect is not taken for a payload
    deaf = robot.identified.model_copy(update={"torque_noise_nm": JointParameter(value=[1e6, 1e6, 1e6])})
    robot = robot.model_copy(update={"identified": deaf})
    corrected = robot.model_copy(update={"effect": [effect(name, [1, 2, 3] if whole else [2])]})
    known = make(2.0)
    trace = trace_of(known)
    online = Estimator(corrected, PERIOD).run(known.samples).feedforward["torque"]
    plain = Estimator(robot, PERIOD).run(known.samples).feedforward["torque"]
    along = motion(trace)
    offline = predict_along(corrected, trace, along)[FULL] - predict_along(robot, trace, along)[FULL]
    moving = (
        (np.abs(known.theta_dot) > 0.05)
        & (np.arange(len(trace)) > 60)[:, None]
        & (np.arange(len(trace)) < len(trace) - 60)[:, None]
    )
    added = np.where(moving, offline, 0)
    size = np.sqrt(np.mean(added**2))
    assert size > 0.05, "the effect shows"
    error = np.where(moving, (online - plain) - offline, 0)
    assert np.sqrt(np.mean(error**2)) < 0.05 * size


def test_every_catalogue_effect_is_carried_or_known_not_to_be():
    assert {entry.name for entry in CATALOGUE if carried(entry)} == set(FOUND)
    assert {entry.name for entry in CATALOGUE} - set(FOUND) == NOT_CARRIED


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
