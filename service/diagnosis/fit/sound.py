"""What a fitted effect must not be: at the end of what was searched, or friction that drives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from service.identification.fit import Problem
from service.model.coulomb_viscous import direction
from service.model.hypothesis import Hypothesis, Term

ALIKE = 0.8  # of the variance of one curve that another has, from which they may be one
FALLS = 0.5  # of a friction above Coulomb's, by which friction has to be less at higher speed
SPEEDS = np.geomspace(1e-4, 1e2, 400)  # rad/s, at which that is looked at
AT_LIMIT = 1e-6  # of a nonlinear parameter's range: so near to its end it stands there


@dataclass(frozen=True)
class Fault:
    """Why an effect at work in a hypothesis cannot be. quantity: the one at its limit."""

    code: Literal["at_limit", "drives", "beyond_any_robot", "by_weight", "does_not_fall"]
    term: Term
    quantity: str = ""


def fault_of(problem: Problem, hypothesis: Hypothesis, given: int) -> Fault | None:
    """The first effect of `hypothesis` beyond the `given` ones that cannot be what it is called, None if all can."""
    mechanism = problem.recordings[0].mechanism
    for term in hypothesis.terms[given:]:
        # of a closed chain it says that the geometry is wrong, and with it all that was found before
        if not mechanism.closed and term.effect.size(mechanism, term.amplitude) > term.effect.beyond:
            return Fault("beyond_any_robot", term)
        if not mechanism.closed and any(_by_weight(problem, hypothesis, term, joint) for joint in term.joints):
            return Fault("by_weight", term)
        if any(_nothing_of(term, place) for place in range(len(term.amplitude))):
            return Fault("at_limit", term, next(iter(term.effect.amplitudes)))
        above = term.effect.above_coulomb(SPEEDS, term.nonlinear)
        if above is not None:
            if any(_frictionless(hypothesis, joint) for joint in term.joints):
                return Fault("at_limit", term, "coulomb_friction")
            if not all(_falls(hypothesis, term, place, above) for place in range(len(term.joints))):
                return Fault("does_not_fall", term)
        for (name, searched), value in zip(term.effect.nonlinear.items(), term.nonlinear, strict=True):
            near = AT_LIMIT * (searched.high - searched.low)
            at_end = min(value - searched.low, searched.high - value) <= near
            if at_end and not searched.fixed and not searched.minor:
                return Fault("at_limit", term, name)
    rubbing = [term for term in hypothesis.terms if term.effect.dissipates]
    for term in hypothesis.terms[given:] if rubbing else ():
        if term.effect.dissipates and any(_drives(problem, hypothesis, rubbing, joint) for joint in term.joints):
            return Fault("drives", term)
    return None


def _by_weight(problem: Problem, hypothesis: Hypothesis, term: Term, joint: int) -> bool:
    """Whether friction goes by the angle of a joint as that by its weight would, which changes at least as much."""
    scenes = [hypothesis.seen(recording) for recording in problem.recordings]
    angles = np.concatenate([scene.segment.theta[:, joint] for scene in scenes])
    if not term.effect.goes_by_load(float(np.ptp(angles)), term.nonlinear):
        return False
    amplitude = term.amplitude[term.joints.index(joint)]
    columns = [term.effect.regressors(scene, joint, term.nonlinear) @ amplitude for scene in scenes]
    friction = np.concatenate([c * scene.direction[:, joint] for c, scene in zip(columns, scenes, strict=True)])
    weight = np.concatenate([np.abs(scene.weight[:, joint]) for scene in scenes])
    if np.ptp(weight) < np.abs(amplitude).max():
        return False
    return bool(np.corrcoef(friction, weight)[0, 1] > ALIKE**0.5)


def _frictionless(hypothesis: Hypothesis, joint: int) -> bool:
    """Whether none is left of the base model's friction, as where a lag of the command looks like less than none."""
    return not hypothesis.base.coulomb[joint] > 0 and not hypothesis.base.viscous[joint] > 0


def _falls(hypothesis: Hypothesis, term: Term, place: int, above: np.ndarray) -> bool:
    """Whether dry friction falls from where it is most by enough of what is above Coulomb's. Where it rises all the
    way it levels off over other speeds than the base model has it. above: share at `SPEEDS`."""
    joint, base, size = term.joints[place], hypothesis.base, term.amplitude[place, 0]
    transition = np.broadcast_to(base.transition, base.coulomb.shape)[joint]
    turned = np.array([direction(speed, transition) for speed in SPEEDS])
    dry = turned * (base.coulomb[joint] + size * above)
    return bool(dry.max() - base.coulomb[joint] >= FALLS * size)


def _nothing_of(term: Term, place: int) -> bool:
    """Whether none is left of an effect on one of its places: all that cannot be less than a limit stands there."""
    low = np.array([amplitude.low for amplitude in term.effect.amplitudes.values()])
    bounded = np.isfinite(low)
    return bool(bounded.any() and (term.amplitude[place, bounded] <= low[bounded]).all())


def _drives(problem: Problem, hypothesis: Hypothesis, rubbing: list[Term], joint: int) -> bool:
    """Whether friction of `joint` puts energy into its motion, in the mean over one direction."""
    work = np.zeros(2)
    for scene in (hypothesis.seen(recording) for recording in problem.recordings):
        speed = scene.segment.theta_dot[:, joint]
        torque = hypothesis.base.viscous[joint] * speed + hypothesis.base.coulomb[joint] * scene.direction[:, joint]
        for term in rubbing:
            for place, other in enumerate(term.joints):
                if other == joint:
                    torque = torque + term.effect.torque(scene, joint, term.amplitude[place], term.nonlinear)[:, joint]
        power = torque * speed * scene.segment.moving[:, joint]
        work += power[speed > 0].sum(), power[speed < 0].sum()
    return bool((work < 0).any())
