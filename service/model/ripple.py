"""Ripple of a torque over the turns of a motor: how strong each whole order is."""

from __future__ import annotations

import numpy as np

MOST_ORDER = 500  # periods a motor turn
BINS = 4096  # a turn: eight for a period of the highest order
STANDS_OUT = 8.0  # times the middle of all orders; of noise, none of 500 in a thousand spectra


def spectrum(turns: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(MOST_ORDER + 1,) amplitude of each order of `values` (N,) at motor angles `turns` (N,), of whatever speed."""
    place = np.floor(np.mod(turns, 1.0) * BINS).astype(np.intp) % BINS
    return 2.0 / len(values) * np.abs(np.fft.rfft(np.bincount(place, values, BINS)))[: MOST_ORDER + 1]


def standing_out(turns: np.ndarray, values: np.ndarray) -> list[int]:
    """Orders far above the rest, strongest first; none where the motor makes less than a turn."""
    if len(values) < 2 or np.ptp(turns) < 1.0:
        return []
    strength = spectrum(turns, values)
    strength[0] = 0.0
    peaks = np.flatnonzero(strength > STANDS_OUT * np.median(strength))
    return sorted((int(order) for order in peaks), key=lambda order: -strength[order])
