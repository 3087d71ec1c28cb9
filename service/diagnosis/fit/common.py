"""An effect that all joints have alike: drives of one kind share a torque constant or a gear ratio that is wrong.

On every joint an effect is fitted with figures of its own, which cost it against one that has a single figure for the
whole robot. Where the joints' figures have one cause, it is a single figure too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.diagnosis.fit.selection import Scored, score
from service.identification.fit import Fit, solve
from service.identification.folds import Split
from service.model.parameters import Parameters


def in_common(scored: Scored, split: Split) -> Scored | None:
    """The hypothesis with one figure on all joints for the effect that it was given last, as far as slopes say; None
    where that sits on fewer, or has several figures a joint."""
    fitted, hypothesis = scored.fitted, scored.hypothesis
    term = hypothesis.terms[-1]
    if len(term.joints) < 2 or term.nonlinear or term.amplitude.shape[1] != 1:
        return None
    if len(term.joints) < len(hypothesis.base.viscous):
        return None
    parameters = Parameters(hypothesis)
    mine = parameters.among_free(parameters.terms[-1])
    first, others = mine[0], mine[1:]
    values = parameters.values[parameters.free]
    change = np.zeros(len(values))
    change[mine] = values[mine].mean() - values[mine]

    def kept(array: np.ndarray) -> np.ndarray:
        return np.delete(array, others, axis=-1)

    tangents = []
    for tangent in fitted.tangents:
        shared = tangent.copy()
        shared[:, first] = tangent[:, mine].sum(axis=1)
        tangents.append(kept(shared))
    residuals = [r - t @ change for r, t in zip(fitted.residuals, fitted.tangents, strict=True)]
    low, high = (kept(limit) for limit in fitted.reach)
    begun = Fit(hypothesis, residuals, tangents, kept(fitted.inside), kept(fitted.free), (low, high))
    gram = np.asarray(sum(t.T @ t for t in begun.moving))
    moment = np.asarray(sum(t.T @ r for t, r in zip(begun.moving, begun.residuals, strict=True)))
    step = solve(gram, moment)
    settled = [r - t @ step for r, t in zip(begun.residuals, begun.moving, strict=True)]
    return score(replace(begun, residuals=settled), split)
