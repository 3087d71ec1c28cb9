"""Pooled weighted least squares over all trajectories, with everything that says how far to trust it.

    tau_j - platform_j = rho_1 inertia_j + rho_2 gravity_j + m_f forearm_j + f_v,j theta_dot_j + f_c,j dir theta_dot_j

dir is the sign, turning over a speed that is fitted too: in slow motion a jump would be read as a gap.

The forearm's rod coupling is fitted, not taken from the described mass: what it multiplies is a mass only for a uniform
rod, and ball joints at the ends make it less. Where the data cannot tell it, the described forearm mass stands.

Each joint weighs by the white noise of its torque. Standard errors come from leaving out blocks of `BLOCK` seconds in
turn (jackknife), so they hold for a residual of any colour that is forgotten within a block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from schemas.errors import DataError
from service.identification.regression import (
    COLUMNS,
    COULOMB_COLUMN,
    FOREARM_COLUMN,
    GRAVITY_COLUMN,
    INERTIA_COLUMN,
    PLATFORM_COLUMN,
    TORQUE_COLUMN,
    TRANSITIONS,
    VISCOUS_COLUMN,
    Trajectory,
)
from service.model.signals import ANALYSIS_HZ

PARAMETERS = ("rho_1", "rho_2", "forearm", "f_v_1", "f_v_2", "f_v_3", "f_c_1", "f_c_2", "f_c_3")
RHO_1, RHO_2, FOREARM_MASS = range(3)
VISCOUS, COULOMB = slice(3, 6), slice(6, 9)

MINIMUM_BLOCKS = 2 * len(PARAMETERS)
# Standard error over value (or over what would make 5 % of the torque, if that is more).
WEAK, NOT_IDENTIFIABLE = 0.1, 0.5
NEGLIGIBLE_SHARE = 0.05
# A parameter whose effect the others reproduce but for this share of its variance is not told apart from them.
COLLINEAR = 1e-5
TURNS_SMOOTHLY = 10.0  # squared residual in units of the noise by which a smooth reversal must beat a jump
MOVES = 0.02  # rad of travel below which a joint does not move
REVERSES = 0.05  # share of the motion time that must go in each direction


@dataclass(frozen=True)
class Estimate:
    """One parameter. verdict: "identifiable", "weak" or "not identifiable"; reason: why, where it is not the first."""

    name: str
    value: float
    std_error: float
    verdict: str
    reason: str = ""


@dataclass(frozen=True)
class Fit:
    """estimates in the order of `PARAMETERS`. noise: (3,) N m white rms per sample. noise_floor: (3,) N m, what of it
    lies in the analysis band. held_out: (T, 3) rms of the residual of each trajectory under the fit to the others, N m
    in the analysis band, NaN for a single trajectory. residual: (T, 3) the same under the fit to all. torque: (T, 3)
    rms. without: (T, 9) values from the other trajectories (from all, for a single one)."""

    estimates: tuple[Estimate, ...]
    noise: np.ndarray
    noise_floor: np.ndarray
    held_out: np.ndarray
    residual: np.ndarray
    torque: np.ndarray
    without: np.ndarray

    @property
    def model_error(self) -> np.ndarray:
        """(3,) N m rms of what is left above the noise, on trajectories not seen by the fit where there are several."""
        left = np.where(np.isfinite(self.held_out), self.held_out, self.residual)
        return np.sqrt(np.maximum(np.nanmean(left**2, axis=0) - self.noise_floor**2, 0.0))

    @property
    def values(self) -> np.ndarray:
        return np.array([estimate.value for estimate in self.estimates])


def selection(joint: int) -> np.ndarray:
    """(COLUMNS, 9): the columns of `joint` that each parameter multiplies."""
    chosen = np.zeros((COLUMNS, len(PARAMETERS)))
    for column, parameter in (
        (INERTIA_COLUMN, RHO_1),
        (GRAVITY_COLUMN, RHO_2),
        (FOREARM_COLUMN, FOREARM_MASS),
        (VISCOUS_COLUMN, VISCOUS.start + joint),
        (COULOMB_COLUMN, COULOMB.start + joint),
    ):
        chosen[column, parameter] = 1.0
    return chosen


def target(joint: int) -> np.ndarray:
    """(COLUMNS,): torque less the platform's."""
    chosen = np.zeros(COLUMNS)
    chosen[TORQUE_COLUMN + joint], chosen[PLATFORM_COLUMN] = 1.0, -1.0
    return chosen


def weights(trajectories: Sequence[Trajectory]) -> np.ndarray:
    """(3,) per (N m)^2 s: information in a second of each joint's torque, from the median noise of the logs."""
    density = np.median([trajectory.density for trajectory in trajectories], axis=0)
    floor = 1e-9 * max(float(np.max(density)), float(np.mean(_mean_square(trajectories))) * 1e-6, 1e-12)
    return 2.0 / np.maximum(density, floor)


def _mean_square(trajectories: Sequence[Trajectory]) -> np.ndarray:
    gram = np.sum([trajectory.gram.sum(axis=0) for trajectory in trajectories], axis=0)
    seconds = np.sum([trajectory.seconds.sum(axis=0) for trajectory in trajectories], axis=0)
    return np.array([gram[j, TORQUE_COLUMN + j, TORQUE_COLUMN + j] for j in range(3)]) / np.maximum(seconds, 1e-9)


def normal_equations(gram: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(..., 9, 9) and (..., 9) of grams (..., 3, COLUMNS, COLUMNS)."""
    chosen = np.stack([selection(joint) for joint in range(3)])
    wanted = np.stack([target(joint) for joint in range(3)])
    left = np.einsum("j,jap,...jab,jbq->...pq", weight, chosen, gram, chosen, optimize=True)
    right = np.einsum("j,jap,...jab,jb->...p", weight, chosen, gram, wanted, optimize=True)
    return left, right


def square_residual(gram: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """(..., 3): sum of squares left by `parameters` (9,) in grams (..., 3, COLUMNS, COLUMNS), unweighted."""
    left = np.stack([target(joint) - selection(joint) @ parameters for joint in range(3)])
    return np.maximum(np.einsum("ja,...jab,jb->...j", left, gram, left), 0.0)


def solve(left: np.ndarray, right: np.ndarray, held: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """(..., 9): least-squares solution with the `held` parameters at their `nominal` values."""
    free = np.flatnonzero(~held)
    result = np.broadcast_to(nominal, right.shape).copy()
    if len(free):
        known = right - left @ np.where(held, nominal, 0.0)
        scale = np.sqrt(np.einsum("...pp->...p", left)[..., free])
        scale = np.where(scale > 0, scale, 1.0)
        scaled = left[..., free[:, None], free] / (scale[..., :, None] * scale[..., None, :])
        result[..., free] = np.linalg.solve(scaled, (known[..., free] / scale)[..., None])[..., 0] / scale
    return result


def transition(trajectories: Sequence[Trajectory]) -> float:
    """Which of `TRANSITIONS` the logs ask for, rad/s; 0 unless they speak against a jump."""
    weight = weights(trajectories)
    held = np.array([_still(trajectories, name) for name in PARAMETERS])
    lost = []
    for speed in TRANSITIONS:
        gram = np.sum([trajectory.at(speed).gram.sum(axis=0) for trajectory in trajectories], axis=0)
        left, right = normal_equations(gram, weight)
        values = np.zeros(len(PARAMETERS))
        values[~held] = np.linalg.lstsq(left[np.ix_(~held, ~held)], right[~held], rcond=1e-10)[0]
        lost.append(float(weight @ square_residual(gram, values)))
    best = int(np.argmin(lost))
    return TRANSITIONS[best] if lost[0] - lost[best] > TURNS_SMOOTHLY else 0.0


def fit(trajectories: Sequence[Trajectory], forearm_mass: float) -> Fit:
    """Fit all trajectories together. forearm_mass: kg, stands where the data cannot tell it.

    Raises:
        DataError: too little motion for any verdict.
    """
    gram = np.concatenate([trajectory.gram for trajectory in trajectories])
    seconds = np.concatenate([trajectory.seconds for trajectory in trajectories])
    filled = seconds.sum(axis=1) > 0
    if filled.sum() < MINIMUM_BLOCKS:
        raise DataError(
            f"{', '.join(t.name for t in trajectories)}: too little motion, {seconds.max(axis=1).sum():.1f} s; "
            f"nine parameters and their errors need {MINIMUM_BLOCKS / 2:.0f} s or more"
        )
    nominal = np.zeros(len(PARAMETERS))
    nominal[[RHO_1, RHO_2, FOREARM_MASS]] = 1.0, 1.0, forearm_mass
    weight = weights(trajectories)
    left, right = normal_equations(gram[filled], weight)
    total_left, total_right = left.sum(axis=0), right.sum(axis=0)

    scale = _scale(gram.sum(axis=0), nominal)
    reasons = _structure(trajectories)
    held = np.array([_still(trajectories, name) for name in PARAMETERS])
    collinear = ~held & (_tolerance(total_left, held) < COLLINEAR)
    while collinear.any():
        worst = int(np.flatnonzero(collinear)[np.argmin(_tolerance(total_left, held)[collinear])])
        reasons.setdefault(PARAMETERS[worst], "the other parameters explain it as well on these logs")
        held[worst] = True
        collinear = ~held & (_tolerance(total_left, held) < COLLINEAR)
    while True:
        values = solve(total_left, total_right, held, nominal)
        error = _jackknife(left, right, held, nominal)
        relative = error / np.maximum(np.abs(values), scale)
        vague = (relative > NOT_IDENTIFIABLE) & ~held
        vague[VISCOUS] = vague[COULOMB] = False  # at zero they would bend the others; left in, flagged below
        if not vague.any():
            break
        worst = int(np.argmax(np.where(vague, relative, 0.0)))
        reasons[PARAMETERS[worst]] = f"these logs leave it open by {100 * relative[worst]:.0f} %"
        held[worst] = True

    estimates = tuple(
        _estimate(name, float(values[p]), float(error[p]), float(relative[p]), bool(held[p]), reasons.get(name, ""))
        for p, name in enumerate(PARAMETERS)
    )
    without = _without_each(trajectories, weight, held, nominal)
    density = np.median([trajectory.density for trajectory in trajectories], axis=0)
    period = float(np.median([trajectory.period for trajectory in trajectories]))
    return Fit(
        estimates,
        np.sqrt(density / (2.0 * period)),
        np.sqrt(density * ANALYSIS_HZ),
        np.full((1, 3), np.nan)
        if len(trajectories) < 2
        else np.array([rms_residual(t, others) for t, others in zip(trajectories, without, strict=True)]),
        np.array([rms_residual(trajectory, values) for trajectory in trajectories]),
        np.array([np.sqrt(_mean_square([trajectory])) for trajectory in trajectories]),
        without,
    )


def _estimate(name: str, value: float, error: float, relative: float, held: bool, reason: str) -> Estimate:
    """One parameter's verdict. relative: standard error over value."""
    if held:
        return Estimate(name, value, 0.0, "not identifiable", f"{reason}; {value:g} assumed")
    if reason or relative > NOT_IDENTIFIABLE:
        return Estimate(name, value, error, "not identifiable", reason or f"open by {100 * relative:.0f} %")
    if relative > WEAK:
        return Estimate(name, value, error, "weak", f"open by {100 * relative:.0f} %: more of the motion that shows it")
    return Estimate(name, value, error, "identifiable")


def _joint(name: str) -> int | None:
    return int(name[-1]) - 1 if name.startswith("f_") else None


def _still(trajectories: Sequence[Trajectory], name: str) -> bool:
    joint = _joint(name)
    return joint is not None and bool(
        max(t.travel[joint] for t in trajectories) < MOVES or not any(t.seconds[:, joint].any() for t in trajectories)
    )


def _structure(trajectories: Sequence[Trajectory]) -> dict[str, str]:
    """Reasons that the motion alone gives, by parameter."""
    reasons: dict[str, str] = {}
    for joint in range(3):
        forward = sum(float(t.forward[joint]) for t in trajectories)
        backward = sum(float(t.backward[joint]) for t in trajectories)
        if _still(trajectories, f"f_v_{joint + 1}"):
            reasons[f"f_v_{joint + 1}"] = reasons[f"f_c_{joint + 1}"] = f"joint {joint + 1} never moves"
        elif min(forward, backward) < REVERSES * (forward + backward):
            reasons[f"f_c_{joint + 1}"] = f"joint {joint + 1} never reverses"
    return reasons


def _scale(gram: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """(9,) what a standard error is held against where the value is less: the nominal value, or for friction what
    would make `NEGLIGIBLE_SHARE` of the joint's torque, so that none at all can be identifiable too."""
    scale = np.array(nominal)
    for joint in range(3):
        torque = gram[joint, TORQUE_COLUMN + joint, TORQUE_COLUMN + joint]
        for column, parameter in ((VISCOUS_COLUMN, VISCOUS.start), (COULOMB_COLUMN, COULOMB.start)):
            energy = gram[joint, column, column]
            scale[parameter + joint] = NEGLIGIBLE_SHARE * np.sqrt(torque / energy) if energy > 0 else 1.0
    return np.maximum(scale, 1e-12)


def _tolerance(left: np.ndarray, held: np.ndarray) -> np.ndarray:
    """(9,) share of each free parameter's variance that the other free ones do not explain."""
    result = np.ones(len(PARAMETERS))
    free = np.flatnonzero(~held)
    diagonal = np.diag(left)[free]
    if len(free) == 0 or not (diagonal > 0).all():
        result[free] = np.where(diagonal > 0, 1.0, 0.0)
        return result
    scale = np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(left[np.ix_(free, free)] / np.outer(scale, scale))
    result[free] = 1.0 / (vectors**2 / np.maximum(values, 1e-14)).sum(axis=1)
    return result


def _jackknife(left: np.ndarray, right: np.ndarray, held: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """(9,) standard errors: the fit repeated with each block left out."""
    count = len(left)
    without = solve(left.sum(axis=0) - left, right.sum(axis=0) - right, held, nominal)
    return np.sqrt((count - 1) / count * ((without - without.mean(axis=0)) ** 2).sum(axis=0))


def _without_each(
    trajectories: Sequence[Trajectory], weight: np.ndarray, held: np.ndarray, nominal: np.ndarray
) -> np.ndarray:
    left, right = normal_equations(np.stack([t.gram.sum(axis=0) for t in trajectories]), weight)
    if len(trajectories) < 2:
        return solve(left, right, held, nominal)
    return solve(left.sum(axis=0) - left, right.sum(axis=0) - right, held, nominal)


def rms_residual(trajectory: Trajectory, parameters: np.ndarray) -> np.ndarray:
    """(3,) N m rms of what `parameters` (9,) leave of a trajectory's moving samples."""
    squares = square_residual(trajectory.gram.sum(axis=0), parameters)
    seconds = trajectory.seconds.sum(axis=0)
    return np.sqrt(squares / np.where(seconds > 0, seconds, np.inf))
