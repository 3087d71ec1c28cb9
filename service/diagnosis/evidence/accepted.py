"""Which effects are accepted where the residual is above the noise: those that explain what neither discrepancies
do nor their own torque does at other times.

The discrepancies that explain the residual are opened, with weights of their own. Given these, an effect has to explain
by far more than its torque does shifted in time. What does not is rejected, the worst first, and the discrepancies are
asked again. Then effects are added by the same quantity.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import numpy as np

from service.diagnosis.evidence.opened import Opened, Pool
from service.diagnosis.fit.candidates import Dictionary, Regressors
from service.diagnosis.fit.null import OWN, over_null
from service.diagnosis.fit.selection import (
    LEAST_GAIN,
    MOST_EFFECTS,
    SHORTLIST,
    Scored,
    Selection,
    fit_added,
    score,
    without,
)
from service.diagnosis.fit.sound import fault_of
from service.diagnosis.fit.wide import Wide
from service.identification.fit import Fit, Problem
from service.identification.folds import Split, block_loss
from service.model.effects.base import Effect


@dataclass(frozen=True)
class Accepted:
    """The model of effects that are accepted, the discrepancies opened with it of those that there may be, and the
    effects that were rejected."""

    best: Scored
    pool: Pool
    opened: Opened
    rejected: list[tuple[Effect, Scored, float]]
    path: list[tuple[list[Scored], Scored | None]]

    def beside(self, best: Scored) -> Opened:
        """The discrepancies that are open with another model."""
        return self.opened if best is self.best else Opened.beside(self.pool, best)

    def given(self, problem: Problem, split: Split) -> Callable[[Scored], Scored]:
        """A model with the losses of its blocks given the discrepancies."""
        known: dict[int, tuple[Scored, Scored]] = {}  # the model too, so that its id stays its own

        def seen(model: Scored) -> Scored:
            if id(model) not in known:
                known[id(model)] = model, replace(model, blocks=_blocks(problem, model, self.opened, split))
            return known[id(model)][1]

        return seen

    def continued(self, selection: Selection) -> Selection:
        """The search with what was added after it."""
        if not self.path:
            return selection
        path = [(tried, taken) for tried, taken in selection.path if taken is not None]
        return replace(selection, best=self.best, path=[*path, *self.path])


def accepted(
    regressors: Regressors, selection: Selection, allows: Callable[[Effect, int], bool],
    progress: Callable[[str], None],
) -> Accepted:  # fmt: skip
    """Starting from what a search found. allows: whether the data let an effect be looked for on a joint at all."""
    problem, split, given = regressors.problem, regressors.split, len(selection.none.hypothesis.terms)
    best, rejected, path = selection.best, [], []
    progress("fitting discrepancies")
    pool = Pool(problem, split, best.hypothesis)
    opened = Opened.beside(pool, best)
    while effects := list(dict.fromkeys(term.effect for term in best.hypothesis.terms[given:])):
        fewer = {effect: without(problem, split, selection.none, best, effect) for effect in effects}
        asked = {effect: own(pool, fewer[effect], best, effect, opened) for effect in effects}
        worst = min(effects, key=lambda effect: asked[effect])
        if asked[worst] > OWN:
            break
        rejected.append((worst, best, asked[worst]))
        best = fewer[worst]
        opened = Opened.beside(pool, best)
    gone = {effect for effect, _, _ in rejected}
    while len(set(best.names[given:])) < MOST_EFFECTS:
        progress("comparing effects given discrepancies")
        tried = _added(regressors, pool, best, opened, gone, given, allows)
        if not tried:
            break
        path.append((tried, tried[0]))
        best = tried[0]
        opened = Opened.beside(pool, best)
    return Accepted(best, pool, opened, rejected, path)


def own(pool: Pool, fewer: Scored, best: Scored, effect: Effect, opened: Opened) -> float:
    """What `effect` explains in `best` given discrepancies, over what its torque does at other times. fewer: the model
    without it."""
    return over_null(pool.problem, Wide.of(fewer.fitted, opened.columns, opened.prior), best.fitted, {effect})


def _blocks(problem: Problem, scored: Scored, opened: Opened, split: Split) -> np.ndarray:
    """(blocks,) squares on held-out data given discrepancies, joints weighted by their residual given these."""
    left = Wide.of(scored.fitted, opened.columns, opened.prior).held_out(split)
    level = problem.level(opened.residuals)
    return block_loss([r / level[j] for r, j in zip(left, problem.joints_of_rows, strict=True)], split)


def _added(
    regressors: Regressors, pool: Pool, best: Scored, opened: Opened, gone: Collection[Effect], given: int,
    allows: Callable[[Effect, int], bool],
) -> list[Scored]:  # fmt: skip
    """Models with one effect more that is accepted, the best first."""
    problem, split = regressors.problem, regressors.split
    dictionary = Dictionary(regressors, *_wide(best, opened))
    before, found = _blocks(problem, best, opened, split), []
    ranking = dictionary.ranking(best.hypothesis.terms, problem.recordings[0].mechanism.joints, allows)
    for loss, candidate in ranking[:SHORTLIST]:
        if candidate.effect in gone or dictionary.nothing - loss < LEAST_GAIN * problem.count:
            continue
        model = score(fit_added(problem, best.fitted, candidate.term()), split)
        after = _blocks(problem, model, opened, split)
        if after.sum() < before.sum() and fault_of(problem, model.hypothesis, given) is None:
            found.append((float(after.sum()), model))
    found.sort(key=lambda item: item[0])
    if not found:
        return []
    first = found[0][1]
    if own(pool, best, first, first.hypothesis.terms[-1].effect, opened) <= OWN:
        return []
    return [model for _, model in found]


def _wide(scored: Scored, opened: Opened) -> tuple[Fit, np.ndarray]:
    wide = Wide.of(scored.fitted, opened.columns, opened.prior)
    return wide.fit, wide.prior
