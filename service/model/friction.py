"""Coulomb and viscous friction: T = f_v theta_dot + f_c sign theta_dot."""

from __future__ import annotations

import math

from numba import njit

from service.model.dynamics import REST_SPEED


@njit(cache=True)
def direction(theta_dot: float, transition: float) -> float:
    """sign theta_dot, going smoothly through zero: tanh(theta_dot / transition), both rad/s.

    Without an identified transition it rises linearly within the rest speed, so that noise at rest does not chatter.
    """
    if transition > 0.0:
        return math.tanh(theta_dot / transition)
    return max(-1.0, min(1.0, theta_dot / REST_SPEED))


@njit(cache=True)
def friction_kernel(viscous: float, coulomb: float, theta_dot: float, transition: float) -> float:
    """Friction torque of one joint, N m. viscous: N m s/rad, coulomb: N m, theta_dot and transition: rad/s."""
    return viscous * theta_dot + coulomb * direction(theta_dot, transition)
