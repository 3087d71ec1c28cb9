"""Frequency response from torque to motion: that of the machine, with its coherence, and that of models along the same
motion.

Cross and power spectral densities are means over Hann windows, half over the last each and without their means (Welch
1967), then over bins even on a logarithmic axis. A model's response is that of its torque along the measured motion, so
both are estimated alike: where they differ, the model is wrong at that frequency. In a closed loop the measured one is
right where the coherence is near 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from schemas.diagnosis import FrequencyResponse

WINDOW_S = 1.0  # of a window: tells frequencies 1 Hz apart
EDGES = np.geomspace(0.9, 0.9 * 2**10, 51)  # Hz, of the bins: five an octave
MEASURED = "measured"


@dataclass(frozen=True)
class Spectra:
    """Sums over windows in B bins, (B, n) of n joints: power of torque and speed, and their cross spectrum. count: (B,)
    lines of windows."""

    torque: np.ndarray
    speed: np.ndarray
    cross: np.ndarray
    count: np.ndarray

    def __add__(self, other: Spectra) -> Spectra:
        return Spectra(*(getattr(self, part) + getattr(other, part) for part in ("torque", "speed", "cross", "count")))

    def of(self, bins: np.ndarray) -> Spectra:
        """Of some (B,) bins."""
        return Spectra(self.torque[bins], self.speed[bins], self.cross[bins], self.count[bins])

    def response(self, joint: int) -> np.ndarray:
        """(B,) complex, rad/s per N m."""
        return self.cross[:, joint] / self.torque[:, joint]

    def coherence(self, joint: int) -> np.ndarray:
        """(B,) share of the speed's power that follows the torque linearly."""
        return np.abs(self.cross[:, joint]) ** 2 / (self.torque[:, joint] * self.speed[:, joint])


def cross_density(first: np.ndarray, second: np.ndarray, period: float, window: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (F,) Hz and one-sided cross spectral density (F, n) of values (N, n) every `period` s, over windows
    of so many samples. As SciPy's `csd`, which takes longer to import than all of this to run."""
    spectra = [_windows(values, window) for values in (first, second)]
    density = np.mean(spectra[0].conj() * spectra[1], axis=0).T * period / np.sum(_taper(window) ** 2)
    density[1 : (window + 1) // 2] *= 2.0  # of both signs of a frequency
    return np.fft.rfftfreq(window, period), density


def _taper(window: int) -> np.ndarray:
    return np.hanning(window + 1)[:-1]


def _windows(values: np.ndarray, window: int) -> np.ndarray:
    """(W, n, F) of (N, n)."""
    parts = np.lib.stride_tricks.sliding_window_view(values, window, axis=0)[:: window - window // 2]
    return np.fft.rfft((parts - parts.mean(axis=-1, keepdims=True)) * _taper(window), axis=-1)


def spectra_of(torque: np.ndarray, speed: np.ndarray, period: float) -> Spectra:
    """Of a stretch (N, n); without a whole window of zeros."""
    window, bins = round(WINDOW_S / period), len(EDGES) - 1
    shape = bins, torque.shape[1]
    if len(torque) < window:
        return Spectra(np.zeros(shape), np.zeros(shape), np.zeros(shape, complex), np.zeros(bins))
    into, out = _windows(torque, window), _windows(speed, window)
    place = np.digitize(np.fft.rfftfreq(window, period), EDGES) - 1

    def binned(power: np.ndarray) -> np.ndarray:
        total = power.sum(axis=0).T
        return np.stack([total[place == number].sum(axis=0) for number in range(bins)])

    count = len(into) * np.bincount(place[(place >= 0) & (place < bins)], minlength=bins)
    return Spectra(binned(np.abs(into) ** 2), binned(np.abs(out) ** 2), binned(into.conj() * out), count)


def responses(
    measured: Sequence[Spectra], models: Mapping[str, Sequence[Spectra]], unit: str
) -> list[FrequencyResponse]:
    """Of each joint that moves, over all stretches. models: by name, on the same stretches. unit: of the response."""
    every = {MEASURED: _summed(measured)} | {name: _summed(parts) for name, parts in models.items()}
    used = every[MEASURED].count > 0
    hertz = np.sqrt(EDGES[:-1] * EDGES[1:])[used]
    every = {name: one.of(used) for name, one in every.items()}
    moves = np.all([one.torque.all(axis=0) & one.speed.all(axis=0) for one in every.values()], axis=0)
    return [
        FrequencyResponse(
            joint=joint + 1,
            unit=unit,
            hz=_digits(hertz),
            coherence=_digits(every[MEASURED].coherence(joint)),
            magnitude={name: _digits(np.abs(one.response(joint))) for name, one in every.items()},
            phase_deg={name: _digits(np.angle(one.response(joint), deg=True)) for name, one in every.items()},
        )
        for joint in np.flatnonzero(moves).tolist()
        if used.any()
    ]


def _summed(parts: Sequence[Spectra]) -> Spectra:
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return total


def _digits(values: np.ndarray) -> list[float]:
    return [float(f"{value:.4g}") for value in values]
