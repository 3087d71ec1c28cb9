"""What the data cannot support, said instead of a confident name."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.diagnosis.fit.selection import Selection
from service.identification.fit import Problem, fit
from service.model.effects.base import Effect

LEAST_TIME = 3.0  # s of motion of a joint
LEAST_SHARE = 0.02  # of the time that a joint moves in its rarer direction
WRONG_MODEL = 0.10  # rms left, of the torque's own rms: a description that leaves more is wrong somewhere
FOREIGN = 0.7  # of what is left that runs shed when each is fitted alone: they are not of one robot
FOREIGN_LEFT = 2.0  # times the noise that has to be left for that question to arise
CARRIES_OVER = 0.6  # of the gap above the noise that effects remove on runs left out: then they are no accident
CHECK = "Check the description (lengths, gear ratio, order and sign of joints)."


@dataclass(frozen=True)
class Offer:
    """What may be looked for. still: joints that hardly move. one_way: joints without reversals. enough: any at all."""

    still: frozenset[int]
    one_way: frozenset[int]
    enough: bool
    reasons: list[str]

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
    reasons = []
    enough = len(still) < joints
    if not enough:
        reasons.append(
            f"Cannot be told apart on this data: no joint moves for {LEAST_TIME:g} s in all. Record three or more runs "
            "of 5 s: picks, a multisine and a slow sweep with reversals."
        )
    elif still:
        which = ", ".join(str(joint + 1) for joint in sorted(still))
        reasons.append(
            f"Joint {which} hardly moves: effects of the whole robot and of that joint cannot be told apart on this "
            "data. Record runs in which all joints move."
        )
    for joint in sorted(one_way):
        reasons.append(
            f"Joint {joint + 1} moves one way only: its friction cannot be told from a constant torque on this data. "
            "Record runs with reversals."
        )
    if enough and len({recording.trace for recording in problem.recordings}) == 1:
        reasons.append(
            "There is one run only: what is left out of the fit is a stretch of the same run. Record three or more."
        )
    return Offer(still, one_way, enough, reasons)


def doubts_of(problem: Problem, selection: Selection, limit: float) -> list[str]:
    """Reasons not to believe any name: the description does not fit at all, or the runs are not of one robot."""
    best = selection.best
    for term in best.hypothesis.terms:
        size = term.effect.size(problem.recordings[0].mechanism, term.amplitude)
        if size > term.effect.beyond:
            return [
                f"It would take {term.effect.name.replace('_', ' ')} beyond any robot's: cannot be told apart on this "
                f"data. {CHECK}"
            ]
        if len(term.joints) > 1 and size > term.effect.beyond_together:
            return [
                "Several arms at once would have to be far from the described geometry: cannot be told apart on this "
                f"data. {CHECK}"
            ]
    left = best.loss / problem.count
    gap = selection.none.loss / problem.count
    if left**0.5 <= max(limit, FOREIGN_LEFT) or gap - left > CARRIES_OVER * (gap - 1.0):
        return []
    if len({recording.trace for recording in problem.recordings}) > 1:
        alone = _alone(problem, selection)
        if left - alone > FOREIGN * (left - 1.0):
            return [
                "Each run fits alone, but not all together: cannot be told apart on this data. Check that all runs are "
                "of one robot with one tool, in one state."
            ]
    torque = sum(
        float(((target[rows] - np.mean(target[rows])) ** 2).sum())
        for target, rows in zip(problem.target, problem.rows, strict=True)
    )
    noise = float(np.mean(problem.sigma**2))
    share = (left * noise / (torque / problem.count)) ** 0.5
    if share > WRONG_MODEL:
        return [
            f"What is left is {100 * share:.0f} % of the torque itself, more than effects of the catalogue would "
            f"leave: cannot be told apart on this data. {CHECK}"
        ]
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
