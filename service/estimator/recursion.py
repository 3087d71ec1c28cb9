"""The paper's payload recursion, for comparison: recursive least squares at a fixed forgetting factor.

    y = -A inv(K) dT = m_p X,   X = p_ddot + (0, 0, g),   three rows a sample, one scalar m_p
    m_p <- m_p + k (y - X m_p)

with the sign and the scalar of `service.model` (the paper prints a minus and a 3 x 3 unknown).
"""

from __future__ import annotations

import numpy as np

from schemas.kernels import kernel

FORGETTING = 0.99  # a sample at 1 kHz: a memory of a tenth of a second
FIRST_COVARIANCE = 1e3  # kg^2


@kernel
def fixed_forgetting(y: np.ndarray, x: np.ndarray, forgetting: float) -> np.ndarray:
    """m_p (N,) kg after each sample. y: (N, 3) N, x: (N, 3) m/s^2; a row of NaN changes nothing."""
    mass, covariance = 0.0, FIRST_COVARIANCE
    result = np.empty(len(y))
    for n in range(len(y)):
        if np.isfinite(y[n]).all():
            covariance /= forgetting
            for axis in range(3):  # one scalar row at a time: the same as the vector form
                gain = covariance * x[n, axis] / (1.0 + covariance * x[n, axis] ** 2)
                mass += gain * (y[n, axis] - x[n, axis] * mass)
                covariance *= 1.0 - gain * x[n, axis]
        result[n] = mass
    return result
