"""The form of an effect inside the online step against the one offline, on one exact motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.model.coulomb_viscous import SOFT, ball_joint_kernel
from service.model.dynamics import TERMS, terms_kernel
from service.model.effects.base import Instant
from service.model.kinematics import POSE
from service.model.nominal import record_of
from tests.service.injected import INJECTED
from tests.service.subject import EFFECTS, added
from tests.service.world import PERIOD, ROBOT, course, scene, stub

ONLINE = [name for name, effect in EFFECTS.items() if effect.online is not None]
INSTANT = [name for name in ONLINE if not EFFECTS[name].memory]
EVERY = 23  # samples
LEANING = ROBOT.model_copy(update={"gravity_mps2": (2.0, -3.5, -9.0)})  # no component stands for another


def test_what_is_no_torque_of_a_joint_has_no_online_form():
    assert set(EFFECTS) - set(ONLINE) == {
        "joint_elasticity", "backlash", "encoder_eccentricity", "angle_scale", "torque_delay", "torque_filter",
        "drive_lag",
        # in the settings of the online model
        "torque_scale", "link_length_error", "forearm_length_error", "base_radius_error", "azimuth_error",
        "joint_offset", "base_tilt",
    }  # fmt: skip


@pytest.mark.parametrize("name", INSTANT)
def test_the_online_torque_is_the_offline_one(name):
    here = scene(course(1, 1.0), robot=LEANING)
    injected, effect = INJECTED[name], EFFECTS[name]
    arms, motion, model = here.arms, here.segment, here.delta.model
    # an even power of a speed, whole cycles of a turn: not what a sign or a slip shows at
    nonlinear = tuple(1.13 * value for value in injected.nonlinear)
    offline = added(here, replace(injected.term(name), nonlinear=nonlinear))
    amplitude = np.zeros((3, 4))
    for place, joint in enumerate(injected.joints or (0,)):
        amplitude[joint, : len(injected.amplitude[place])] = injected.amplitude[place]
    record = stub(amplitude=amplitude, nonlinear=np.array([*nonlinear, 0.0, 0.0]))
    # the platform's acceleration by differences of its velocity, which is closed form
    acceleration = np.gradient(arms.velocity, PERIOD, axis=0, edge_order=2)
    lever = np.einsum("nia,nia->ni", arms.forearm, arms.slope)
    form = effect.online.py_func  # pyright: ignore[reportFunctionMemberAccess, reportOptionalMemberAccess]
    checked = 0
    for k in range(EVERY, len(motion.time) - EVERY, EVERY):
        columns = (arms.jacobian[k] / lever[k]).T  # J[axis, i] = column[i, axis] lever[i]
        pose = np.zeros((), POSE).view(np.recarray)
        pose["position"], pose["velocity"], pose["acceleration"] = arms.position[k], arms.velocity[k], acceleration[k]
        pose["column"], pose["elbow"], pose["lever"] = columns, arms.slope[k], lever[k]
        pose["forearm"] = arms.forearm[k]
        now = Instant(
            model, float(here.mechanism.gear_ratio[0]), motion.theta[k], motion.theta_dot[k],
            motion.theta_ddot[k], here.direction[k], here.load[k], float(motion.time[k]), pose[()], np.zeros(3),
        )  # fmt: skip
        found = np.array([form(record, now, i) for i in range(3)])
        if effect.per_joint:
            found = [found[i] if i in injected.joints else 0.0 for i in range(3)]
        np.testing.assert_allclose(found, offline[k], rtol=1e-4, atol=1e-4 * np.abs(offline).max())
        checked += bool(np.abs(offline[k]).max() > 0.0)
    assert checked > 20


def test_ball_joints_rub_as_the_effect_has_it():
    """Samples in which every forearm turns against both its neighbours."""
    here = scene(course(1, 1.0))
    model, motion, arms = record_of(here.delta.model), here.segment, here.arms
    offline = EFFECTS["passive_joint_friction"].regressors(here, 0, ())
    turn = np.cross(arms.forearm, arms.swing) / here.delta.model.passive_length[:, None] ** 2
    rates = np.linalg.norm([turn, turn - arms.axle * motion.theta_dot[..., None]], axis=-1)
    clear = np.flatnonzero((rates > 10 * SOFT).all(axis=(0, 2)))[::EVERY]
    assert len(clear) > 10
    pose, terms, found = np.zeros(1, POSE)[0], np.zeros((len(TERMS), 3)), np.zeros(3)
    for k in clear:
        terms_kernel(model, motion.theta[k], motion.theta_dot[k], motion.theta_ddot[k], pose, terms)
        ball_joint_kernel(model, motion.theta_dot[k], pose, found)
        np.testing.assert_allclose(found, offline[k, :, :2].sum(axis=1), atol=0.03)
