"""Whether what an effect explains is its own: more by far than the same torque at other times explains given it.

What no effect explains is coloured and follows the motion; how much of it an effect takes by chance, no error of the
noise says. The logs say it themselves: the torque of the effect, shifted in time within each recording, is as large and
as coloured, and is at work nowhere. Given the effect itself, it explains what chance does; more where the effect mimics
something else. Joints weigh by what model and discrepancies leave of them: a disturbance on one hides nothing of the
others, and one that a discrepancy explains hides nothing at all.

Source: Candès, Fan, Janson, Lv: Panning for gold, 2018 (a null from columns that look alike and explain nothing).
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from service.diagnosis.fit.wide import Wide
from service.identification.fit import Fit, Problem, evaluate, solve
from service.model.effects.base import Effect
from service.model.parameters import Parameters

DRAWS = 24  # of shifts: a p-value of 0.04 is the least that they tell, so the ratio to the largest is asked for
SEPARABLE = 0.1  # of an effect's energy, that discrepancies of any size have to leave of it
OWN = 100.0  # times what the best of them explains, that an effect has to
LEAST = 1e-3  # of a shifted torque's energy, that is left given the effect: less is the same again, as of a constant


def over_null(problem: Problem, fewer: Wide, best: Fit, effects: Collection[Effect], level: np.ndarray) -> float:
    """Squares that effects explain, over the most that their torque does shifted in time, given them.

    Args:
        problem: The logs, in units of the noise.
        fewer: The model without the effects, and the discrepancies that are open, their prior in units of `level`.
        best: The model with them.
        effects: Those that are asked about.
        level: (n,) rms of each joint that it leaves given the discrepancies, in units of the noise.

    Returns:
        `inf` where no shift makes another torque of it; 0 where discrepancies explain nearly all of its torque, so that
        the logs do not separate it from them.
    """
    torque = _torques(problem, best, effects)
    random = np.random.default_rng(0)
    count = torque[0].shape[1]
    parts = [
        torque,
        *(_shifted(problem, torque, random) for _ in range(DRAWS)),
        [r[:, None] for r in fewer.fit.residuals],
    ]
    units = [level[joints, None] for joints in problem.joints_of_rows]
    columns = [np.concatenate(each, axis=1) / unit for *each, unit in zip(*parts, units, strict=True)]
    known = [k / unit for k, unit in zip(fewer.fit.moving, units, strict=True)]
    gram = np.asarray(sum(k.T @ k for k in known)) + fewer.prior
    cross = np.asarray(sum(k.T @ c for k, c in zip(known, columns, strict=True)))
    square = np.asarray(sum(c.T @ c for c in columns)) - cross.T @ solve(gram, cross)
    own = slice(0, count)
    torques = [part[:, :count] for part in columns]
    model = np.diag(fewer.prior) == 0.0
    if _energy(known, torques) < SEPARABLE * _energy([k[:, model] for k in known], torques):
        return 0.0
    taken = _explained(square[own, own], square[own, -1])
    given = square - square[:, own] @ solve(square[own, own], square[own])
    told = np.diag(given) > LEAST * np.diag(square)
    largest = 0.0
    for draw in range(1, DRAWS + 1):
        mine = draw * count + np.flatnonzero(told[draw * count : (draw + 1) * count])
        largest = max(largest, _explained(given[np.ix_(mine, mine)], given[mine, -1]))
    return taken / largest if largest > 0 else float("inf") if taken > 0 else 0.0


def _energy(known: list[np.ndarray], torques: list[np.ndarray]) -> float:
    """Of torques (R, K) a recording, that columns (R, P) do not explain."""
    gram = np.asarray(sum(k.T @ k for k in known))
    cross = np.asarray(sum(k.T @ t for k, t in zip(known, torques, strict=True)))
    return sum(float(np.sum(t**2)) for t in torques) - float(np.sum(cross * solve(gram, cross)))


def _explained(gram: np.ndarray, moment: np.ndarray) -> float:
    return float(moment @ solve(gram, moment))


def _torques(problem: Problem, best: Fit, effects: Collection[Effect]) -> list[np.ndarray]:
    """(R, K) a recording, in units of the noise: torque of each amplitude of the effects; of one without amplitudes,
    that it has."""
    parameters, chosen = Parameters(best.hypothesis), np.zeros(len(best.free), bool)
    whole = []
    for term, places in zip(best.hypothesis.terms, parameters.terms, strict=True):
        if term.effect in effects and term.amplitude.size:
            chosen[parameters.among_free(slice(places.start, places.start + term.amplitude.size))] = True
        elif term.effect in effects:
            whole.append(term)
    parts = [[tangent[:, chosen] for tangent in best.tangents]]
    for term in whole:
        rest = tuple(other for other in best.hypothesis.terms if other is not term)
        without = evaluate(problem, best.hypothesis.carrying(rest)).residuals
        parts.append([(before - after)[:, None] for before, after in zip(without, best.residuals, strict=True)])
    return [np.concatenate(each, axis=1) for each in zip(*parts, strict=True)]


def _shifted(problem: Problem, torque: list[np.ndarray], random: np.random.Generator) -> list[np.ndarray]:
    """Torque (R, K) a recording as if each had begun elsewhere in it, its end put before its start."""
    result = []
    for rows, values in zip(problem.rows, torque, strict=True):
        whole = np.zeros((*rows.shape, values.shape[1]))
        whole.swapaxes(0, 1)[rows.T] = values
        late = np.roll(whole, round(random.uniform(0.1, 0.9) * len(whole)), axis=0)
        result.append(late.swapaxes(0, 1)[rows.T])
    return result
