"""The paper's misprints, line by line: the right-hand column holds with eq. (1), the printed one does not."""

import numpy as np
import pytest

from service.model import kinematics
from service.model.dynamics import GRAVITY, INERTIA, PAYLOAD, PLATFORM, torque_terms


@pytest.fixture(scope="module")
def pose(model, poses):
    """Everything of one odd pose: x0 y0 z0, angles, u_i."""
    theta = poses[7]
    x0, y0, z0 = kinematics.forward(model, theta)
    angle = theta + model.joint_offset
    u = x0 * model.azimuth_cos + y0 * model.azimuth_sin
    return theta, angle, np.array([x0, y0, z0]), u


def close(a, b):
    return np.allclose(a, b, rtol=0, atol=1e-9)


def test_n(model, pose):
    _, angle, p, u = pose
    r, l1, l2 = model.radius, model.active_length, model.passive_length
    needed = 2 * l1 * ((r - u) * np.cos(angle) + p[2] * np.sin(angle))  # what eq. (1), expanded, asks n_i to be
    assert close(2 * r * u - p @ p - l1**2 + l2**2 - r**2, needed)
    assert not close(2 * r * p[0] - 2 * r * p[1] * model.azimuth_sin + p @ p + l1**2 - l2**2 + r**2, needed)


def forearms(model, pose, *, printed):
    _, angle, p, _ = pose
    r, l1, cosine, sine = model.radius, model.active_length, model.azimuth_cos, model.azimuth_sin
    if printed:
        x = p[0] + r * cosine - l1 * np.cos(angle) * cosine
        y = p[1] + r * sine - l1 * np.cos(angle) * sine
        return np.stack([x, y, p[2] - l1 * np.sin(angle)])
    reach = r + l1 * np.cos(angle)
    return np.stack([p[0] - reach * cosine, p[1] - reach * sine, p[2] + l1 * np.sin(angle)])


def test_a_1_and_a_2(model, pose):
    """The first two rows of A are a forearm's horizontal reach: with the right third row its length is l2."""
    right, printed = forearms(model, pose, printed=False), forearms(model, pose, printed=True)
    assert close(np.linalg.norm(right, axis=0), model.passive_length)
    mixed = np.vstack([printed[:2], right[2]])
    assert not close(np.linalg.norm(mixed, axis=0), model.passive_length)


def test_a_3(model, pose):
    right, printed = forearms(model, pose, printed=False), forearms(model, pose, printed=True)
    assert not close(np.linalg.norm(np.vstack([right[:2], printed[2]]), axis=0), model.passive_length)


def test_a_k_V_and_G_as_printed_are_exact_in_another_frame(model, robot, pose):
    """One cause for five rows: z from the base towards the platform, r = r_b - r_a, weight towards the base."""
    theta, angle, p, u = pose
    x, y, z, r = p[0], p[1], -p[2], -model.radius
    l1, cosine, sine = model.active_length, model.azimuth_cos, model.azimuth_sin
    flip = np.array([1.0, 1.0, -1.0])
    printed = np.stack(
        [x + r * cosine - l1 * np.cos(angle) * cosine, y + r * sine - l1 * np.cos(angle) * sine, z - l1 * np.sin(angle)]
    )
    assert close(printed, flip[:, None] * forearms(model, pose, printed=False))
    k = l1 * ((u + r) * np.sin(angle) - z * np.cos(angle))  # the l1 is a misprint of its own
    assert close(-np.linalg.inv(printed).T @ np.diag(k), flip[:, None] * kinematics.jacobian(model, theta))

    m1, m2 = robot.mass.active_link, robot.mass.passive_link / 2

    def energy(q):
        """V_1 + V_2 as printed, and the platform's."""
        q = q + model.joint_offset
        height = -kinematics.forward(model, q - model.joint_offset)[2]
        links = (m1 / 2 + m2) * (l1 * np.sin(q)).sum()
        return -model.gravity[2] * (links + (3 * m2 + robot.mass.platform) * height)

    step = 1e-6 * np.eye(3)
    slope = np.array([(energy(theta + e) - energy(theta - e)) / 2e-6 for e in step])
    gravity = (m1 / 2 + m2) * -model.gravity[2] * l1 * np.cos(angle)  # G as printed
    static = torque_terms(model, theta, np.zeros(3), np.zeros(3))
    assert np.allclose(slope, gravity - static[PLATFORM], atol=1e-7)  # and the platform's weight the other way too


def test_k(model, pose):
    theta, angle, p, u = pose
    a = forearms(model, pose, printed=False)
    slope = kinematics.jacobian(model, theta)
    right = model.active_length * ((u - model.radius) * np.sin(angle) + p[2] * np.cos(angle))
    printed = (u + model.radius) * np.sin(angle) - p[2] * np.cos(angle)
    assert close(-np.linalg.inv(a).T @ np.diag(right), slope)
    assert not close(-np.linalg.inv(a).T @ np.diag(printed), slope)


def test_potential_energy_and_gravity_torque(model, robot, pose):
    """Static torque is the slope of the potential energy, heights taken from the geometry."""
    theta = pose[0]
    m0, m1, m2 = robot.mass.platform, robot.mass.active_link, robot.mass.passive_link / 2

    def energy(q, sign):
        height = sign * model.active_length * np.sin(q + model.joint_offset)  # elbow
        z0 = kinematics.forward(model, q)[2]
        return -model.gravity[2] * (m1 / 2 * height.sum() + m2 * (3 * z0 + height.sum()) + m0 * z0)

    def slope(sign):
        step = 1e-6
        return np.array(
            [(energy(theta + step * e, sign) - energy(theta - step * e, sign)) / (2 * step) for e in np.eye(3)]
        )

    terms = torque_terms(model, theta, np.zeros(3), np.zeros(3))
    static = terms[GRAVITY] + terms[PLATFORM]
    assert np.allclose(static, slope(-1.0), atol=1e-7)
    assert not np.allclose(static, slope(+1.0), atol=1e-2), "printed: plus before l1 sin theta"
    printed = -terms[GRAVITY] + terms[PLATFORM]
    assert not np.allclose(printed, slope(-1.0), atol=1e-2), "printed: G with a plus"


def test_friction_coefficients_stand_in_the_order_of_their_columns():
    """Phi = [theta_dot, sign theta_dot] goes with [f_v, f_c]."""
    from service.model.coulomb_viscous import direction, friction_kernel

    f_v, f_c, speed = 1.4, 3.0, np.array([-2.0, 0.7, 5.0])
    phi = np.stack([speed, np.sign(speed)], axis=1)
    kernel = np.array([friction_kernel(f_v, f_c, s, direction(s, 0.0)) for s in speed])
    assert np.allclose(phi @ [f_v, f_c], kernel)
    assert not np.allclose(phi @ [f_c, f_v], kernel)


def test_payload_is_one_scalar_in_three_rows(model, poses):
    """-A inv(K) dT = m_p X for the torque that a payload adds, with one and the same m_p in x, y and z."""
    random = np.random.default_rng(4)
    theta, theta_dot, theta_ddot = poses[7], random.normal(0, 3, 3), random.normal(0, 50, 3)
    position = kinematics.forward(model, theta)
    angle = theta + model.joint_offset
    u = position[0] * model.azimuth_cos + position[1] * model.azimuth_sin
    a = forearms(model, (theta, angle, position, u), printed=False)
    k = np.diag(model.active_length * ((u - model.radius) * np.sin(angle) + position[2] * np.cos(angle)))
    terms = torque_terms(model, theta, theta_dot, theta_ddot)
    y = -a @ np.linalg.inv(k) @ (2.5 * terms[PAYLOAD])
    x = kinematics.motion(model, theta, theta_dot, theta_ddot).acceleration + [0, 0, -model.gravity[2]]
    assert np.allclose(y / x, 2.5)


def test_innovation_takes_y_and_x_of_the_gains_own_sample():
    """A known mass, no noise, acceleration that changes from sample to sample, nothing forgotten."""
    from service.estimator.recursion import fixed_forgetting

    x = np.random.default_rng(5).normal(0, 30, (4000, 3)) + [0, 0, 9.81]
    y = 3.8 * x
    assert fixed_forgetting(y, x, 1.0)[-1] == pytest.approx(3.8, abs=1e-6)

    def printed(ahead):
        """Gain from X(k+1); innovation from k + `ahead`."""
        mass, covariance = 0.0, 1e3
        for k in range(len(x) - 1):
            gain = np.linalg.solve(np.eye(3) + covariance * np.outer(x[k + 1], x[k + 1]), covariance * x[k + 1])
            mass += gain @ (y[k + ahead] - x[k + ahead] * mass)
            covariance *= 1 - gain @ x[k + 1]
        return mass

    assert printed(ahead=1) == pytest.approx(3.8, abs=1e-5)
    assert printed(ahead=0) < 0.8 * 3.8, "as printed it does not get there"


def test_nominal_coefficients(model, robot, poses):
    m0, m1, m2 = robot.mass.platform, robot.mass.active_link, robot.mass.passive_link / 2
    terms = torque_terms(model, poses[7], np.zeros(3), np.ones(3))
    assert np.allclose(terms[INERTIA], (m1 / 3 + m2) * model.active_length**2)
    assert np.allclose(terms[PLATFORM], (m0 + 3 * m2) * terms[PAYLOAD])
