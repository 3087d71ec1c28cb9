"""The paper's method: (rho_1, rho_2) by greedy grid search per trajectory, then friction by least squares per joint and
trajectory on what is left; the mean over trajectories of each. Two point masses for each forearm.

The RMS error is a quadratic form in (rho_1, rho_2), so the grid follows from six sums over the samples.

The paper takes its sums over all samples and the torque as it was measured (`literal`); `refit` takes them as the
pooled fit does, over samples in motion and with both sides low-passed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from schemas.errors import PoseError, TraceError
from schemas.trace import Trace
from service.identification.pooled import WEAK, Plain
from service.identification.regression import (
    COLUMNS,
    COULOMB,
    COULOMB_COLUMN,
    FOREARM_MASS,
    GRAVITY_COLUMN,
    INERTIA_COLUMN,
    ONE_COLUMN,
    PARAMETERS,
    RHO_1,
    RHO_2,
    TORQUE_COLUMN,
    VISCOUS,
    VISCOUS_COLUMN,
    WEIGHT_COLUMN,
    NormalEquations,
    regressors,
    rms_residual,
    target,
)
from service.model.mechanism import Delta
from service.model.nominal import DeltaModel
from service.model.scene import Recording
from service.model.signals import segments

GRID = 200  # points a side
HIGHEST = 5.0  # of rho_1 and rho_2 on it
WIDENINGS = 8  # times that the range doubles at most, where the best point lies at its upper end


def refit(logs: Sequence[NormalEquations], fit: Plain) -> Plain:
    """`fit` with the paper's values in place of the pooled ones. Verdicts are the pooled fit's, and weak at best where
    the trajectories disagree; standard errors come from their spread."""
    values, errors = means(logs)
    estimates = []
    for number, (estimate, value, error) in enumerate(zip(fit.estimates, values, errors, strict=True)):
        verdict, reason = estimate.verdict, estimate.reason
        if number == FOREARM_MASS:
            verdict, reason = "not identifiable", "two point masses in the paper's model"
        elif verdict == "identifiable" and not error <= WEAK * abs(value):
            verdict = "weak"
            reason = "one trajectory only: the spread is unknown" if np.isnan(error) else "the trajectories disagree"
        std_error = float(np.nan_to_num(error))
        estimates.append(replace(estimate, value=float(value), std_error=std_error, verdict=verdict, reason=reason))
    others = [[t for t in logs if t is not log] for log in logs]
    return replace(
        fit,
        estimates=tuple(estimates),
        residual=np.array([rms_residual(t, values) for t in logs]),
        held_out=fit.held_out
        if len(logs) < 2
        else np.array([rms_residual(t, means(o)[0]) for t, o in zip(logs, others, strict=True)]),
    )


def means(logs: Sequence[NormalEquations]) -> tuple[np.ndarray, np.ndarray]:
    """(9,) parameters in the order of `base_parameters` and their standard errors from the spread over trajectories.

    A single trajectory has no spread: its errors are NaN. A joint that rests throughout a trajectory has no say in it.
    """
    return _average([_single(log.gram.sum(axis=0)) for log in logs])


def literal(model: DeltaModel, traces: Sequence[Trace]) -> tuple[np.ndarray, np.ndarray]:
    """As `means`, from every sample of `traces`, at rest or not, and the torque as it was measured.

    Raises:
        TraceError: nothing usable in a trace, or positions that are no pose of the robot, naming the file.
    """
    return _average([_single(_raw_gram(model, trace)) for trace in traces])


def _raw_gram(model: DeltaModel, trace: Trace) -> np.ndarray:
    """(3, COLUMNS, COLUMNS) sums over all samples; only columns that the paper's method reads are filled."""
    gram = np.zeros((3, COLUMNS, COLUMNS))
    for part in segments(trace):
        columns = np.zeros((len(part.time), 3, COLUMNS))
        try:
            columns[:, :, :WEIGHT_COLUMN] = regressors(Recording(part, Delta(model, np.ones(3)), 0, trace.path.name))
        except PoseError as error:
            raise TraceError(f"{trace.path}: {error}") from error
        columns[:, :, TORQUE_COLUMN:ONE_COLUMN] = part.torque[:, None, :]
        gram += np.einsum("nja,njb->jab", columns, columns) * part.period
    return gram


def _average(of_each: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    each = np.array(of_each)
    known = np.isfinite(each)
    count = known.sum(axis=0)
    values = np.where(known, each, 0.0).sum(axis=0) / np.maximum(count, 1)
    spread = (np.where(known, each - values, 0.0) ** 2).sum(axis=0) / np.maximum(count - 1, 1)
    return values, np.where(count > 1, np.sqrt(spread / np.maximum(count, 1)), np.nan)


def _single(gram: np.ndarray) -> np.ndarray:
    """(9,) parameters from the sums of one trajectory, (3, COLUMNS, COLUMNS)."""
    result = np.full(PARAMETERS, np.nan)
    result[RHO_1], result[RHO_2] = grid(six_sums(gram))
    result[FOREARM_MASS] = 0.0
    for joint in range(3):
        left = target(joint)
        left[INERTIA_COLUMN], left[GRAVITY_COLUMN] = -result[RHO_1], -result[RHO_2]
        friction = gram[joint][[VISCOUS_COLUMN, COULOMB_COLUMN]]
        if np.linalg.det(friction[:, [VISCOUS_COLUMN, COULOMB_COLUMN]]) > 0:
            solved = np.linalg.solve(friction[:, [VISCOUS_COLUMN, COULOMB_COLUMN]], friction @ left)
            result[VISCOUS.start + joint], result[COULOMB.start + joint] = solved
    return result


def six_sums(gram: np.ndarray) -> np.ndarray:
    """(3, 3): squares and products of inertia, gravity and torque less the platform's, over all joints.

    gram: (3, COLUMNS, COLUMNS).
    """
    result = np.zeros((3, 3))
    for joint in range(3):
        chosen = np.zeros((COLUMNS, 3))
        chosen[INERTIA_COLUMN, 0] = chosen[GRAVITY_COLUMN, 1] = 1.0
        chosen[:, 2] = target(joint)
        result += chosen.T @ gram[joint] @ chosen
    return result


def grid(sums: np.ndarray) -> tuple[float, float]:
    """(rho_1, rho_2) of least RMS error on a grid of `GRID` points a side, refined once over the neighbours of the best
    one: to 2.5e-4 in the end.

    A grid whose upper edge has the best point is widened; below its lower edge, zero, there is no inertia and no mass.
    """
    none, high = np.zeros(2), np.full(2, HIGHEST)
    best = _best(sums, none, high)
    for _ in range(WIDENINGS):
        if (best < high).all():
            break
        high = np.where(best < high, high, 2.0 * high)
        best = _best(sums, none, high)
    step = high / (GRID - 1)
    best = _best(sums, np.maximum(best - step, none), best + step)
    return float(best[0]), float(best[1])


def _best(sums: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(2,) the point of least RMS error on the grid between `low` and `high` (2,)."""
    rho_1, rho_2 = np.linspace(low, high, GRID).T
    square = (
        sums[2, 2]
        + (sums[0, 0] * rho_1**2 - 2.0 * sums[0, 2] * rho_1)[:, None]
        + sums[1, 1] * rho_2**2
        - 2.0 * sums[1, 2] * rho_2
        + 2.0 * sums[0, 1] * np.outer(rho_1, rho_2)
    )
    first, second = np.unravel_index(np.argmin(square), square.shape)
    return np.array([rho_1[first], rho_2[second]])


def edges(logs: Sequence[NormalEquations]) -> list[str]:
    """Warnings about trajectories whose best point lay at an edge of the grid."""
    warnings = []
    for log in logs:
        found = grid(six_sums(log.gram.sum(axis=0)))
        for name, value in zip(("rho_1", "rho_2"), found, strict=True):
            if value > HIGHEST:
                warnings.append(
                    f"{log.name}: {name} = {value:.3g} is beyond the grid's limit of {HIGHEST:g}, which was widened; "
                    "are the masses in the description right?"
                )
            elif value <= 0.0:
                warnings.append(
                    f"{log.name}: {name} is at the grid's lower limit, 0: the best fit to this log would be negative"
                )
    return warnings
