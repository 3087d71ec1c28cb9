"""What the numbers are worth: standard errors, the noise floor, the gap on data left out, bootstrap intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.diagnosis.fit.selection import Z95, Scored, Selection, worth, z_score
from service.diagnosis.fit.wide import Wide
from service.identification.correlated import WHITE, Correlated
from service.identification.fit import Fit, Problem, evaluate, solve
from service.identification.folds import Split, block_loss, normal_equations
from service.model.parameters import Parameters

# A reversal's place between two samples is known to about this share of the sample time.
REVERSAL_PLACE = 0.2
DRAWS = 2000  # of a bootstrap
TOLD_APART_FROM_OTHERS = 1e-8  # of a parameter's effect, squared, that others do not reproduce; less is rounding
SAME_FIT = 1e-6  # of the squared residual by which two ways to write one model may differ
# Of the rms acceleration of the liveliest run: one with less is a slow sweep, made to identify, not what a robot does.
AT_WORK = 0.2


def standard_errors(fitted: Fit, split: Split, noise: Correlated = WHITE) -> np.ndarray:
    """(P,) in the order of `Parameters`, zero for what the fit does not move or the data do not tell from parameters
    before it (`untold`); at a limit as if there were none.

    Blocks of the residual count as independent, samples in a block do not: the residual may be coloured. noise: its
    covariance, by which the fit weighed.
    """
    told = ~untold(fitted)
    inside, everything = fitted.inside & told, told
    error = np.where(inside, _errors(fitted, split, inside, noise), _errors(fitted, split, everything, noise))
    return Parameters(fitted.hypothesis).spread(error)


def untold(fitted: Fit) -> np.ndarray:
    """(F,) bool: parameters whose effect those before them reproduce, so that only their combination is told."""
    return ~_independent(_scaled_gram(fitted)[0])[0]


def _scaled_gram(fitted: Fit) -> tuple[np.ndarray, np.ndarray]:
    """(F, F) products of the tangents at unit length, and (F,) their lengths, 1 where one is nothing."""
    gram = np.asarray(sum(t.T @ t for t in fitted.tangents))
    scale = np.sqrt(np.where(np.diag(gram) > 0, np.diag(gram), 1.0))
    return gram / np.outer(scale, scale), scale


def _independent(gram: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(F,) bool, columns that are no combination of those before them; and (F, F) the shares of those in each column
    that is. gram: (F, F) with ones on its diagonal, or zeros where a column is nothing."""
    count = len(gram)
    kept, shares = np.zeros(count, bool), np.zeros((count, count))
    for column in range(count):
        before = np.flatnonzero(kept)
        share = solve(gram[np.ix_(before, before)], gram[before, column])
        if gram[column, column] - share @ gram[before, column] > TOLD_APART_FROM_OTHERS:
            kept[column] = True
        else:
            shares[before, column] = share
    return kept, shares


def combined(problem: Problem, scored: Scored) -> Scored:
    """The same model with what only a combination of parameters tells given to the first of them: the amplitudes of
    effects that are no more than the base model's constants, or another effect's, are zero."""
    fitted, parameters = scored.fitted, Parameters(scored.hypothesis)
    gram, scale = _scaled_gram(fitted)
    kept, shares = _independent(gram)
    linear = np.zeros(len(kept), bool)
    for term, mine in zip(scored.hypothesis.terms, parameters.terms, strict=True):
        linear[parameters.among_free(slice(mine.start, mine.start + term.amplitude.size))] = True
    moved = np.flatnonzero(~kept & linear)
    values = parameters.values[parameters.free]
    if not np.any(values[moved]):
        return scored
    for column in moved:
        values += values[column] * scale[column] * shares[:, column] / scale
        values[column] = 0.0
    again = evaluate(problem, parameters.at(values))
    if not again.cost <= fitted.cost * (1.0 + SAME_FIT):  # the torque is not as linear as its slopes
        return scored
    return replace(scored, fitted=again)


def _errors(fitted: Fit, split: Split, moved: np.ndarray, noise: Correlated) -> np.ndarray:
    """(F,) with the parameters `moved` (F,) free."""
    tangents = [tangent[:, moved] for tangent in fitted.tangents]
    slopes, residuals = noise.weighed(tangents), noise.weighed(fitted.residuals)
    gram = np.asarray(sum(t.T @ w for t, w in zip(tangents, slopes, strict=True)))
    inverse = solve(gram, np.eye(len(gram)))
    score = np.zeros((split.blocks, len(gram)))
    for slope, residual, block in zip(slopes, residuals, split.block, strict=True):
        np.add.at(score, block, slope * residual[:, None])
    covariance = inverse @ (score.T @ score) @ inverse
    error = np.zeros(len(moved))
    error[moved] = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return error


def reversal_noise(problem: Problem, coulomb: np.ndarray) -> np.ndarray:
    """(n,) N m rms in the band that no sampled model can remove: where between two samples friction changes sign.

    A step of 2 f_c whose place is uncertain by `REVERSAL_PLACE` of a sample is an impulse of that area.
    coulomb: (F,), of which the joints' own count.
    """
    coulomb = coulomb[: len(problem.sigma)]
    square, count = np.zeros(len(coulomb)), np.zeros(len(coulomb))
    for recording in problem.recordings:
        segment = recording.segment
        turns = (np.diff(np.sign(segment.theta_dot), axis=0) != 0) & segment.moving[1:]
        square += turns.sum(axis=0) * (2 * np.abs(coulomb) * REVERSAL_PLACE) ** 2 * problem.band.white_share
        count += segment.moving.sum(axis=0)
    return np.sqrt(square / np.maximum(count, 1.0))


def by_fold(chosen: Sequence[Scored], split: Split) -> list[np.ndarray]:
    """Residuals of each fold under the hypothesis chosen for it."""
    result = [residual.copy() for residual in chosen[0].residuals]
    for fold, scored in enumerate(chosen):
        for mine, theirs, f in zip(result, scored.residuals, split.fold, strict=True):
            mine[f == fold] = theirs[f == fold]
    return result


def given(models: Sequence[Scored], split: Split, noise: Correlated) -> list[Scored]:
    """Models with their residuals on held-out data given discrepancies, those of the noise."""
    if noise is WHITE:
        return list(models)
    result = {}
    for one in models:
        if id(one) not in result:
            left = Wide.of(one.fitted, noise.columns, noise.prior).held_out(split)
            result[id(one)] = Scored(one.fitted, left, block_loss(left, split))
    return [result[id(one)] for one in models]


def walked(selection: Selection, split: Split, rows: int, most: float = 1.0) -> list[Scored]:
    """The hypothesis for each fold that is chosen without it.

    The search is walked again among the hypotheses that were fitted, weighing them by folds that are neither this one
    nor in training, given the discrepancies that are open, and the fold is predicted by the one chosen without it:
    where the walk ends, or the model chosen on all data if the other folds prefer that.
    """
    result: list[Scored] = []
    known: dict[int, np.ndarray] = {}

    def inner_of(scored: Scored) -> np.ndarray:
        if id(scored) not in known:
            known[id(scored)] = _inner(scored, split, selection.noise)
        return known[id(scored)][fold]

    for fold in range(split.folds):
        outside = [f != fold for f in split.fold]
        share = round(rows * float(np.mean(np.concatenate(outside))))
        chosen = selection.none
        for tried, taken in selection.path:
            if taken is None:  # what fell, or was not worth it, is not in the model whose gap this is
                break
            inner = [(inner_of(candidate), candidate) for candidate in tried]
            loss, best = min(inner, key=lambda item: item[0].sum())
            kept = next(item for item in inner if item[1] is taken)
            if z_score(kept[0], loss) < Z95:
                loss, best = kept  # without this fold nothing speaks against the choice made with it
            if not worth(loss, inner_of(chosen), inner_of(selection.none), share, most):
                break
            chosen = selection.after(best)
            if best is not taken:
                break
        whole, steps = (inner_of(scored) for scored in (selection.best, chosen))
        if z_score(steps, whole) > Z95:  # another order of steps leads there too
            chosen = selection.best
        result.append(chosen)
    return result


def _inner(scored: Scored, split: Split, noise: Correlated) -> np.ndarray:
    """(folds, blocks) losses of a fitted hypothesis with a fold each neither trained on nor counted, every other one
    left out in turn. noise: whose discrepancies are fitted with it."""
    columns = noise.columns or [np.zeros((len(residual), 0)) for residual in scored.residuals]
    wide = Wide.of(scored.fitted, columns, noise.prior)
    fitted, moving = wide.fit, wide.fit.moving
    grams, moments = normal_equations(moving, fitted.residuals, split)
    result = []
    for out in range(split.folds):
        residuals = [r.copy() for r in fitted.residuals]
        for fold in range(split.folds):
            train = [k for k in range(split.folds) if k not in (fold, out)]
            if fold == out or not train:
                continue
            gram, moment = (np.asarray(sum(one[k] for k in train)) for one in (grams, moments))
            step = fitted.step(gram + wide.prior, moment)
            for residual, slope, f in zip(residuals, moving, split.fold, strict=True):
                residual[f == fold] -= slope[f == fold] @ step
        for residual, f in zip(residuals, split.fold, strict=True):
            residual[f == out] = 0.0
        result.append(block_loss(residuals, split))
    return np.array(result)


def rms_per_joint(
    problem: Problem, residuals: Sequence[np.ndarray], runs: Sequence[int] | np.ndarray | None = None
) -> np.ndarray:
    """(n,) N m. runs: traces that count, default all."""
    counts = [True] * len(residuals) if runs is None else [log in runs for log in problem.logs]
    return problem.rms(residuals, [0 if counted else 1 for counted in counts])[0]


def pooled_squares(problem: Problem, residuals: Sequence[np.ndarray], split: Split) -> np.ndarray:
    """(blocks,) (N m)^2, all joints."""
    scaled = [r * problem.sigma[j] for r, j in zip(residuals, problem.joints_of_rows, strict=True)]
    return block_loss(scaled, split)


def run_of_blocks(problem: Problem, split: Split) -> np.ndarray:
    """(blocks,) trace that each block is of."""
    runs = np.zeros(split.blocks, int)
    for recording, block in zip(problem.recordings, split.block, strict=True):
        runs[block] = recording.trace
    return runs


def runs_at_work(problem: Problem) -> np.ndarray:
    """(T,) of the traces of which there are rows, in order, those that are no slow sweeps."""
    square, count = np.zeros(max(problem.logs) + 1), np.zeros(max(problem.logs) + 1)
    for recording in problem.recordings:
        square[recording.trace] += np.sum(recording.segment.theta_ddot**2)
        count[recording.trace] += recording.segment.theta_ddot.size
    acceleration = np.sqrt(square / np.maximum(count, 1))
    return np.flatnonzero(acceleration > AT_WORK * acceleration.max())


@dataclass(frozen=True)
class Shrink:
    """1 - rms after / rms before, with a 95 % bootstrap interval."""

    value: float
    low: float
    high: float


def shrink(before: np.ndarray, after: np.ndarray, seed: int = 0, runs: np.ndarray | None = None) -> Shrink:
    """From block sums of squares (blocks,). runs: (blocks,) of which run each block is; the interval is then that of
    other such runs, drawn first and blocks of each after that: how far a gap shrinks goes by how a run moves. Without
    them it is of these very runs.

    Source: Davison, Hinkley: Bootstrap Methods and their Application, 1997, section 3.8 (hierarchical data).
    """
    random = np.random.default_rng(seed)
    groups = [np.arange(len(before))] if runs is None else [np.flatnonzero(runs == run) for run in np.unique(runs)]
    squares = np.zeros((2, DRAWS))
    for chosen in random.integers(0, len(groups), (len(groups), DRAWS)):
        for number, group in enumerate(groups):
            mine = chosen == number
            draw = group[random.integers(0, len(group), (int(mine.sum()), len(group)))]
            squares[:, mine] += before[draw].sum(axis=1), after[draw].sum(axis=1)
    low, high = np.quantile(1.0 - np.sqrt(squares[1] / np.maximum(squares[0], 1e-300)), [0.025, 0.975])
    value = 1.0 - float(np.sqrt(after.sum() / max(float(before.sum()), 1e-300)))
    return Shrink(value, float(low), float(high))
