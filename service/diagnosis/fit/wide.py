"""A fit with columns beside the model's own parameters: discrepancies, whose weights have a prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.identification.fit import Fit
from service.identification.folds import Split, held_out


@dataclass(frozen=True)
class Wide:
    """fit: tangents of the model's free parameters, then of the columns. prior: (P, P) information on their steps."""

    fit: Fit
    prior: np.ndarray

    @classmethod
    def of(cls, fitted: Fit, columns: Sequence[np.ndarray], prior: np.ndarray | float) -> Wide:
        """columns: (R, K) a recording. prior: information on the weight of each."""
        own, opened = fitted.moving[0].shape[1], columns[0].shape[1]
        low, high = (reach[fitted.free] for reach in fitted.reach)
        free, far = np.ones(own + opened, bool), np.full(opened, np.inf)
        wide = replace(
            fitted,
            tangents=[np.concatenate(parts, axis=1) for parts in zip(fitted.moving, columns, strict=True)],
            inside=free,
            free=free,
            reach=(np.append(low, -far), np.append(high, far)),
        )
        return cls(wide, np.diag(np.r_[np.zeros(own), np.broadcast_to(prior, opened)]))

    def left(self) -> list[np.ndarray]:
        """Residuals (R,) a recording, of a step on all rows."""
        moving = self.fit.moving
        gram = np.asarray(sum(t.T @ t for t in moving)) + self.prior
        moment = np.asarray(sum(t.T @ r for t, r in zip(moving, self.fit.residuals, strict=True)))
        step = self.fit.step(gram, moment)
        return [r - t @ step for r, t in zip(self.fit.residuals, moving, strict=True)]

    def held_out(self, split: Split) -> list[np.ndarray]:
        """Residuals (R,) a recording on held-out data."""
        return held_out(self.fit, split, prior=self.prior)
