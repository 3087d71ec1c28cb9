"""Values of what was found, given discrepancies: generalised least squares, with the discrepancies part of the noise.

A parameter whose torque discrepancies of any size explain nearly whole is not separable from them. It is fitted as if
there were none, with the others as they are, so that the model explains what it can.

Source: Kennedy, O'Hagan: Bayesian calibration of computer models, 2001 (parameters given a discrepancy).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.diagnosis.evidence import statistics
from service.diagnosis.fit.null import SEPARABLE
from service.diagnosis.fit.selection import Scored, Selection
from service.diagnosis.fit.wide import Wide
from service.identification.correlated import WHITE, Correlated
from service.identification.fit import Fit, Problem, fit, solve, within
from service.identification.folds import Split, block_loss, normal_equations
from service.model.parameters import Parameters


@dataclass(frozen=True)
class Valued:
    """best: with these values; its residuals on held-out data are those of the model alone, whose values are from the
    other folds. errors: (P,) standard ones, in the order of `Parameters`."""

    best: Scored
    errors: np.ndarray

    @classmethod
    def of(cls, problem: Problem, split: Split, found: Selection) -> Valued:
        """Of the best model, fitted again where its noise is correlated."""
        best, noise = found.best, found.noise
        if noise is WHITE:
            return cls(best, statistics.standard_errors(best.fitted, split))
        together = fit(problem, best.hypothesis, noise=noise)
        own = separable(together, noise)
        fitted = together if own.all() else fit(problem, together.hypothesis, moved=~own)
        residuals = _held_out(fitted, split, noise, own)
        errors = statistics.standard_errors(fitted, split)
        mine = np.flatnonzero(Parameters(fitted.hypothesis).free)[own]
        errors[mine] = statistics.standard_errors(together, split, noise)[mine]
        return cls(Scored(fitted, residuals, block_loss(residuals, split)), errors)


def separable(fitted: Fit, noise: Correlated) -> np.ndarray:
    """(F,) bool: parameters of whose torque, given all others, discrepancies of any size leave enough."""
    gram = np.asarray(sum(t.T @ t for t in fitted.tangents))
    square = np.asarray(sum(z.T @ z for z in noise.columns))
    cross = np.asarray(sum(z.T @ t for z, t in zip(noise.columns, fitted.tangents, strict=True)))
    return _own(gram - cross.T @ solve(square, cross)) > SEPARABLE * _own(gram)


def _own(gram: np.ndarray) -> np.ndarray:
    """(F,) squares of each column that the others do not explain, from their products (F, F)."""
    others = [np.delete(np.arange(len(gram)), column) for column in range(len(gram))]
    return np.array(
        [gram[i, i] - gram[i, rest] @ solve(gram[np.ix_(rest, rest)], gram[rest, i]) for i, rest in enumerate(others)]
    )


def _held_out(fitted: Fit, split: Split, noise: Correlated, own: np.ndarray) -> list[np.ndarray]:
    """Residuals (R,) a recording of the model alone on held-out data. own: (F,) bool, parameters that are fitted given
    the discrepancies."""
    wide, mine = Wide.of(fitted, noise.columns, noise.prior), own[fitted.free]
    grams, moments = normal_equations(wide.fit.moving, fitted.residuals, split)
    low, high = (reach[fitted.free][~mine] for reach in fitted.reach)
    count, residuals = len(mine), [residual.copy() for residual in fitted.residuals]
    gram, moment = np.asarray(sum(grams)), np.asarray(sum(moments))
    for fold in range(split.folds):
        train, left = gram - grams[fold], moment - moments[fold]
        step = wide.fit.step(train + wide.prior, left)[:count]
        if not mine.all():
            train, left = train[:count, :count][~mine], left[:count][~mine]
            step[~mine] = within(train[:, ~mine], left - train[:, mine] @ step[mine], low, high)
        for residual, slope, f in zip(residuals, fitted.moving, split.fold, strict=True):
            residual[f == fold] -= slope[f == fold] @ step
    return residuals
