"""Correlated noise against its dense covariance matrix."""

from __future__ import annotations

import numpy as np

from service.identification.correlated import WHITE, Correlated


def test_the_inverse_covariance_is_that_of_the_whole_matrix():
    random = np.random.default_rng(1)
    columns, prior = [random.standard_normal((rows, 3)) for rows in (5, 4)], np.array([0.5, 2.0, 9.0])
    parts = [random.standard_normal((rows, 2)) for rows in (5, 4)]
    whole = np.concatenate(columns)
    covariance = np.eye(9) + whole @ np.diag(1.0 / prior) @ whole.T
    found = Correlated(columns, prior).weighed(parts)
    np.testing.assert_allclose(np.concatenate(found), np.linalg.solve(covariance, np.concatenate(parts)), atol=1e-12)
    assert [part.shape for part in found] == [(5, 2), (4, 2)]
    one = Correlated(columns, prior).weighed([part[:, 0] for part in parts])
    np.testing.assert_allclose(np.concatenate(one), np.concatenate(found)[:, 0], atol=1e-12)


def test_white_noise_weighs_nothing():
    parts = [np.arange(3.0)]
    assert WHITE.weighed(parts)[0] is parts[0]
