"""How much of the torque is noise: its level, read where the mechanism is quiet, and its colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from service.model.scene import Recording
from service.model.signals import NOISE_HZ, Band

WINDOW = 128  # samples
RESOLVED = 16  # bins of the analysis band, in the windows in which noise is read inside it
CLIP = 3.0  # standard deviations of a window's variance
BANDS = 5  # between the analysis band and half the sample rate, in which the colour is read
COLOURED = 1.25  # rms of the lowest of these over the highest: white noise on robots of all kinds stays below 1.1
MEMORY = 4.0  # most that the density may rise further below the lowest of them: beyond, the colour is not known
ROUNDING = 1e-9  # of a signal: less is none
LEAST_SHARE = 1e-3  # of the torque's rms in the band: no drive measures better than that
UNKNOWN_SHARE = 1e-2  # the same where noise cannot be read at all: no model of a machine is better than that


@dataclass(frozen=True)
class Floor:
    """Noise of n joints, N m rms. sample: of one sample. band: of it in the analysis band.

    coloured: read from its colour, with more in the band than white noise has; unknown: smoothed, computed or constant
    torque, of which the floor is a guess (`UNKNOWN_SHARE`). Both (n,) bool.
    """

    sample: np.ndarray
    band: np.ndarray
    coloured: np.ndarray
    unknown: np.ndarray


def floor(recordings: Sequence[Recording], residuals: Sequence[np.ndarray], band: Band) -> Floor:
    """The noise floor of `recordings`. residuals: (N, n) N m of a first fit; the torque itself may be quieter."""
    white = np.minimum(white_noise(recordings), white_noise(recordings, residuals))
    step = _steps(recordings) / 12**0.5
    sample = np.maximum(white, step)
    torques = [recording.segment.torque for recording in recordings]
    levels = np.minimum(_profile(recordings, torques, band), _profile(recordings, residuals, band))
    torque = np.concatenate([band(recording.segment.torque) for recording in recordings]).std(axis=0)
    share = band.white_share**0.5
    rms = sample * share
    coloured = levels[:, 0] > COLOURED * np.maximum(levels[:, -1], step)
    known = np.ones(len(rms), bool)
    if coloured.any():
        inside, known[coloured] = _extrapolated(levels[coloured], band)
        rms[coloured] = np.where(known[coloured], np.maximum(rms[coloured], inside), rms[coloured])
    unknown = ~known | (rms < LEAST_SHARE * torque)
    rms = np.maximum(rms, np.where(unknown, UNKNOWN_SHARE, LEAST_SHARE) * torque)
    return Floor(np.maximum(sample, 1e-9), np.maximum(rms, 1e-9), coloured & ~unknown, unknown)


def refined(recordings: Sequence[Recording], residuals: Sequence[np.ndarray], known: Floor, band: Band) -> Floor:
    """The floor read inside the analysis band, from the windows in which the best model leaves least.

    residuals: (N, n) N m of the best model that there is. Any structure in them makes the reading too high, so it is
    limited by the noise just above the band. Where noise was taken as white: by its level there, which noise of first
    order exceeds inside the band. Where the level inside was extrapolated or guessed: by `MEMORY` times its density,
    the most that noise of first order may rise by. A reading below a guess does not replace the guess.
    """
    length = round(RESOLVED / (band.cutoff_hz * band.period))
    inside = _levels(recordings, residuals, [(2 * band.cutoff_hz / RESOLVED, band.cutoff_hz)], length)[:, 0]
    above = _profile(recordings, residuals, band)[:, 0]
    share = band.white_share**0.5
    level, flagged = inside * share, known.coloured | known.unknown
    read = (known.coloured | (known.unknown & (level > known.band))) & (inside < MEMORY**0.5 * above)
    white = np.maximum(known.band, np.minimum(inside, above) * share)
    found = np.where(read, level, np.where(flagged, known.band, white))
    return Floor(known.sample, found, known.coloured | read, known.unknown & ~read)


def white_noise(recordings: Sequence[Recording], residuals: Sequence[np.ndarray] | None = None) -> np.ndarray:
    """(n,) N m rms a sample, from the band above `NOISE_HZ`, where a robot does not move.

    Chatter, cogging and friction jumps reach into that band while something moves fast. So the level is taken over
    short windows and only those count that agree with the quietest. residuals: (N, n) torque less a model, where there
    is one: it is quieter. Assumes that the noise is white: a drive that filters its torque has less above than below.
    """
    signals = [r.segment.torque for r in recordings] if residuals is None else residuals
    period = recordings[0].segment.period
    return _levels(recordings, signals, [(min(NOISE_HZ, 0.25 / period), np.inf)])[:, 0]


def _profile(recordings: Sequence[Recording], residuals: Sequence[np.ndarray], band: Band) -> np.ndarray:
    """(n, BANDS) rms a sample that white noise of the density in each band above the analysis band would have."""
    return _levels(recordings, residuals, list(pairwise(_edges(band))))


def _edges(band: Band) -> np.ndarray:
    return np.geomspace(1.2 * band.cutoff_hz, 0.5 / band.period, BANDS + 1)


def _levels(
    recordings: Sequence[Recording], signals: Sequence[np.ndarray], bands: Sequence[tuple[float, float]],
    window: int = WINDOW,
) -> np.ndarray:  # fmt: skip
    """(n, bands) rms a sample in each band of frequencies, Hz, of the windows that agree with the quietest."""
    powers, frequency = [], np.zeros(0)
    for recording, values in zip(recordings, signals, strict=True):
        count = len(values) // window
        if not count:
            continue
        windows = values[: count * window].reshape(count, window, -1)
        taper = np.hanning(window)[:, None]
        # the mean out of each window, so that what leaks from below does not count
        windows = windows - windows.mean(axis=1, keepdims=True)
        powers.append(np.abs(np.fft.rfft(windows * taper, axis=1)) ** 2 / np.sum(taper**2))
        frequency = np.fft.rfftfreq(window, recording.segment.period)
    if not powers:
        return np.zeros((signals[0].shape[1], len(bands)))
    power, result = np.concatenate(powers), []
    for low, high in bands:
        inside = (frequency >= low) & (frequency < high)
        freedom = float(inside.sum()) * 2 / 1.5  # neighbouring bins of a Hann window are correlated
        result.append([_quiet(column, freedom) for column in power[:, inside].mean(axis=1).T])
    return np.sqrt(np.array(result).T)


def _extrapolated(levels: np.ndarray, band: Band) -> tuple[np.ndarray, np.ndarray]:
    """Rms (m,) in the analysis band of noise with these levels (m, BANDS) above it, white and of first order together;
    and whether the levels say what is below them, (m,) bool.

    The drives of a machine are of one kind, so the corner is that of all: it is what the levels of one tell least.
    """
    told = levels.min(axis=1) > ROUNDING * levels.max(axis=1)  # a torque that stood at its limit tells nothing
    result = np.zeros(len(levels)), told.copy()
    if told.any():
        result[0][told], result[1][told] = _coloured(levels[told], band)
    return result


def _coloured(levels: np.ndarray, band: Band) -> tuple[np.ndarray, np.ndarray]:
    """`_extrapolated` of levels none of which is zero."""
    middle = np.sqrt(np.array([low * high for low, high in pairwise(_edges(band))]))
    corners, densities = np.geomspace(0.2 * band.cutoff_hz, 0.5 / band.period, 60), levels**2
    falling = 1.0 / (1.0 + (middle / corners[:, None]) ** 2)
    shapes = np.stack([np.ones_like(falling), falling], axis=-1)
    every, left = _weights(shapes[:, None] / densities[..., None])
    best = np.argmin(left.sum(axis=1))
    frequency, passed = band.passes
    inside = every[best, :, :1] + every[best, :, 1:] / (1.0 + (frequency / corners[best]) ** 2)
    return np.sqrt(np.mean(inside * passed, axis=1)), inside[:, 0] < MEMORY * densities[:, 0]


def _weights(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(..., 2) weights of two positive columns (..., B, 2), none negative, with which they come nearest to ones; and
    (...) squares that they leave."""
    gram, moment = columns.swapaxes(-2, -1) @ columns, columns.sum(axis=-2)
    both = np.linalg.solve(gram, moment[..., None])[..., 0]
    each = moment[..., None] / np.diagonal(gram, axis1=-2, axis2=-1)[..., None] * np.eye(2)  # one of them alone
    tried = np.stack([np.where((both < 0).any(axis=-1, keepdims=True), 0.0, both), each[..., 0, :], each[..., 1, :]])
    left = np.sum(((columns @ tried[..., None])[..., 0] - 1.0) ** 2, axis=-1)
    best = np.argmin(left, axis=0)[None]
    return np.take_along_axis(tried, best[..., None], 0)[0], np.take_along_axis(left, best, 0)[0]


def _steps(recordings: Sequence[Recording]) -> np.ndarray:
    """(n,) N m between neighbouring values of the torque, where it comes in steps."""
    torque = np.concatenate([recording.segment.torque for recording in recordings])
    steps = []
    for column in torque.T:
        values = np.unique(column)
        apart = np.diff(values)
        apart = apart[apart > ROUNDING * np.ptp(values)]
        steps.append(float(apart.min()) if 0 < len(apart) < 0.2 * len(column) else 0.0)
    return np.array(steps)


def _quiet(levels: np.ndarray, freedom: float) -> float:
    """Mean of the windows that agree with the quietest fifth."""
    spread = np.sqrt(2.0 / freedom)
    ordered = np.sort(levels)
    mean = float(np.mean(ordered[: max(1, len(ordered) // 5)])) / max(1.0 - 1.4 * spread, 0.1)
    for _ in range(20):
        kept = ordered[ordered < mean * (1.0 + CLIP * spread)]
        mean = float(np.mean(kept)) if len(kept) else mean
    return mean
