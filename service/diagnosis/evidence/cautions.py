"""What the data cannot support, said instead of a confident name. First of all: is the base model right, is the loop
open, is the noise known?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from schemas.diagnosis import Caution, Follows
from service.diagnosis.evidence import statistics
from service.diagnosis.fit.candidates import JOINT_SHARE
from service.diagnosis.fit.selection import LEAST_GAIN, Scored, Selection
from service.identification.checks import FOREIGN_LEFT, FOREIGN_TOGETHER
from service.identification.fit import Problem, fit, solve
from service.identification.noise import Floor
from service.model.effects.base import Effect

LEAST_TIME = 3.0  # s of motion of a joint
LEAST_SHARE = 0.02  # of the time that a joint moves in its rarer direction
WRONG_MODEL = 0.10  # rms left, of the torque's own rms: a description that leaves more is wrong somewhere
CARRIES_OVER = 0.6  # of the gap above the noise that effects remove on runs left out: then they are no accident
EXCUSED = 0.95  # the same, from which effects may leave more than `WRONG_MODEL`: it is little of the gap
FOLLOWS = 0.3  # of the gap above the noise that follows what the base model lacks: then the base is wrong, not a part
BETTER = 0.2  # or leave less than this of what that leaves: a spring and a weight differ by a hundredth of a large gap
NO_WEIGHT = 0.1  # of what a spring changes by over its travel, that a weight beside it is at least
OTHER_GRAVITY = 3.0  # m/s^2 beside the description's: no base is mounted so far from level by mistake


@dataclass(frozen=True)
class SearchScope:
    """What may be looked for. still: joints that hardly move. one_way: without reversals. closed: joints whose torque
    is the controller's answer to their position error. enough: any at all."""

    still: frozenset[int]
    one_way: frozenset[int]
    closed: frozenset[int]
    enough: bool
    cautions: list[Caution]

    def allows(self, effect: Effect, joint: int) -> bool:
        """Whether `effect` may be looked for on `joint`. Where torque was not measured, nothing was done to it."""
        if effect.measured and (joint in self.closed or (self.closed and not effect.per_joint)):
            return False
        if not effect.per_joint:
            return not self.still
        return joint not in self.still and not (joint in self.one_way and effect.directional)


def limits_of(
    problem: Problem, loops: dict[int, tuple[float, float]] | None = None, units: Sequence[str] = ()
) -> SearchScope:
    """Joints at rest, joints without reversals, too little motion, a held torque. loops: gains of closed loops, by
    joint. units: of such gains, of each joint."""
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
    held = max(recording.segment.held for recording in problem.recordings)
    if held:
        cautions.append(Caution(code="torque_held", held_s=round(held, 6), advice="log_quicker"))
    for joint, (low, high) in sorted((loops or {}).items()):
        gains = {"gain": low, "gain_most": high, "gain_unit": units[joint]}
        found = {"code": "closed_loop", "joints": [joint + 1], "advice": "measure_torque"}
        cautions.append(Caution.model_validate(found | gains))
    return SearchScope(still, one_way, frozenset(loops or ()), enough, cautions)


def noise_of(floor: Floor) -> list[Caution]:
    """What there is to say of a noise floor that is not simply read."""
    cautions = []
    for code, which in (("noise_coloured", floor.coloured), ("noise_unknown", floor.unknown)):
        if which.any():
            joints = (np.flatnonzero(which) + 1).tolist()
            cautions.append(Caution.model_validate({"code": code, "joints": joints, "advice": "measure_noise"}))
    return cautions


def faults_of(selection: Selection) -> list[Caution]:
    """Said of what would have been named next and cannot be."""
    fault = selection.fault
    if fault is None:
        return []
    joints, name = [joint + 1 for joint in fault.term.joints], fault.term.effect.name
    quantity = fault.quantity or None
    return [Caution(code=fault.code, joints=joints, effect=name, quantity=quantity, advice="check_base")]


def degrees_doubted(problem: Problem, best: Scored) -> list[Caution]:
    """Whether what pulls an axis back, on which no weight is found though one may be, is a weight whose angle is in
    degrees and was taken for radians: a Delta's geometry and an arm's masses tell, an axis has nothing to hold it
    against."""
    mechanism, base, cautions = problem.recordings[0].mechanism, best.hypothesis.base, []
    if not mechanism.weighs:
        return cautions
    found = dict(zip(mechanism.coefficients, base.rigid.tolist(), strict=True))
    for term in best.hypothesis.terms:
        for place, joint in enumerate(term.joints if term.effect.is_weight_in_degrees() else ()):
            travel = max(float(np.ptp(recording.segment.theta[:, joint])) for recording in problem.recordings)
            weight = math.hypot(*(found.get(f"gravity_{part}_{joint + 1}", 0.0) for part in ("sin", "cos")))
            pull = abs(float(term.amplitude[place, 0])) * travel
            if joint in mechanism.weighs and weight < NO_WEIGHT * pull:
                effect = term.effect.name
                cautions.append(Caution(code="degrees", joints=[joint + 1], effect=effect, advice="say_degrees"))
    return cautions


def base_doubts(
    problem: Problem, before: Sequence[Follows], after: Sequence[Follows], none: Scored, best: Scored
) -> list[Caution]:
    """Whether the gap belongs to a base model that lacks something: other joints, a weight, the direction of gravity.

    before, after: what the gap follows under the base model and with the effects. However much a stand-in removes: what
    the gap follows as well without it is not its doing. A Delta's base knows its other joints, and its effects follow
    them too.
    """
    if problem.recordings[0].mechanism.closed:
        return _gravity(problem, none, best)
    levels = [statistics.rms_per_joint(problem, scored.residuals) / problem.sigma for scored in (none, best)]
    above = [np.maximum(level**2 - 1.0, 1e-9) for level in levels]
    removed = 1.0 - above[1] / above[0]
    cautions = {}
    for term in best.hypothesis.terms:
        for joint in term.joints:
            ratio = problem.recordings[0].mechanism.gear_ratio[joint]
            angles = np.concatenate([recording.segment.theta[:, joint] for recording in problem.recordings])
            if term.effect.is_weight(ratio, float(np.ptp(angles)), term.nonlinear):
                caution = Caution(
                    code="sine_of_angle", joints=[joint + 1], share=round(removed[joint], 4), advice="check_base"
                )
                cautions[caution.code, joint + 1] = caution
    for found, level, least, beaten in (
        (before, levels[0], np.maximum(removed - JOINT_SHARE, FOLLOWS), BETTER * above[0]),
        (after, levels[1], np.full(len(removed), FOLLOWS), np.zeros(len(removed))),
    ):
        for one in found:
            place = one.joint - 1
            if one.what == "position_error" or level[place] < FOREIGN_LEFT or one.share < least[place]:
                continue
            if above[1][place] < (1.0 - one.share) * beaten[place]:
                continue
            code = "other_joints" if one.what == "motion" else "sine_of_angle"
            joints = [one.joint] if one.other is None else [one.joint, one.other]
            caution = Caution(code=code, joints=joints, share=one.share, advice="check_base")
            cautions.setdefault((code, one.joint), caution)
    return list(cautions.values())


def _gravity(problem: Problem, none: Scored, best: Scored) -> list[Caution]:
    """Whether another gravity would do as well as what was found: forces, masses and tilts stand in for it. What both
    together leave is something else's."""
    gap, left = none.loss - problem.count, best.loss - problem.count
    if left >= gap:
        return []
    weights = []
    for number, scene in enumerate(problem.scenes(none.hypothesis)):
        model = scene.delta.model
        # of an m/s^2 on platform and forearms, whose mass is known, up to its sign; on the active links as is fitted
        known = [model.moving_mass * scene.at_platform(axis) for axis in np.eye(3)]
        fitted = [scene.arms.slope @ axis for axis in np.eye(3)]
        weights.append(problem.select(number, problem.band(np.stack([*known, *fitted], axis=-1))))
    change, taken = _beside(none, weights)
    rest = none.fitted.cost - taken - problem.count
    size = float(np.linalg.norm(change[-6:-3]))
    if size < OTHER_GRAVITY or rest > left + JOINT_SHARE * gap:
        return []
    _, more = _beside(best, weights)
    both = best.fitted.cost - more - problem.count
    if max(left - both, LEAST_GAIN * problem.count) < BETTER * (rest - both):
        return []
    return [Caution(code="gravity", share=round(1.0 - max(rest, 0.0) / gap, 4), advice="check_description")]


def _beside(scored: Scored, columns: Sequence[np.ndarray]) -> tuple[np.ndarray, float]:
    """Figures (F + K,) of tangents and `columns` (R, K) a recording together, and the squares that they take of what is
    left."""
    every = [np.concatenate(parts, axis=1) for parts in zip(scored.fitted.tangents, columns, strict=True)]
    moment = np.asarray(sum(c.T @ r for c, r in zip(every, scored.fitted.residuals, strict=True)))
    change = solve(np.asarray(sum(c.T @ c for c in every)), moment)
    return change, float(change @ moment)


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
    if left**0.5 <= max(limit, FOREIGN_LEFT):
        return []
    accident = gap - left <= CARRIES_OVER * (gap - 1.0)
    if accident and len({recording.trace for recording in problem.recordings}) > 1:
        alone = _alone(problem, selection)
        if left - alone > FOREIGN_TOGETHER * (left - 1.0):
            return [Caution(code="runs_differ", advice="check_runs")]
    if problem.recordings[0].mechanism.described_whole:  # what is left is opened as discrepancies
        return []
    torque = sum(
        float(((target[rows] - np.mean(target[rows])) ** 2).sum())
        for target, rows in zip(problem.target, problem.rows, strict=True)
    )
    noise = float(np.mean(problem.sigma**2))
    share = (left * noise / (torque / sum(len(joints) for joints in problem.joints_of_rows))) ** 0.5
    if share > WRONG_MODEL and gap - left <= EXCUSED * (gap - 1.0):
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
