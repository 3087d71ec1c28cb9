"""A planned motion as a file: joint and platform position at the controller's rate, and the torque it should take.

The file is a trace as well: `replay` plays it, with the torque that was expected.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

from drivers.data_frames import pl
from drivers.motion import Planner, Trajectory
from drivers.trace import read_trace
from schemas.errors import DataError
from schemas.files import write_text
from schemas.robot import Robot
from service.model import kinematics

DECIMALS = 12  # the way is differentiated twice


def write_motion(motion: Trajectory, torque: np.ndarray, planner: Planner, path: Path) -> None:
    """Write `motion` and the torque (N + 1, 3) N m expected along it.

    Raises:
        StorageError: the file cannot be written.
    """
    platform = kinematics.forward(planner.geometry, motion.position)
    columns = {"time_s": np.arange(len(motion.position)) * motion.period}
    columns |= {f"position_{joint + 1}_rad": motion.position[:, joint] for joint in range(3)}
    columns |= {f"torque_{joint + 1}_nm": torque[:, joint] for joint in range(3)}
    columns |= {f"platform_{axis}_m": platform[:, number] for number, axis in enumerate("xyz")}
    write_text(path, pl.DataFrame(columns).write_csv(float_precision=DECIMALS))


def read_motion(path: Path, robot: Robot, planner: Planner) -> Trajectory:
    """The motion of a file, at the planner's period, checked against its limits.

    Raises:
        TraceError: the file cannot be read. DataError: a row is flagged, or the motion breaks a limit.
    """
    trace = read_trace(path, robot)
    if trace.flags.any():
        row = int(np.flatnonzero(trace.flags)[0])
        said = trace.findings[0].message if trace.findings else "flagged"
        raise DataError(f"{path}: row {row + 1}: a motion must not contain faults: {said}")
    count = int((trace.time[-1] - trace.time[0]) / planner.period + 1e-6)
    time = np.minimum(trace.time[0] + np.arange(count + 1) * planner.period, trace.time[-1])
    if len(trace) < 6 or count < 2:
        raise DataError(f"{path}: too few rows for a motion: {len(trace)}")
    motion = resampled(trace.time, trace.position, time, planner.period)
    planner.check(motion, str(path))
    return motion


def resampled(time: np.ndarray, position: np.ndarray, instants: np.ndarray, period: float) -> Trajectory:
    """The motion through (N, 3) `position` at (N,) `time`, s, at `instants`, which are `period` s apart."""
    path = make_interp_spline(time, position, k=5)
    return Trajectory(period, path(instants), path(instants, 1), path(instants, 2))
