"""How much of the torque is noise: its white level, read where the mechanism is quiet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.model.scene import Recording
from service.model.signals import NOISE_HZ

WINDOW = 128  # samples
CLIP = 3.0  # standard deviations of a window's variance


def white_noise(recordings: Sequence[Recording], residuals: Sequence[np.ndarray] | None = None) -> np.ndarray:
    """(n,) N m rms a sample, from the band above `NOISE_HZ`, where a robot does not move.

    Chatter, cogging and friction jumps reach into that band while something moves fast. So the level is taken over
    short windows and only those count that agree with the quietest. residuals: (N, n) torque less a model, where there
    is one: it is quieter. Assumes that the noise is white: a drive that filters its torque has less above than below.
    """
    signals = [r.segment.torque for r in recordings] if residuals is None else residuals
    levels = []
    freedom = 1.0
    for recording, values in zip(recordings, signals, strict=True):
        count = len(values) // WINDOW
        if not count:
            continue
        windows = values[: count * WINDOW].reshape(count, WINDOW, -1)
        taper = np.hanning(WINDOW)[:, None]
        # a straight line out of each window, so that what leaks from below does not count
        windows = windows - windows.mean(axis=1, keepdims=True)
        power = np.abs(np.fft.rfft(windows * taper, axis=1)) ** 2 / np.sum(taper**2)
        frequency = np.fft.rfftfreq(WINDOW, recording.segment.period)
        high = frequency >= min(NOISE_HZ, 0.25 / recording.segment.period)
        freedom = float(high.sum()) * 2 / 1.5  # neighbouring bins of a Hann window are correlated
        levels.append(power[:, high].mean(axis=1))
    variance = np.concatenate(levels)
    return np.sqrt(np.array([_quiet(column, freedom) for column in variance.T]))


def _quiet(levels: np.ndarray, freedom: float) -> float:
    """Mean of the windows that agree with the quietest fifth."""
    spread = np.sqrt(2.0 / freedom)
    ordered = np.sort(levels)
    mean = float(np.mean(ordered[: max(1, len(ordered) // 5)])) / (1.0 - 1.4 * spread)
    for _ in range(20):
        kept = ordered[ordered < mean * (1.0 + CLIP * spread)]
        following = float(np.mean(kept)) if len(kept) else mean
        if abs(following - mean) < 1e-6 * mean:
            break
        mean = following
    return mean
