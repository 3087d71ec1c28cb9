"""Coulomb and viscous friction: T = f_v theta_dot + f_c sign theta_dot."""

from __future__ import annotations

import math

import numpy as np

from schemas.kernels import kernel
from service.model.dynamics import REST_SPEED

SOFT = 0.05  # rad/s, within which dry friction of a ball joint fades: its seat is compliant
SETTLED = 20.0  # transitions from zero, where the integral of tanh is a straight line to the last bit
FLAT = 1e-4  # transitions, over which a mean is the value: as a difference quotient it would be rounding


@kernel
def direction(theta_dot: float, transition: float) -> float:
    """sign theta_dot, going smoothly through zero: tanh(theta_dot / transition), both rad/s.

    Without an identified transition it rises linearly within the rest speed, so that noise at rest does not chatter.
    """
    if transition > 0.0:
        return math.tanh(theta_dot / transition)
    return max(-1.0, min(1.0, theta_dot / REST_SPEED))


@kernel
def friction_kernel(viscous: float, coulomb: float, theta_dot: float, turned: float) -> float:
    """Friction torque of one joint, N m. viscous: N m s/rad, coulomb: N m, theta_dot: rad/s, turned: `direction`."""
    return viscous * theta_dot + coulomb * turned


@kernel
def ball_joint_kernel(model, theta_dot, pose, torque):
    """Fill torque (3,): of the joints where the ball joints at either end of each forearm rub with 1 N m, dry.

    By virtual power, as `effects.passive_joint_friction` has it: a forearm turns at s x s_dot / l2^2 against the
    platform, and at that less its joint's rate against the active link. pose: filled by `motion_kernel`.
    """
    forearm, column, elbow, lever, velocity = pose.forearm, pose.column, pose.elbow, pose.lever, pose.velocity
    total_x = total_y = total_z = 0.0
    for i in range(3):
        x, y, z = forearm[i, 0], forearm[i, 1], forearm[i, 2]
        rate, square = theta_dot[i], model.passive_length[i] * model.passive_length[i]
        u = (velocity[0] - elbow[i, 0] * rate) / square
        v = (velocity[1] - elbow[i, 1] * rate) / square
        w = (velocity[2] - elbow[i, 2] * rate) / square
        turn_x, turn_y, turn_z = y * w - z * v, z * u - x * w, x * v - y * u
        bend_x, bend_y = turn_x + model.azimuth_sin[i] * rate, turn_y - model.azimuth_cos[i] * rate
        turn = 1.0 / math.sqrt(turn_x * turn_x + turn_y * turn_y + turn_z * turn_z + SOFT * SOFT)
        bend = 1.0 / math.sqrt(bend_x * bend_x + bend_y * bend_y + turn_z * turn_z + SOFT * SOFT)
        both_x, both_y = turn_x * turn + bend_x * bend, turn_y * turn + bend_y * bend
        both_z = turn_z * (turn + bend)
        push_x, push_y = (both_y * z - both_z * y) / square, (both_z * x - both_x * z) / square
        push_z = (both_x * y - both_y * x) / square
        total_x, total_y, total_z = total_x + push_x, total_y + push_y, total_z + push_z
        torque[i] = (model.azimuth_sin[i] * bend_x - model.azimuth_cos[i] * bend_y) * bend
        torque[i] -= push_x * elbow[i, 0] + push_y * elbow[i, 1] + push_z * elbow[i, 2]
    for i in range(3):
        torque[i] += lever[i] * (total_x * column[i, 0] + total_y * column[i, 1] + total_z * column[i, 2])


def mean_direction(theta_dot: np.ndarray, transition: float | np.ndarray) -> np.ndarray:
    """Direction (N, n) of speeds, in [-1, 1]: sign theta_dot, or smooth over `transition` rad/s, one or (n,).

    The smooth form is the mean of tanh(theta_dot / transition) over the sample's interval, the speed taken as straight
    between half-way points: a fast reversal falls between two samples, and its place there is worth 2 f_c times a
    fraction of the interval.
    """
    if not np.any(transition):
        return np.sign(theta_dot)
    result = np.empty(theta_dot.shape)
    _mean_direction(theta_dot, np.broadcast_to(np.asarray(transition, float), theta_dot.shape[1:]), result)
    return result


@kernel
def _area(steps):
    """Integral of tanh from 0 to `steps`, up to a constant."""
    size = abs(steps)
    return size if size > SETTLED else size + math.log1p(math.exp(-2.0 * size))


@kernel(nogil=True)
def _mean_direction(theta_dot, transition, result):
    """Fill result (N, n)."""
    count = len(theta_dot)
    for j in range(theta_dot.shape[1]):
        width = transition[j]
        before = theta_dot[0, j] / width
        area = _area(before)
        for k in range(count):
            after = (0.5 * (theta_dot[k + 1, j] + theta_dot[k, j]) if k + 1 < count else theta_dot[k, j]) / width
            reached, step = _area(after), after - before
            flat = abs(step) < FLAT
            result[k, j] = math.tanh(theta_dot[k, j] / width) if flat else (reached - area) / step
            before, area = after, reached
