"""The robot with its drives: commands in, motion and torque out.

    torque = integral + push + acceleration_feedforward command_ddot
    push = velocity_gain (velocity_feedforward command_dot - theta_dot + position_gain (command - theta))

and the integral grows by push over integral_time while the torque is not limited: position and velocity control in
cascade, as in CiA 402 drives. With the velocity fed forward in full it is a PID on the position error, in which
position gain and inverse integral time can change places: the larger one is taken for the gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from schemas.errors import DataError
from schemas.kernels import kernel
from schemas.robot import Servo
from schemas.trace import Trace
from service.model.kinematics import REACHED
from service.model.signals import Band, Segment
from service.rollout.kernel import SCRATCH, Pace, Runs, near_kernel, set_out_kernel, step_kernel
from service.rollout.robot import Stretch

MOST_LEFT = 0.3  # of the torque's rms that a drive's law may leave to be believed


class DriveGains(NamedTuple):
    """(3,) each, as in `Servo`; per_time: 1/s, inverse of the integral time. peak: N m."""

    position: np.ndarray
    velocity: np.ndarray
    per_time: np.ndarray
    velocity_forward: np.ndarray
    acceleration_forward: np.ndarray
    peak: float


def gains_of(servo: Servo, peak: float) -> DriveGains:
    """As the kernel takes them. peak: N m, where the drives' own is not described."""
    return DriveGains(
        np.array(servo.position_gain_ps),
        np.array(servo.velocity_gain_nms),
        np.array([1.0 / time if time else 0.0 for time in servo.integral_time_s]),
        np.array(servo.velocity_feedforward),
        np.array(servo.acceleration_feedforward_kgm2),
        servo.peak_torque_nm or peak,
    )


def commands_of(trace: Trace, segment: Segment) -> np.ndarray:
    """(N, 3, 3) of a segment's rows: command, its speed and acceleration, rad and s.

    Raises:
        DataError: the log has none, or not in every row.
    """
    command = trace.position_command
    if command is None:
        raise DataError(f"{trace.path}: holds no position commands")
    command = command[segment.rows]
    if not np.isfinite(command).all():
        row, joint = np.argwhere(~np.isfinite(command))[0]
        raise DataError(f"{trace.path}: row {segment.rows[row] + 1}: no position command of joint {joint + 1}")
    speed = np.gradient(command, segment.period, axis=0)
    return np.stack([command, speed, np.gradient(speed, segment.period, axis=0)], axis=1)


def identified(parts: Sequence[tuple[Trace, Segment, Stretch]]) -> Servo:
    """The drives by what their torque follows, in the band, a constant a part aside.

    Raises:
        DataError: there are no commands, or the torque of a joint does not follow them.
    """
    found = []
    for joint in range(3):
        columns, targets = [], []
        for trace, segment, seen in parts:
            command = commands_of(trace, segment)[:, :, joint]
            lag, slip = command[:, 0] - segment.theta[:, joint], command[:, 1] - segment.theta_dot[:, joint]
            rows = [slip, lag, np.cumsum(lag) * segment.period, command[:, 1], command[:, 2], seen.torque[:, joint]]
            band = Band.of(segment.period)
            kept = band(np.stack(rows, axis=1))[segment.moving[:: band.step, joint]]
            kept = kept - kept.mean(axis=0) if len(kept) else kept
            columns.append(kept[:, :-1])
            targets.append(kept[:, -1])
        slopes, target = np.concatenate(columns), np.concatenate(targets)
        weights = np.linalg.lstsq(slopes, target)[0]
        left = float(np.sqrt(np.sum((target - slopes @ weights) ** 2) / max(np.sum(target**2), 1e-300)))
        damping, stiffness, integral, forward, inertia = weights
        if not (left < MOST_LEFT and damping > 0 and stiffness > 0):
            raise DataError(
                f"{parts[0][0].path}: the torque of joint {joint + 1} does not follow the position error of its drive "
                f"({left:.0%} is left): describe the drives in [servo]"
            )
        mean, product = stiffness / damping / 2, max(integral, 0.0) / damping
        root = np.sqrt(max(mean**2 - product, 0.0))
        per_time = mean - root
        found.append((mean + root, damping, 1 / per_time if per_time > 0 else 0.0, 1 + forward / damping, inertia))
    values = [[float(f"{value:.4g}") for value in row] for row in zip(*found, strict=True)]
    return Servo(
        position_gain_ps=values[0],
        velocity_gain_nms=values[1],
        integral_time_s=values[2],
        velocity_feedforward=values[3],
        acceleration_feedforward_kgm2=values[4],
    )


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


def follow(
    seen: Stretch, gains: DriveGains, runs: Runs, command: np.ndarray, period: float
) -> tuple[np.ndarray, np.ndarray]:
    """Angles that the encoders give, rad, and torque, N m, (W, S, 3) each, NaN once a run ends.

    command: (W, S, 3, 3) angle, speed, acceleration.
    """
    motor, pushed = np.empty(runs.torque.shape), np.empty(runs.torque.shape)
    follow_kernel(seen.forward, np.zeros(1, SCRATCH), gains, runs, command, Pace.of(period), motor, pushed)
    return seen.measured(motor), pushed
