"""Motion of known angle, speed and acceleration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def sines(seed: int, time: np.ndarray, parts: Sequence[tuple[float, float]]) -> list[np.ndarray]:
    """Angle, speed and acceleration (N, 3) of three joints. parts: size rad and, a quarter up or down, Hz of each."""
    random = np.random.default_rng(seed)
    signals = [np.zeros((len(time), 3)) for _ in range(3)]
    for joint in range(3):
        for size, hertz in parts:
            rate = 2 * np.pi * hertz * random.uniform(0.8, 1.25)
            wave = size * np.exp(1j * (rate * time + random.uniform(0, 6)))
            for order, signal in enumerate(signals):
                signal[:, joint] += ((1j * rate) ** order * wave).imag
    return signals
