"""The base model where nothing is looked for beside it: what `identify` fits to axes and arms.

It has to predict other logs. So each joint weighs by what is typically left on it, which on a real machine is the
model's own error rather than noise. Friction turns over a wide range of speeds only where data left out gain by it:
there it has the shape to take the place of other friction. What the model says of fast motion is cut off where data
left out are predicted better without it, and slow rows are masked where they are predicted better by the others. The
masses of an arm are drawn towards those of its URDF as far as data left out gain by that.

Source: Gautier, Dynamic identification of robots with power model, 1997 (doi 10.1109/ROBOT.1997.619069), for weights by
what a first fit leaves of each joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from service.identification import fit as solver
from service.identification.fit import Fit, Problem
from service.identification.folds import Split, block_loss, gains, held_out, predicts
from service.model.hypothesis import Hypothesis
from service.model.parameters import TRANSITION, WIDE_TRANSITION, Parameters
from service.model.signals import LEAST_HZ, LEVER, NARROWER

REWEIGHED = 2  # times: weights move the parameters, and so what is left
# Of an axis' rms speed: a recorder's filter leaves so much beside a stop, where friction is not what it is in motion
SLOW = 0.03
NORMAL = 0.6745  # median size of normally distributed residuals, in standard deviations
# Weight of the squared torque of each coefficient's step away from the URDF, over that of squared residuals
DRAWN = (0.01, 0.1, 1.0)


def refined(problem: Problem, fitted: Fit) -> tuple[Problem, Fit, float]:
    """The problem as its joints weigh in the end, the fit to it, and how far masses are drawn to those described, in
    terms of `DRAWN`; 0: not at all. fitted: the base model by the weights of `problem`."""
    fitted, weighed = narrowed(problem, fitted), problem
    for _ in range(REWEIGHED):
        weighed = by_what_is_left(problem, fitted.hypothesis)
        fitted = solver.fit(weighed, fitted.hypothesis)
    weighed, fitted = without_slow(weighed, fitted)
    fitted = in_band(weighed, fitted)
    return weighed, fitted, drawn(weighed, fitted)


def in_band(problem: Problem, fitted: Fit) -> Fit:
    """Refitted with the model cut off where it says nothing right any more: above, an encoder's noise is more than the
    motion, links bend or gears have play, or the recorder has filtered torque and motion alike."""
    split, base = Split.of(problem), fitted.hypothesis.base
    widest = least = block_loss(held_out(fitted, split), split)
    best, cutoff = np.inf, problem.band.cutoff_hz / NARROWER
    while cutoff >= LEAST_HZ:
        cut = solver.evaluate(problem, replace(fitted.hypothesis, base=replace(base, band_hz=cutoff)))
        loss = block_loss(held_out(cut, split), split)
        if loss.sum() >= least.sum():
            break
        best, least, cutoff = cutoff, loss, cutoff / NARROWER
    if not predicts(widest, least):
        return fitted
    return solver.fit(problem, replace(fitted.hypothesis, base=replace(base, band_hz=best)))


def without_slow(problem: Problem, fitted: Fit) -> tuple[Problem, Fit]:
    """The problem without the rows in which an axis is nearly at rest, and the fit to it, where the others predict all
    data left out better than all do."""
    speeds = [np.abs(recording.segment.theta_dot[:: problem.band.step]) for recording in problem.recordings]
    square = sum((speed**2 * rows).sum(axis=0) for speed, rows in zip(speeds, problem.rows, strict=True))
    count = sum(rows.sum(axis=0) for rows in problem.rows)
    fast = SLOW * np.sqrt(square / np.maximum(count, 1))
    rows = [mine & (speed > fast) for mine, speed in zip(problem.rows, speeds, strict=True)]
    masked, split = replace(problem, rows=rows), Split.of(problem)
    learnt = solver.evaluate(masked, fitted.hypothesis), Split.of(masked)
    all_rows, others = (block_loss(held_out(fitted, split, source), split) for source in (None, learnt))
    if not predicts(all_rows, others):
        return problem, fitted
    masked = by_what_is_left(masked, fitted.hypothesis)
    return masked, solver.fit(masked, fitted.hypothesis)


def narrowed(problem: Problem, fitted: Fit) -> Fit:
    """Refitted with narrow transitions of friction, but for those that data left out want wide."""
    base, mechanism = fitted.hypothesis.base, problem.recordings[0].mechanism
    narrow = TRANSITION[1] * (1.0 if problem.recordings[0].segment.angular else LEVER)
    wide = np.asarray(base.transition) > narrow
    if not wide.any():
        return fitted
    split = Split.of(problem)
    held = _within(problem, fitted, np.full(len(wide), narrow))
    kept, lost = (_by_joint(problem, split, held_out(one, split)) for one in (fitted, held))
    wanted = [gains(lost[:, row != 0].sum(axis=1), kept[:, row != 0].sum(axis=1)) for row in mechanism.rows]
    if not (wide & wanted).any():
        return held
    return _within(problem, fitted, np.where(wide & wanted, WIDE_TRANSITION, narrow))


def _within(problem: Problem, fitted: Fit, widest: np.ndarray) -> Fit:
    """Refitted with transitions of at most `widest` (F,)."""
    base = fitted.hypothesis.base
    base = replace(base, transition=np.minimum(base.transition, widest), widest=widest)
    return solver.fit(problem, replace(fitted.hypothesis, base=base))


def _by_joint(problem: Problem, split: Split, residuals: Sequence[np.ndarray]) -> np.ndarray:
    """(blocks, n) sums of squares."""
    joints = problem.joints_of_rows
    each = [
        block_loss([np.where(mine == joint, r, 0.0) for mine, r in zip(joints, residuals, strict=True)], split)
        for joint in range(len(problem.sigma))
    ]
    return np.stack(each, axis=1)


def by_what_is_left(problem: Problem, hypothesis: Hypothesis) -> Problem:
    """Each joint weighed by what a hypothesis typically leaves on it, as if that were the rms of its noise: by an rms a
    few stops, in which friction is anything, would hide what the joint says in motion."""
    residuals = solver.evaluate(problem, hypothesis).residuals
    size, mine = np.abs(np.concatenate(residuals)), np.concatenate(problem.joints_of_rows)
    left = [np.median(size[mine == joint]) if (mine == joint).any() else 0.0 for joint in range(len(problem.sigma))]
    share = 1.0 / np.maximum(np.array(left) / NORMAL, 1.0)
    return replace(problem, weights=[np.broadcast_to(share, target.shape) for target in problem.target])


def drawn(problem: Problem, fitted: Fit) -> float:
    """How far masses are best drawn to those described."""
    mechanism, parameters = problem.recordings[0].mechanism, Parameters(fitted.hypothesis)
    links, split = mechanism.links, Split.of(problem)
    if not links.any():
        return 0.0
    change = np.zeros(fitted.tangents[0].shape[1])
    change[: len(links)] = np.where(links, mechanism.start - parameters.values[: len(links)], 0.0)
    described = replace(
        fitted, residuals=[r - t @ change for r, t in zip(fitted.residuals, fitted.tangents, strict=True)]
    )
    square = np.asarray(sum((t**2).sum(axis=0) for t in fitted.moving))
    pull = np.diag(square * np.pad(links, (0, len(square) - len(links))))
    best, least = 0.0, block_loss(held_out(fitted, split), split)
    for share in DRAWN:
        loss = block_loss(held_out(described, split, prior=share * pull), split)
        if gains(least, loss):
            best, least = share, loss
    return best
