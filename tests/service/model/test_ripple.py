"""Ripple over the turns of a motor: sines of known order and strength in noise."""

from __future__ import annotations

import numpy as np

from service.model.ripple import BINS, MOST_ORDER, spectrum, standing_out


def waves(turns: np.ndarray) -> np.ndarray:
    """1 N m at 3 periods a turn, 0.4 N m at 7, round a mean of 5 N m."""
    return 5.0 + np.sin(2 * np.pi * 3 * turns + 1.0) + 0.4 * np.cos(2 * np.pi * 7 * turns)


def test_the_spectrum_is_the_amplitude_of_each_order() -> None:
    turns = np.repeat(np.arange(4 * BINS) / BINS, 2) - 1.25  # each bin equally often, from a negative angle on
    found = spectrum(turns, waves(turns))
    assert found.shape == (MOST_ORDER + 1,)
    np.testing.assert_allclose(found[[1, 3, 7]], [0.0, 1.0, 0.4], atol=1e-9)


def test_orders_stand_out_strongest_first() -> None:
    turns = np.arange(6 * BINS) / BINS
    values = waves(turns) + np.random.default_rng(1).normal(0.0, 0.5, len(turns))
    assert standing_out(turns, values) == [3, 7], "the mean is no ripple, 0.05 N m of noise an order does not stand out"
    assert standing_out(turns[:4000], values[:4000]) == [], "less than a turn"
    assert standing_out(np.arange(2.0), np.array([1.0, -1.0])) == []
    assert standing_out(np.zeros(1), np.ones(1)) == []
