"""The robot with its drives, forward in time; what a drive does is in `servo`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from schemas.kernels import kernel
from service.model.kinematics import REACHED
from service.rollout.kernel import near_kernel, set_out_kernel, step_kernel


class DriveGains(NamedTuple):
    """(3,) each, as in `Servo`; per_time: 1/s, inverse of the integral time. peak: N m."""

    position: np.ndarray
    velocity: np.ndarray
    per_time: np.ndarray
    velocity_forward: np.ndarray
    acceleration_forward: np.ndarray
    peak: float


@kernel
def _drive(gains, state, command, later, integral, i):
    """Torque of drive i and its push, N m, `later` s after a sample's command (3, 3)."""
    place = command[0, i] + later * (command[1, i] + 0.5 * later * command[2, i])
    speed = command[1, i] + later * command[2, i]
    slip = gains.velocity_forward[i] * speed - state[3, i]
    push = gains.velocity[i] * (slip + gains.position[i] * (place - state[2, i]))
    return push + integral[i] + gains.acceleration_forward[i] * command[2, i], push


@kernel(nogil=True)
def follow_kernel(forward, scratch, gains, runs, command, pace, motor, pushed):
    """As `run_kernel`, with torque that the drives make. command: (W, S, 3, 3) angle, speed, acceleration. Filled:
    motor, pushed (W, S, 3)."""
    f, s = forward[0], scratch[0]
    period, substeps = pace.period, pace.substeps
    h = period / substeps
    integral = np.zeros(3)
    count = command.shape[1]
    for w in range(len(runs.start)):
        set_out_kernel(s, runs.start[w], runs.payload[w])
        for i in range(3):
            integral[i] = 0.0
            integral[i] = runs.torque[w, 0, i] - _drive(gains, s.state, command[w, 0], 0.0, integral, i)[0]
        sound = True
        for k in range(count):
            sound &= near_kernel(s, runs.start[w])
            for i in range(3):
                free, _ = _drive(gains, s.state, command[w, k], 0.0, integral, i)
                motor[w, k, i] = s.state[2, i] if sound else np.nan
                pushed[w, k, i] = min(max(free, -gains.peak), gains.peak) if sound else np.nan
            if not sound or k == count - 1:
                continue
            for part in range(substeps):
                for i in range(3):
                    free, push = _drive(gains, s.state, command[w, k], part * h, integral, i)
                    limited = min(max(free, -gains.peak), gains.peak)
                    if limited == free:
                        integral[i] += push * h * gains.per_time[i]
                    s.before[i] = s.after[i] = limited
                sound = step_kernel(f, s, runs.seconds[w] + k * period + part * h, h) == REACHED
                if not sound:
                    break
