"""Effects that are at work several times on a joint, each time at another order: cogging of many orders.

Once one order is found, the others are looked for at once, by what they leave over the turns of the motor: one by one
they would be a catalogue's worth of rounds, and each alone explains too little of the rest to be believed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.diagnosis.fit.selection import LEAST_GAIN, LEAST_SHARE_OF_GAP, LEAST_Z, Scored, score, z_score
from service.identification.fit import Problem, fit
from service.identification.folds import Split
from service.model import ripple
from service.model.effects.base import Effect
from service.model.hypothesis import Term

MOST = 8  # orders a joint
TRIED = 3  # strongest, before a joint is said to have no more
APART = 0.5  # orders


def more_orders(problem: Problem, split: Split, best: Scored) -> Scored:
    """`best` with further orders of the effects at work in it that repeat, while data left out gain by each."""
    found = {(term.effect, joint) for term in best.hypothesis.terms if term.effect.repeats for joint in term.joints}
    for effect, joint in sorted(found, key=lambda pair: pair[1]):
        while (larger := _one_more(problem, split, best, effect, joint)) is not None:
            best = larger
    return best


def _one_more(problem: Problem, split: Split, best: Scored, effect: Effect, joint: int) -> Scored | None:
    mine = [t for t in best.hypothesis.terms if t.effect is effect and joint in t.joints]
    if len(mine) >= MOST:
        return None
    strength = _left(problem, best, joint)
    for term in mine:
        near = np.abs(np.arange(len(strength)) - term.nonlinear[0]) < APART
        strength[near] = 0.0
    for order in np.argsort(strength)[::-1][:TRIED]:
        term = Term.blank(effect, (joint,), (float(order),))
        trial = replace(best.hypothesis, terms=(*best.hypothesis.terms, term))
        larger = score(fit(problem, trial, iterations=3), split)
        gain = best.loss - larger.loss
        least = max(LEAST_GAIN * problem.count, LEAST_SHARE_OF_GAP * (best.loss - problem.count))
        if gain > least and z_score(best.blocks, larger.blocks) > LEAST_Z:
            return larger
    return None


def _left(problem: Problem, best: Scored, joint: int) -> np.ndarray:
    """Strength of each order in what is left on a joint, order 0 aside."""
    turns, values = [], []
    ratio = problem.recordings[0].mechanism.gear_ratio[joint] / (2 * np.pi)
    for recording, rows, joints, residual in zip(
        problem.recordings, problem.rows, problem.joints_of_rows, best.fitted.residuals, strict=True
    ):
        turns.append(ratio * recording.segment.theta[:: problem.band.step, joint][rows[:, joint]])
        values.append(residual[joints == joint])
    strength = ripple.spectrum(np.concatenate(turns), np.concatenate(values))
    strength[0] = 0.0
    return strength
