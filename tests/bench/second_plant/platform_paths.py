"""Motions of the second plant: paths of its platform, drawn by a generator, each from rest to rest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from tests.bench.second_plant.closed_chain import CYCLE_S, Plant
from tests.bench.second_plant.inverse import angles

REST_S = 0.25  # before and after each motion
LOWEST_RAD, HIGHEST_RAD = -0.9, 1.5  # of the joints


class Room(NamedTuple):
    """A cylinder in which the platform works: height of its middle, radius, half its height; m."""

    middle: float
    radius: float
    half: float


def room_of(plant: Plant) -> Room:
    """The largest of a row of cylinders in which all joints stay within their range, away from stretched arms."""
    at = angles(plant, np.array([[0.0, 0.0, z] for z in np.linspace(-2.5, -0.1, 600)])).max(axis=1)
    middle = float(np.linspace(-2.5, -0.1, 600)[np.nanargmin(np.abs(at - 0.45))])
    reach = float(plant.link.mean())
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    for share in np.linspace(1.1, 0.3, 17):
        room = Room(middle, share * reach, 0.32 * share * reach)
        edge = [
            (room.radius * np.cos(a), room.radius * np.sin(a), middle + height)
            for a in turn for height in (-room.half, 0.0, room.half)
        ]  # fmt: skip
        angle = angles(plant, np.array(edge))
        if np.all((angle > LOWEST_RAD) & (angle < HIGHEST_RAD)):
            return room
    raise ValueError(f"no room for the platform at {middle:.3f} m of arms {plant.link} m and {plant.forearm} m")


def _between(share: np.ndarray) -> np.ndarray:
    """From 0 to 1 with speed, acceleration and jerk zero at both ends."""
    return share**4 * (35 - 84 * share + 70 * share**2 - 20 * share**3)


def _rested(path: np.ndarray) -> np.ndarray:
    rest = round(REST_S / CYCLE_S)
    return np.concatenate([np.repeat(path[:1], rest, axis=0), path, np.repeat(path[-1:], rest, axis=0)])


def picks(rng: np.random.Generator, room: Room, seconds: float, stations: np.ndarray | None = None) -> np.ndarray:
    """Pick and place, (n, 3) m each `CYCLE_S`: lift, across, down, a rest; to drawn places, or round `stations`."""
    here, found, number = None, [], 0
    while sum(map(len, found)) * CYCLE_S < seconds:
        if stations is None:
            turn, far = rng.uniform(0, 2 * np.pi), room.radius * np.sqrt(rng.uniform(0.05, 0.95))
            there = np.array([far * np.cos(turn), far * np.sin(turn), room.middle - room.half * rng.uniform(0.1, 0.9)])
        else:
            there = stations[number % len(stations)] + np.r_[rng.normal(0, 0.004, 2), 0.0]
        if here is not None:
            way = float(np.linalg.norm(there - here))
            duration = max(0.18, np.sqrt(way / rng.uniform(1.6, 4.5)))
            share = np.arange(round(duration / CYCLE_S)) * CYCLE_S / duration
            path = here + _between(share)[:, None] * (there - here)
            path[:, 2] += room.half * rng.uniform(0.5, 0.9) * 256 * (share * (1 - share)) ** 4
            dwell = np.repeat(there[None], round(rng.uniform(0.04, 0.25) / CYCLE_S), axis=0)
            found += [path, dwell]
        here, number = there, number + 1
    return _rested(np.concatenate(found))


def stations(rng: np.random.Generator, room: Room) -> np.ndarray:
    """Two to four places (k, 3) m that a production goes round."""
    turn = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(2, 5)))
    turn = turn[0] + np.cumsum(np.maximum(np.diff(turn, prepend=turn[0]), 0.8))
    far = room.radius * rng.uniform(0.45, 0.95, len(turn))
    height = room.middle - room.half * rng.uniform(0.2, 0.9, len(turn))
    return np.stack([far * np.cos(turn), far * np.sin(turn), height], axis=1)


def waves(rng: np.random.Generator, room: Room, seconds: float, low: float, high: float, steep: float) -> np.ndarray:
    """Sums of sines, (n, 3) m each `CYCLE_S`, between two frequencies in Hz; amplitudes fall with frequency^steep."""
    time = np.arange(round(seconds / CYCLE_S)) * CYCLE_S
    hertz = np.exp(rng.uniform(np.log(low), np.log(high), (3, 6)))
    size = hertz**-steep * rng.uniform(0.5, 1.0, (3, 6))
    phase = rng.uniform(0, 2 * np.pi, (3, 6))
    path = np.sum(size[..., None] * np.sin(2 * np.pi * hertz[..., None] * time + phase[..., None]), axis=1).T
    path[:, :2] *= 0.95 * room.radius / np.hypot(path[:, 0], path[:, 1]).max()
    path[:, 2] *= 0.95 * room.half / np.abs(path[:, 2]).max()
    begin = _between(np.clip(time / 0.6, 0, 1)) * _between(np.clip((seconds - time) / 0.6, 0, 1))
    return _rested(path * begin[:, None] + [0.0, 0.0, room.middle])


def gentle(plant: Plant, path: np.ndarray, most: float) -> np.ndarray:
    """The same path, slower where a joint would be faster than `most`, rad/s^2 of acceleration."""
    angle = angles(plant, path)
    worst = np.abs(np.diff(angle, 2, axis=0)).max() / CYCLE_S**2
    if worst <= most:
        return path
    stretched = np.arange(0, len(path) - 1, np.sqrt(most / worst))
    return CubicSpline(np.arange(len(path)), path)(stretched)
