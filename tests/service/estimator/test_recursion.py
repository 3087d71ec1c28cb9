"""The paper's recursion against the weighted least squares that it stands for."""

import numpy as np

from service.estimator.recursion import FIRST_COVARIANCE, fixed_forgetting


def test_the_recursion_is_least_squares_with_weights_that_fade():
    """sum w x'y / (sum w x'x + what is left of the prior), a row that is not there with no weight and no fading."""
    random, forgetting, mass = np.random.default_rng(0), 0.97, 1.7
    x = random.standard_normal((60, 3))
    y = mass * x + 0.2 * random.standard_normal((60, 3))
    there = np.ones(60, bool)
    there[[0, 20, 21]] = False
    y[20], y[21, 1], y[0, 2] = np.nan, np.nan, np.inf
    found = fixed_forgetting(y, x, forgetting)
    for n in range(60):
        rows = np.flatnonzero(there[: n + 1])
        weight = forgetting ** np.arange(len(rows))[::-1]
        information = forgetting ** len(rows) / FIRST_COVARIANCE + weight @ np.sum(x[rows] ** 2, axis=1)
        expected = weight @ np.sum(x[rows] * y[rows], axis=1) / information
        np.testing.assert_allclose(found[n], expected, rtol=1e-9, atol=1e-12)
