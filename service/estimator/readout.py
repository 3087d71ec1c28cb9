"""From the torque that a drive reports to the one that acts, and from the model's torque to what would be reported.

A report is late (or early), behind a first-order low-pass, or what the drive was asked for and followed behind one of
its own. The payload is told by the torque that acts: the report of the instant, the low-pass turned round, so that a
pick is as sharp in it as it is at the gripper. Errors are told of the report: the model's torque goes through the same
low-pass. Shift and inverse low-pass together are a few weights on the reports round the instant.
"""

from __future__ import annotations

import numpy as np

from schemas.kernels import kernel
from service.estimator.kalman import MAX_LAG
from service.model.effects.base import Readout
from service.model.signals import ramp, shift_weights

SLOPE = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0  # per sample, of the two before to the two after
REACH = 2  # samples to either side that it needs
TAPS = len(SLOPE) + 3
MODELS = 4  # whose errors are told

SETTINGS = np.dtype(
    [
        ("active", "i8"),
        ("first", "i8"),  # samples from the instant to the oldest report that is weighed
        ("shift", "f8", TAPS),  # weights of the report at the instant, oldest first
        ("acting", "f8", TAPS),  # the same of the torque that acts
        ("lag", "f8"),  # s, 0: none
        ("follows", "f8"),  # s, 0: none
    ],
    align=True,
)
STATE = np.dtype(
    [
        ("asked", "f8", 3),  # N m, last report
        ("acting", "f8", 3),  # N m, what the drive made of it
        ("started", "i8"),
        ("models", "f8", (MODELS, 3)),  # N m, last torque of each model
        ("reported", "f8", (MODELS, 3)),  # N m, what is reported of it
        ("settled", "i8"),
    ],
    align=True,
)


def settings(readout: Readout, period: float) -> np.ndarray:
    """One SETTINGS record. period: s."""
    record = np.zeros((), SETTINGS)
    record["active"] = readout != Readout()
    weights, first = shift_weights(-readout.late / period)
    record["first"] = first - REACH
    record["shift"][REACH:-REACH] = weights
    record["acting"] = record["shift"] + readout.lag / period * np.convolve(weights, SLOPE)
    record["lag"], record["follows"] = readout.lag, readout.follows
    return record


def newest(record: np.ndarray) -> int:
    """Samples after the instant whose reports are weighed, one at least: a look back may not be nearer."""
    return max(1, int(record["first"]) + TAPS - 1) if record["active"] else 1


def fits(record: np.ndarray, lag: int) -> bool:
    """Whether the reports that are weighed lie within what is remembered, at a look back of `lag` samples."""
    return bool(newest(record) <= lag <= MAX_LAG + min(0, int(record["first"])))


def noise_share(record: np.ndarray, samples: int) -> float:
    """Variance of the mean of `samples` torques that act over that of as many reports of white noise; one at least, for
    what a low-pass takes off the noise comes again in the samples after."""
    through = np.convolve(np.ones(samples), record["acting"])
    return max(1.0, float(through @ through) / samples) if record["active"] else 1.0


@kernel
def follow_kernel(settings, state, torque, elapsed):
    """Make of `torque` (3,) N m, in place, what acts behind a drive that follows it, `elapsed` s after the last."""
    keep, mean = ramp(elapsed / settings.follows)
    for i in range(3):
        before = state.asked[i] if state.started != 0 else torque[i]
        acted = state.acting[i] if state.started != 0 else torque[i]
        state.asked[i] = torque[i]
        torque[i] = state.acting[i] = keep * acted + (mean - keep) * before + (1.0 - mean) * torque[i]
    state.started = 1


@kernel
def lag_kernel(settings, state, models, elapsed):
    """Make of the torques of the models (MODELS, 3) N m, in place, what is reported, `elapsed` s after the last."""
    keep, mean = ramp(elapsed / settings.lag)
    for n in range(MODELS):
        for i in range(3):
            before = state.models[n, i] if state.settled != 0 else models[n, i]
            told = state.reported[n, i] if state.settled != 0 else models[n, i]
            state.models[n, i] = models[n, i]
            models[n, i] = state.reported[n, i] = keep * told + (mean - keep) * before + (1.0 - mean) * models[n, i]
    state.settled = 1


@kernel
def weigh_reports_kernel(weights, first, past, instant, unusable, torque):
    """Fill torque (3,), N m: reports round the slot `instant` of the ring `past`, weighted. Returns whether all of them
    are there."""
    whole = True
    for i in range(3):
        torque[i] = 0.0
    for tap in range(TAPS):
        weight = weights[tap]
        if weight == 0.0:
            continue
        slot = past[(instant + first + tap + MAX_LAG + 1) % (MAX_LAG + 1)]
        whole &= slot.flags & unusable == 0
        for i in range(3):
            torque[i] += weight * slot.acting[i]
    return whole
