"""What a residual follows that the base model of its joint does not know: the motion of other joints, the sine of its
own angle, the position error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal

import numpy as np

from schemas.diagnosis import Follows
from schemas.trace import Trace
from service.diagnosis.evidence.opened import LEAST_SHARE, STANDS_OUT
from service.identification.fit import Problem, solve
from service.identification.folds import Split
from service.identification.loops import position_error
from service.model.coulomb_viscous import mean_direction
from service.model.scene import Recording

What = Literal["motion", "sine_of_angle", "position_error"]


def follows(
    problem: Problem, split: Split, residuals: Sequence[np.ndarray], traces: Sequence[Trace], angular: bool
) -> list[Follows]:
    """What residuals (R,) a recording, in units of the noise, follow, strongest first; each share on data left out.

    traces: that the recordings are of, for their position commands. angular: the axes turn.
    """
    found: list[Follows] = []
    joints = len(problem.sigma)
    for joint in range(joints):
        values = [r[j == joint] for r, j in zip(residuals, problem.joints_of_rows, strict=True)]
        fold = [f[j == joint] for f, j in zip(split.fold, problem.joints_of_rows, strict=True)]
        count = sum(map(len, values))
        energy = sum(float(v @ v) for v in values)
        if count < 50 or energy < STANDS_OUT * count:
            continue
        for what, other, columns in _groups(problem, joint, traces, angular):
            share = _share(columns, values, fold, split.folds, energy - count)
            if share > LEAST_SHARE:
                found.append(Follows(joint=joint + 1, what=what, other=other, share=round(share, 4)))
    return sorted(found, key=lambda one: -one.share)


def _groups(
    problem: Problem, joint: int, traces: Sequence[Trace], angular: bool
) -> list[tuple[What, int | None, list[np.ndarray]]]:
    """(what, joint it is of, columns (R, C) a recording) of everything that is asked."""

    def rows(columns_of: Callable[[Recording], np.ndarray]) -> list[np.ndarray]:
        """(R, C + 1) a recording of (N, C), in the band, with a constant."""
        every = zip(problem.recordings, problem.rows, strict=True)
        chosen = [problem.band(columns_of(recording))[moving[:, joint]] for recording, moving in every]
        return [np.concatenate([one, np.ones((len(one), 1))], axis=1) for one in chosen]

    groups: list[tuple[What, int | None, list[np.ndarray]]] = [
        ("motion", other + 1, rows(partial(_motion, joint=other)))
        for other in range(len(problem.sigma))
        if other != joint
    ]
    if angular:
        groups.append(("sine_of_angle", None, rows(partial(_sine, joint=joint))))
    if all(trace.position_command is not None for trace in traces):
        errors = rows(lambda recording: position_error(recording, traces[recording.trace])[:, [joint]])
        if any(np.ptp(error[:, 0]) > 0 for error in errors if len(error)):
            groups.append(("position_error", None, errors))
    return groups


def _motion(recording: Recording, joint: int) -> np.ndarray:
    segment = recording.segment
    direction = mean_direction(segment.theta_dot[:, [joint]], 0.01)[:, 0]
    return np.stack([segment.theta_ddot[:, joint], segment.theta_dot[:, joint], direction], axis=1)


def _sine(recording: Recording, joint: int) -> np.ndarray:
    theta = recording.segment.theta[:, joint]
    return np.stack([np.sin(theta), np.cos(theta)], axis=1)


def _share(
    columns: list[np.ndarray], values: list[np.ndarray], fold: list[np.ndarray], folds: int, above: float
) -> float:
    """Of the energy `above` the noise that columns take away on folds left out, beyond what a constant does."""
    kept = 0.0
    for number in range(folds):
        fitted = []
        for part in (slice(None), slice(-1, None)):
            train = [(c[f != number, part], v[f != number]) for c, v, f in zip(columns, values, fold, strict=True)]
            out = [(c[f == number, part], v[f == number]) for c, v, f in zip(columns, values, fold, strict=True)]
            weight = solve(np.asarray(sum(c.T @ c for c, _ in train)), np.asarray(sum(c.T @ v for c, v in train)))
            fitted.append(sum(float(((v - c @ weight) ** 2).sum()) for c, v in out))
        kept += fitted[1] - fitted[0]
    return float(np.clip(kept / above, 0.0, 1.0))
