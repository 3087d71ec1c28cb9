"""The bounds of the feed-forward torque where the description does not declare them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from schemas.robot import Robot
from service.model.dynamics import GRAVITY, INERTIA, PAYLOAD, PLATFORM, torque_terms
from service.model.kinematics import PlatformMotion, forward, inverse_motion
from service.model.nominal import pack

# The move that the default bounds are made for: 10 g in any direction with the greatest payload, near the middle of the
# workspace (arms at 20 to 50 degrees). It is several times what a light part asks for; a drive's own peak, declared as
# peak_torque_nm, bounds closer.
ACCELERATION = 10 * 9.81  # m/s^2
ARM_ANGLES = np.radians([20.0, 35.0, 50.0])
REVERSAL_TIME = 0.02  # s from one peak to the other


class Bounds(NamedTuple):
    """peak_nm: N m, either way. slope_nmps: N m/s."""

    peak_nm: float
    slope_nmps: float


def bounds_of(robot: Robot) -> Bounds:
    """Peak and slope of the torque of any joint of `robot`: as declared in its `limits`, or by default."""
    peak = robot.limits.peak_torque_nm
    if peak is None:
        peak = _needed(robot)
    slope = robot.limits.torque_slope_nmps
    return Bounds(peak, 2 * peak / REVERSAL_TIME if slope is None else slope)


def _needed(robot: Robot) -> float:
    """Greatest joint torque, N m, of `robot` in the move that the default bounds are made for."""
    model, found = pack(robot), robot.identified
    across = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
    directions = np.stack([np.cos(across), np.sin(across), np.zeros(24)], axis=1)
    up = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    acceleration = ACCELERATION * np.concatenate([directions, up])
    position = forward(model, np.repeat(ARM_ANGLES[:, None], 3, axis=1))
    position, acceleration = np.repeat(position, len(acceleration), axis=0), np.tile(acceleration, (len(position), 1))
    theta, speed, change = inverse_motion(model, PlatformMotion(position, np.zeros_like(position), acceleration))
    terms = torque_terms(model, theta, speed, change)
    rho_1, rho_2 = (1.0, 1.0) if found is None else (found.rho_1.value, found.rho_2.value)
    moving = rho_1 * terms[:, INERTIA] + terms[:, PLATFORM] + robot.limits.max_payload_kg * terms[:, PAYLOAD]
    friction = 0.0 if found is None else max(map(abs, found.coulomb_friction_nm.value))
    return float(np.abs(moving + rho_2 * terms[:, GRAVITY]).max()) + friction
