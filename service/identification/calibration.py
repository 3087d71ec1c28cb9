"""Logs with a known load: what the drives' torque constants and the platform's mass really are.

Empty motion alone cannot tell: a torque constant that is off by 5 % on all joints is a robot 5 % heavier. With c kg
known to hang on the platform, joint j of each log reports

    tau_j = s_j (rho_1 I_j + rho_2 G_j + m_f F_j + (M + dm + c) P_j) + f_v,j theta_dot + f_c,j sign theta_dot

with I, G, F and P as in `service.model` and s_j reported over true torque. It is bilinear: Gauss-Newton on the sums of
`regression`, which hold every product that it takes. The torque stands on the left alone, since noise in a regressor
would pull its factor towards zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from schemas.errors import DataError
from schemas.robot import EffectEntry, Identified, Robot
from schemas.trace import Trace
from schemas.words import part_of
from service.estimator.payload.payload_state import UNCALIBRATED
from service.identification import checks
from service.identification.fit import solve
from service.identification.noise import white_noise
from service.identification.regression import (
    COLUMNS,
    COULOMB_COLUMN,
    FOREARM_COLUMN,
    GRAVITY_COLUMN,
    INERTIA_COLUMN,
    PLATFORM_COLUMN,
    TORQUE_COLUMN,
    VISCOUS_COLUMN,
    NormalEquations,
    summarise,
)
from service.model.description import digits, entry
from service.model.effects.torque_scale import TorqueScale
from service.model.hypothesis import Term
from service.model.nominal import pack

ITERATIONS = 20
SETTLED = 1e-10  # step over its standard error, squared, that ends them
Z = 3.0  # standard errors by which a figure has to stand out before it is put right
LEAST_SCALE, LEAST_MASS = 0.01, 0.02  # -, kg; below this a torque constant or a platform is as described
BEYOND = 0.3  # no torque constant is that far off: the load is not what it is said to be
TOLD = 0.03  # standard error of a scale beyond which the logs cannot tell it
SUSPECT = 0.1  # share of the torque's rms that a log with the load that it is said to have leaves at most

_SCALE, _MASS, _RHO_1, _RHO_2, _FOREARM = slice(0, 3), 3, 4, 5, 6
_VISCOUS, _COULOMB = 7, 10  # of joint 1
_COUNT = 13
_RIGID = ((_RHO_1, INERTIA_COLUMN), (_RHO_2, GRAVITY_COLUMN), (_FOREARM, FOREARM_COLUMN))


@dataclass(frozen=True)
class CalibratedFigure:
    """What a known load says of one number of the description. std_error: in the same unit. changed: it was put
    right."""

    name: str
    unit: str
    value: float
    std_error: float
    changed: bool


@dataclass(frozen=True)
class Calibration:
    """robot: with the platform's mass put right. scale: (3,) reported over true torque, 1 where nothing shows
    otherwise. std_error: of the scale that the joints have in common, as a share. effect: the scale for the
    description. figures, warnings: what was found, and what a user has to know."""

    robot: Robot
    scale: np.ndarray
    std_error: float
    effect: EffectEntry | None
    figures: tuple[CalibratedFigure, ...]
    warnings: tuple[str, ...]

    def true(self, trace: Trace) -> Trace:
        """`trace` with its torque put right, and what the drives were told of it."""
        command = None if trace.torque_command is None else trace.torque_command / self.scale
        return replace(trace, torque=trace.torque / self.scale, torque_command=command)

    def carried(self, robot: Robot) -> Robot:
        """`robot`, identified on torque that was put right, as the description of what the drives report."""
        identified = robot.identified or Identified()
        known = identified.model_copy(update={"torque_constant_error": digits(self.std_error)})
        effect = [*robot.effect, *([] if self.effect is None else [self.effect])]
        return robot.model_copy(update={"identified": known, "effect": effect})


def calibrate(robot: Robot, empty: Sequence[Trace], carried: Sequence[tuple[float, Trace]]) -> Calibration:
    """Torque constants and platform mass of `robot` from logs without load and logs with a known one, kg.

    Raises:
        DataError: a load that is none, or a log in which it does not hang; names the log.
        TraceError: nothing usable in a trace, or positions that are no pose of the robot, naming the file.
    """
    model = pack(robot)
    for mass, trace in carried:
        if not 0.0 < mass <= robot.limits.max_payload_kg:
            raise DataError(
                f"{trace.path}: {mass:g} kg carried: must be above 0, at most {robot.limits.max_payload_kg:g}"
            )
    loads = np.array([0.0] * len(empty) + [mass for mass, _ in carried])
    logs = [summarise(model, trace) for trace in [*empty, *(trace for _, trace in carried)]]
    masses = (model.moving_mass + loads) / model.moving_mass
    checks.check(logs[: len(empty)], robot.drive.gear_ratio)
    noise = np.maximum(white_noise([part for log in logs for part in log.recordings]), 1e-6)
    free = np.ones(_COUNT, bool)
    values, errors = _solve(logs, masses, model.moving_mass, noise, free)
    _check(logs[len(empty) :], loads[len(empty) :], masses[len(empty) :], model.moving_mass, values, errors)
    off = np.abs(values - _nominal())[:4] > np.maximum(Z * errors[:4], [LEAST_SCALE] * 3 + [LEAST_MASS])
    off[_SCALE] &= errors[_SCALE] < TOLD
    free[: _MASS + 1] = off
    final, _ = _solve(logs, masses, model.moving_mass, noise, free)
    scale, change = final[_SCALE], float(final[_MASS])
    described = robot.mass.platform
    names = [*(f"reported over true torque, joint {joint + 1}" for joint in range(3)), "mass.platform"]
    told = [*values[_SCALE], described + values[_MASS]]
    figures = [
        CalibratedFigure(name, unit, float(value), float(error), bool(changed))
        for name, unit, value, error, changed in zip(names, ["", "", "", "kg"], told, errors[:4], off, strict=True)
    ]
    if described + change <= 0.0:
        raise DataError(
            f"{', '.join(str(trace.path) for _, trace in carried)}: a platform of {described + change:.2f} kg is "
            "impossible; is the stated load right?"
        )
    mass = robot.mass.model_copy(update={"platform": digits(described + change)})
    return Calibration(
        robot.model_copy(update={"mass": mass}),
        scale,
        _common_error(values[_SCALE], errors[_SCALE], off[_SCALE]),
        _effect(robot, scale, errors, off),
        tuple(figures),
        tuple(_warnings(values, errors, off, described)),
    )


def _nominal() -> np.ndarray:
    values = np.zeros(_COUNT)
    values[[0, 1, 2, _RHO_1, _RHO_2]] = 1.0
    return values


def _solve(
    logs: Sequence[NormalEquations], masses: np.ndarray, moving: float, noise: np.ndarray, free: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(13,) values, those not `free` as described, and standard errors by leaving out blocks in turn.

    masses: of each log, what hangs on the arms over `moving`, kg, which the platform's column is for.
    """
    values = _nominal()
    left, right = _normal_equations(logs, masses, moving, noise, values, free)
    for _ in range(ITERATIONS):
        whole = left.sum(axis=0)
        step = solve(whole, right.sum(axis=0))
        values[free] += step
        if step @ whole @ step < SETTLED:
            break
        left, right = _normal_equations(logs, masses, moving, noise, values, free)
    whole, count = left.sum(axis=0), len(left)
    changes = np.array([solve(whole - one, pull) for one, pull in zip(left, right, strict=True)])
    errors = np.zeros(_COUNT)
    errors[free] = np.sqrt((count - 1) / count * np.sum(changes**2, axis=0))
    return values, errors


def _normal_equations(
    logs: Sequence[NormalEquations], masses: np.ndarray, moving: float, noise: np.ndarray, values: np.ndarray,
    free: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """(B, F, F) and (B, F) of the `free` of `values` (13,), of every block of every log."""
    left, right = [], []
    for log, mass in zip(logs, masses, strict=True):
        block_left = np.zeros((len(log.gram), _COUNT, _COUNT))
        block_right = np.zeros((len(log.gram), _COUNT))
        for joint in range(3):
            predicted, slope = _prediction(values, joint, mass, moving)
            remains = -predicted
            remains[TORQUE_COLUMN + joint] += 1.0
            gram = log.gram[:, joint] / noise[joint] ** 2
            block_left += slope.T @ gram @ slope
            block_right += slope.T @ gram @ remains
        left.append(block_left)
        right.append(block_right)
    return np.concatenate(left)[:, free][:, :, free], np.concatenate(right)[:, free]


def _prediction(values: np.ndarray, joint: int, mass: float, moving: float) -> tuple[np.ndarray, np.ndarray]:
    """(COLUMNS,) of what joint `joint` reports, and (COLUMNS, 13) its derivative."""
    true, slope = np.zeros(COLUMNS), np.zeros((COLUMNS, _COUNT))
    scale = values[joint]
    for parameter, column in _RIGID:
        true[column] = values[parameter]
        slope[column, parameter] = scale
    true[PLATFORM_COLUMN] = mass + values[_MASS] / moving
    slope[PLATFORM_COLUMN, _MASS] = scale / moving
    slope[:, joint] = true
    predicted = scale * true
    for first, column in ((_VISCOUS, VISCOUS_COLUMN), (_COULOMB, COULOMB_COLUMN)):
        predicted[column] += values[first + joint]
        slope[column, first + joint] = 1.0
    return predicted, slope


def _check(
    logs: Sequence[NormalEquations],
    loads: np.ndarray,
    masses: np.ndarray,
    moving: float,
    values: np.ndarray,
    errors: np.ndarray,
) -> None:
    """
    Raises:
        DataError: a log with a load that does not go with it.
    """
    for log, load, mass in zip(logs, loads, masses, strict=True):
        square = torque = 0.0
        for joint in range(3):
            remains = -_prediction(values, joint, mass, moving)[0]
            remains[TORQUE_COLUMN + joint] += 1.0
            gram = log.gram[:, joint].sum(axis=0)
            square += remains @ gram @ remains
            torque += gram[TORQUE_COLUMN + joint, TORQUE_COLUMN + joint]
        share = np.sqrt(max(square, 0.0) / max(torque, 1e-12))
        if share > SUSPECT:
            raise DataError(
                f"{log.name}: with {load:g} kg on the platform the model leaves {part_of(share)} the torque "
                "unexplained; is that payload carried in the whole log?"
            )
    scale = values[_SCALE]
    far = np.abs(scale - 1.0) > BEYOND + Z * errors[_SCALE]
    if far.any():
        joint = int(np.argmax(far))
        names = ", ".join(f"{log.name} ({load:g} kg)" for log, load in zip(logs, loads, strict=True))
        raise DataError(
            f"{names}: joint {joint + 1} would report {scale[joint]:.2f} times the true torque, more than a wrong "
            "torque constant can cause; is the stated load right?"
        )


def _common_error(scale: np.ndarray, errors: np.ndarray, off: np.ndarray) -> float:
    """Standard error, as a share, of what the joints (3,) have in common: that of each scale and, where it was left as
    declared, by how much it seems to be off; no more than without a known load."""
    left = np.where(off, 0.0, scale - 1.0)
    return float(np.sqrt(np.mean(np.minimum(errors**2 + left**2, UNCALIBRATED**2))))


def _effect(robot: Robot, scale: np.ndarray, errors: np.ndarray, off: np.ndarray) -> EffectEntry | None:
    joints = tuple(int(joint) for joint in np.flatnonzero(off[_SCALE]))
    if not joints:
        return None
    term = replace(Term.blank(TorqueScale(), joints, ()), amplitude=(scale[list(joints)] - 1.0)[:, None])
    return entry(term, errors[list(joints)], robot)


def _warnings(values: np.ndarray, errors: np.ndarray, off: np.ndarray, described: float) -> list[str]:
    warnings = []
    for joint in range(3):
        scale, error = values[joint], errors[joint]
        if off[joint]:
            warnings.append(
                f"joint {joint + 1}: with the known load, the drive reports {scale:.3f} ± {error:.3f} times the true "
                "torque: check torque constant, rated torque and gear ratio; the description contains the factor as "
                "torque_scale"
            )
        elif error >= TOLD:
            warnings.append(
                f"joint {joint + 1}: the known load determines its torque constant only to {100 * error:.0f} %: it "
                "remains as declared; use a heavier load or faster moves"
            )
    if off[_MASS]:
        warnings.append(
            f"mass.platform: {described + values[_MASS]:.3f} ± {errors[_MASS]:.3f} kg from the known load, "
            f"{described:g} kg in the description: corrected"
        )
    return warnings
