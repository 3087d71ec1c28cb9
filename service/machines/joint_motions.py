"""Motions of axes and arms within their limits, from rest to rest: sums of sines that excite every parameter.

Source: Swevers et al., Optimal robot excitation and identification, IEEE T-RA 1997 (doi 10.1109/70.631234).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from schemas.errors import DataError
from service.machines.machine import Limits, MachineModel
from service.model.coulomb_viscous import mean_direction
from service.model.description import in_units_of
from service.model.scene import Base

HARMONICS = 6  # of the motion's length
RAMP = 0.8  # s at each end, in which a motion comes out of rest and goes back
OF_RANGE = 0.7  # of a joint's half range that is used at most
FARTHEST, FARTHEST_M = 1.2, 0.25  # rad, m to each side of the middle, whatever the range
SHRINK = 0.8  # of a motion whose torque is too great
ROUNDS = 20
ROUNDING = 1e-9  # of the largest eigenvalue: less is none
COARSE = 25.0  # Hz at which motions are compared


@dataclass(frozen=True)
class JointMotion:
    """N instants `period` s apart: angle, speed and acceleration (N, n), rad or m."""

    period: float
    theta: np.ndarray
    theta_dot: np.ndarray
    theta_ddot: np.ndarray

    @property
    def time(self) -> np.ndarray:
        """(N,) s."""
        return np.arange(len(self.theta)) * self.period


def limits_of(
    machine: MachineModel, speed: float | None, acceleration: float | None, torque: float | None
) -> tuple[Limits, list[str]]:
    """Limits of the description, tightened by those given, and what has no limit: option names."""
    found = machine.limits()
    given = {"speed": speed, "acceleration": acceleration, "torque": torque}
    tight = {key: np.minimum(getattr(found, key), value) for key, value in given.items() if value is not None}
    limits = replace(found, **tight)
    return limits, [f"--max-{key}" for key in given if not np.isfinite(getattr(limits, key)).all()]


def multisine(
    machine: MachineModel,
    base: Base,
    limits: Limits,
    duration: float,
    period: float,
    rng: np.random.Generator,
    slow: bool = False,
) -> JointMotion:
    """A motion drawn at random, as large as the limits let it be. slow: of the lowest harmonic alone.

    Raises:
        DataError: the torque to stand still is above its limit somewhere within the range.
    """
    time = np.arange(round(duration / period) + 1) * period
    n = len(limits.low)
    most = FARTHEST if machine.description.angular else FARTHEST_M
    ended = np.isfinite(limits.low) & np.isfinite(limits.high)
    low, high = np.where(ended, limits.low, -most / OF_RANGE), np.where(ended, limits.high, most / OF_RANGE)
    middle, reach = (low + high) / 2, np.minimum(OF_RANGE * (high - low) / 2, most)
    order = np.arange(1, 2 if slow else HARMONICS + 1)
    size = rng.normal(size=(2, len(order), n)) / (np.ones_like(order) if slow else order)[:, None]
    rate = 2 * np.pi * order / duration
    wave = np.exp(1j * rate * time[:, None])
    parts = [((1j * rate) ** k * wave) @ (size[0] - 1j * size[1]) for k in range(3)]
    path = _from_rest(time, duration, [part.real for part in parts])
    path = [part * (reach / np.maximum(np.abs(path[0]).max(axis=0), 1e-12)) for part in path]
    for k, limit in ((1, limits.speed), (2, limits.acceleration)):
        share = np.minimum(1.0, limit / np.maximum(np.abs(path[k]).max(axis=0), 1e-12))
        path = [part * share for part in path]
    needed = np.zeros((1, n))
    for _ in range(ROUNDS):
        motion = JointMotion(period, middle + path[0], path[1], path[2])
        every = slice(None, None, max(1, round(1 / (COARSE * period))))
        needed = torque_of(machine, base, motion.theta[every], motion.theta_dot[every], motion.theta_ddot[every])
        if (np.abs(needed) <= limits.torque).all():
            return motion
        path = [part * SHRINK for part in path]
    unit = in_units_of(machine.description, "N m")
    raise DataError(
        f"{machine.description.name}: holding it in the middle of its range needs up to {np.abs(needed).max():.3g} "
        f"{unit}, but the smallest torque limit of a joint is {np.min(limits.torque):g} {unit}"
    )


def torque_of(
    machine: MachineModel, base: Base, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray
) -> np.ndarray:
    """(N, n) torque of the base model along (N, n) motion."""
    mechanism = machine.mechanism
    sliding = theta_dot @ mechanism.rows.T
    rubs = base.viscous * sliding + base.coulomb * mean_direction(sliding, base.transition)
    return mechanism.rigid(theta, theta_dot, theta_ddot).torque(base.rigid) + rubs @ mechanism.rows


def most_telling(
    machine: MachineModel,
    base: Base,
    limits: Limits,
    duration: float,
    period: float,
    seed: int,
    tries: int,
    progress: Callable[[], None] = lambda: None,
) -> tuple[JointMotion, np.ndarray]:
    """Of `tries` motions the one that tells base parameters best (greatest determinant of their information), and their
    standard errors (P,) for white noise of 1 N m at `COARSE`.

    Raises:
        As `multisine`.
    """
    best, told = None, (-np.inf, np.zeros(0))
    for number in range(tries):
        motion = multisine(machine, base, limits, duration, period, np.random.default_rng([seed, number]))
        found = _told(machine, motion)
        if best is None or found[0] > told[0]:
            best, told = motion, found
        progress()
    assert best is not None
    return best, told[1]


def _told(machine: MachineModel, motion: JointMotion) -> tuple[float, np.ndarray]:
    """Log determinant of the information, and standard errors (P,), without end where a motion does not tell."""
    every = slice(None, None, max(1, round(1 / (COARSE * motion.period))))
    theta, theta_dot, theta_ddot = (part[every] for part in (motion.theta, motion.theta_dot, motion.theta_ddot))
    mechanism = machine.mechanism
    sliding = theta_dot @ mechanism.rows.T
    rubs = [values[:, None] * mechanism.rows.T for values in (sliding, np.sign(sliding))]
    columns = np.concatenate([mechanism.rigid(theta, theta_dot, theta_ddot).columns, *rubs], axis=-1)
    flat = columns.reshape(-1, columns.shape[-1])
    gram = flat.T @ flat
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    kept = values > ROUNDING * values[-1]
    variance = (vectors[:, kept] ** 2 / values[kept]).sum(axis=1) / size**2
    unsure = (vectors[:, ~kept] ** 2).sum(axis=1) > ROUNDING
    return float(np.linalg.slogdet(gram)[1]), np.where(unsure, np.inf, np.sqrt(variance))


def _from_rest(time: np.ndarray, duration: float, parts: list[np.ndarray]) -> list[np.ndarray]:
    """Angle, speed and acceleration (N, n) times a smooth gate that is zero, with two derivatives, at both ends."""
    ramp = min(RAMP, duration / 4)
    gate = [np.ones_like(time), np.zeros_like(time), np.zeros_like(time)]
    for ends, way in ((time / ramp, 1.0), ((duration - time) / ramp, -1.0)):
        x = np.clip(ends, 0.0, 1.0)
        inside = ends < 1.0
        gate[0] = np.where(inside, x**3 * (10 - 15 * x + 6 * x**2), gate[0])
        gate[1] = np.where(inside, way * 30 * x**2 * (1 - x) ** 2 / ramp, gate[1])
        gate[2] = np.where(inside, 60 * x * (1 - x) * (1 - 2 * x) / ramp**2, gate[2])
    g, g1, g2 = (part[:, None] for part in gate)
    q, v, a = parts
    return [g * q, g * v + g1 * q, g * a + 2 * g1 * v + g2 * q]
