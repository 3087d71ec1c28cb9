"""Torque that was not measured but is the controller's answer to its position error: a command."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from schemas.axes_description import Description
from schemas.trace import Trace
from schemas.words import significant
from service.identification.fit import Problem, solve
from service.model.description import gain_unit
from service.model.scene import Recording

LOOP = 0.98  # of the torque's variance that position error and speeds explain: it is what the controller makes of them
TOLD_BETTER = 4.0  # times what the base model leaves of the square: from there the torque is the robot's
LEAST_ROWS = 50  # of a log, for four figures of it
LOOP_ALONE = 0.25  # of what speed leaves of it that is left at most when the error is known


def position_error(recording: Recording, trace: Trace) -> np.ndarray:
    """(N, n) commanded minus measured position, zero where there is no command; of a trace with commands."""
    assert trace.position_command is not None
    rows = recording.segment.rows
    return np.nan_to_num(trace.position_command[rows] - trace.position[rows])


def position_errors(recordings: Sequence[Recording], traces: Sequence[Trace]) -> list[np.ndarray]:
    """The same of each recording; none where the trace of one has no commands at all."""
    mine = [traces[recording.trace] for recording in recordings]
    if any(trace.position_command is None for trace in mine):
        return []
    return [position_error(recording, trace) for recording, trace in zip(recordings, mine, strict=True)]


def loops_of(
    problem: Problem, errors: Sequence[np.ndarray], plain: Sequence[np.ndarray]
) -> dict[int, tuple[float, float]]:
    """Lowest and highest gain, N m/rad or N/m, of each joint (from 0) whose torque the controller makes of its position
    error at once, with the same gain all through a log.

    Such a torque shows the controller: a delay, viscous friction and inertia trade places in it. One that the base
    model tells better was measured, however directly the drives answer. errors: (N, n) a recording, of its position;
    none where there is no command. plain: (R,) a recording, what the base model leaves.
    """
    if not errors:
        return {}
    loops, physics = {}, problem.rms(plain, [0] * len(plain))[0] ** 2
    for joint in range(len(problem.sigma)):
        answers = [
            _answer(basis, torque)
            for basis, torque in _by_log(problem, errors, joint)
            if len(torque) >= LEAST_ROWS and np.ptp(basis[:, 0]) > 0
        ]
        if not answers:
            continue
        gains, torque, left, without = zip(*answers, strict=True)
        square = float(np.mean(np.concatenate(left) ** 2))
        most = min((1.0 - LOOP) * float(np.var(np.concatenate(torque))), TOLD_BETTER * physics[joint])
        if square < most and square < LOOP_ALONE * float(np.mean(np.concatenate(without) ** 2)) and all(gains):
            loops[joint] = (min(gains), max(gains))
    return loops


def _by_log(problem: Problem, errors: Sequence[np.ndarray], joint: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """What a controller makes a torque of, (R, 4) position error, its rate, speed and one, and the torque (R,)."""
    logs: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}
    for number, recording in enumerate(problem.recordings):
        error, speed = errors[number][:, joint], recording.segment.theta_dot[:, joint]
        seen = np.stack([error, np.gradient(error, recording.segment.period), speed, np.ones_like(speed)], axis=1)
        rows = problem.rows[number][:, joint]
        logs.setdefault(recording.trace, []).append((problem.band(seen)[rows], problem.target[number][rows, joint]))
    sides = (zip(*parts, strict=True) for parts in logs.values())
    return [(np.concatenate(seen), np.concatenate(torque)) for seen, torque in sides]


def _answer(basis: np.ndarray, torque: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Gain, the torque (R,), what is left of it, and what speed alone leaves."""
    weight, left = _least_squares(basis, torque)
    _, without = _least_squares(basis[:, 2:], torque)
    return float(f"{weight[0]:.4g}"), torque, left, without


def _least_squares(basis: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights, and what they leave (R,)."""
    weight = solve(basis.T @ basis, basis.T @ wanted)
    return weight, wanted - basis @ weight


def gains_in_words(low: float, high: float, unit: str) -> str:
    """Gains of one log or of several."""
    return " to ".join(dict.fromkeys(map(significant, (low, high)))) + f" {unit}"


def told(loops: dict[int, tuple[float, float]], robot: Description) -> list[str]:
    """What to say of them."""
    return [
        f"the torque of joint {joint + 1} was not measured: it is the controller's response to its position error "
        f"({gains_in_words(*gains, gain_unit(robot, joint))}, without lag). The parameters include the controller; "
        "log the drive's measured current"
        for joint, gains in sorted(loops.items())
    ]
