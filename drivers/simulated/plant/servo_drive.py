"""Servo drives: cascaded position and velocity control with velocity and torque feed-forward, as in CiA 402 drives.

The controller hands over position and velocity at both ends of its cycle; the drive interpolates with a cubic, closes
its loops several times a cycle and adds the torque offset.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from drivers.simulated.plant.truth import PlantTruth
from schemas.kernels import kernel

VELOCITY_FILTER_HZ = 400.0  # of the speed error, which the drive makes from its encoder


class Tuning(NamedTuple):
    """Gains of the cascade: the same position gain and integral time for all, one velocity gain a joint."""

    position_gain: float  # 1/s
    velocity_gain: np.ndarray  # (3,) N m s/rad
    integral_time: float  # s
    peak_torque: float  # N m
    filter: float  # share of a new speed error that the filter takes over
    step: float  # s
    resolution: float  # rad, of the encoders at the joint; 0: none


class Cycle(NamedTuple):
    """What the drives are told for a cycle of `period` s: motion at both ends and feed-forward. All (3,) rad, rad/s,
    N m."""

    period: float
    start: np.ndarray
    start_dot: np.ndarray
    end: np.ndarray
    end_dot: np.ndarray
    feedforward: np.ndarray


class ServoState(NamedTuple):
    """What the drives remember. All (3,)."""

    lag: np.ndarray  # rad, position error of the pass before
    slip: np.ndarray  # rad/s, filtered speed error
    integral: np.ndarray  # N m


def tune(inertia: np.ndarray, truth: PlantTruth, step: float) -> Tuning:
    """Gains for joints of `inertia` (3,) kg m^2 from the bandwidths of the two loops."""
    counts = truth.encoder_counts_per_turn
    return Tuning(
        position_gain=2 * math.pi * truth.position_bandwidth_hz,
        velocity_gain=2 * math.pi * truth.velocity_bandwidth_hz * np.asarray(inertia, float),
        integral_time=truth.integral_time_s,
        peak_torque=truth.peak_torque_nm,
        filter=1 - math.exp(-2 * math.pi * VELOCITY_FILTER_HZ * step),
        step=step,
        resolution=2 * math.pi / (counts * truth.gear_ratio) if counts else 0.0,
    )


def rest(torque: np.ndarray) -> ServoState:
    """Drives at rest on their target that hold `torque` (3,) N m."""
    return ServoState(np.zeros(3), np.zeros(3), torque.copy())


@kernel
def interpolate(cycle, share, position):
    """Cubic through position and velocity at both ends of a cycle, at `share` 0..1 of it."""
    a = share * share * (3.0 - 2.0 * share)
    b = share * (1.0 - share) * (1.0 - share) * cycle.period
    c = -share * share * (1.0 - share) * cycle.period
    for i in range(3):
        distance = cycle.end[i] - cycle.start[i]
        position[i] = cycle.start[i] + a * distance + b * cycle.start_dot[i] + c * cycle.end_dot[i]


@kernel
def read_kernel(position, resolution, reading):
    """What encoders in steps of `resolution` rad (0: none) give for `position` (3,) rad."""
    for i in range(3):
        reading[i] = position[i]
        if resolution > 0.0:
            reading[i] = np.rint(reading[i] / resolution) * resolution


@kernel
def drive_kernel(tuning, state, reading, target, feedforward, torque):
    """One pass of the three cascades; fills torque (3,) N m. The integral stands still while the torque is limited.

    Target and reading are differentiated and filtered alike, so the filter's delay is no speed error.
    """
    for i in range(3):
        lag = target[i] - reading[i]
        raw = (lag - state.lag[i]) / tuning.step
        state.lag[i] = lag
        state.slip[i] += tuning.filter * (raw - state.slip[i])
        push = tuning.velocity_gain[i] * (state.slip[i] + tuning.position_gain * lag)
        free = push + state.integral[i] + feedforward[i]
        torque[i] = min(max(free, -tuning.peak_torque), tuning.peak_torque)
        if torque[i] == free:
            state.integral[i] += push * tuning.step / tuning.integral_time


@kernel
def control_kernel(tuning, state, cycle, share, position, target, reading, torque):
    """Encoders, interpolation and drives of one pass at `share` of a Cycle, the motors at `position` (3,) rad with the
    encoders' noise in it. Fills target, reading (3,) rad and torque (3,) N m."""
    read_kernel(position, tuning.resolution, reading)
    interpolate(cycle, share, target)
    drive_kernel(tuning, state, reading, target, cycle.feedforward, torque)


@kernel
def creep_kernel(forward, backward, speed, creep, torque):
    """Add dry friction (3,) N m of the levels `forward`, `backward` that builds up within `creep` rad/s."""
    for i in range(3):
        level = forward[i] if speed[i] > 0.0 else backward[i]
        torque[i] -= level * math.tanh(speed[i] / creep)
