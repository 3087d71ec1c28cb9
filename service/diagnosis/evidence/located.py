"""Where the residual sits that no effect explains: as a force on the platform that depends on its position, or as a
torque of one joint that depends on its angle or its speed.

How much each explains is measured on held-out data.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from schemas.axes_description import Description
from schemas.diagnosis import Extreme, Located
from service.diagnosis.evidence.opened import LEAST_SHARE, Beside, Pool, Tried, above
from service.diagnosis.fit.selection import Z95, Scored, score, z_score
from service.identification.fit import Problem, evaluate, solve
from service.identification.folds import Split, block_loss
from service.model.description import digits, in_units_of
from service.model.hypothesis import Hypothesis


def located(robot: Description, problem: Problem, split: Split, hypothesis: Hypothesis) -> list[Located]:
    """On what the residual of a model depends, what explains most first; further answers are given that one.

    Args:
        robot: Whose units are used.
        problem: The logs, in units of the noise.
        split: Which rows are held out together.
        hypothesis: The model whose residual it is.

    Returns:
        Nothing where the residual is noise, or depends on none of these.
    """
    best = score(evaluate(problem, hypothesis), split)
    beside, left, known = Beside(Pool(problem, split, hypothesis, told=True), best), best.residuals, []
    everything, found, total = beside.every, [], sum(float(residual @ residual) for residual in left) - problem.count
    while above(problem, left).any():
        blocks = block_loss(left, split)
        tried = beside.worth(known, everything, left)
        told = [one for one in tried if one.gains.sum() > LEAST_SHARE * total]
        if not told:
            break
        first = max(told, key=lambda one: float(one.gains.sum()))
        same = [t for t in told if len({t.process.joint, first.process.joint} - {None}) < 2]
        alike = [t for t in same if t is first or z_score(blocks - t.gains, blocks - first.gains) < Z95]
        for one in sorted(alike, key=lambda one: -float(one.gains.sum())):
            found.append(_told(robot, beside, one, total, one is not first))
        left, known = first.residuals, first.together
        everything = [one.process for one in tried if one.process.joint != first.process.joint]
    return found


def _told(robot: Description, beside: Beside, tried: Tried, total: float, alternative: bool) -> Located:
    """total: squares of all residuals above the noise. alternative: to what was told before it."""
    process, pool, problem = tried.process, beside.pool, beside.pool.problem
    assert process.discrepancy.over is not None
    weight = _weight(beside.best, pool.columns(tried.together), beside.prior[pool.of(tried.together)])
    weight = weight[-len(pool.of([process])) :].reshape(-1, process.values[0].shape[1])
    rows = [r.any(axis=1) if process.joint is None else r[:, process.joint] for r in problem.rows]
    value = np.concatenate([v[m] @ weight.T for v, m in zip(process.values, rows, strict=True)])
    place = np.concatenate([p[m] for p, m in zip(process.place, rows, strict=True)])
    if process.joint is None:
        most, unit = [int(np.argmax(np.sum(value**2, axis=1)))], "N"
    else:
        most, unit = [int(np.argmin(value[:, 0])), int(np.argmax(value[:, 0]))], "N m"
    gains = tried.gains / total
    error = Z95 * float(np.sqrt(len(gains)) * np.std(gains))
    share = float(np.clip(gains.sum(), 0.0, 1.0))
    low, high = (float(np.clip(share + way * error, 0.0, 1.0)) for way in (-1.0, 1.0))
    return Located(
        joint=None if process.joint is None else process.joint + 1, over=process.discrepancy.over,
        alternative=alternative,
        share=round(share, 4), share_ci95=(round(low, 4), round(high, 4)),
        rms=digits(np.sqrt(np.mean(np.sum((value - value.mean(axis=0)) ** 2, axis=1)))), unit=in_units_of(robot, unit),
        extremes=[
            Extreme(value=[digits(v) for v in value[one]], at=[digits(p) for p in place[one]]) for one in most
        ],
        at_unit=in_units_of(robot, process.discrepancy.unit),
    )  # fmt: skip


def _weight(best: Scored, columns: Sequence[np.ndarray], prior: np.ndarray) -> np.ndarray:
    """(C,) posterior mean on all rows, the model's parameters free."""
    own = best.fitted.moving
    both = [np.concatenate(parts, axis=1) for parts in zip(own, columns, strict=True)]
    gram = np.asarray(sum(c.T @ c for c in both))
    moment = np.asarray(sum(c.T @ r for c, r in zip(both, best.fitted.residuals, strict=True)))
    open_ = own[0].shape[1]
    gram[open_:, open_:] += np.diag(prior)
    return solve(gram, moment)[open_:]
