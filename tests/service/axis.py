"""One axis whose link sits behind a spring or a gap, by closed forms and by small steps."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tests.service.subject import Base, DecoupledAxes, Recording, Scene, Segment
from tests.service.world import PERIOD

INERTIA, LOAD = 0.4, 1.5  # kg m^2, N m: one axis with a constant load on its link
AXIS = DecoupledAxes(np.array([25.0]))
SINGLE = Base(np.array([INERTIA, LOAD]), np.array([0.6]), np.array([0.0]), 0.002)


def elastic(hz: float, ratio: float, share: float) -> tuple[float, float, float, float]:
    """Spring N m/rad, damper N m s/rad, motor's and link's inertia kg m^2 of an axis."""
    motor, link = share * INERTIA, (1 - share) * INERTIA
    spring = link * (2 * math.pi * hz) ** 2
    return spring, 2 * ratio * math.sqrt(spring * link), motor, link


@dataclass(frozen=True)
class Axis:
    """Motor motion (N,) of an axis and the torque that its motor feels, less that of a rigid one."""

    time: np.ndarray
    motion: tuple[np.ndarray, np.ndarray, np.ndarray]
    extra: np.ndarray

    def scene(self) -> Scene:
        """As effects see it."""
        torque = INERTIA * self.motion[2] + LOAD + 0.6 * self.motion[1] + self.extra
        theta, theta_dot, theta_ddot, torque = (values[:, None] for values in (*self.motion, torque))
        moving = np.abs(theta_dot) > 0.02
        part = Segment(np.arange(len(self.time)), self.time, PERIOD, theta, theta_dot, theta_ddot, torque, moving)
        return Scene(Recording(part, AXIS, 0, "axis"), SINGLE)


def swings(seconds: float, size: float = 1.0) -> tuple[np.ndarray, list[tuple[float, float]]]:
    """Clock and (amplitude rad, rad/s) of the sines of a motor's motion."""
    return np.arange(round(seconds / PERIOD)) * PERIOD, [
        (0.5 * size, 5.0),
        (0.05 * size, 31.0),
        (0.01 * size, 83.0),
        (0.005 * size, 107.0),
    ]


def spring_axis(seconds: float, hz: float, ratio: float, share: float) -> Axis:
    """The steady state of every sine through spring and damper, by transfer functions."""
    time, sines = swings(seconds)
    spring, damper, _, link = elastic(hz, ratio, share)
    motion = [np.zeros_like(time) for _ in range(3)]
    extra = np.zeros_like(time)
    for size, rate in sines:
        wave = size * np.exp(1j * rate * time)
        for order in range(3):
            motion[order] += ((1j * rate) ** order * wave).imag
        passed = spring + 1j * rate * damper
        follows = passed / (passed - link * rate**2)  # link over motor
        extra += (-link * rate**2 * (follows - 1) * wave).imag
    return Axis(time, (motion[0], motion[1], motion[2]), extra)


def loose_axis(seconds: float, half: float, hz: float, ratio: float, share: float) -> Axis:
    """A link between two stiff, damped flanks, semi-implicit Euler at 50 us; teeth push, they do not pull."""
    time, sines = swings(seconds, 2.0)
    spring, damper, _, link = elastic(hz, ratio, share)
    fine = 20
    clock = np.arange(len(time) * fine) * PERIOD / fine
    waves = [np.array([size * np.exp(1j * rate * clock) * (1j * rate) ** n for size, rate in sines]) for n in range(3)]
    angle, speed, change = (wave.sum(axis=0).imag for wave in waves)
    q, v = angle[0] - half - (link * change[0] + LOAD) / spring, speed[0]
    force = np.empty(len(clock))
    for k in range(len(clock)):
        gap, rate = angle[k] - q, speed[k] - v
        contact = 0.0
        if gap > half:
            contact = max(0.0, spring * (gap - half) + damper * rate)
        elif gap < -half:
            contact = min(0.0, spring * (gap + half) + damper * rate)
        force[k] = contact
        v += (contact - LOAD) / link * PERIOD / fine
        q += v * PERIOD / fine
    extra = force - link * change - LOAD
    mean = extra.reshape(len(time), fine).mean(axis=1)
    return Axis(time, (angle[::fine], speed[::fine], change[::fine]), mean)
