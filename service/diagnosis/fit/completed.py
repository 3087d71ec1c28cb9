"""What comes once an effect has been found: quantities that the search kept, and further orders of what repeats.

How flanks ring behind a gap is told by what the impacts leave, so that it is fitted when gap and shares are known; as
part of the search it would be a grid of several quantities more on every joint.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

from service.diagnosis.fit.orders import more_orders
from service.diagnosis.fit.selection import LEAST_GAIN, LEAST_Z, Scored, score, z_score
from service.identification.fit import Problem, fit
from service.identification.folds import Split
from service.model.hypothesis import Hypothesis, Term

ITERATIONS = 5  # from each start, before the best of them is fitted to the end


def completed(problem: Problem, split: Split, best: Scored) -> Scored:
    """`best` with what its effects bring, while data left out gain by each."""
    return more_orders(problem, split, _late_fitted(problem, split, best))


def _late_fitted(problem: Problem, split: Split, best: Scored) -> Scored:
    for place, term in enumerate(best.hypothesis.terms):
        if term.found or not any(one.late for one in term.effect.nonlinear.values()):
            continue
        starts = [_with(best.hypothesis, place, replace(term, found=True, nonlinear=one)) for one in _starts(term)]
        nearest = min((fit(problem, one, iterations=ITERATIONS) for one in starts), key=lambda fitted: fitted.cost)
        trial = score(fit(problem, nearest.hypothesis), split)
        if best.loss - trial.loss > LEAST_GAIN * problem.count and z_score(best.blocks, trial.blocks) > LEAST_Z:
            best = trial
    return best


def _starts(term: Term) -> list[tuple[float, ...]]:
    """All of the grid of what is late, and where the rest then starts."""
    known = zip(term.effect.nonlinear.values(), term.nonlinear, strict=True)
    points = itertools.product(*(one.grid if one.late else (value,) for one, value in known))
    return [start for point in points for start in term.effect.starts(point)]


def _with(hypothesis: Hypothesis, place: int, term: Term) -> Hypothesis:
    return replace(hypothesis, terms=(*hypothesis.terms[:place], term, *hypothesis.terms[place + 1 :]))
