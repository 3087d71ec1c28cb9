"""What a diagnosis found; documents are made from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.axes_description import Description
from schemas.diagnosis import Caution, Follows, Verdict
from service.diagnosis.fit.selection import Scored, Selection
from service.identification.fit import Problem
from service.identification.folds import Split
from service.model.hypothesis import Hypothesis, Term


@dataclass(frozen=True)
class Findings:
    """Everything the documents need. Residuals are in units of `problem.sigma`.

    plain: the model that `identify` writes. baseline: the description given as one. reference: the model whose gap is
    "before". given: effects that the description carried already. before, after: residuals (R,) a recording on data
    left out, of the reference and of the corrected model, the latter left out of selection too. noise: (n,) N m a
    sample. commanded: whether the reported torque is the commanded one and that noise. ahead: s by which it is
    behind that and what the corrected model says of the report, None where it is not. reversal: (n,) N m in the band.
    errors: as `statistics.standard_errors` of the corrected model. limit: rms up to which what is left is noise.
    cannot_tell: what this data cannot say. follows: what the corrected model's gap still follows.
    """

    robot: Description
    problem: Problem
    split: Split
    plain: Scored
    reference: Hypothesis
    selection: Selection
    given: tuple[Term, ...]
    before: list[np.ndarray]
    after: list[np.ndarray]
    noise: np.ndarray
    commanded: bool
    ahead: float | None
    reversal: np.ndarray
    errors: np.ndarray
    verdict: Verdict
    limit: float
    cannot_tell: list[Caution]
    follows: list[Follows]
    baseline: Description | None

    @property
    def best(self) -> Scored:
        """The corrected model."""
        return self.selection.best
