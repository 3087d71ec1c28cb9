"""The bounds of the feed-forward torque where the description does not declare them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from schemas.robot import Robot
from service.estimator.kalman import ORDER
from service.model.dynamics import GRAVITY, INERTIA, PAYLOAD, PLATFORM, torque_terms
from service.model.kinematics import PlatformMotion, forward, inverse_motion
from service.model.nominal import pack

# The move that the default bounds are made for: 10 g in any direction with the greatest payload, near the middle of the
# workspace (arms at 20 to 50 degrees). It is several times what a light part asks for; a drive's own peak, declared as
# peak_torque_nm, bounds closer.
ACCELERATION = 10 * 9.81  # m/s^2
ARM_ANGLES = np.radians([20.0, 35.0, 50.0])
REVERSAL_TIME = 0.02  # s from one peak to the other
# A drive's current follows within about this time: what the torque does in less never reaches the gear as it is.
RISE_TIME = 1e-3  # s


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


def growth_of(robot: Robot, period: float) -> float:
    """N m/s by which the slope of a joint's torque may grow in one cycle of `period` s.

    What alternates from sample to sample is no motion, and a slow stream's cycle is long enough for all of the slope's
    torque. So the slope takes the rise time to build up, at most the ORDER cycles from which a motion is known.
    """
    return bounds_of(robot).slope_nmps * growth_share(period)


def growth_share(period: float) -> float:
    """The same over the largest slope, 1 / cycle."""
    return max(1.0 / ORDER, min(1.0, RISE_TIME / period))


def acceleration_of(robot: Robot) -> float:
    """rad/s^2 that no joint of `robot` exceeds: its peak torque on the empty robot, but at least the torque of the move
    that the default bounds are made for. Drives may have more than the feed-forward is to use."""
    change, empty, *_ = _hard_moves(robot)
    peak = max(bounds_of(robot).peak_nm, _needed(robot))
    return peak * float(np.abs(change).max() / np.abs(empty).max())


def _needed(robot: Robot) -> float:
    """Greatest joint torque, N m, of `robot` in the move that the default bounds are made for."""
    found = robot.identified
    _, empty, loaded, weight = _hard_moves(robot)
    friction = 0.0 if found is None else max(map(abs, found.coulomb_friction_nm.value))
    return float(np.abs(empty + loaded + weight).max()) + friction


def _hard_moves(robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of the move that the default bounds are made for, (N, 3) each: joint acceleration, rad/s^2, and the torque, N m,
    that it takes of the empty robot, of the greatest payload and for the weight."""
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
    empty = rho_1 * terms[:, INERTIA] + terms[:, PLATFORM]
    return change, empty, robot.limits.max_payload_kg * terms[:, PAYLOAD], rho_2 * terms[:, GRAVITY]


def assumed_limit(file: Path, robot: Robot) -> str:
    """What stands in for a largest torque that a description does not state."""
    peak, most = bounds_of(robot).peak_nm, robot.limits.max_payload_kg
    return f"{file}: limits.peak_torque_nm is not set: {peak:.3g} N m assumed, the torque at 10 g with {most:g} kg"
