"""What the data cannot support, said instead of a confident name."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from schemas.diagnosis import Caution
from service.diagnosis.fit.selection import Selection
from service.identification.fit import Problem, fit
from service.model.effects.base import Effect

LEAST_TIME = 3.0  # s of motion of a joint
LEAST_SHARE = 0.02  # of the time that a joint moves in its rarer direction
WRONG_MODEL = 0.10  # rms left, of the torque's own rms: a description that leaves more is wrong somewhere
FOREIGN = 0.7  # of what is left that runs shed when each is fitted alone: they are not of one robot
FOREIGN_LEFT = 2.0  # times the noise that has to be left for that question to arise
CARRIES_OVER = 0.6  # of the gap above the noise that effects remove on runs left out: then they are no accident


@dataclass(frozen=True)
class Offer:
    """What may be looked for. still: joints that hardly move. one_way: without reversals. enough: any at all."""

    still: frozenset[int]
    one_way: frozenset[int]
    enough: bool
    cautions: list[Caution]

    def allows(self, effect: Effect, joint: int) -> bool:
        """Whether `effect` may be looked for on `joint`."""
        if not effect.per_joint:
            return not self.still
        return joint not in self.still and not (joint in self.one_way and effect.directional)


def limits_of(problem: Problem) -> Offer:
    """Joints at rest, joints without reversals, too little motion."""
    joints = len(problem.sigma)
    forward, backward = np.zeros(joints), np.zeros(joints)
    for recording in problem.recordings:
        segment = recording.segment
        forward += ((segment.theta_dot > 0) & segment.moving).sum(axis=0) * segment.period
        backward += ((segment.theta_dot < 0) & segment.moving).sum(axis=0) * segment.period
    time = forward + backward
    still = frozenset(np.flatnonzero(time < LEAST_TIME).tolist())
    one_way = frozenset(np.flatnonzero(np.minimum(forward, backward) < LEAST_SHARE * time).tolist()) - still
    cautions = []
    enough = len(still) < joints
    if not enough:
        cautions.append(Caution(code="too_little_motion", advice="record_runs"))
    elif still:
        which = [joint + 1 for joint in sorted(still)]
        cautions.append(Caution(code="joints_at_rest", joints=which, advice="record_all_joints"))
    for joint in sorted(one_way):
        cautions.append(Caution(code="one_way", joints=[joint + 1], advice="record_reversals"))
    if enough and len({recording.trace for recording in problem.recordings}) == 1:
        cautions.append(Caution(code="one_run", advice="record_runs"))
    return Offer(still, one_way, enough, cautions)


def doubts_of(problem: Problem, selection: Selection, limit: float) -> list[Caution]:
    """Reasons not to believe any name: the description does not fit at all, or the runs are not of one robot."""
    best = selection.best
    for term in best.hypothesis.terms:
        size = term.effect.size(problem.recordings[0].mechanism, term.amplitude)
        which = [joint + 1 for joint in term.joints]
        if size > term.effect.beyond:
            name = term.effect.name
            return [Caution(code="beyond_any_robot", joints=which, effect=name, advice="check_description")]
        if len(term.joints) > 1 and size > term.effect.beyond_together:
            return [Caution(code="several_arms", joints=which, advice="check_description")]
    left = best.loss / problem.count
    gap = selection.none.loss / problem.count
    if left**0.5 <= max(limit, FOREIGN_LEFT) or gap - left > CARRIES_OVER * (gap - 1.0):
        return []
    if len({recording.trace for recording in problem.recordings}) > 1:
        alone = _alone(problem, selection)
        if left - alone > FOREIGN * (left - 1.0):
            return [Caution(code="runs_differ", advice="check_runs")]
    torque = sum(
        float(((target[rows] - np.mean(target[rows])) ** 2).sum())
        for target, rows in zip(problem.target, problem.rows, strict=True)
    )
    noise = float(np.mean(problem.sigma**2))
    share = (left * noise / (torque / problem.count)) ** 0.5
    if share > WRONG_MODEL:
        return [Caution(code="much_is_left", share=round(share, 4), advice="check_description")]
    return []


def _alone(problem: Problem, selection: Selection) -> float:
    """Mean square residual, in units of the noise, when every run has a base model of its own."""
    cost = 0.0
    for trace in {recording.trace for recording in problem.recordings}:
        mine = [index for index, recording in enumerate(problem.recordings) if recording.trace == trace]
        part = replace(
            problem,
            recordings=[problem.recordings[i] for i in mine],
            target=[problem.target[i] for i in mine],
            rows=[problem.rows[i] for i in mine],
        )
        cost += fit(part, selection.best.hypothesis, iterations=3).cost
    return cost / problem.count
