"""Forward dynamics of the Delta: which motion a torque gives, from the same terms as the inverse dynamics.

    T = M(theta) theta_ddot + b(theta, theta_dot),   b = T at theta_ddot 0, M from the Jacobian and the levers

With the rod's energy less that of two point masses, -m_f/12 |s_dot_i|^2, in it:

    M = rho_1 diag I + (M - m_f/2) J' J + m_f/6 (d' J + J' d - diag |d_i|^2),   d_i = dJ'_i / dtheta_i
"""

from __future__ import annotations

import numpy as np

from schemas.kernels import kernel
from service.model.dynamics import FOREARM, GRAVITY, PAYLOAD, PLATFORM, terms_kernel
from service.model.kinematics import POSE, REACHED, raise_pose, rows
from service.model.nominal import DeltaModel, record_of


@kernel
def mass_kernel(model, rho_1, forearm, carried, pose, mass):
    """Fill mass (3, 3), kg m^2, at the record `pose` that the terms kernel filled. rho_1: (3,). forearm, carried: kg,
    of the rods and on the platform."""
    column, elbow, lever = pose.column, pose.elbow, pose.lever
    for i in range(3):
        for j in range(i + 1):
            both = one = other = own = 0.0
            for axis in range(3):
                slope_i, slope_j = column[i, axis] * lever[i], column[j, axis] * lever[j]
                both += slope_i * slope_j
                one += elbow[i, axis] * slope_j
                other += elbow[j, axis] * slope_i
                own += elbow[i, axis] * elbow[j, axis]
            value = (model.moving_mass + carried - forearm / 2.0) * both + forearm / 6.0 * (one + other)
            if i == j:
                value += rho_1[i] * model.inertia[i] - forearm / 6.0 * own
            mass[i, j] = mass[j, i] = value


@kernel
def bias_kernel(model, rho_2, forearm, carried, theta, theta_dot, pose, terms, bias):
    """Fill bias (3,), N m: torque that `theta_dot` and weight take without acceleration. Returns a status."""
    for i in range(3):
        bias[i] = 0.0  # the acceleration, for as long as the terms are asked for: a constant would compile them anew
    status = terms_kernel(model, theta, theta_dot, bias, pose, terms)
    if status == REACHED:
        for i in range(3):
            bias[i] = rho_2[i] * terms[GRAVITY, i] + terms[PLATFORM, i] + forearm * terms[FOREARM, i]
            bias[i] += carried * terms[PAYLOAD, i]
    return status


@kernel
def solve_kernel(matrix, right, result):
    """result (3,) of matrix (3, 3) result = right (3,), by cofactors."""
    a, b, c = matrix[0], matrix[1], matrix[2]
    x, y, z = b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]
    over = 1.0 / (a[0] * x + a[1] * y + a[2] * z)
    u, v, w = right[0], right[1], right[2]
    result[0] = over * (x * u + (a[2] * c[1] - a[1] * c[2]) * v + (a[1] * b[2] - a[2] * b[1]) * w)
    result[1] = over * (y * u + (a[0] * c[2] - a[2] * c[0]) * v + (a[2] * b[0] - a[0] * b[2]) * w)
    result[2] = over * (z * u + (a[1] * c[0] - a[0] * c[1]) * v + (a[0] * b[1] - a[1] * b[0]) * w)


@kernel(nogil=True)
def _forward_batch(model, rho_1, rho_2, forearm, theta, theta_dot, torque, mass, acceleration):
    poses, terms, bias = np.empty(1, POSE), np.empty((5, 3)), np.empty(3)
    for n in range(len(theta)):
        pose = poses[0]
        status = bias_kernel(model, rho_2, forearm, 0.0, theta[n], theta_dot[n], pose, terms, bias)
        if status != REACHED:
            return status, n
        mass_kernel(model, rho_1, forearm, 0.0, pose, mass[n])
        for i in range(3):
            bias[i] = torque[n, i] - bias[i]
        solve_kernel(mass[n], bias, acceleration[n])
    return REACHED, -1


def forward_dynamics(
    model: DeltaModel, coefficients: np.ndarray, theta: np.ndarray, theta_dot: np.ndarray, torque: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Acceleration (N, 3) rad/s^2 that a torque gives, and the mass matrix (N, 3, 3) kg m^2 there.

    coefficients: rho_1, rho_2, forearm kg. theta, theta_dot, torque: (N, 3) rad, rad/s, N m without friction.

    Raises:
        PoseError: unreachable or singular, naming the angles.
    """
    rho_1, rho_2, forearm = (float(value) for value in coefficients)
    batch = rows(theta)
    mass, acceleration = np.empty((len(batch), 3, 3)), np.empty_like(batch)
    status, row = _forward_batch(
        record_of(model),
        np.full(3, rho_1),
        np.full(3, rho_2),
        forearm,
        batch,
        rows(theta_dot),
        rows(torque),
        mass,
        acceleration,
    )
    raise_pose(status, row, batch, "rad")
    return acceleration, mass
