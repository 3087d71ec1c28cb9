"""The commanded torque in place of the reported one, where the two differ by a sensor's noise alone.

A reported torque is the motor's current as it was measured, noise and all. Where `identify` found that the drives do
what they are told, what they were told is the same torque without that noise, and a mass picked is known sooner. A
command that stands for something else (a feed-forward offset, a drive at its limit or late) departs from the torque in
a mean over some time or at once; then it is not used again.
"""

from __future__ import annotations

import numpy as np

from schemas.kernels import kernel

PROOF_TIME = 0.2  # s of samples that bear it out before it is used
MEAN_TIMES = (0.02, 0.5)  # s over which departures are averaged: a mass picked, a slow drift
# Squared standard deviations beyond which a departure is none of the noise: once in some years at 1 kHz.
REFUTATION = 50.0

SETTINGS = np.dtype([("variance", "f8", 3), ("keep", "f8", len(MEAN_TIMES))], align=True)  # (N m)^2, 0: not used; -
STATE = np.dtype([("mean", "f8", (len(MEAN_TIMES), 3)), ("proved", "f8"), ("refuted", "i8")], align=True)


def settings(noise: np.ndarray, commanded: bool, period: float) -> np.ndarray:
    """One SETTINGS record. noise: (3,) N m rms of a reported sample. commanded: as identified. period: s."""
    record = np.zeros((), SETTINGS)
    record["variance"] = np.square(noise) if commanded else 0.0
    record["keep"] = np.exp(-period / np.array(MEAN_TIMES))
    return record


@kernel
def compare_kernel(settings, state, torque, command, period):
    """Take one sample, (3,) N m each. Returns whether a command in use is refuted by it."""
    if settings.variance[0] <= 0.0 or state.refuted != 0:
        return False
    for i in range(3):
        departure = torque[i] - command[i]
        wrong = departure * departure > REFUTATION * settings.variance[i]
        for n in range(len(MEAN_TIMES)):
            keep = settings.keep[n]
            mean = state.mean[n, i] = keep * state.mean[n, i] + (1.0 - keep) * departure
            wrong |= mean * mean * (1.0 + keep) > REFUTATION * (1.0 - keep) * settings.variance[i]
        if wrong:
            state.refuted = 1
    state.proved += period
    return state.refuted != 0 and state.proved > PROOF_TIME


@kernel
def is_used(settings, state):
    return settings.variance[0] > 0.0 and state.refuted == 0 and state.proved > PROOF_TIME
