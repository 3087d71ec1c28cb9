"""Coulomb and viscous friction: T = f_v theta_dot + f_c sign theta_dot."""

from __future__ import annotations

import math

import numpy as np

from schemas.kernels import kernel
from service.model.dynamics import REST_SPEED


@kernel
def direction(theta_dot: float, transition: float) -> float:
    """sign theta_dot, going smoothly through zero: tanh(theta_dot / transition), both rad/s.

    Without an identified transition it rises linearly within the rest speed, so that noise at rest does not chatter.
    """
    if transition > 0.0:
        return math.tanh(theta_dot / transition)
    return max(-1.0, min(1.0, theta_dot / REST_SPEED))


@kernel
def friction_kernel(viscous: float, coulomb: float, theta_dot: float, transition: float) -> float:
    """Friction torque of one joint, N m. viscous: N m s/rad, coulomb: N m, theta_dot and transition: rad/s."""
    return viscous * theta_dot + coulomb * direction(theta_dot, transition)


def mean_direction(theta_dot: np.ndarray, transition: float | np.ndarray) -> np.ndarray:
    """Direction (N, n) of speeds, in [-1, 1]: sign theta_dot, or smooth over `transition` rad/s, one or (n,).

    The smooth form is the mean of tanh(theta_dot / transition) over the sample's interval, the speed taken as straight
    between half-way points: a fast reversal falls between two samples, and its place there is worth 2 f_c times a
    fraction of the interval.
    """
    if not np.any(transition):
        return np.sign(theta_dot)
    half = np.empty((len(theta_dot) + 1, theta_dot.shape[1]))
    half[1:-1] = 0.5 * (theta_dot[1:] + theta_dot[:-1])
    half[0], half[-1] = theta_dot[0], theta_dot[-1]
    half /= transition
    size = np.abs(half)
    area = size + np.log1p(np.exp(-2.0 * size))  # integral of tanh, up to a constant
    step = np.diff(half, axis=0)
    flat = np.abs(step) < 1e-4
    return np.where(flat, np.tanh(theta_dot / transition), np.diff(area, axis=0) / np.where(flat, 1.0, step))
