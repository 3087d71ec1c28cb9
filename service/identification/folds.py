"""Data left out: folds and blocks of a problem's rows, and residuals under parameters from the other folds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.identification.fit import Fit, Problem, solve

BLOCK = 0.5  # s, of bootstrap and jackknife: longer than the residual remembers
FOLDS = 4  # where fewer than three traces are given
TURN = 1.0  # s of a trace in a fold, where folds take turns
WANTED_GAIN = 0.01  # of the squared residual of data left out that what is optional has to remove
WANTED_Z = 3.0  # standard errors over blocks
UNEVEN = 8.0  # times the spread that equal traces would be predicted with by each other: logs of one kind have 1.4


@dataclass(frozen=True)
class Split:
    """Who is left out together. fold, block: a (R,) array a recording; blocks are numbered through."""

    fold: list[np.ndarray]
    block: list[np.ndarray]
    folds: int
    blocks: int

    @classmethod
    def of(cls, problem: Problem, mixed: bool = False) -> Split:
        """A trace a fold; with fewer than three traces, contiguous stretches. mixed: `TURN` s of each trace in turn."""
        recordings = problem.recordings
        traces = sorted({recording.trace for recording in recordings})
        total = sum(len(target) for target in problem.target)
        folds, blocks, done, first = [], [], 0, 0
        for index, (recording, target) in enumerate(zip(recordings, problem.target, strict=True)):
            count = len(target)
            if mixed:
                fold = (index + np.arange(count) // round(TURN / (problem.band.period * problem.band.step))) % FOLDS
            elif len(traces) >= 3:
                fold = np.full(count, traces.index(recording.trace))
            else:
                fold = (done + np.arange(count)) * FOLDS // total
            length = max(1, round(BLOCK / (problem.band.period * problem.band.step)))
            block = first + np.arange(count) // length
            first, done = int(block[-1]) + 1, done + count
            folds.append(_rows(problem, index, fold))
            blocks.append(_rows(problem, index, block))
        return cls(folds, blocks, len(traces) if len(traces) >= 3 and not mixed else FOLDS, first)

    @classmethod
    def fair(cls, problem: Problem, fitted: Fit) -> Split:
        """The same; mixed where the traces say so unequal things that one, left out, would show how far the others
        reach and not how good a model is: slow production tells little of a fast run. fitted: any model."""
        split = cls.of(problem)
        grams, _ = normal_equations(fitted.moving, fitted.residuals, split)
        total = np.asarray(sum(grams))
        even = len(total) * split.folds / (split.folds - 1)
        spread = sum(float(np.trace(solve(total - gram, gram))) for gram in grams)
        return cls.of(problem, mixed=True) if spread > UNEVEN * even else split


def _rows(problem: Problem, index: int, values: np.ndarray) -> np.ndarray:
    return np.concatenate([values[rows] for rows in problem.rows[index].T])


def held_out(
    fitted: Fit, split: Split, learnt: tuple[Fit, Split] | None = None, prior: np.ndarray | float = 0.0
) -> list[np.ndarray]:
    """Residuals (R,) a recording, each fold predicted by parameters from the other folds (linear in the refit, within
    reach of the slopes: what one fold left open may not run away on the next). learnt: the rows they are learnt from,
    where these are not all; the same hypothesis on them. prior: (P, P) information on steps of the free parameters."""
    source, rows = learnt or (fitted, split)
    grams, moments = normal_equations(source.moving, source.residuals, rows)
    gram, moment = np.asarray(sum(grams)) + prior, sum(moments)
    moving = [tangent[:, source.free] for tangent in fitted.tangents]
    result = [residual.copy() for residual in fitted.residuals]
    for number in range(split.folds):
        step = source.step(gram - grams[number], moment - moments[number])
        for residual, slope, fold in zip(result, moving, split.fold, strict=True):
            out = fold == number
            residual[out] -= slope[out] @ step
    return result


def normal_equations(
    tangents: Sequence[np.ndarray], residuals: Sequence[np.ndarray], split: Split
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Gram matrix (P, P) and moment (P,) of each fold, of tangents (R, P) and residuals (R,) a recording."""
    grams, moments = [], []
    for number in range(split.folds):
        parts = [(t[f == number], r[f == number]) for t, r, f in zip(tangents, residuals, split.fold, strict=True)]
        grams.append(np.asarray(sum(t.T @ t for t, _ in parts)))
        moments.append(np.asarray(sum(t.T @ r for t, r in parts)))
    return grams, moments


def block_loss(residuals: Sequence[np.ndarray], split: Split) -> np.ndarray:
    """(blocks,) sums of squares."""
    loss = np.zeros(split.blocks)
    for residual, block in zip(residuals, split.block, strict=True):
        loss += np.bincount(block, residual**2, split.blocks)
    return loss


def predicts(lost: np.ndarray, kept: np.ndarray) -> bool:
    """Whether the second of two models that are as simple is the better one: (blocks,) losses on data left out."""
    return bool(lost.sum() - kept.sum() > WANTED_GAIN * lost.sum())


def gains(lost: np.ndarray, kept: np.ndarray) -> bool:
    """Whether something optional is worth it: (blocks,) losses on data left out without it and with it."""
    gain = lost - kept
    spread = np.sqrt(len(gain)) * np.std(gain)
    return bool(gain.sum() > max(WANTED_GAIN * lost.sum(), WANTED_Z * spread))
