"""Offline prediction: the torque of each model along a recorded motion, smoothed in both directions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from schemas.axes_description import Description
from schemas.errors import DataError, PoseError, TraceError
from schemas.trace import Trace
from service.model.coulomb_viscous import mean_direction
from service.model.description import hypothesis_of, torque_along
from service.model.mechanism import mechanism_of
from service.model.signals import Segment, between, lowpass, resolved_hz, segments, usable

MODELS = ("M_KH", "M_Id", "M_Id+F", "full")  # each a superset of the one before; full adds forearm and effects
FULL = MODELS[-1]


@dataclass(frozen=True)
class Motion:
    """Smoothed motion of every row of a trace, N rows. theta, theta_dot, theta_ddot: (N, 3) rad, rad/s, rad/s^2.

    moving: (N, 3), False at rest, near the ends of a segment, and on rows that belong to none. measured: (N,), False on
    those rows; their motion is interpolated between their neighbours'. parts: what of the trace no fault interrupts.
    """

    theta: np.ndarray
    theta_dot: np.ndarray
    theta_ddot: np.ndarray
    moving: np.ndarray
    measured: np.ndarray
    parts: Sequence[Segment]

    @cached_property
    def band_hz(self) -> float:
        """Below it the positions tell the acceleration: where models are compared."""
        return resolved_hz(self.parts)


def motion(trace: Trace) -> Motion:
    """Smooth the parts of `trace` between faults and bridge the faults.

    Raises:
        TraceError: no part is long enough, naming the file.
    """
    shape = trace.position.shape
    signals = np.zeros((3, *shape))
    moving, measured = np.zeros(shape, bool), np.zeros(len(trace), bool)
    parts = segments(trace)
    for part in parts:
        rows = rows_of(part, trace)
        for order, values in enumerate((part.theta, part.theta_dot, part.theta_ddot)):
            signals[order, rows] = between(trace.time[rows], part.time, values)
        moving[rows] = between(trace.time[rows], part.time, part.moving) > 0.5
        measured[rows] = True
    if not measured.all():
        # by row, not by time: a faulty row's stamp may be the fault
        row, known = np.arange(len(trace)), np.flatnonzero(measured)
        for signal, joint in np.ndindex(len(signals), shape[1]):
            signals[signal, ~measured, joint] = np.interp(row[~measured], known, signals[signal, known, joint])
    return Motion(signals[0], signals[1], signals[2], moving, measured, parts)


def rows_of(part: Segment, trace: Trace) -> np.ndarray:
    """The usable rows that a part spans; all of its own, and those between, where it was brought to an even clock."""
    rows = np.arange(part.rows[0], part.rows[-1] + 1)
    return rows[usable(trace)[rows]]


def predict_along(robot: Description, trace: Trace, along: Motion) -> dict[str, np.ndarray]:
    """Torque (N, n), N m or N, of every row of `trace` by each of `MODELS` that `robot` carries figures for. along: its
    smoothed motion.

    Raises:
        TraceError: its positions are no pose of the robot, naming the file.
        RobotError: the robot carries an effect that is not known. DataError: it describes axes without figures.
    """
    if not robot.predicts:
        raise DataError(f"robot {robot.name}: no [identified] parameters: run `deltatwin diagnose` on its logs first")
    try:
        mechanism = mechanism_of(robot)
        rigid = mechanism.rigid(along.theta, along.theta_dot, along.theta_ddot)
    except PoseError as error:
        raise TraceError(f"{trace.path}: {error}") from error
    result = {name: rigid.torque(coefficients) for name, coefficients in mechanism.unidentified.items()}
    if robot.identified is not None:
        hypothesis = hypothesis_of(robot)
        base = hypothesis.base
        result["M_Id"] = rigid.torque(mechanism.grey(base.rigid))
        sliding = along.theta_dot @ mechanism.rows.T
        friction = base.viscous * sliding + base.coulomb * mean_direction(sliding, base.transition)
        friction = friction @ mechanism.rows
        result["M_Id+F"] = result["M_Id"] + friction
        result[FULL] = rigid.torque(base.rigid) + friction
        if hypothesis.terms or base.timing or np.isfinite(base.band_hz):
            result[FULL] = torque_along(robot, trace.time, along.theta, along.theta_dot, along.theta_ddot)
    return result


def error_in_band(trace: Trace, along: Motion, torque: np.ndarray) -> np.ndarray:
    """tau - `torque` (N, 3) below `along.band_hz`, N m; NaN where a joint rests or rows are faulty. along: the smoothed
    motion of `trace`."""
    result = np.full(torque.shape, np.nan)
    for part in along.parts:
        rows = rows_of(part, trace)
        error = part.torque - between(part.time, trace.time[rows], torque[rows])
        result[rows] = between(trace.time[rows], part.time, lowpass(error, part.period, along.band_hz))
    return np.where(along.moving, result, np.nan)
