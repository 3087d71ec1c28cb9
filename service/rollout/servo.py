"""The robot with its drives: commands in, motion and torque out.

    torque = integral + push + acceleration_feedforward command_ddot
    push = velocity_gain (velocity_feedforward command_dot - theta_dot + position_gain (command - theta))

and the integral grows by push over integral_time while the torque is not limited: position and velocity control in
cascade, as in CiA 402 drives. With the velocity fed forward in full it is a PID on the position error, in which
position gain and inverse integral time can change places: the larger one is taken for the gain.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from schemas.errors import DataError
from schemas.robot import Servo
from schemas.trace import Trace
from schemas.words import percent
from service.model.signals import Band, Segment
from service.rollout.kernel import DriveGains
from service.rollout.packed import SeenStretch

MOST_LEFT = 0.3  # of the torque's rms that a drive's law may leave to be believed


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
        raise DataError(f"{trace.path}: contains no position commands")
    command = command[segment.rows]
    if not np.isfinite(command).all():
        row, joint = np.argwhere(~np.isfinite(command))[0]
        raise DataError(f"{trace.path}: row {segment.rows[row] + 1}: no position command of joint {joint + 1}")
    speed = np.gradient(command, segment.period, axis=0)
    return np.stack([command, speed, np.gradient(speed, segment.period, axis=0)], axis=1)


def identified(parts: Sequence[tuple[Trace, Segment, SeenStretch]]) -> Servo:
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
                f"(residual {percent(left)}): describe the drives in [servo]"
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
