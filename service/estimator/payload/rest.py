"""A change of load while nothing moves, seen as a step of the torque.

At rest friction is any share of Coulomb's, so the torque says little of the mass. But it says so for as long as nothing
changes: where the torques step on the joints as J'g does, between two stretches in which they stand, another mass hangs
there. Friction may have taken up a part of the step, and is in its error.
"""

from __future__ import annotations

import numpy as np

from schemas.kernels import kernel
from service.estimator import departure

STRETCH = 6  # bins, in which the torque stands
STRETCHES = 5  # two before the step, one in which it is made, two behind it
BINS = STRETCHES * STRETCH
# Of the squared step, what is along J'g at least.
LIKENESS = 0.85
# Of the step, what the torque may drift by before and after: friction creeps, drives settle.
DRIFT_BEFORE, DRIFT_AFTER = 0.25, 0.2
# Squared, normalised step that stands out of noise: some hundred instants are looked at a second.
STEP_THRESHOLD = 45.0
# Noise of neighbouring bins is alike to some extent: the variance of a mean over that of white noise.
COLOURED = 1.5
# Variance of the difference of two that are anything within +-1.
ANY_TWO = 2.0 / 3.0
# Of what friction may take up of a step, one standard deviation, what shows of it at least.
SLIP_SHARE = 0.4
# A load that is gripped or let go shakes the arms for less than this, until the drives hold them again.
JOLT_TIME = 0.05  # s

STATE = np.dtype(
    [
        ("torque", "f8", (BINS, 3)),  # N m, means of bins that payload does not explain, a ring
        ("head", "i8"),
        ("filled", "i8"),
        ("sum", "f8", 3),  # N m, of the bin that is being filled
        ("in_bin", "i8"),  # samples in it
        ("jolted", "f8"),  # s, for which something has moved between
        ("stood", "f8"),  # s, in which nothing has but for that
        ("mean", "f8", (STRETCHES, 3)),  # scratch, the latest first
        ("step", "f8"),  # kg, by which the load has changed at this sample
        ("variance", "f8"),  # kg^2, of it
    ],
    align=True,
)


@kernel
def rest_kernel(settings, rest, column, residual):
    """Take a sample at rest. column: (3, LOADS), the first N m/kg. residual: (3,) N m. Returns whether rest.step and
    rest.variance say that the load is another."""
    for i in range(3):
        rest.sum[i] += residual[i]
    rest.jolted = max(0.0, rest.jolted - settings.period)
    rest.stood += settings.period
    rest.in_bin += 1
    if rest.in_bin < settings.bin_size:
        return False
    rest.head = (rest.head + 1) % BINS
    for i in range(3):
        rest.torque[rest.head, i] = rest.sum[i] / rest.in_bin
        rest.sum[i] = 0.0
    rest.in_bin = 0
    rest.filled += 1
    return rest.filled >= BINS and _steps(settings, rest, column)


@kernel
def jolt_kernel(settings, rest):
    """Something moves, slowly: a jolt, whose torque is left out, unless it lasts."""
    rest.jolted += settings.period
    if rest.jolted > JOLT_TIME:
        moved_kernel(rest)
    _leave_bin_out(rest)


@kernel
def moved_kernel(rest):
    """Something moves, or nothing is known of it."""
    rest.filled = 0
    rest.jolted = rest.stood = 0.0
    _leave_bin_out(rest)


@kernel
def _leave_bin_out(rest):
    rest.in_bin = 0
    for i in range(3):
        rest.sum[i] = 0.0


@kernel
def _steps(settings, rest, column):
    """Whether the torque has stepped as a load pulls; rest.step and rest.variance, if so."""
    noise = _stretches(rest)
    mean, load = rest.mean, 0.0
    along = square = before = after = rubbed = 0.0
    for i in range(3):
        phi = column[i, 0]
        step = 0.5 * (mean[0, i] + mean[1, i]) - mean[3, i]
        coulomb = settings.prior[departure.place(i, 0)] / departure.DRIFT_SHARE
        load += phi * phi
        along += phi * step
        square += step * step
        before += phi * (mean[3, i] - mean[4, i])
        after += phi * (mean[0, i] - mean[1, i])
        rubbed += ANY_TWO * (phi * coulomb) ** 2
    squared = along * along
    if squared < LIKENESS * load * square or squared <= max(STEP_THRESHOLD * load * noise, SLIP_SHARE**2 * rubbed):
        return False
    if abs(before) > DRIFT_BEFORE * abs(along) or abs(after) > DRIFT_AFTER * abs(along):
        return False
    rest.step, rest.variance = along / load, rubbed / (load * load) + noise / load
    rest.filled = 2 * STRETCH  # what stands behind this step stands before the next
    return True


@kernel
def _stretches(rest):
    """rest.mean, and the variance of a step between two of them by the scatter within all but the one in the middle,
    (N m)^2."""
    scatter = 0.0
    for n in range(STRETCHES):
        for i in range(3):
            mean = square = 0.0
            for k in range(n * STRETCH, (n + 1) * STRETCH):
                value = rest.torque[(rest.head - k + BINS) % BINS, i]
                mean += value / STRETCH
                square += value * value / STRETCH
            rest.mean[n, i] = mean
            if n != STRETCHES // 2:
                scatter += max(0.0, square - mean * mean)
    variance = scatter / (3 * (STRETCHES - 1)) * STRETCH / (STRETCH - 1)
    return 1.5 * COLOURED * variance / STRETCH
