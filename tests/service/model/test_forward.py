"""Forward dynamics against the inverse, against energy, and against MuJoCo's closed chain."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's compiled modules carry no types)

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from drivers.simulated.plant.mujoco_delta import Design, build, close, dependence, required_torque
from schemas.errors import PoseError
from service.model import kinematics
from service.model.dynamics import torque_terms
from service.model.forward import bias_kernel, forward_dynamics, mass_kernel
from service.model.kinematics import POSE, REACHED
from service.model.nominal import pack, record_of
from tests.service.world import BASE, ROBOT, TRUTH

RHO_1, RHO_2, FOREARM = BASE.rigid


def states(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(4)
    return random.uniform(-0.2, 0.9, (count, 3)), random.normal(0, 3, (count, 3)), random.normal(0, 60, (count, 3))


def test_it_turns_the_inverse_dynamics_round():
    theta, theta_dot, theta_ddot = states(200)
    terms = torque_terms(pack(ROBOT), theta, theta_dot, theta_ddot)
    torque = RHO_1 * terms[:, 0] + RHO_2 * terms[:, 1] + terms[:, 2] + FOREARM * terms[:, 3]
    found, mass = forward_dynamics(pack(ROBOT), BASE.rigid, theta, theta_dot, torque)
    np.testing.assert_allclose(found, theta_ddot, atol=1e-9)
    np.testing.assert_array_equal(mass, np.swapaxes(mass, 1, 2))
    assert (np.linalg.eigvalsh(mass) > 0).all()


def test_angles_that_are_no_pose_are_named():
    theta = np.array([[0.3, 0.3, 0.3], [3.1, 0.0, 0.0]])
    with pytest.raises(PoseError, match=r"unreachable pose \(3\.1, 0, 0\) rad in row 1"):
        forward_dynamics(pack(ROBOT), BASE.rigid, theta, np.zeros((2, 3)), np.zeros((2, 3)))


def test_what_is_carried_weighs_as_a_heavier_platform():
    model, (theta, theta_dot, _) = pack(ROBOT), states(5)
    heavier = model._replace(moving_mass=model.moving_mass + 2.5)
    rho_1, rho_2 = np.array([1.1, 1.2, 1.3]), np.array([0.9, 0.8, 0.7])
    for place, speed in zip(theta, theta_dot, strict=True):
        found = []
        for packed, carried in ((model, 2.5), (heavier, 0.0)):
            pose, terms, bias, mass = np.zeros(1, POSE)[0], np.zeros((5, 3)), np.zeros(3), np.zeros((3, 3))
            record = record_of(packed)
            assert bias_kernel(record, rho_2, FOREARM, carried, place, speed, pose, terms, bias) == REACHED
            mass_kernel(record, rho_1, FOREARM, carried, pose, mass)
            found.append(np.vstack([bias, mass]))
        np.testing.assert_allclose(*found, rtol=1e-12)


def test_the_mass_matrix_is_mujocos_closed_chain():
    theta, *_ = states(5)
    still = np.zeros((3, 3))
    mechanism = build(Design(TRUTH), 1e-4)
    _, mass = forward_dynamics(pack(ROBOT), BASE.rigid, theta, np.zeros_like(theta), np.zeros_like(theta))
    for pose, ours in zip(theta, mass, strict=True):
        three = np.repeat(pose[None], 3, axis=0)
        held = required_torque(mechanism, pose[None], still[:1], still[:1])
        np.testing.assert_allclose(
            required_torque(mechanism, three, still, np.eye(3)) - held, ours, rtol=2e-4, atol=1e-5
        )


def test_a_free_fall_is_mujocos():
    step = 1e-4
    mechanism = build(Design(TRUTH), step)
    data = mujoco.MjData(mechanism.model)
    theta, theta_dot = np.array([0.1, 0.25, -0.1]), np.array([1.0, -2.0, 0.5])
    data.qpos[:] = close(mechanism, theta[None])[0]
    data.qvel[:] = dependence(mechanism, theta[None])[0] @ theta_dot
    model = pack(ROBOT)

    def rate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return forward_dynamics(model, BASE.rigid, q[None], v[None], np.zeros((1, 3)))[0][0]

    start = theta
    for _ in range(1000):  # 0.1 s
        mujoco.mj_step(mechanism.model, data)
        middle = theta + 0.5 * step * theta_dot, theta_dot + 0.5 * step * rate(theta, theta_dot)
        theta, theta_dot = theta + step * middle[1], theta_dot + step * rate(*middle)
    way = np.linalg.norm(kinematics.forward(model, theta) - kinematics.forward(model, start))
    assert way > 0.02
    assert np.linalg.norm(kinematics.forward(model, theta) - data.qpos[mechanism.platform]) < 0.01 * way
