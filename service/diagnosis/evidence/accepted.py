"""Which effects are accepted where the residual is above the noise: those that explain what neither discrepancies
do nor their own torque does at other times.

The discrepancies that explain the residual are opened, with weights of their own. Given these, an effect has to explain
by far more than its torque does shifted in time. What does not is rejected, the worst first, and the discrepancies are
asked again. Then effects are added by the same quantity, one or, where two hide each other, both.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace

import numpy as np

from service.diagnosis.evidence.opened import Opened, Pool
from service.diagnosis.fit.candidates import PROMISE, Candidate, Dictionary, Regressors
from service.diagnosis.fit.exchange import with_several
from service.diagnosis.fit.null import OWN, over_null
from service.diagnosis.fit.selection import (
    LEAST_GAIN,
    MOST_EFFECTS,
    SHORTLIST,
    Scored,
    Selection,
    without,
)
from service.diagnosis.fit.sound import fault_of
from service.identification.correlated import WHITE
from service.identification.fit import Problem
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
    # the model too, so that its id stays its own
    known: dict[int, tuple[Scored, Scored]] = field(default_factory=dict)

    def beside(self, best: Scored) -> Opened:
        """The discrepancies that are open with another model."""
        return self.opened if best is self.best else Opened.beside(self.pool, best)

    def seen(self, model: Scored) -> Scored:
        """A model with its residuals on held-out data given the discrepancies."""
        if id(model) not in self.known:
            self.known[id(model)] = model, _seen(self.pool.problem, model, self.opened, self.pool.split)
        return self.known[id(model)][1]

    def least(self, none: Scored, model: Scored, names: Collection[str]) -> float:
        """What effects of another model explain given the discrepancies, over what their torque does at other times:
        the least of them, 0 where one is not separable. none: the base model."""
        problem, split = self.pool.problem, self.pool.split
        effects = dict.fromkeys(term.effect for term in model.hypothesis.terms if term.effect.name in names)
        fewer = {effect: without(problem, split, none, model, effect) for effect in effects}
        return min((own(self.pool, fewer[effect], model, effect, self.opened) for effect in effects), default=np.inf)

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
        wide = opened.wide(best.fitted)
        dictionary = Dictionary(regressors, wide.fit, wide.prior)
        tried = _added(regressors, dictionary, pool, best, opened, gone, given, allows)
        if not tried and len(set(best.names[given:])) + 2 <= MOST_EFFECTS:
            tried = _couple(regressors, dictionary, pool, selection.none, best, opened, gone, allows)
        if not tried:
            break
        path.append((tried, tried[0]))
        best = tried[0]
        opened = Opened.beside(pool, best)
    return Accepted(best, pool, opened, rejected, path)


def own(pool: Pool, fewer: Scored, best: Scored, effect: Effect, opened: Opened) -> float:
    """What `effect` explains in `best` given discrepancies, over what its torque does at other times. fewer: the model
    without it."""
    level = pool.problem.level(opened.wide(best.fitted).left())
    return over_null(pool.problem, opened.in_its_units(fewer.fitted), best.fitted, {effect}, level)


def _seen(problem: Problem, scored: Scored, opened: Opened, split: Split) -> Scored:
    """A model with its residuals on held-out data given discrepancies, joints weighted by what is left of the best."""
    left, level = opened.wide(scored.fitted).held_out(split), problem.level(opened.residuals)
    residuals = [r / level[j] for r, j in zip(left, problem.joints_of_rows, strict=True)]
    return Scored(scored.fitted, residuals, block_loss(residuals, split))


def _added(
    regressors: Regressors, dictionary: Dictionary, pool: Pool, best: Scored, opened: Opened,
    gone: Collection[Effect], given: int, allows: Callable[[Effect, int], bool],
) -> list[Scored]:  # fmt: skip
    """Models with one effect more that is accepted, the best first."""
    problem, split = regressors.problem, regressors.split
    before, found = _seen(problem, best, opened, split), []
    ranking = dictionary.ranking(best.hypothesis.terms, problem.recordings[0].mechanism.joints, allows)
    for promised, candidate in ranking[:SHORTLIST]:
        if candidate.effect in gone or dictionary.nothing - promised < LEAST_GAIN * problem.count:
            continue
        for loss, model in _fitted(regressors, best, (candidate,), opened, given):
            if loss < before.loss:
                found.append((loss, own(pool, best, model, candidate.effect, opened), model))
    found.sort(key=lambda item: item[0])
    first = _furthest([ratio for _, ratio, _ in found])
    models = [model for *_, model in found]
    return [] if first is None else [models.pop(first), *models]


def _fitted(
    regressors: Regressors, best: Scored, several: tuple[Candidate, ...], opened: Opened, given: int
) -> list[tuple[float, Scored]]:
    """The sound model with these too that explains most given discrepancies, with its loss; none where none is sound.

    It is fitted with the discrepancies and without: beside a disturbance only the first has its values, and where a
    discrepancy mimics the effect only the second.
    """
    problem, split = regressors.problem, regressors.split
    noises = (opened.noise, WHITE) if opened.found else (WHITE,)
    models = [with_several(regressors, best, several, noise) for noise in noises]
    sound = [model for model in models if fault_of(problem, model.hypothesis, given) is None]
    losses = [(_seen(problem, model, opened, split).loss, model) for model in sound]
    return sorted(losses, key=lambda item: item[0])[:1]


def _couple(
    regressors: Regressors, dictionary: Dictionary, pool: Pool, none: Scored, best: Scored, opened: Opened,
    gone: Collection[Effect], allows: Callable[[Effect, int], bool],
) -> list[Scored]:  # fmt: skip
    """Models with two effects more that hide each other, each accepted given the other, what explains most first. They
    promise to explain half of the residual at least, and each has a null. none: the base model."""
    problem, split, given = regressors.problem, regressors.split, len(none.hypothesis.terms)
    before, found = _seen(problem, best, opened, split), []
    ranking = dictionary.couples(best.hypothesis.terms, problem.recordings[0].mechanism.joints, allows)
    # squares; what promises to leave more is not fitted
    most = dictionary.nothing - PROMISE * (dictionary.nothing - problem.count)
    for promised, several in ranking[:SHORTLIST]:
        effects = [candidate.effect for candidate in several]
        if promised > most or any(effect in gone for effect in effects):
            continue
        for loss, model in _fitted(regressors, best, several, opened, given):
            fewer = [without(problem, split, none, model, effect) for effect in effects]
            ratios = [own(pool, one, model, effect, opened) for one, effect in zip(fewer, effects, strict=True)]
            if loss < before.loss and all(OWN < ratio < np.inf for ratio in ratios):
                found.append((loss, model))
    return [model for _, model in sorted(found, key=lambda item: item[0])]


def _furthest(ratios: list[float]) -> int | None:
    """Place of the largest ratio that is accepted, of models that explain most first; None where none is. One without a
    null, which nothing is to be compared with, has to explain most, and no other is accepted."""
    finite = [ratio if ratio < np.inf else 0.0 for ratio in ratios]
    if max(finite, default=0.0) > OWN:
        return int(np.argmax(finite))
    return 0 if ratios[:1] == [np.inf] else None
