"""Kinematics of the Delta: where the platform is, how it moves, which joint angles take it there.

Every function takes one pose as (3,) or a batch as (N, 3) and gives the same shape back; the kernels `*_kernel` do one
sample and are called by the batch, the dynamics and the estimator alike.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from schemas.errors import PoseError
from schemas.kernels import kernel
from service.model.nominal import DeltaModel, record_of

REACHED, UNREACHABLE, SINGULAR = 0, 1, 2

# |det A| / l2^3 below this: the forearms lie nearly in one plane (or two are parallel), and a force on the platform
# would need a thousand times itself in a forearm.
SINGULAR_DETERMINANT = 1e-3
# |k_ii| / (l1 l2) below this: active link and forearm are in line, and the joint no longer moves the platform.
SINGULAR_STRETCH = 1e-3


class PlatformMotion(NamedTuple):
    """Platform motion in the base frame: position m, velocity m/s, acceleration m/s^2, each (..., 3)."""

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


# What the kernels of one sample leave for each other and for the dynamics, base frame; row i of a (3, 3) is arm i's.
POSE = np.dtype(
    [
        ("sine", "f8", 3),  # of the true angles
        ("cosine", "f8", 3),
        ("centre", "f8", (3, 3)),  # m, J'_i of eq. (1): the platform lies passive_length from each
        ("position", "f8", 3),  # m, of the platform
        ("forearm", "f8", (3, 3)),  # m, s_i
        ("column", "f8", (3, 3)),  # 1/m, (s_j x s_k) / det A: p_dot = sum_i column_i (s_i . p_dot)
        ("elbow", "f8", (3, 3)),  # m, d_i = dJ'_i / dtheta_i
        ("lever", "f8", 3),  # m^2, s_i . d_i = -k_ii, so that J[:, i] = lever_i column_i
        ("velocity", "f8", 3),  # m/s
        ("acceleration", "f8", 3),  # m/s^2
        ("bend", "f8", (3, 3)),  # m, d'_i = d^2 J'_i / dtheta_i^2
        ("swing", "f8", (3, 3)),  # m/s^2, s_ddot_i
    ],
    align=True,
)


@kernel
def pose_kernel(model, theta, pose):
    """Forward kinematics and Jacobian of one pose.

    The platform is where three spheres of the forearms' lengths round the elbows meet: below their radical centre in
    the elbows' plane (with equal forearms the elbows' circumcentre), on the normal.

    theta: (3,) measured angles. Filled of the record `pose`: sine to column. Returns REACHED, UNREACHABLE or SINGULAR.
    """
    centre, position, forearm, column = pose.centre, pose.position, pose.forearm, pose.column
    for i in range(3):
        angle = theta[i] + model.joint_offset[i]
        sine, cosine = math.sin(angle), math.cos(angle)
        pose.sine[i], pose.cosine[i] = sine, cosine
        reach = model.radius[i] + model.active_length[i] * cosine
        centre[i, 0] = reach * model.azimuth_cos[i]
        centre[i, 1] = reach * model.azimuth_sin[i]
        centre[i, 2] = -model.active_length[i] * sine
    ax, ay, az = centre[1, 0] - centre[0, 0], centre[1, 1] - centre[0, 1], centre[1, 2] - centre[0, 2]
    bx, by, bz = centre[2, 0] - centre[0, 0], centre[2, 1] - centre[0, 1], centre[2, 2] - centre[0, 2]
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    aa, bb, nn = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz, nx * nx + ny * ny + nz * nz
    length = model.passive_length[0]
    aa += length * length - model.passive_length[1] * model.passive_length[1]
    bb += length * length - model.passive_length[2] * model.passive_length[2]
    if not nn > (1e-9 * length * length) ** 2:  # also when NaN
        return SINGULAR
    ox = ((ny * az - nz * ay) * bb + (by * nz - bz * ny) * aa) / (2.0 * nn)
    oy = ((nz * ax - nx * az) * bb + (bz * nx - bx * nz) * aa) / (2.0 * nn)
    oz = ((nx * ay - ny * ax) * bb + (bx * ny - by * nx) * aa) / (2.0 * nn)
    drop = length * length - (ox * ox + oy * oy + oz * oz)
    if drop < 0.0:
        return UNREACHABLE
    step = -math.sqrt(drop / nn) * (1.0 if nz > 0.0 else -1.0)
    position[0] = centre[0, 0] + ox + step * nx
    position[1] = centre[0, 1] + oy + step * ny
    position[2] = centre[0, 2] + oz + step * nz
    for i in range(3):
        for axis in range(3):
            forearm[i, axis] = position[axis] - centre[i, axis]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        column[i, 0] = forearm[j, 1] * forearm[k, 2] - forearm[j, 2] * forearm[k, 1]
        column[i, 1] = forearm[j, 2] * forearm[k, 0] - forearm[j, 0] * forearm[k, 2]
        column[i, 2] = forearm[j, 0] * forearm[k, 1] - forearm[j, 1] * forearm[k, 0]
    determinant = forearm[0, 0] * column[0, 0] + forearm[0, 1] * column[0, 1] + forearm[0, 2] * column[0, 2]
    if abs(determinant) < SINGULAR_DETERMINANT * length**3:
        return SINGULAR
    for i in range(3):
        for axis in range(3):
            column[i, axis] /= determinant
    return REACHED


@kernel
def lever_kernel(model, pose):
    """Fill elbow and lever of `pose` from its forearms."""
    forearm, elbow, lever = pose.forearm, pose.elbow, pose.lever
    for i in range(3):
        sine, cosine = pose.sine[i], pose.cosine[i]
        elbow[i, 0] = -model.active_length[i] * sine * model.azimuth_cos[i]
        elbow[i, 1] = -model.active_length[i] * sine * model.azimuth_sin[i]
        elbow[i, 2] = -model.active_length[i] * cosine
        lever[i] = forearm[i, 0] * elbow[i, 0] + forearm[i, 1] * elbow[i, 1] + forearm[i, 2] * elbow[i, 2]


@kernel
def motion_kernel(model, theta_dot, theta_ddot, pose):
    """Fill velocity, acceleration and bend of `pose` from what the kernels before left in it, by eq. (1) differentiated
    twice:

        s_i . p_dot  = (s_i . d_i) theta_dot_i
        s_i . p_ddot = (s_i . d_i) theta_ddot_i + (s_i . d'_i) theta_dot_i^2 - |s_dot_i|^2
    """
    forearm, column, elbow, lever = pose.forearm, pose.column, pose.elbow, pose.lever
    velocity, acceleration, bend = pose.velocity, pose.acceleration, pose.bend
    for axis in range(3):
        velocity[axis] = 0.0
        acceleration[axis] = 0.0
    for i in range(3):
        for axis in range(3):
            velocity[axis] += column[i, axis] * lever[i] * theta_dot[i]
    for i in range(3):
        sine, cosine = pose.sine[i], pose.cosine[i]
        bend[i, 0] = -model.active_length[i] * cosine * model.azimuth_cos[i]
        bend[i, 1] = -model.active_length[i] * cosine * model.azimuth_sin[i]
        bend[i, 2] = model.active_length[i] * sine
        right = lever[i] * theta_ddot[i]
        for axis in range(3):
            swing = velocity[axis] - elbow[i, axis] * theta_dot[i]
            right += forearm[i, axis] * bend[i, axis] * theta_dot[i] * theta_dot[i] - swing * swing
        for axis in range(3):
            acceleration[axis] += column[i, axis] * right


@kernel
def inverse_kernel(model, position, theta):
    """Joint angles of one platform position, elbows outward. Returns REACHED or UNREACHABLE."""
    for i in range(3):
        u = position[0] * model.azimuth_cos[i] + position[1] * model.azimuth_sin[i]
        square = position[0] ** 2 + position[1] ** 2 + position[2] ** 2
        l1, l2, r = model.active_length[i], model.passive_length[i], model.radius[i]
        n = 2.0 * r * u - square - l1 * l1 + l2 * l2 - r * r
        # eq. (1) reads (r - u) cos theta + z sin theta = n / (2 l1); of its two solutions the one with k_ii < 0 has
        # its elbow outward
        cosine = n / (2.0 * l1 * math.hypot(r - u, position[2]))
        if not abs(cosine) <= 1.0:
            return UNREACHABLE
        theta[i] = math.atan2(position[2], r - u) + math.acos(cosine) - model.joint_offset[i]
    return REACHED


@kernel(nogil=True)
def _forward_batch(model, theta, position, column, lever):
    poses = np.empty(1, POSE)
    for n in range(len(theta)):
        pose = poses[0]
        status = pose_kernel(model, theta[n], pose)
        if status != REACHED:
            return status, n
        lever_kernel(model, pose)
        for i in range(3):  # not by slices: what checks their shapes takes seconds to compile
            position[n, i], lever[n, i] = pose.position[i], pose.lever[i]
            for axis in range(3):
                column[n, i, axis] = pose.column[i, axis]
    return REACHED, -1


@kernel(nogil=True)
def _motion_batch(model, theta, theta_dot, theta_ddot, position, velocity, acceleration):
    poses = np.empty(1, POSE)
    for n in range(len(theta)):
        pose = poses[0]
        status = pose_kernel(model, theta[n], pose)
        if status != REACHED:
            return status, n
        lever_kernel(model, pose)
        motion_kernel(model, theta_dot[n], theta_ddot[n], pose)
        for axis in range(3):
            position[n, axis] = pose.position[axis]
            velocity[n, axis], acceleration[n, axis] = pose.velocity[axis], pose.acceleration[axis]
    return REACHED, -1


@kernel
def _inverse_batch(model, position, theta):
    for n in range(len(position)):
        if inverse_kernel(model, position[n], theta[n]) != REACHED:
            return UNREACHABLE, n
    return REACHED, -1


def rows(values: np.ndarray) -> np.ndarray:
    """`values` of shape (3,) or (N, 3) as contiguous (N, 3) float64."""
    return np.ascontiguousarray(np.atleast_2d(np.asarray(values, float)))


def raise_pose(status: int, row: int, batch: np.ndarray, unit: str) -> None:
    """Turn a kernel's status into an error that names the pose. batch: (N, 3), whose `row` it is of; N may be 0.

    Raises:
        PoseError: status is not REACHED.
    """
    if status == REACHED:
        return
    what = "unreachable" if status == UNREACHABLE else "singular"
    values = ", ".join(f"{value:.6g}" for value in batch[row])
    raise PoseError(f"{what} pose ({values}) {unit} in row {row}")


def _poses(model: DeltaModel, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """position (N, 3), column (N, 3, 3) and lever (N, 3) of the forward kernel."""
    batch = rows(theta)
    position, column, lever = np.empty_like(batch), np.empty((len(batch), 3, 3)), np.empty_like(batch)
    status, row = _forward_batch(record_of(model), batch, position, column, lever)
    raise_pose(status, row, batch, "rad")
    return position, column, lever


def forward(model: DeltaModel, theta: np.ndarray) -> np.ndarray:
    """Platform position (N, 3) m, base frame, of joint angles `theta` (N, 3) rad.

    Raises:
        PoseError: unreachable or singular, naming the angles.
    """
    position, _, _ = _poses(model, theta)
    return position.reshape(np.shape(theta))


def inverse(model: DeltaModel, position: np.ndarray) -> np.ndarray:
    """Joint angles (N, 3) rad, elbows outward, of platform positions (N, 3) m in the base frame.

    Raises:
        PoseError: unreachable, naming the position.
    """
    batch = rows(position)
    theta = np.empty_like(batch)
    status, row = _inverse_batch(record_of(model), batch, theta)
    raise_pose(status, row, batch, "m")
    return theta.reshape(np.shape(position))


def jacobian(model: DeltaModel, theta: np.ndarray) -> np.ndarray:
    """J = dp/dtheta, (N, 3, 3) m/rad: J[n, a, i] moves axis a per angle i.

    Raises:
        PoseError: unreachable or singular, naming the angles.
    """
    _, column, lever = _poses(model, theta)
    result = np.swapaxes(column * lever[:, :, None], 1, 2)
    return result.reshape(*np.shape(theta), 3)


def motion(model: DeltaModel, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray) -> PlatformMotion:
    """Platform motion of joint motion, all (N, 3): rad, rad/s, rad/s^2 to m, m/s, m/s^2.

    Raises:
        PoseError: unreachable or singular, naming the angles.
    """
    batch = rows(theta)
    position, velocity, acceleration = np.empty_like(batch), np.empty_like(batch), np.empty_like(batch)
    status, row = _motion_batch(
        record_of(model), batch, rows(theta_dot), rows(theta_ddot), position, velocity, acceleration
    )
    raise_pose(status, row, batch, "rad")
    shape = np.shape(theta)
    return PlatformMotion(position.reshape(shape), velocity.reshape(shape), acceleration.reshape(shape))


def inverse_motion(model: DeltaModel, platform: PlatformMotion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Joint angles, velocities and accelerations (N, 3) of a platform motion.

    Raises:
        PoseError: unreachable, or an arm is stretched so that its joint velocity is undefined.
    """
    theta = rows(inverse(model, platform.position))
    velocity, acceleration = rows(platform.velocity), rows(platform.acceleration)
    angle = theta + model.joint_offset
    sine, cosine, l1 = np.sin(angle), np.cos(angle), model.active_length
    azimuth = np.stack([model.azimuth_cos, model.azimuth_sin, np.zeros(3)], axis=1)  # (arm, axis)
    down = np.array([0.0, 0.0, 1.0])
    elbow = (model.radius + l1 * cosine)[..., None] * azimuth - (l1 * sine)[..., None] * down
    forearm = rows(platform.position)[:, None, :] - elbow
    slope = -(l1 * sine)[..., None] * azimuth - (l1 * cosine)[..., None] * down
    bend = -(l1 * cosine)[..., None] * azimuth + (l1 * sine)[..., None] * down
    lever = np.einsum("nia,nia->ni", forearm, slope)
    stretched = np.flatnonzero((np.abs(lever) < SINGULAR_STRETCH * l1 * model.passive_length).any(axis=1))
    if len(stretched):
        raise_pose(SINGULAR, int(stretched[0]), theta, "rad")
    theta_dot = np.einsum("nia,na->ni", forearm, velocity) / lever
    swing = velocity[:, None, :] - slope * theta_dot[..., None]
    theta_ddot = (
        np.einsum("nia,na->ni", forearm, acceleration)
        - np.einsum("nia,nia->ni", forearm, bend) * theta_dot**2
        + np.einsum("nia,nia->ni", swing, swing)
    ) / lever
    shape = np.shape(platform.position)
    return theta.reshape(shape), theta_dot.reshape(shape), theta_ddot.reshape(shape)
