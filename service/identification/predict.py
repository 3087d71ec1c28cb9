"""Offline prediction: the torque of each model along a recorded motion, smoothed in both directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.axes import Axes, Description
from schemas.errors import DataError, PoseError, TraceError
from schemas.robot import Identified, JointParameter
from schemas.trace import Trace
from service.diagnosis.description import torque_along
from service.identification.pooled import COULOMB, FOREARM_MASS, RHO_1, RHO_2, VISCOUS
from service.identification.regression import regressors
from service.model.nominal import pack
from service.model.signals import lowpass, segments

MODELS = ("M_KH", "M_Id", "M_Id+F", "full")  # each a superset of the one before; full adds forearm and effects
FULL = MODELS[-1]


@dataclass(frozen=True)
class Motion:
    """Smoothed motion of every row of a trace, N rows. theta, theta_dot, theta_ddot: (N, 3) rad, rad/s, rad/s^2.

    moving: (N, 3), False at rest, near the ends of a segment, and on rows that belong to none. measured: (N,), False on
    those rows; their motion is interpolated between their neighbours'.
    """

    theta: np.ndarray
    theta_dot: np.ndarray
    theta_ddot: np.ndarray
    moving: np.ndarray
    measured: np.ndarray


def motion(trace: Trace) -> Motion:
    """Smooth the parts of `trace` between faults and bridge the faults.

    Raises:
        TraceError: no part is long enough, naming the file.
    """
    shape = trace.position.shape
    signals = np.zeros((3, *shape))
    moving, measured = np.zeros(shape, bool), np.zeros(len(trace), bool)
    for part in segments(trace):
        signals[:, part.rows] = part.theta, part.theta_dot, part.theta_ddot
        moving[part.rows] = part.moving
        measured[part.rows] = True
    if not measured.all():
        # by row, not by time: a faulty row's stamp may be the fault
        row, known = np.arange(len(trace)), np.flatnonzero(measured)
        for signal, joint in np.ndindex(len(signals), shape[1]):
            signals[signal, ~measured, joint] = np.interp(row[~measured], known, signals[signal, known, joint])
    return Motion(signals[0], signals[1], signals[2], moving, measured)


def predict(robot: Description, trace: Trace) -> dict[str, np.ndarray]:
    """Torque (N, n), N m or N, of every row of `trace` by each of `MODELS` that `robot` carries figures for.

    Raises:
        TraceError: no part of the trace is long enough, or its positions are no pose of the robot, naming the file.
        DataError: the robot carries an effect that is not known, or describes axes without figures.
    """
    return predict_along(robot, trace, motion(trace))


def predict_along(robot: Description, trace: Trace, along: Motion) -> dict[str, np.ndarray]:
    """`predict` for a motion that is smoothed already."""
    if isinstance(robot, Axes):
        return _axes_along(robot, trace, along)
    try:
        turning = robot.identified.friction_transition_radps if robot.identified else 0.0
        columns = regressors(pack(robot), along.theta, along.theta_dot, along.theta_ddot, turning)
    except PoseError as error:
        raise TraceError(f"{trace.path}: {error}") from error
    inertia, gravity, forearm, viscous, coulomb, platform = np.moveaxis(columns, -1, 0)
    result = {"M_KH": inertia + gravity + platform}
    if robot.identified is not None:
        values = coefficients(robot.identified)
        result["M_Id"] = values[RHO_1] * inertia + values[RHO_2] * gravity + platform
        result["M_Id+F"] = result["M_Id"] + values[VISCOUS] * viscous + values[COULOMB] * coulomb
        result["full"] = result["M_Id+F"] + values[FOREARM_MASS] * forearm
        if robot.effect or robot.identified.torque_timing_s:
            result["full"] = torque_along(robot, trace.time, along.theta, along.theta_dot, along.theta_ddot)
    return result


def _axes_along(axes: Axes, trace: Trace, along: Motion) -> dict[str, np.ndarray]:
    """Inertia and offset alone stand for M_Id; without figures nothing is known of an axis but that it moves."""
    if axes.identified is None:
        raise DataError(f"robot {axes.name}: no [identified] parameters: run `deltatwin diagnose` on its logs first")
    signals = (trace.time, along.theta, along.theta_dot, along.theta_ddot)
    zero = JointParameter(value=[0.0] * len(axes.axis))
    rigid = axes.identified.model_copy(update={"viscous_friction": zero, "coulomb_friction": zero})
    plain = axes.model_copy(update={"effect": []})
    return {
        "M_Id": torque_along(plain.model_copy(update={"identified": rigid}), *signals),
        "M_Id+F": torque_along(plain, *signals),
        FULL: torque_along(axes, *signals),
    }


def coefficients(identified: Identified) -> np.ndarray:
    """(9,) in the order of `pooled.PARAMETERS`."""
    return np.array(
        [
            identified.rho_1.value,
            identified.rho_2.value,
            identified.forearm_inertia_kg.value,
            *identified.viscous_friction_nms.value,
            *identified.coulomb_friction_nm.value,
        ]
    )


def error_in_band(trace: Trace, along: Motion, torque: np.ndarray) -> np.ndarray:
    """tau - `torque` (N, 3) through the common low-pass, N m; NaN where a joint rests or rows are faulty."""
    result = np.full(torque.shape, np.nan)
    for part in segments(trace):
        result[part.rows] = lowpass(part.torque - torque[part.rows], part.period)
    return np.where(along.moving, result, np.nan)
