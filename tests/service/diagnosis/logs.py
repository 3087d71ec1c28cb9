"""Small logs of a robot that is exactly its model, with as much Stribeck friction as asked for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from drivers.trace import write_trace
from schemas.robot import Geometry, Mass, Robot
from schemas.trace import Trace
from service.model.dynamics import FOREARM, GRAVITY, INERTIA, PLATFORM, torque_terms
from service.model.nominal import pack

ROBOT = Robot(
    name="bench",
    geometry=Geometry(active_link_length=0.36, passive_link_length=0.85, base_radius=0.19, platform_radius=0.05),
    mass=Mass(active_link=2.7, passive_link=0.55, platform=1.3),
)
RESOLUTION = 2.4e-7  # rad
NOISE = 0.3  # N m
Angles = Callable[[np.ndarray], np.ndarray]


def swing(seed: int, joints: tuple[int, ...] = (0, 1, 2)) -> Angles:
    """Angles (N, 3) rad of a slow multisine on `joints`, the others held."""
    rng = np.random.default_rng(seed)
    rate, phase = rng.uniform(2.0, 9.0, (3, 4)), rng.uniform(0, 2 * np.pi, (3, 4))

    def angles(time: np.ndarray) -> np.ndarray:
        sines = np.sin(time[:, None, None] * rate + phase).sum(axis=2)
        return np.where(np.isin(np.arange(3), joints), 0.45 + 0.09 * sines, 0.45)

    return angles


def one_way(time: np.ndarray) -> np.ndarray:
    """All joints down, never up, at a speed that varies."""
    return np.stack([0.0 + 0.18 * time + 0.02 * np.sin((3 + j) * time) for j in range(3)], axis=1)


def record(path: Path, robot: Robot, angles: Angles, seconds: float, seed: int, stuck: float) -> str:
    """A log of `robot` moving by `angles`, without commands. stuck: N m of Stribeck friction below 0.3 rad/s."""
    rng = np.random.default_rng(seed)
    step = 1e-4
    time = np.arange(0.0, seconds, 1e-3)
    before, theta, after = angles(time - step), angles(time), angles(time + step)
    speed, acceleration = (after - before) / (2 * step), (after - 2 * theta + before) / step**2
    terms = torque_terms(pack(robot), theta, speed, acceleration)
    torque = 1.6 * terms[:, INERTIA] + 1.1 * terms[:, GRAVITY] + terms[:, PLATFORM] + 0.55 * terms[:, FOREARM]
    sign = np.tanh(speed / 0.002)
    torque += 0.8 * speed + sign * (3.0 + stuck * np.exp(-((speed / 0.3) ** 2)))
    torque += rng.normal(0.0, NOISE, torque.shape)
    write_trace(Trace(path, time, np.round(theta / RESOLUTION) * RESOLUTION, torque), path)
    return str(path)
