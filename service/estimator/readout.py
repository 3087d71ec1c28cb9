"""From the torque that a drive reports to the one that acts, and from the model's torque to what would be reported.

A report is late (or early), behind a first-order low-pass, or what the drive was asked for and followed behind one of
its own. Model and report are compared as the drive reports: what the model says, and what a mass, friction and scale do
to it, goes through the same low-pass, so the noise that is left is the sensor's own, white as it was. What a twist of a
gear is drawn by is the torque that acts: shift and inverse low-pass together are a few weights on the reports round the
instant.
"""

from __future__ import annotations

import numpy as np

from schemas.kernels import kernel
from service.estimator.departure import PARTS
from service.estimator.kalman import MAX_LAG
from service.estimator.payload.payload_state import LOADS
from service.model.effects.base import Readout
from service.model.signals import ramp, shift_weights

SLOPE = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0  # per sample, of the two before to the two after
REACH = 2  # samples to either side that it needs
TAPS = len(SLOPE) + 3
MODELS = 4  # whose errors are told
TOLD = 1 + LOADS + PARTS  # what the payload is told by: the model without it, each load and each part of friction
COMMAND = TOLD + MODELS  # row of the command

SETTINGS = np.dtype(
    [
        ("active", "i8"),
        ("first", "i8"),  # samples from the instant to the oldest report that is weighed
        ("shift", "f8", TAPS),  # weights of the report at the instant, oldest first
        ("acting", "f8", TAPS),  # the same of the torque that acts
        ("ahead", "i8"),  # whether commands are ahead of the report; else they are as it is
        ("command", "f8", TAPS),  # of them, where they are, the same of what acts
        ("first_command", "i8"),
        ("lag", "f8"),  # s, 0: none
        ("follows", "f8"),  # s, 0: none
    ],
    align=True,
)
# A drive that follows what it was asked for.
FOLLOWED = np.dtype(
    [
        ("asked", "f8", 3),  # N m, last
        ("acting", "f8", 3),  # N m, what the drive made of it
        ("started", "i8"),
    ],
    align=True,
)
STATE = np.dtype(
    [
        ("report", FOLLOWED),
        ("command", FOLLOWED),  # which is the report without its noise, where it is used
        # N m, last torque that acted, of what is told, of each model and of the command
        ("acted", "f8", (COMMAND + 1, 3)),
        ("reported", "f8", (COMMAND + 1, 3)),  # N m, what is reported of it
        ("awake", "f8"),  # s, that the command has been behind the low-pass without a hole
        ("load_before", "f8"),  # kg, until the last change
        ("remains", "f8", 3),  # N m/kg, what of it is reported still
    ],
    align=True,
)


def settings(readout: Readout, period: float, ahead: float | None = None) -> np.ndarray:
    """One SETTINGS record. period: s. ahead: s, by which the command is ahead of the report, None: by nothing that is
    known, as where it is not about `readout.late`."""
    record = np.zeros((), SETTINGS)
    record["active"] = readout != Readout()
    weights, first = shift_weights(-readout.late / period)
    record["first"] = first - REACH
    record["shift"][REACH:-REACH] = weights
    record["acting"] = record["shift"] + readout.lag / period * np.convolve(weights, SLOPE)
    if ahead is not None and record["active"] and abs(ahead - readout.late) <= REACH * period:
        weights, record["first_command"] = shift_weights((ahead - readout.late) / period)
        record["ahead"], record["command"][: len(weights)] = True, weights
    record["lag"], record["follows"] = readout.lag, readout.follows
    return record


def newest(record: np.ndarray) -> int:
    """Samples after the instant whose reports are weighed, one at least: a look back may not be nearer."""
    weighed = np.flatnonzero(record["acting"]) if record["active"] else [0]
    ahead = np.flatnonzero(record["command"]) if record["ahead"] else [0]
    return max(1, int(record["first"]) + int(weighed[-1]), int(record["first_command"]) + int(ahead[-1]))


def fits(record: np.ndarray, lag: int) -> bool:
    """Whether the reports that are weighed lie within what is remembered, at a look back of `lag` samples."""
    return bool(newest(record) <= lag <= MAX_LAG + min(0, int(record["first"])))


@kernel
def follow_kernel(settings, followed, torque, elapsed):
    """Make of `torque` (3,) N m, in place, what acts behind a drive that follows it, `elapsed` s after the last."""
    keep, mean = ramp(elapsed / settings.follows)
    for i in range(3):
        before = followed.asked[i] if followed.started != 0 else torque[i]
        acted = followed.acting[i] if followed.started != 0 else torque[i]
        followed.asked[i] = torque[i]
        torque[i] = followed.acting[i] = keep * acted + (mean - keep) * before + (1.0 - mean) * torque[i]
    followed.started = 1


@kernel
def lag_kernel(settings, state, torque, first, elapsed):
    """Make of torques (N, 3) N m, in place, what is reported of them, `elapsed` s after the last, 0: they start over.
    They are the rows of the state from `first` on."""
    keep, mean = ramp(elapsed / settings.lag) if elapsed > 0.0 else (0.0, 0.0)
    for n in range(len(torque)):
        acted, reported = state.acted[first + n], state.reported[first + n]
        for i in range(3):
            now = torque[n, i]
            torque[n, i] = reported[i] = keep * reported[i] + (mean - keep) * acted[i] + (1.0 - mean) * now
            acted[i] = now


@kernel
def keep_load_kernel(settings, state, load, column, since):
    """A load of `load` kg was another `since` s ago: what of `column` (3,) N m/kg is reported now belongs to it yet."""
    keep = ramp(since / settings.lag)[0]
    state.load_before = load
    for i in range(3):
        state.remains[i] = keep * column[i]


@kernel
def weigh_reports_kernel(weights, first, past, instant, unusable, commanded, torque):
    """Fill torque (3,), N m: reports round the slot `instant` of the ring `past`, weighted, or what was commanded
    there. Returns whether all of them are there."""
    whole = True
    for i in range(3):
        torque[i] = 0.0
    for tap in range(TAPS):
        weight = weights[tap]
        if weight == 0.0:
            continue
        slot = past[(instant + first + tap + MAX_LAG + 1) % (MAX_LAG + 1)]
        whole &= slot.flags & unusable == 0 and (slot.commanded != 0 or not commanded)
        for i in range(3):
            torque[i] += weight * (slot.torque_command[i] if commanded else slot.acting[i])
    return whole
