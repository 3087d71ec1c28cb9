"""An effect that all joints have alike: drives of one kind share a torque constant or a gear ratio that is wrong.

On every joint an effect is fitted with figures of its own, which cost it against one that has a single figure for the
whole robot. Where the joints' figures have one cause, it is a single figure too.
"""

from __future__ import annotations

import numpy as np

from service.diagnosis.fit.selection import Scored, score
from service.identification.fit import Fit
from service.identification.folds import Split
from service.model.parameters import Parameters


def in_common(scored: Scored, number: int, split: Split) -> Scored | None:
    """The hypothesis with one figure on all joints for its effect `number`, as far as slopes say; None where that sits
    on fewer, or has several figures a joint."""
    fitted, hypothesis = scored.fitted, scored.hypothesis
    term = hypothesis.terms[number]
    if len(term.joints) < 2 or term.nonlinear or term.amplitude.shape[1] != 1:
        return None
    if len(term.joints) < len(hypothesis.base.viscous):
        return None
    parameters = Parameters(hypothesis)
    mine = parameters.columns(number)
    first, others = mine[0], mine[1:]
    values = parameters.values[parameters.free]
    change = np.zeros(len(values))
    change[mine] = values[mine].mean() - values[mine]

    def kept(array: np.ndarray) -> np.ndarray:
        return np.delete(array, others, axis=-1)

    tangents = []
    for tangent in fitted.tangents:
        summed = tangent.copy()
        summed[:, first] = tangent[:, mine].sum(axis=1)
        tangents.append(kept(summed))
    residuals = [r - t @ change for r, t in zip(fitted.residuals, fitted.tangents, strict=True)]
    inside, free = fitted.inside.copy(), fitted.free.copy()
    inside[first], free[first] = inside[mine].any(), free[mine].any()  # between its limits where one of them is
    low, high = (kept(reach - change) for reach in fitted.reach)
    _, shared = Fit(hypothesis, residuals, tangents, kept(inside), kept(free), (low, high)).stepped()
    return score(shared, split)
