"""Friction that is told though a description of axes leaves much of the torque: that may be wrong in much, but what it
may be wrong in goes by the angle.

A weight, a spring, a stop, a counterbalance, another gear ratio, a tight spot: load, inertia and friction by the angle
of an axis. With all of these left open what stands in for them takes next to nothing more, and friction that grows with
the load as much as before, as far as the load is what it takes to accelerate. It has to do so on each log left out, and
ahead of everything in its place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from schemas.diagnosis import Caution
from service.diagnosis.evidence.cautions import doubts_of
from service.diagnosis.evidence.earned import STANDS, earned
from service.diagnosis.evidence.rivals import SURE
from service.diagnosis.fit.candidates import Regressors
from service.diagnosis.fit.selection import LEAST_Z, Scored, Selection, Standing, worth, z_score
from service.diagnosis.fit.wide import Wide
from service.identification.fit import Problem
from service.identification.folds import Split, block_loss, held_out
from service.model.effects.base import Effect, on_joint
from service.model.hypothesis import Hypothesis

LOAD, INERTIA = 6, 2  # degree by the angle of load and friction, which a weight over a turn needs, and of inertia
LEAST_LOGS = 3


def named_beside(
    regressors: Regressors, selection: Selection, doubts: Sequence[Caution], kept_out: Sequence[Problem],
    allows: Callable[[Effect, int], bool], limit: float,
) -> tuple[Selection, list[Caution]] | None:  # fmt: skip
    """The names that stand and what is said of the rest, where the description is of axes, no more speaks against it
    than how much it leaves, and all that was found is told however wrong it is; else None."""
    problem = regressors.problem
    if not _much_alone(doubts) or not problem.recordings[0].mechanism.decoupled:
        return None
    kept, _ = earned(regressors, _nearest(problem, selection), kept_out, allows, limit, lambda _: None)
    left = doubts_of(problem, kept, limit)
    found = {term.effect for term in kept.best.hypothesis.terms[len(kept.none.hypothesis.terms) :]}
    if not found or not _much_alone(left):
        return None
    if not all(told_beside(problem, kept.best, effect, kept.standings[effect]) for effect in found):
        return None
    return kept, [one.model_copy(update={"code": "much_beside"}) for one in left]


def _nearest(problem: Problem, selection: Selection) -> Selection:
    """A search that found nothing as if it had taken what came nearest, where that is worth it however little of what
    is left it takes: what else is left here says nothing of it."""
    if selection.names or selection.fault is not None or not selection.path:
        return selection
    (tried, _), none = selection.path[0], selection.none
    if not tried or not worth(tried[0].blocks, none.blocks, none.blocks, problem.count, problem.most):
        return selection
    return replace(selection, best=tried[0], path=[(tried, tried[0])])


def _much_alone(doubts: Sequence[Caution]) -> bool:
    return [one.code for one in doubts] == ["much_is_left"]


def told_beside(problem: Problem, best: Scored, effect: Effect, standing: Standing) -> bool:
    """Whether an effect of `best` is friction that is told from all that goes by the angle, and from the catalogue."""
    ahead = standing.probability >= SURE and not standing.confusable and standing.ahead > LEAST_Z
    return (
        ahead
        and effect.dissipates
        and all(searched.fixed for searched in effect.nonlinear.values())  # a shape that is fitted suits what is none
        and on_each_log(problem, standing.without, best)
        and stays(problem, standing.without, best, effect) >= STANDS
    )


def on_each_log(problem: Problem, fewer: Scored, best: Scored) -> bool:
    """Whether what is left of each of three logs or more, predicted by the others, shrinks."""
    runs, split = np.array(problem.logs), Split.of(problem)
    before, after = (np.array([float(r @ r) for r in held_out(one.fitted, split)]) for one in (fewer, best))
    logs = np.unique(runs)
    return len(logs) >= LEAST_LOGS and all(after[runs == log].sum() < before[runs == log].sum() for log in logs)


def stays(problem: Problem, fewer: Scored, best: Scored, effect: Effect) -> float:
    """Of what an effect takes on stretches left out, the share that it takes beside all that goes by the angle of its
    joints; none where that may be chance."""
    split = Split.of(problem, mixed=True)
    joints = sorted({joint for term in best.hypothesis.terms if term.effect is effect for joint in term.joints})
    if not joints:
        return 0.0
    columns = by_angle(problem, best.hypothesis, joints)
    plain = [block_loss(held_out(one.fitted, split), split) for one in (fewer, best)]
    opened = [block_loss(Wide.of(one.fitted, columns, 0.0).held_out(split), split) for one in (fewer, best)]
    taken, still = (float((without - all_).sum()) for without, all_ in (plain, opened))
    return still / taken if taken > 0 and z_score(*opened) > LEAST_Z else 0.0


def by_angle(problem: Problem, hypothesis: Hypothesis, joints: Sequence[int]) -> list[np.ndarray]:
    """(R, K) a recording, in units of the noise, all columns of one size: on each of `joints` a load by the angle of
    each axis; friction, and inertia against each axis' acceleration and squared speed, by its own."""
    segments = [recording.segment for recording in problem.recordings]
    low = np.min([segment.theta.min(axis=0) for segment in segments], axis=0)
    high = np.max([segment.theta.max(axis=0) for segment in segments], axis=0)
    result = []
    for number, scene in enumerate(problem.scenes(hypothesis)):
        segment = scene.segment
        shapes = chebvander(2.0 * (segment.theta - low) / np.maximum(high - low, 1e-12) - 1.0, LOAD)  # (N, n, k)
        loads = shapes[:, :, 1:].reshape(len(shapes), -1)
        rates = np.concatenate([segment.theta_ddot, segment.theta_dot**2], axis=1)
        parts = []
        for joint in joints:
            own = shapes[:, joint]
            inertias = (rates[:, :, None] * own[:, None, : INERTIA + 1]).reshape(len(shapes), -1)
            mine = np.concatenate([loads, inertias, own * scene.direction[:, [joint]]], axis=1)
            parts.append(problem.select(number, problem.band(on_joint(mine, joint, scene.joints))))
        result.append(np.concatenate(parts, axis=1))
    size = np.sqrt(np.sum([np.square(part).sum(axis=0) for part in result], axis=0))
    return [part / np.where(size > 0, size, 1.0) for part in result]
