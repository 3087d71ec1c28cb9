"""Noise that is correlated: torques beside a model, whose weights have a prior, as part of its covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve


@dataclass(frozen=True)
class Correlated:
    """Of covariance 1 + Z diag(prior)^-1 Z^T, in units of the noise.

    columns: (R, C) a recording, Z; none: white noise. prior: (C,) information on the weight of each, positive.

    Source: Rasmussen, Williams: Gaussian Processes for Machine Learning, 2006, appendix A.3 (the inverse).
    """

    columns: Sequence[np.ndarray]
    prior: np.ndarray

    @cached_property
    def _factor(self) -> tuple[np.ndarray, bool]:
        return cho_factor(np.asarray(sum(z.T @ z for z in self.columns)) + np.diag(self.prior))

    def weighed(self, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """The inverse covariance times (R,) or (R, K) a recording.

        Example: `sum(t.T @ w for t, w in zip(tangents, noise.weighed(tangents)))` is the Gram matrix of generalised
        least squares.
        """
        if not self.columns:
            return list(parts)
        weight = cho_solve(self._factor, np.asarray(sum(z.T @ p for z, p in zip(self.columns, parts, strict=True))))
        return [part - z @ weight for z, part in zip(self.columns, parts, strict=True)]

    def square(self, residuals: Sequence[np.ndarray]) -> float:
        """Squares of (R,) residuals a recording, as it weighs them."""
        return float(sum(r @ w for r, w in zip(residuals, self.weighed(residuals), strict=True)))


WHITE = Correlated((), np.zeros(0))
