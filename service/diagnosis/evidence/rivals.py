"""How sure: probabilities over rivals by block bootstrap, and which effects this data cannot tell apart."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from service.diagnosis.evidence.statistics import DRAWS
from service.diagnosis.fit.candidates import PROMISE, Dictionary, Regressors
from service.diagnosis.fit.common import in_common
from service.diagnosis.fit.selection import (
    LEAST_GAIN,
    SHORTLIST,
    SIMPLER_SHARE,
    Z95,
    Scored,
    Selection,
    Standing,
    added,
    fit_added,
    score,
    size,
    z_score,
)
from service.diagnosis.fit.sound import fault_of
from service.identification.folds import Split
from service.model.effects.base import Effect
from service.model.hypothesis import Term

Seen = Callable[[Scored], Scored]
Counts = Callable[[Scored, Collection[str]], bool]

SURE = 0.9  # probability from which a name is not asked about again
CONFUSED = 0.05  # probability from which what stands in for a name is told beside it
LIKELY = 0.5  # probability that a name needs, and keeps where all that does as well is what all joints may have alike


@dataclass(frozen=True)
class ModelComparison:
    """One round of the search: each hypothesis's effect with its probability, and that of adding none to `before`."""

    before: Scored
    candidates: list[tuple[Scored, float]]
    none: float

    def probability(self, name: str) -> float:
        """Of an effect, 0 if it did not come into question."""
        return sum(p for scored, p in self.candidates if name in _names(added(scored, self.before)))


def comparisons(selection: Selection, split: Split, rows: int) -> list[ModelComparison]:
    """The rounds of a search, weighed on bootstrap draws of its blocks."""
    result = []
    for parent, tried, _ in selection.rounds():
        gain = float(parent.blocks.sum() - tried[0].blocks.sum())
        *chances, none = shares([*tried, parent], [gain] * len(tried), split, rows)
        result.append(ModelComparison(parent, list(zip(tried, chances, strict=True)), none))
    return result


def shares(
    models: Sequence[Scored], gains: Sequence[float], split: Split, rows: int, level: Sequence[int] = ()
) -> list[float]:
    """Probability of each model: its Akaike weight, in the mean over bootstrap draws of the blocks of data left out.

    gains: squares, of as many models as there are: what the effects take in which it differs from the first. With more
    parameters than the first a model has to be ahead by a share of that, or counts as alike. Models after these lack an
    effect, which has to be worth it. Where the best leaves more than noise, a difference counts by that. level: places
    of models that count like the first, whatever they leave.

    Source: Burnham, Anderson: Model Selection and Multimodel Inference, 2002, sections 2.5 (lack of fit) and 2.9.
    """
    draw = np.random.default_rng(0).integers(0, split.blocks, (DRAWS, split.blocks))
    unit = max(1.0, min(float(model.blocks.sum()) for model in models) / rows)
    sizes = np.array([size(model) for model in models])
    loss = np.stack([model.blocks[draw].sum(axis=1) for model in models])
    least = loss[0] - SIMPLER_SHARE * np.pad(gains, (0, len(models) - len(gains)))[:, None]
    alike = (sizes > sizes[0])[:, None] & (loss > least)
    loss = np.where(alike, np.maximum(loss, loss[0]), loss) / unit + 2.0 * sizes[:, None]
    loss[len(gains) :] -= LEAST_GAIN * rows
    loss[list(level)] = loss[0]
    weight = np.exp(-0.5 * (loss - loss.min(axis=0)))
    return (weight / weight.sum(axis=0)).mean(axis=1).tolist()


def undecided(selection: Selection, rounds: list[ModelComparison]) -> ModelComparison | None:
    """The first round whose winner others might be as well; where there is none, the first of all."""
    doubtful = {effect.name for effect, one in selection.standings.items() if one.probability < SURE or one.confusable}
    for comparison, (_, taken) in zip(rounds, selection.path, strict=True):
        if taken is not None:
            for name in _names(added(taken, comparison.before)):
                if comparison.probability(name) < SURE or name in doubtful:
                    return comparison
    return rounds[0] if rounds else None


def standings(
    regressors: Regressors, selection: Selection, best: Scored, refits: Mapping[Effect, Scored],
    allows: Callable[[Effect, int], bool], explained: bool, seen: Seen = lambda model: model,
    counts: Counts = lambda model, instead: True,
) -> dict[Effect, Standing]:  # fmt: skip
    """How each effect of `best` stands against models without it, the others fitted anew beside each rival.

    When an effect was added, others that are at work were still in the gap, and what stood in for them. What all joints
    may have alike takes no name from an effect, but leaves it no surer than even. refits: `best` without each effect.
    explained: what `best` leaves is noise, so that a likelihood tells which of two is better. seen: a model with the
    losses of its blocks as they count: given discrepancies, where more than noise is left. counts: whether a model that
    does better is accepted with what it has instead.
    """
    given = len(selection.none.hypothesis.terms)
    once = {}
    for model, instead in _rivals(regressors, selection, best, refits, allows):
        where = frozenset(Counter(place for term in model.hypothesis.terms for place in _at(term)).items())
        if where not in once or model.loss < once[where][0].loss:
            once[where] = model, instead
    least = seen(best).loss
    rivals = [(one, instead) for one, instead in once.values() if seen(one).loss > least or counts(one, instead)]
    alike = [(one, instead) for model, instead in rivals for one in _alike(model, instead, regressors.split)]
    others = [model for model, _ in rivals]
    apart = every = _weighed(regressors, best, others, refits, given, seen)
    shared = [one for one, _ in alike]
    level = _level(best, others, shared, refits, given, regressors.split)
    if shared or level:
        every = _weighed(regressors, best, [*others, *shared], refits, given, seen, level)
    result = {}
    for effect, refit in refits.items():
        lacks = [place for place, (model, _) in enumerate(every) if effect.name not in model.names[given:]]
        told = [(), *(instead for _, instead in (*rivals, *alike)), *[()] * len(refits)]
        confusable = [name for place in lacks if every[place][1] >= CONFUSED for name in told[place]]
        lacking = [one for one in apart[: 1 + len(rivals)] if effect.name not in one[0].names[given:]]
        ahead = [z_score(seen(model).blocks, seen(best).blocks) for model, _ in lacking]
        better = [
            model
            for model, chance in lacking
            if _one_more(model, refit) and (_told_better(seen(model), seen(best)) or (explained and chance >= LIKELY))
        ]
        alone = [every[place][0] for place in level if place in lacks and place <= len(rivals)]
        simpler = [model for model in alone if size(model) < size(best)]
        sure, even = (
            1.0 - sum(chance for model, chance in these if effect.name not in model.names[given:])
            for these in (every, apart)
        )
        result[effect] = Standing(
            refit,
            max(sure, min(even, LIKELY)),
            list(dict.fromkeys(confusable)),
            min(ahead, default=np.inf),
            min(better, key=lambda model: model.loss, default=None),
            min(simpler, key=lambda model: model.loss, default=None),
        )
    return result


def _alike(model: Scored, instead: Collection[str], split: Split) -> list[Scored]:
    """`model` with one figure on all joints for one of the effects that it has `instead`, each that may have one."""
    mine = [number for number, term in enumerate(model.hypothesis.terms) if term.effect.name in instead]
    return [one for number in mine if (one := in_common(model, number, split)) is not None]


def _level(
    best: Scored, rivals: Sequence[Scored], shared: Sequence[Scored], refits: Mapping[Effect, Scored], given: int,
    split: Split,
) -> list[int]:  # fmt: skip
    """Places, in `best`, rivals, shared, of models with one figure for the whole robot, or the one that the last joint
    lacked, in place of an effect of `best` that has, or may have, one for the whole robot: they have to lack a fiftieth
    of what it takes to be told from it.

    A mass at the platform is a scale of all torques, as far as friction, inertia and weight of the arms are found and
    forearms and platform are taken as described; no description is as true as such a difference is small.
    """
    places = set()
    for number, term in enumerate(best.hypothesis.terms):
        fewer = refits.get(term.effect)
        mine = best if _of_whole(term) else in_common(best, number, split)
        if fewer is None or mine is None:
            continue
        most = best.loss + SIMPLER_SHARE * (fewer.loss - best.loss)
        for place, model in enumerate((*rivals, *shared), 1) if mine.loss < most else ():
            if term.effect.name in model.names[given:] or not _one_more(model, fewer):
                continue
            single = place > len(rivals) or _on_all(model, added(model, fewer)[0])
            if single and model.loss < most and size(model) <= size(mine):
                places.add(place)
    return sorted(places)


def _of_whole(term: Term) -> bool:
    """Whether all that there is of it is one figure for the whole robot."""
    return not term.joints and not term.nonlinear and term.amplitude.size == 1


def _on_all(model: Scored, term: Term) -> bool:
    """Whether a term of `model` is one figure for the whole robot, or the last of those that each joint has."""
    mine = [one for one in model.hypothesis.terms if one.effect is term.effect]
    joints = {joint for one in mine for joint in one.joints}
    return _of_whole(term) or (
        len(joints) == len(model.hypothesis.base.viscous)
        and all(one.amplitude.shape[1] == 1 and not one.nonlinear for one in mine)
    )


def _names(terms: Sequence[Term]) -> tuple[str, ...]:
    return tuple(term.effect.name for term in terms)


def _placed(model: Scored) -> set[tuple[Effect, int]]:
    """Its effects, each where it sits."""
    return set().union(*map(_at, model.hypothesis.terms))


def _at(term: Term) -> set[tuple[Effect, int]]:
    return {(term.effect, place) for place in term.places}


def _one_more(model: Scored, fewer: Scored) -> bool:
    """Whether a model has the effects of `fewer` and one more, in whatever order they were found."""
    return len(added(model, fewer)) == 1 == len(model.names) - len(fewer.names)


def _told_better(model: Scored, best: Scored) -> bool:
    return model.blocks.sum() < best.blocks.sum() and z_score(best.blocks, model.blocks) > Z95


def _weighed(
    regressors: Regressors, best: Scored, others: Sequence[Scored], refits: Mapping[Effect, Scored], given: int,
    seen: Seen, places: Sequence[int] = (),
) -> list[tuple[Scored, float]]:  # fmt: skip
    """`best`, others and refits, each with its probability among them. seen: as of `standings`. places: of those that
    count like it."""
    full, fewer = [seen(model) for model in (best, *others)], [seen(refit) for refit in refits.values()]
    worth = {effect: float((one.blocks - full[0].blocks).sum()) for effect, one in zip(refits, fewer, strict=True)}
    gains = [
        min((worth[effect] for effect in refits if effect.name not in model.names[given:]), default=0.0)
        for model in full
    ]
    chances = shares([*full, *fewer], gains, regressors.split, regressors.problem.count, places)
    return list(zip([best, *others, *refits.values()], chances, strict=True))


def _rivals(
    regressors: Regressors, selection: Selection, best: Scored, refits: Mapping[Effect, Scored],
    allows: Callable[[Effect, int], bool],
) -> Iterator[tuple[Scored, tuple[str, ...]]]:  # fmt: skip
    """Models that lack an effect of `best` and none of what fell, with the effects that they have instead."""
    found, placed = set(best.names), _placed(best)
    fallen = set(selection.best.names) - found
    begun = []
    for before, tried, _ in selection.rounds():
        begun.append(_placed(before))
        for model in tried:
            names = set(model.names)
            instead = [term for term in model.hypothesis.terms if not _at(term) <= placed]
            if instead and found - names and not fallen & names:
                yield model, _names(instead)
    for effect, fewer in refits.items():
        if _placed(fewer) not in begun:
            gain = fewer.loss - best.loss
            for model in _in_its_place(regressors, fewer, effect, PROMISE * gain, allows):
                yield model, _names(added(model, fewer))


def _in_its_place(
    regressors: Regressors, fewer: Scored, effect: Effect, least: float, allows: Callable[[Effect, int], bool]
) -> Iterator[Scored]:
    """What else might be beside `fewer`, fitted: those that promise to take `least` squares."""
    problem, dictionary = regressors.problem, Dictionary(regressors, fewer.fitted)
    joints, given = problem.recordings[0].mechanism.joints, len(regressors.start.terms)
    for loss, candidate in dictionary.ranking(fewer.hypothesis.terms, joints, allows)[:SHORTLIST]:
        if candidate.effect is not effect and dictionary.nothing - loss > least:
            model = score(fit_added(problem, fewer.fitted, candidate.term()), regressors.split)
            if fault_of(problem, model.hypothesis, given) is None:
                yield model
