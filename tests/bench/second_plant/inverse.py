"""The second plant backwards: joint angles of a path of the platform, and the torque that a motion takes.

Vectorised over samples, with the forces along the forearms from the platform's balance alone; `closed_chain.py` solves
the same robot forwards.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tests.bench.second_plant.closed_chain import STICKING_RADPS, Plant


class Moving(NamedTuple):
    """Joints (n, 3) rad, rad/s, rad/s^2 and platform (n, 3) m, m/s, m/s^2."""

    angle: np.ndarray
    rate: np.ndarray
    angular: np.ndarray
    place: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray


class Elbows(NamedTuple):
    """Of each sample and arm, (n, 3, 3): elbow, its first and second derivative by the angle, forearm."""

    at: np.ndarray
    slope: np.ndarray
    bend: np.ndarray
    forearm: np.ndarray


def angles(plant: Plant, place: np.ndarray) -> np.ndarray:
    """Joint angles (n, 3) in rad, elbows outwards, of places (n, 3) in m; NaN where the platform cannot be.

    Of the circle on which an elbow turns, the points as far from the wrist as the forearm is long: with u and z the
    wrist's place in the arm's plane, u cos θ - z sin θ = k.
    """
    out = np.stack([np.cos(plant.azimuth), np.sin(plant.azimuth)])
    across = np.stack([-np.sin(plant.azimuth), np.cos(plant.azimuth)])
    u, t, z = place[:, :2] @ out - plant.radius, place[:, :2] @ across, place[:, 2:]
    k = (u**2 + t**2 + z**2 + plant.link**2 - plant.forearm**2) / (2 * plant.link)
    with np.errstate(invalid="ignore"):
        return np.arctan2(-z, u) - np.arccos(k / np.hypot(u, z))


def elbows(plant: Plant, angle: np.ndarray, place: np.ndarray) -> Elbows:
    """What the arms are at angles (n, 3) and places (n, 3)."""
    x, y = np.cos(plant.azimuth), np.sin(plant.azimuth)
    cosine, sine = np.cos(angle), np.sin(angle)
    at = plant.radius + plant.link * cosine
    at = np.stack([at * x, at * y, -plant.link * sine], axis=-1)
    slope = -plant.link[:, None] * np.stack([sine * x, sine * y, cosine], axis=-1)
    bend = -plant.link[:, None] * np.stack([cosine * x, cosine * y, -sine], axis=-1)
    return Elbows(at, slope, bend, place[:, None] - at)


def along(plant: Plant, place: np.ndarray, period: float) -> Moving:
    """The joints along a path of the platform, (n, 3) m each `period` s: its derivatives by central differences."""
    speed = np.gradient(place, period, axis=0)
    acceleration = np.gradient(speed, period, axis=0)
    angle = angles(plant, place)
    arm = elbows(plant, angle, place)
    lever = np.sum(arm.forearm * arm.slope, axis=-1)
    rate = np.sum(arm.forearm * speed[:, None], axis=-1) / lever
    away = np.sum((speed[:, None] - arm.slope * rate[..., None]) ** 2, axis=-1)
    pulled = np.sum(arm.forearm * (acceleration[:, None] - arm.bend * rate[..., None] ** 2), axis=-1)
    return Moving(angle, rate, (pulled + away) / lever, place, speed, acceleration)


def parts(plant: Plant, moving: Moving) -> dict[str, np.ndarray]:
    """Torque (n, 3) in N m by what takes it: links and rotors turning, their weight, platform with rods, friction."""
    arm = elbows(plant, moving.angle, moving.place)
    rod = plant.forearm_mass[:, None]
    lift = np.sum(arm.slope * plant.gravity, axis=-1)
    elbow = arm.slope * moving.angular[..., None] + arm.bend * moving.rate[..., None] ** 2
    other = moving.acceleration[:, None]
    at_wrist = rod * ((elbow + 2 * other) / 6 - plant.gravity / 2)
    carried = plant.platform_mass * (moving.acceleration - plant.gravity) + at_wrist.sum(axis=1)
    pushed = np.linalg.solve(np.swapaxes(arm.forearm, 1, 2), carried[..., None])[..., 0]
    lever = np.sum(arm.forearm * arm.slope, axis=-1)
    at_elbow = np.sum(arm.slope * rod * ((2 * elbow + other) / 6 - plant.gravity / 2), axis=-1)
    return {
        "turning": (plant.link_mass * plant.link**2 / 3 + plant.rotor) * moving.angular,
        "weight": -plant.link_mass / 2 * lift,
        "carried": lever * pushed + at_elbow,
        "dry": plant.coulomb * np.tanh(moving.rate / STICKING_RADPS),
        "wet": plant.viscous * moving.rate,
    }


def required(plant: Plant, moving: Moving) -> np.ndarray:
    """Torque (n, 3) in N m that a motion takes of links, rods, platform and plain friction."""
    return np.sum(list(parts(plant, moving).values()), axis=0)
