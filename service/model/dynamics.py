"""Inverse dynamics of the Delta as a sum of terms, so that every model is a choice of coefficients.

    T = rho_1 inertia + rho_2 gravity + platform + m_f forearm + m_p payload + f_v theta_dot + f_c sign theta_dot

`forearm` is what an exact rod adds to the paper's two point masses: with end velocities u (elbow) and w (platform) its
kinetic energy is m_f/6 (|u|^2 + u.w + |w|^2) against m_f/4 (|u|^2 + |w|^2), a difference of -m_f/12 |s_dot|^2.
"""

from __future__ import annotations

import numpy as np

from schemas.kernels import kernel
from service.model.kinematics import POSE, REACHED, lever_kernel, motion_kernel, pose_kernel, raise_pose, rows
from service.model.nominal import DeltaModel, record_of

TERMS = ("inertia", "gravity", "platform", "forearm", "payload")
INERTIA, GRAVITY, PLATFORM, FOREARM, PAYLOAD = range(5)

# Below this speed a joint is at rest and its friction can be anything within Coulomb's bounds.
REST_SPEED = 0.01  # rad/s


@kernel
def terms_kernel(model, theta, theta_dot, theta_ddot, pose, terms):
    """Fill terms (5, 3) of one sample and the whole record `pose`. Returns a status."""
    status = pose_kernel(model, theta, pose)
    if status != REACHED:
        return status
    lever_kernel(model, pose)
    motion_kernel(model, theta_dot, theta_ddot, pose)
    column, elbow, lever = pose.column, pose.elbow, pose.lever
    acceleration, bend, swing = pose.acceleration, pose.bend, pose.swing
    for i in range(3):
        for axis in range(3):
            swing[i, axis] = (
                acceleration[axis] - elbow[i, axis] * theta_ddot[i] - bend[i, axis] * theta_dot[i] * theta_dot[i]
            )
    for i in range(3):
        load = rod = own = weight = 0.0
        for axis in range(3):
            slope = column[i, axis] * lever[i]  # J[axis, i]
            load += slope * (acceleration[axis] - model.gravity[axis])
            rod += slope * (swing[0, axis] + swing[1, axis] + swing[2, axis])
            weight += elbow[i, axis] * model.gravity[axis]
            own += elbow[i, axis] * swing[i, axis]
        terms[INERTIA, i] = model.inertia[i] * theta_ddot[i]
        terms[GRAVITY, i] = -model.link_mass * weight
        terms[PLATFORM, i] = model.moving_mass * load
        terms[FOREARM, i] = -(rod - own) / 6.0
        terms[PAYLOAD, i] = load
    return REACHED


@kernel(nogil=True)
def _terms_batch(model, theta, theta_dot, theta_ddot, terms):
    poses = np.empty(1, POSE)
    for n in range(len(theta)):
        pose = poses[0]
        status = terms_kernel(model, theta[n], theta_dot[n], theta_ddot[n], pose, terms[n])
        if status != REACHED:
            return status, n
    return REACHED, -1


def torque_terms(model: DeltaModel, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray) -> np.ndarray:
    """The terms of the inverse dynamics, (N, 5, 3) in the order of `TERMS`.

    theta, theta_dot, theta_ddot: (N, 3) rad, rad/s, rad/s^2. Inertia, gravity and platform are N m at the nominal
    masses; forearm and payload are N m per kg.

    Raises:
        PoseError: unreachable or singular, naming the angles.
    """
    batch = rows(theta)
    terms = np.empty((len(batch), len(TERMS), 3))
    status, row = _terms_batch(record_of(model), batch, rows(theta_dot), rows(theta_ddot), terms)
    raise_pose(status, row, batch, "rad")
    return terms.reshape(*np.shape(theta)[:-1], len(TERMS), 3)
