"""Dynamics against a finite-difference Lagrangian and an energy balance."""

import numpy as np
import pytest

from schemas.errors import PoseError
from service.model import kinematics
from service.model.dynamics import FOREARM, GRAVITY, INERTIA, PLATFORM, torque_terms


def platform_slope(model, q):
    step = 1e-5

    def f(delta):
        return kinematics.forward(model, q + delta)

    return np.stack(
        [(8 * (f(step * e) - f(-step * e)) - (f(2 * step * e) - f(-2 * step * e))) / (12 * step) for e in np.eye(3)],
        axis=1,
    )


def energies(model, robot, q, q_dot, *, exact):
    """Kinetic and potential energy from the bodies: rods for the active links, two points or a rod a forearm."""
    m0, m1, mf = robot.mass.platform, robot.mass.active_link, robot.mass.passive_link
    angle, l1 = q + model.joint_offset, model.active_length
    slope = np.stack([-np.sin(angle) * model.azimuth_cos, -np.sin(angle) * model.azimuth_sin, -np.cos(angle)], 1)
    u = l1[:, None] * slope * q_dot[:, None]  # elbow velocities (arm, axis)
    w = platform_slope(model, q) @ q_dot
    kinetic = 0.5 * m0 * w @ w + 0.5 * (m1 / 3 * l1**2 * q_dot**2).sum()
    for arm in u:
        kinetic += mf / 6 * (arm @ arm + arm @ w + w @ w) if exact else mf / 4 * (arm @ arm + w @ w)
    reach = model.radius + l1 * np.cos(angle)
    elbow = np.stack([reach * model.azimuth_cos, reach * model.azimuth_sin, -l1 * np.sin(angle)], 1)
    axle = np.stack([model.radius * model.azimuth_cos, model.radius * model.azimuth_sin, np.zeros(3)], 1)
    platform = kinematics.forward(model, q)
    moment = m0 * platform + m1 * (axle + elbow).sum(0) / 2 + mf / 2 * (elbow + platform).sum(0)
    potential = -model.gravity @ moment
    return kinetic, potential


def model_torque(model, robot, q, q_dot, q_ddot, *, exact):
    terms = torque_terms(model, q, q_dot, q_ddot)
    return terms[INERTIA] + terms[GRAVITY] + terms[PLATFORM] + exact * robot.mass.passive_link * terms[FOREARM]


@pytest.mark.parametrize(
    ("exact", "gravity"), [(False, [0.0, 0.0, -9.81]), (True, [-7.0, 5.0, 3.0])], ids=["two points", "rod, leaning"]
)
def test_torque_is_the_lagrangian_derivative(model, robot, poses, exact, gravity):
    model = model._replace(gravity=np.array(gravity))
    random = np.random.default_rng(5)
    for q in poses[:20]:
        q_dot, q_ddot = random.normal(0, 4, 3), random.normal(0, 60, 3)
        step = 1e-3

        def lagrangian(a, b):
            kinetic, potential = energies(model, robot, a, b, exact=exact)
            return kinetic - potential

        def momentum(time, q=q, q_dot=q_dot, q_ddot=q_ddot):
            a, b = q + q_dot * time + q_ddot * time**2 / 2, q_dot + q_ddot * time
            # L is quadratic in the velocity: a central difference of any step is exact
            return np.array([(lagrangian(a, b + e) - lagrangian(a, b - e)) / 2 for e in np.eye(3)])

        rate = (8 * (momentum(step) - momentum(-step)) - (momentum(2 * step) - momentum(-2 * step))) / (12 * step)
        h = 1e-4
        force = np.array([(lagrangian(q + h * e, q_dot) - lagrangian(q - h * e, q_dot)) / (2 * h) for e in np.eye(3)])
        expected = rate - force
        found = model_torque(model, robot, q, q_dot, q_ddot, exact=exact)
        assert np.abs(found - expected).max() < 1e-4 * max(1.0, np.abs(expected).max())


@pytest.mark.parametrize("exact", [False, True], ids=["two points", "rod"])
def test_power_in_is_the_rate_of_energy(model, robot, exact):
    time = np.linspace(0, 1, 4001)
    rate = 2 * np.pi * np.array([1.0, 1.7, 2.3])
    wave = rate * time[:, None]
    q, q_dot, q_ddot = 0.4 + 0.4 * np.sin(wave), 0.4 * rate * np.cos(wave), -0.4 * rate**2 * np.sin(wave)
    energy = np.array([sum(energies(model, robot, a, b, exact=exact)) for a, b in zip(q, q_dot, strict=True)])
    power = np.array(
        [model_torque(model, robot, *row, exact=exact) @ row[1] for row in zip(q, q_dot, q_ddot, strict=True)]
    )
    work = np.concatenate([[0], np.cumsum((power[1:] + power[:-1]) / 2) * (time[1] - time[0])])
    assert np.abs(energy - energy[0] - work).max() < 1e-5 * np.ptp(energy)


def test_one_sample_and_the_batch_give_the_same_bits(model, poses):
    speed = np.random.default_rng(6).normal(0, 3, poses.shape)
    batch = torque_terms(model, poses, speed, 10 * speed)
    for row in range(20):
        assert (torque_terms(model, poses[row], speed[row], 10 * speed[row]) == batch[row]).all()


def test_an_impossible_pose_is_an_error_never_a_nan(model):
    with pytest.raises(PoseError, match=r"\(3, 0, 0.5\) rad in row 0"):
        torque_terms(model, np.array([3.0, 0.0, 0.5]), np.zeros(3), np.zeros(3))
