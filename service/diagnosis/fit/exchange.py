"""One effect in place of two that were found, or two in place of one or beside all, where they leave noise.

Effects are added one by one, and what stands in for two of them goes before either: the length of a link and the
inertia of its rotor are an offset of the torque and a scale. What then stands in for the rest makes three of one.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace

from service.diagnosis.fit.candidates import PROMISE, Candidate, Dictionary, Regressors
from service.diagnosis.fit.selection import (
    LEAST_GAIN,
    MOST_EFFECTS,
    SHORTLIST,
    Scored,
    Selection,
    fit_added,
    pruned,
    score,
    size,
    without,
    worth,
)
from service.diagnosis.fit.sound import fault_of
from service.identification.correlated import WHITE, Correlated
from service.model.effects.base import Effect


def exchanged(
    regressors: Regressors, selection: Selection, limit: float, allows: Callable[[Effect, int], bool],
    progress: Callable[[str], None],
) -> Selection:  # fmt: skip
    """The selection with the first exchange that explains all: what it leaves is noise, `limit` rms at most. Where that
    is so already: by fewer effects, as well. What it makes superfluous goes too."""
    problem, given = regressors.problem, len(selection.none.hypothesis.terms)
    if not regressors.effects:
        return selection
    best, explained = selection.best, problem.over_noise(selection.best.residuals) <= limit
    # squares; what promises to leave more is not fitted
    most = limit**2 * problem.count if explained else best.loss - PROMISE * (best.loss - problem.count)
    for parent in _fewer(regressors, selection, 2) if explained else _fewer(regressors, selection, 0, 1):
        progress("comparing alternatives to the effects found")
        tried = [
            scored
            for scored in _tried(regressors, parent, 1 if explained else 2, most, allows)
            if problem.over_noise(scored.residuals) <= limit
            and fault_of(problem, scored.hypothesis, given) is None
            and (
                scored.loss < best.loss + LEAST_GAIN * problem.count
                if explained
                else worth(scored.blocks, best.blocks, selection.none.blocks, problem.count, problem.most)
            )
        ]
        if not tried:
            continue
        tried.sort(key=lambda scored: scored.loss + 2 * size(scored))
        kept = pruned(problem, regressors.split, tried[0], selection.none, problem.count, given)
        if len(set(kept.names[given:])) > MOST_EFFECTS or problem.over_noise(kept.residuals) > limit:
            continue
        path = [(others, taken) for others, taken in selection.path if taken is not None]
        trimmed = selection.trimmed | ({id(path[-1][1]): parent} if path else {}) | {id(tried[0]): kept}
        return replace(selection, best=kept, path=[*path, (tried, tried[0])], trimmed=trimmed, fault=None)
    return selection


def _fewer(regressors: Regressors, selection: Selection, *counts: int) -> Iterator[Scored]:
    """What was found without so many of its effects."""
    best, given = selection.best, len(selection.none.hypothesis.terms)
    effects = list(dict.fromkeys(term.effect for term in best.hypothesis.terms[given:]))
    for count in counts:
        for gone in itertools.combinations(effects, count):
            yield without(regressors.problem, regressors.split, selection.none, best, *gone) if gone else best


def _tried(
    regressors: Regressors, parent: Scored, count: int, most: float, allows: Callable[[Effect, int], bool]
) -> list[Scored]:
    """One effect or two beside `parent`, fitted, those that promise to leave least, and less than `most`."""
    dictionary, taken = Dictionary(regressors, parent.fitted), parent.hypothesis.terms
    joints = regressors.problem.recordings[0].mechanism.joints
    promising = (
        [(loss, (one,)) for loss, one in dictionary.ranking(taken, joints, allows)]
        if count == 1
        else dictionary.couples(taken, joints, allows)
    )
    return [with_several(regressors, parent, several) for loss, several in promising[:SHORTLIST] if loss < most]


def with_several(
    regressors: Regressors, parent: Scored, several: tuple[Candidate, ...], noise: Correlated = WHITE
) -> Scored:
    """`parent` with these candidates too, fitted. noise: its covariance."""
    *first, last = sorted(several, key=lambda candidate: candidate.effect.rough)
    fitted = parent.fitted
    for candidate in first:
        terms = (*fitted.hypothesis.terms, candidate.term())
        fitted = replace(fitted, hypothesis=fitted.hypothesis.carrying(terms))
    return score(fit_added(regressors.problem, fitted, last.term(), noise), regressors.split)
