"""The plain model fitted to all logs together, with everything that says how far to trust it: what `identify` writes
and `diagnose` starts from.

The fit is that of any hypothesis; friction turns over a speed that is fitted too, since in slow motion a jump would be
read as a gap. So is by what part of a sample torque and position are apart. At both the model is linear, so leaving out
a block or a log is a small linear solve.

A Delta's forearm coupling is fitted, not taken from the described mass: what it multiplies is a mass only for a uniform
rod, and ball joints at the ends make it less. Where the data cannot tell it, the described forearm mass stands.

Each joint weighs by the white noise of its torque. Standard errors come from leaving out blocks of `BLOCK` seconds in
turn (jackknife), so they hold for a residual of any colour that is forgotten within a block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from schemas.axes_description import Description
from schemas.errors import DataError
from service.identification import bare as bare_model
from service.identification import fit as solver
from service.identification.fit import Problem
from service.identification.folds import Split, block_loss, gains, held_out
from service.identification.noise import Floor, floor, refined, white_noise
from service.model.hypothesis import Hypothesis
from service.model.parameters import Parameters, Quantity, base_parameters
from service.model.ripple import standing_out
from service.model.scene import Base, Recording
from service.model.signals import LEVER, Band, lowpass, one_period, resolved_hz
from service.model.torque import predict

START_TRANSITION = 0.002  # rad/s
WIDER_TRANSITIONS = (0.01, 0.04, 0.15, 0.4)  # rad/s, tried where each friction has its own: slopes do not lead there
MOST_RIPPLES = 4  # orders a joint that the band has to reach
RIPPLE_REACH = 1.3  # times their frequency at the middle speed
# Standard error over value (or over what would make 5 % of the torque, if that is more).
WEAK, NOT_IDENTIFIABLE = 0.1, 0.5
NEGLIGIBLE_SHARE = 0.05
HARM = 0.95  # of the loss on data left out that is left without the timing: then it is not of the plant
# A parameter whose effect the others reproduce but for this share of its variance is not told apart from them.
COLLINEAR = 1e-5
CONSTANT = 1e-9  # of a torque: what rounding and a decimation make of one number
MOVES = 50.0  # times the noise of its position, or its encoder's step, that a joint has to go to move
REVERSES = 0.05  # share of the motion time that must go in each direction

Described = TypeVar("Described", bound=Description)


@dataclass(frozen=True)
class ParameterEstimate:
    """One parameter. verdict: "identifiable", "weak" or "not identifiable"; reason: why, where it is not the
    first, or is in spite of an error that is large beside the value."""

    name: str
    unit: str
    value: float
    std_error: float
    verdict: str
    reason: str = ""


@dataclass(frozen=True)
class Plain:
    """The plain model's fit. T logs, n joints, P parameters.

    estimates: in the order of `base_parameters`. fitted: residuals and tangents at them. noise: (n,) N m white rms a
    sample. held_out: (T, n) rms of the residual of each log under the fit to the others, N m in the
    analysis band, NaN for a single log. residual: (T, n) the same under the fit to all. torque: (T, n) rms. without:
    (T, P) values from the other logs (from all, for a single one). alone: (T, n) as residual, each log under a fit of
    its own; runs: (T, P) its values.
    """

    problem: Problem
    fitted: solver.Fit
    estimates: tuple[ParameterEstimate, ...]
    noise: np.ndarray
    held_out: np.ndarray
    residual: np.ndarray
    torque: np.ndarray
    without: np.ndarray
    alone: np.ndarray
    runs: np.ndarray

    @property
    def values(self) -> np.ndarray:
        """(P,)."""
        return np.array([estimate.value for estimate in self.estimates])

    @property
    def noise_floor(self) -> np.ndarray:
        """(n,) N m, what of the noise lies in the analysis band."""
        return self.problem.sigma

    @property
    def model_error(self) -> np.ndarray:
        """(n,) N m rms of what is left above the noise, on logs not seen by the fit where there are several."""
        left = np.where(np.isfinite(self.held_out), self.held_out, self.residual)
        return np.sqrt(np.maximum(np.nanmean(left**2, axis=0) - self.noise_floor**2, 0.0))

    def left(self, values: np.ndarray) -> np.ndarray:
        """(T, n) N m rms that other parameters (P,) leave of each log."""
        return _left(self.problem, self.fitted, values)


@dataclass(frozen=True)
class Identification(Generic[Described]):
    """robot: the description with what was found. fit: numbers and verdicts. warnings: what a user has to know."""

    robot: Described
    fit: Plain
    warnings: tuple[str, ...]


def refuse_dead_torque(recordings: Sequence[Recording]) -> None:
    """Raises:
    DataError: a joint moves and its torque is one number all the while, naming the log.
    """
    for recording in recordings:
        segment = recording.segment
        for joint, moving in enumerate(segment.moving.T):
            torque = segment.torque[moving, joint]
            if len(torque) > 1 and np.ptp(torque) <= CONSTANT * np.abs(torque).max():
                raise DataError(
                    f"{recording.name}: joint {joint + 1} moves and its torque is {torque[0]:g} throughout: was it "
                    "recorded?"
                )


def problem_of(recordings: Sequence[Recording], bare: bool = False) -> tuple[Problem, Floor]:
    """The problem in units of the noise, which is read from the residual of a first fit; and the noise. bare: no effect
    is looked for on it: there need be no ripple in its band.

    Raises:
        DataError: logs of several rates, naming them.
    """
    period = one_period([(recording.name, recording.segment) for recording in recordings])
    band = Band.of(period, resolved_hz([recording.segment for recording in recordings]))
    problem = Problem.of(recordings, band, np.maximum(white_noise(recordings), 1e-9))  # how joints weigh, for now
    first = solver.fit(problem, start(problem), iterations=2).hypothesis
    left = _of_every_sample(problem, first)
    if not bare:
        above = [values - lowpass(values, period, band.cutoff_hz) for values in left]
        wider = Band.of(period, max(band.cutoff_hz, _ripple_hz(recordings, above)))
        if wider.cutoff_hz > band.cutoff_hz:
            problem = Problem.of(recordings, wider, problem.sigma)
    return _in_units_of(floor(recordings, left, problem.band), replace(problem, bare=bare))


def floor_in_band(problem: Problem, known: Floor, best: Hypothesis) -> tuple[Problem, Floor]:
    """The problem in units of a noise floor that is read inside the band, from the residual of the `best` model; where
    the floor was read from white noise above it, as it is."""
    return _in_units_of(refined(problem.recordings, _of_every_sample(problem, best), known, problem.band), problem)


def _of_every_sample(problem: Problem, hypothesis: Hypothesis) -> list[np.ndarray]:
    """Residual (N, n) N m of a hypothesis, of each recording, neither filtered nor thinned out."""
    return [scene.segment.torque - predict(scene, hypothesis) for scene in problem.scenes(hypothesis)]


def _in_units_of(found: Floor, problem: Problem) -> tuple[Problem, Floor]:
    return replace(problem, sigma=found.band, filtered=bool(found.coloured.any())), found


def _ripple_hz(recordings: Sequence[Recording], above: Sequence[np.ndarray]) -> float:
    """How far a band has to reach for the ripple over motor turns that stands out of (N, n) what a model leaves above
    the band that there is."""
    highest = 0.0
    for recording, values in zip(recordings, above, strict=True):
        segment = recording.segment
        turns = recording.mechanism.gear_ratio * segment.theta / (2 * np.pi)
        for joint, moving in enumerate(segment.moving.T):
            orders = standing_out(turns[moving, joint], values[moving, joint])[:MOST_RIPPLES]
            if orders:
                speed = np.median(np.abs(np.gradient(turns[:, joint], segment.period)[moving]))
                highest = max(highest, RIPPLE_REACH * max(orders) * float(speed))
    return highest


def start(problem: Problem) -> Hypothesis:
    """The base model as far as it is described, before anything is fitted."""
    mechanism = problem.recordings[0].mechanism
    n, unit = len(mechanism.frictions), _lever(problem)
    transition = np.full(n, START_TRANSITION * unit) if mechanism.own_transitions else START_TRANSITION
    return Hypothesis(Base(mechanism.start, np.zeros(n), np.zeros(n), transition), timed=False)


def _base(problem: Problem) -> solver.Fit:
    """The base model at its optimum, torque and position at two instants within a sample; but at one where that does
    less harm on data left out."""
    still = _still(problem)
    split = Split.fair(problem, still)
    held = block_loss(held_out(still, split), split).sum()  # first: the next fit's tangents may take the place of these
    timed = solver.fit(problem, replace(still.hypothesis, timed=True))
    moved = block_loss(held_out(timed, split), split).sum()
    return still if held < HARM * moved else timed


def _still(problem: Problem) -> solver.Fit:
    """The same at one instant, optional coefficients left out where data left out do not want them."""
    fitted = solver.fit(problem, start(problem))
    mechanism = problem.recordings[0].mechanism
    if not mechanism.own_transitions:
        return fitted
    fitted = _turning(problem, fitted)
    split, names = Split.of(problem), list(mechanism.coefficients)
    wanted = np.ones(len(names), bool)
    for group in mechanism.optional:
        columns = np.array([names.index(name) for name in group])
        if not _wants(fitted, split, columns):
            wanted[columns] = False
    if wanted.all():
        return fitted
    base = fitted.hypothesis.base
    base = replace(base, rigid=np.where(wanted, base.rigid, 0.0), wanted=wanted)
    return _turning(problem, solver.fit(problem, replace(fitted.hypothesis, base=base)))


def _turning(problem: Problem, fitted: solver.Fit) -> solver.Fit:
    """The fit with the transition of each friction that of several which suits its joints best."""
    base, rows = fitted.hypothesis.base, problem.recordings[0].mechanism.rows
    widths = [base.transition, *(np.full(len(rows), width * _lever(problem)) for width in WIDER_TRANSITIONS)]
    left = [_left_at(problem, replace(fitted.hypothesis, base=replace(base, transition=width))) for width in widths]
    best = np.argmin(np.array(left) @ (rows.T != 0), axis=0)
    suits = np.array([np.asarray(widths[choice])[place] for place, choice in enumerate(best)])
    moved = solver.fit(problem, replace(fitted.hypothesis, base=replace(base, transition=suits)))
    return moved if moved.cost < fitted.cost else fitted


def _left_at(problem: Problem, hypothesis: Hypothesis) -> np.ndarray:
    """(n,) (N m)^2 that a fit leaves which holds the transitions of `hypothesis`: then the model is linear."""
    trial, parameters = solver.evaluate(problem, hypothesis), Parameters(hypothesis)
    turning = parameters.among_free(parameters.transition)
    tangents = [np.delete(tangent, turning, axis=1) for tangent in trial.tangents]
    low, high = (np.delete(reach, turning) for reach in trial.reach)
    gram = np.asarray(sum(t.T @ t for t in tangents))
    moment = np.asarray(sum(t.T @ r for t, r in zip(tangents, trial.residuals, strict=True)))
    step = solver.within(gram, moment, low, high)
    rest = [r - t @ step for r, t in zip(trial.residuals, tangents, strict=True)]
    return np.sum(problem.rms(rest) ** 2, axis=0)


def _lever(problem: Problem) -> float:
    """What a speed of 1 rad/s counts as in the unit of the joints' speeds."""
    return 1.0 if problem.recordings[0].segment.angular else LEVER


def _wants(fitted: solver.Fit, split: Split, columns: np.ndarray) -> bool:
    """Whether data left out lose by holding the rigid coefficients of `columns` at zero."""
    without = fitted.holding(columns, np.zeros(len(columns)))
    kept, lost = (block_loss(held_out(one, split), split) for one in (fitted, without))
    return gains(lost, kept)


@dataclass(frozen=True)
class _Told:
    """What all blocks together tell of P parameters: (P,) values and standard errors. relative: these over what they
    are held against. held: (P,) bool, those that stand at `assumed`. reasons: why one cannot be told, by its name."""

    values: np.ndarray
    error: np.ndarray
    relative: np.ndarray
    held: np.ndarray
    assumed: np.ndarray
    reasons: dict[str, str]


def fit(problem: Problem, noise: np.ndarray, robot: Description) -> Plain:
    """Fit the plain model. noise: (n,) N m a sample. robot: what of it stands where the data cannot tell."""
    fitted, weighed, drawn = _base(problem), problem, 0.0
    if problem.bare:
        weighed, fitted, drawn = bare_model.refined(problem, fitted)
    known = base_parameters(problem.recordings[0].mechanism)
    nominal = np.array([robot.nominal.get(parameter.name, np.nan) for parameter in known])
    told = _told(weighed, fitted, known, nominal, drawn)
    base = fitted.hypothesis.base
    k, n = len(base.rigid), len(base.viscous)
    rigid, viscous, coulomb = np.split(told.values, [k, k + n])
    base = replace(base, rigid=rigid, viscous=viscous, coulomb=coulomb)
    plain = solver.evaluate(problem, replace(fitted.hypothesis, base=base))
    as_weighed = plain if weighed is problem else solver.evaluate(weighed, plain.hypothesis)
    logs = [np.full(len(rows), number) for rows, number in zip(as_weighed.residuals, problem.logs, strict=True)]
    left, right = _normal_equations(as_weighed, told.values, logs, max(problem.logs) + 1)
    left, right = _drawn(left, right, problem, drawn, told.assumed)
    residual = problem.rms(plain.residuals)
    without, held_out, alone = told.values[None], np.full(residual.shape, np.nan), residual
    runs = _solve(left, right, told.held, told.assumed) if len(left) > 1 else without
    if len(left) > 1:
        without = _solve(left.sum(axis=0) - left, right.sum(axis=0) - right, told.held, told.assumed)
        held_out, alone = (
            np.array([_left(problem, plain, one)[log] for log, one in enumerate(found)]) for found in (without, runs)
        )
    torque = problem.rms([problem.select(i, target) for i, target in enumerate(problem.target)])
    return Plain(problem, plain, _estimates(known, told), noise, held_out, residual, torque, without, alone, runs)


def _told(
    problem: Problem, fitted: solver.Fit, known: Sequence[Quantity], nominal: np.ndarray, drawn: float = 0.0
) -> _Told:
    """Least squares over all blocks; what they leave open or would have below its least is held, one at a time.

    nominal: (P,) what stands by the description, NaN where it says nothing. drawn: as `bare.refined` has it.
    """
    split = Split.of(problem)
    values = Parameters(fitted.hypothesis).values[: len(known)]
    blocks = _normal_equations(_timing_apart(fitted), values, split.block, split.blocks)
    filled = np.einsum("bpp->b", blocks[0]) > 0
    described = problem.recordings[0].mechanism.start
    assumed = np.where(np.isnan(nominal), np.pad(described, (0, len(known) - len(described))), nominal)
    left, right = _drawn(blocks[0][filled], blocks[1][filled], problem, drawn, assumed)
    whole = left.sum(axis=0), right.sum(axis=0)
    scale, low = _scale(problem, fitted, nominal), np.array([parameter.low for parameter in known])
    reasons = _structure(problem)
    held = np.array([reasons.get(parameter.name, "").endswith("never moves") for parameter in known])
    held |= np.diag(whole[0]) == 0
    if (wanted := fitted.hypothesis.base.wanted) is not None:
        reasons |= {
            known[index].name: "held-out data are predicted equally well without it"
            for index in np.flatnonzero(~wanted).tolist()
        }
    while (tolerance := _tolerance(whole[0], held)).min() < COLLINEAR:
        worst = int(np.argmin(tolerance))
        reasons.setdefault(known[worst].name, "on these logs it cannot be separated from the other parameters")
        held[worst] = True
    while True:
        values, error = _solve(*whole, held, assumed), _jackknife(left, right, held, assumed)
        relative = error / np.maximum(np.abs(values), scale)
        # without a nominal value, as zero, it would bend the others: left in, flagged below
        vague = (relative > NOT_IDENTIFIABLE) & ~held & np.isfinite(nominal)
        below = ~held & (values < low)
        if vague.any():
            worst = int(np.argmax(np.where(vague, relative, 0.0)))
            reasons[known[worst].name] = f"these logs determine it only to {100 * relative[worst]:.0f} %"
        elif below.any():
            worst = int(np.argmax(np.where(below, (low - values) / np.maximum(error, 1e-300), 0.0)))
            reasons[known[worst].name] = "the best fit to these logs is below its physical limit"
            assumed[worst] = low[worst]
        else:
            return _Told(values, error, relative, held, assumed, reasons)
        held[worst] = True


def _left(problem: Problem, fitted: solver.Fit, values: np.ndarray) -> np.ndarray:
    """(T, n) N m rms that parameters (P,) leave of each log."""
    parameters, count = Parameters(fitted.hypothesis), len(values)
    change = values - parameters.values[:count]
    pairs = zip(fitted.residuals, fitted.tangents, strict=True)
    return problem.rms([r - parameters.widened(t, count) @ change for r, t in pairs])


def _normal_equations(
    fitted: solver.Fit, values: np.ndarray, groups: Sequence[np.ndarray], count: int
) -> tuple[np.ndarray, np.ndarray]:
    """(G, P, P) and (G, P) of the linear parameters, which stand at `values`. groups: a (R,) array a recording."""
    left, right = np.zeros((count, len(values), len(values))), np.zeros((count, len(values)))
    parameters = Parameters(fitted.hypothesis)
    for tangent, residual, group in zip(fitted.tangents, fitted.residuals, groups, strict=True):
        slopes = parameters.widened(tangent, len(values))
        wanted = residual + slopes @ values
        for number in np.unique(group):
            mine = slopes[group == number]
            left[number] += mine.T @ mine
            right[number] += mine.T @ wanted[group == number]
    return left, right


def _drawn(
    left: np.ndarray, right: np.ndarray, problem: Problem, drawn: float, described: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations (G, P, P) and (G, P) with what draws the masses of an arm to those described (P,), in each group
    its share of all."""
    links = problem.recordings[0].mechanism.links
    links = np.pad(links, (0, len(described) - len(links)))
    pull = drawn * np.where(links, np.einsum("gpp->gp", left), 0.0)
    return left + pull[:, :, None] * np.eye(len(described)), right + pull * described


def _timing_apart(fitted: solver.Fit) -> solver.Fit:
    """With what the tangents have in common with that of the timing taken out: solved for, the others are then as sure
    as they are beside it."""
    parameters = Parameters(fitted.hypothesis)
    timing = parameters.among_free(slice(parameters.timing, parameters.timing + 1))
    along = [tangent[:, timing] for tangent in fitted.tangents]
    square = sum(float((one**2).sum()) for one in along)
    if not square:
        return fitted
    share = np.asarray(sum(one.T @ tangent for one, tangent in zip(along, fitted.tangents, strict=True))) / square
    return replace(fitted, tangents=[t - one @ share for one, t in zip(along, fitted.tangents, strict=True)])


def _solve(left: np.ndarray, right: np.ndarray, held: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """(..., P): least-squares solution with the `held` parameters at their `nominal` values, and what the data do not
    tell of the others as near to theirs as can be."""
    free = np.flatnonzero(~held)
    result = np.broadcast_to(nominal, right.shape).copy()
    if len(free):
        known = right - left @ nominal
        scale = np.sqrt(np.maximum(np.einsum("...pp->...p", left)[..., free], 0.0))  # sums less sums: zero may be less
        scale = np.where(scale > 0, scale, 1.0)
        scaled = left[..., free[:, None], free] / (scale[..., :, None] * scale[..., None, :])
        solved = np.linalg.pinv(scaled, rcond=1e-10, hermitian=True) @ (known[..., free] / scale)[..., None]
        result[..., free] += solved[..., 0] / scale
    return result


def _jackknife(left: np.ndarray, right: np.ndarray, held: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """(P,) standard errors: the fit repeated with each block left out."""
    count = len(left)
    without = _solve(left.sum(axis=0) - left, right.sum(axis=0) - right, held, nominal)
    return np.sqrt((count - 1) / count * ((without - without.mean(axis=0)) ** 2).sum(axis=0))


def _tolerance(left: np.ndarray, held: np.ndarray) -> np.ndarray:
    """(P,) share of each free parameter's variance that the other free ones do not explain."""
    result = np.ones(len(held))
    free = np.flatnonzero(~held)
    scale = np.sqrt(np.diag(left)[free])
    values, vectors = np.linalg.eigh(left[np.ix_(free, free)] / np.outer(scale, scale))
    result[free] = 1.0 / (vectors**2 / np.maximum(values, 1e-14)).sum(axis=1)
    return result


def _scale(problem: Problem, fitted: solver.Fit, nominal: np.ndarray) -> np.ndarray:
    """(P,) what a standard error is held against where the value is less: the nominal value, or what would make
    `NEGLIGIBLE_SHARE` of the torque where it acts, so that none at all can be identifiable too."""
    energy, torque = np.zeros(len(nominal)), np.zeros(len(nominal))
    parameters = Parameters(fitted.hypothesis)
    for index, tangent in enumerate(fitted.tangents):
        slopes = parameters.widened(tangent, len(nominal))
        energy += (slopes**2).sum(axis=0)
        torque += (slopes != 0).T @ problem.select(index, problem.target[index]) ** 2
    share = NEGLIGIBLE_SHARE * np.sqrt(torque / np.where(energy > 0, energy, np.inf))
    return np.maximum(np.where(np.isfinite(nominal), nominal, np.where(energy > 0, share, 1.0)), 1e-12)


def _structure(problem: Problem) -> dict[str, str]:
    """Reasons that the motion alone gives, by parameter."""
    segments = [recording.segment for recording in problem.recordings]
    forward, backward = (sum(((way * s.theta_dot > 0) & s.moving).sum(axis=0) for s in segments) for way in (1, -1))
    travel = np.max([np.ptp(s.theta, axis=0) for s in segments], axis=0)
    noise = np.max([np.zeros(len(travel)) if s.noise is None else s.noise for s in segments], axis=0)
    reasons: dict[str, str] = {}
    for joint, (there, back) in enumerate(zip(np.asarray(forward), np.asarray(backward), strict=True), start=1):
        if travel[joint - 1] <= MOVES * noise[joint - 1] or there + back == 0:
            reasons[f"f_v_{joint}"] = reasons[f"f_c_{joint}"] = f"joint {joint} never moves"
        elif min(there, back) < REVERSES * (there + back):
            reasons[f"f_c_{joint}"] = f"joint {joint} never reverses"
    return reasons


def _estimates(known: Sequence[Quantity], told: _Told) -> tuple[ParameterEstimate, ...]:
    columns = zip(known, *(part.tolist() for part in (told.values, told.error, told.relative, told.held)), strict=True)
    return tuple(
        _estimate(parameter, value, error, relative, held, told.reasons.get(parameter.name, ""))
        for parameter, value, error, relative, held in columns
    )


def _estimate(
    parameter: Quantity, value: float, error: float, relative: float, held: bool, reason: str
) -> ParameterEstimate:
    """One parameter's verdict. relative: standard error over value."""
    name, unit = parameter.name, parameter.unit
    if held:
        return ParameterEstimate(name, unit, value, 0.0, "not identifiable", f"{reason}; {value:g} assumed")
    if reason or relative > NOT_IDENTIFIABLE:
        return ParameterEstimate(
            name, unit, value, error, "not identifiable", reason or f"determined only to {100 * relative:.0f} %"
        )
    if relative > WEAK:
        why = f"determined only to {100 * relative:.0f} %: log more motion that excites it"
        return ParameterEstimate(name, unit, value, error, "weak", why)
    if error > WEAK * abs(value):  # held against more than the value, see `_scale`
        reason = "near zero; its error is small beside the torque"
    return ParameterEstimate(name, unit, value, error, "identifiable", reason)
