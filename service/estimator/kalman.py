"""Joint motion from joint position: a Kalman filter for all joints, with a fixed-lag smoother behind it.

State of a joint: position, velocity, acceleration and jerk. The jerk is a first-order Markov process, which is what
"expected jerk" means physically: of a given rms, changing over a given time.

The covariance runs along with the state, so the gain always belongs to the gap that a sample closes. With every gap
bounded (a longer one restarts the filter) the model is uniformly observable and controllable, and the filter is stable
for any pattern of losses (Jazwinski, Stochastic Processes and Filtering Theory, 1970, theorem 7.4). The joints share
model, noise and gaps, so they share one covariance. Records are those of the three joints of a Delta; `joints.state`
has the same of more.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from schemas.kernels import kernel

ORDER = 4  # position, velocity, acceleration, jerk
POSITION, VELOCITY, ACCELERATION = range(3)

# A pick-and-place at 10 g asks 1000 to 1500 rad/s^3 rms of a joint, with peaks of 8000; twice that leaves headroom.
EXPECTED_JERK = 3000.0  # rad/s^3
# Motion profiles change their jerk within some hundredths of a second.
JERK_TIME = 0.02  # s
# What may be expected of a joint that is heard for the first time; it may be in the middle of a move.
FIRST_SPEED, FIRST_ACCELERATION = 5.0, 300.0  # rad/s, rad/s^2

# A fixed lag behind the newest sample at which a smoothed acceleration is worth more than a fresh one: the payload
# branch can wait for it, the feed-forward torque cannot.
SMOOTHING_LAG = 0.006  # s
MAX_LAG = 128  # samples that are remembered; a torque that is reported late is waited for: 8 kHz x 15 ms = 120
LONGEST_SMOOTHING = 64  # samples; 8 kHz x 6 ms = 48
# Nobody needs to know an acceleration better; below it its variance is a difference of near equals.
SMALLEST_VARIANCE = 0.1**2  # (rad/s^2)^2

FILTER = np.dtype(
    [
        ("transition", "f8", (ORDER, ORDER)),  # of one cycle; upper triangular
        ("noise", "f8", (ORDER, ORDER)),  # what the jerk adds to the covariance in one cycle
        ("first", "f8", (ORDER, ORDER)),  # covariance at the start of a stream
        ("resolution", "f8"),  # rad, standard deviation of a position
        ("behind", "f8"),  # s^2, see `_behind`
        ("lag", "i8"),  # samples
        ("acceleration_variance", "f8"),  # (rad/s^2)^2, of the smoothed one where no sample is missing
    ],
    align=True,
)

# What is known of three joints at the newest cycle, and what the newest sample did to it.
TRACK = np.dtype(
    [
        ("state", "f8", (3, ORDER)),
        ("covariance", "f8", (ORDER, ORDER)),
        ("gain", "f8", ORDER),
        ("scaled", "f8", 3),  # innovation over its variance, 1/rad
        ("seen", "f8", 3),  # rad, the last position that was used
        ("used", "i8"),  # positions since the start
        ("idle", "i8"),  # cycles since the last one
        ("scratch", "f8", (ORDER, ORDER)),
    ],
    align=True,
)

# Of a covariance that is symmetric, what the smoother needs: the jerk's own variance is last, and not among it.
SHARED = ORDER * (ORDER + 1) // 2 - 1
# One cycle in the lag line: what the smoother needs to know of it, and no more, since a controller has little memory.
SLOT = np.dtype(
    [
        ("state", "f8", (3, ORDER - 1)),  # without the jerk
        ("covariance", "f8", SHARED),  # by `shared`
        ("gain", "f8", ORDER),
        ("scaled", "f8", 3),
        ("gap", "i8"),  # cycles since the slot before
    ],
    align=True,
)


class MotionFilter(NamedTuple):
    """The filter at one sample rate: the fields of FILTER."""

    transition: np.ndarray
    noise: np.ndarray
    first: np.ndarray
    resolution: float
    behind: float
    lag: int
    acceleration_variance: float


@lru_cache
def design(period: float, resolution: float, least_lag: int = 1, jerk: float = EXPECTED_JERK) -> MotionFilter:
    """The filter for samples every `period` s of an encoder with `resolution` rad at the joint. least_lag: samples that
    the look back waits for at least. jerk: rad/s^3 rms that is expected.

    The resolution is taken as the standard deviation of a position sample: quantisation is 0.29 of it, the rest is the
    encoder's own noise. The same arrays for the same arguments: a description is asked about several times.
    """
    drift = np.zeros((ORDER, ORDER))
    drift[0, 1] = drift[1, 2] = drift[2, 3] = 1.0
    drift[3, 3] = -1.0 / JERK_TIME
    drive = np.zeros((ORDER, 1))
    drive[3, 0] = jerk * np.sqrt(2.0 / JERK_TIME)
    transition, noise = _sampled(drift, drive, period)
    motion = MotionFilter(
        transition=np.triu(transition),  # below the diagonal there is rounding alone
        noise=0.5 * (noise + noise.T),
        first=np.diag(np.array([resolution, FIRST_SPEED, FIRST_ACCELERATION, jerk]) ** 2),
        resolution=resolution,
        behind=math.nan,
        lag=max(least_lag, min(LONGEST_SMOOTHING, round(SMOOTHING_LAG / period))),
        acceleration_variance=math.nan,
    )
    prior = _settled(motion)
    return motion._replace(behind=_behind(motion, prior), acceleration_variance=_steady_variance(motion, prior))


def _sampled(drift: np.ndarray, drive: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition and noise over `period` s of x' = drift x + drive w with white noise w of density 1.

    Source: Van Loan, Computing integrals involving the matrix exponential, 1978 (doi 10.1109/TAC.1978.1101743).
    """
    from scipy.linalg import expm  # here, for what uses this module without a filter

    both = np.block([[-drift, drive @ drive.T], [np.zeros_like(drift), drift.T]])
    power = expm(both * period)
    transition = power[ORDER:, ORDER:].T
    return transition, transition @ power[:ORDER, ORDER:]


def speed_deviation(motion: MotionFilter) -> float:
    """Standard deviation of the newest speed once the filter has settled, rad/s."""
    prior = _settled(motion)
    return math.sqrt(prior[VELOCITY, VELOCITY] - prior[0, VELOCITY] ** 2 / (prior[0, 0] + motion.resolution**2))


def _settled(motion: MotionFilter) -> np.ndarray:
    """Covariance of a prediction once the filter has settled, (4, 4)."""
    from scipy.linalg import solve_discrete_are

    return solve_discrete_are(motion.transition.T, np.eye(ORDER, 1), motion.noise, np.array([[motion.resolution**2]]))


def _behind(motion: MotionFilter, prior: np.ndarray) -> float:
    """Largest error of a predicted position, rad per rad/s^2 by which the acceleration changes at once, until the
    filter has found the new one. prior: covariance of a prediction once the filter has settled."""
    gain, error, largest = prior[:, 0] / (prior[0, 0] + motion.resolution**2), np.eye(ORDER)[ACCELERATION], 0.0
    for _ in range(2 * MAX_LAG):
        error = motion.transition @ error
        largest = max(largest, abs(float(error[0])))
        error = error - gain * error[0]
    return largest


def _steady_variance(motion: MotionFilter, prior: np.ndarray) -> float:
    """Variance of the smoothed acceleration once the filter has settled: of its covariance P, what the samples until
    the lag is over leave (see `acceleration_variance_kernel`). prior: covariance of a prediction then."""
    transition = motion.transition
    spread = prior[0, 0] + motion.resolution**2
    gain = prior[:, :1] / spread
    carried = (prior - gain @ gain.T * spread)[:, 2:3]
    variance = carried[2, 0]
    for _ in range(motion.lag):
        carried = transition @ carried
        variance -= carried[0, 0] ** 2 / spread
        carried = carried - gain * carried[0, 0]
    return max(float(variance), SMALLEST_VARIANCE)


@kernel
def restart_kernel(motion, track, position):
    """Begin at `position` (n,), rad: at rest there, as far as is known."""
    for i in range(len(track.seen)):
        track.seen[i] = track.state[i, 0] = position[i]
        for order in range(1, ORDER):
            track.state[i, order] = 0.0
        track.scaled[i] = 0.0
    for row in range(ORDER):
        track.gain[row] = 0.0
        for column in range(ORDER):
            track.covariance[row, column] = motion.first[row, column]
    track.used = 1
    track.idle = 0


@kernel
def predict_kernel(motion, track, cycles):
    """Move on by `cycles`: x = F x, P = F P F' + Q, each time."""
    transition, covariance, carried = motion.transition, track.covariance, track.scratch
    for _ in range(cycles):
        for i in range(len(track.seen)):
            for row in range(ORDER):  # upwards, in place: a row needs only those below it
                total = 0.0
                for column in range(row, ORDER):
                    total += transition[row, column] * track.state[i, column]
                track.state[i, row] = total
        for row in range(ORDER):
            for column in range(ORDER):
                total = 0.0
                for k in range(row, ORDER):
                    total += transition[row, k] * covariance[k, column]
                carried[row, column] = total
        for row in range(ORDER):
            for column in range(row, ORDER):
                total = motion.noise[row, column]
                for k in range(column, ORDER):
                    total += carried[row, k] * transition[column, k]
                covariance[row, column] = total
                covariance[column, row] = total


@kernel
def predicted_variance_kernel(motion, track, seconds):
    """Variance, rad^2, of a position measured `seconds` on: p' P p with p = (1, t, t^2 / 2, t^3 / 6), which leaves out
    that the jerk fades and is renewed, both within its own variance, and the resolution."""
    passed = (1.0, seconds, seconds * seconds / 2.0, seconds * seconds * seconds / 6.0)
    variance = motion.resolution * motion.resolution
    for row in range(ORDER):
        for column in range(ORDER):
            variance += passed[row] * track.covariance[row, column] * passed[column]
    return variance


@kernel
def update_kernel(motion, track, position):
    """Take `position` (n,), rad, at the predicted cycle: K = P H' / S, x = x + K e, P = P - K S K'."""
    covariance, gain = track.covariance, track.gain
    noise = motion.resolution * motion.resolution
    spread = covariance[0, 0] + noise
    for row in range(ORDER):
        gain[row] = covariance[row, 0] / spread
    for i in range(len(track.seen)):
        innovation = position[i] - track.state[i, 0]
        track.scaled[i] = innovation / spread
        track.seen[i] = position[i]
        for row in range(ORDER):
            track.state[i, row] += gain[row] * innovation
    for row in range(1, ORDER):
        for column in range(row, ORDER):
            covariance[row, column] -= gain[row] * gain[column] * spread
            covariance[column, row] = covariance[row, column]
    for row in range(ORDER):  # P - K S K' in the row of H, without the difference of near equals
        covariance[0, row] = covariance[row, 0] = gain[row] * noise
    track.used += 1
    track.idle = 0


@kernel
def largest_innovation(motion, track):
    """Of the newest position, over its standard deviation: e / sqrt(S) with S = R / (1 - K_0)."""
    largest = 0.0
    for i in range(len(track.scaled)):
        largest = max(largest, abs(track.scaled[i]))
    return largest * motion.resolution / math.sqrt(1.0 - track.gain[0])


@kernel
def coast_kernel(track, cycles):
    """No position came with the predicted cycle."""
    for i in range(len(track.seen)):
        track.scaled[i] = 0.0
    for row in range(ORDER):
        track.gain[row] = 0.0
    track.idle += cycles


@kernel
def shared(one, other):
    """Where a slot has what two orders share, not both the jerk."""
    low, high = min(one, other), max(one, other)
    return low * (2 * ORDER - 1 - low) // 2 + high


@kernel
def keep_kernel(track, gap, slot):
    """Put the newest cycle into the lag line."""
    for row in range(ORDER):
        slot.gain[row] = track.gain[row]
    for row in range(ORDER - 1):
        for column in range(row, ORDER):
            slot.covariance[shared(row, column)] = track.covariance[row, column]
    for i in range(len(track.seen)):
        slot.scaled[i] = track.scaled[i]
        for order in range(ORDER - 1):
            slot.state[i, order] = track.state[i, order]
    slot.gap = gap


@kernel
def smooth_kernel(transition, slots, newest, lag, adjoint, smoothed):
    """The state `lag` samples ago as all samples since tell it: x + P a, with the adjoint state (Bryson, Frazier)

        a = F' ((I - K H)' a + H' e / S)     backwards over the samples since, F to the power of each one's gap.

    slots: records of SLOT, a ring. adjoint: (4,) scratch. Filled: smoothed (3, n): position, velocity, acceleration.
    """
    for i in range(len(slots[newest].scaled)):
        for row in range(ORDER):
            adjoint[row] = 0.0
        index = newest
        for _ in range(lag):
            slot = slots[index]
            pull = slot.scaled[i]
            for row in range(ORDER):
                pull -= slot.gain[row] * adjoint[row]
            adjoint[0] += pull
            for _ in range(slot.gap):
                for column in range(ORDER - 1, -1, -1):
                    total = 0.0
                    for row in range(column + 1):
                        total += transition[row, column] * adjoint[row]
                    adjoint[column] = total
            index = index - 1 if index > 0 else len(slots) - 1
        slot = slots[index]
        for order in range(3):
            total = slot.state[i, order]
            for k in range(ORDER):
                total += slot.covariance[shared(order, k)] * adjoint[k]
            smoothed[order, i] = total


@kernel
def acceleration_variance_kernel(motion, slots, newest, lag, carried):
    """Variance, (rad/s^2)^2, of the acceleration that `smooth_kernel` gives, alike for the joints: the column of it in
    the covariance of then, carried through the samples since, each of which takes (H F p)^2 / S off.

    carried: (4,) scratch.
    """
    index = newest - lag
    if index < 0:
        index += len(slots)
    for row in range(ORDER):
        carried[row] = slots[index].covariance[shared(row, ACCELERATION)]
    variance = carried[2]
    for _ in range(lag):
        index = index + 1 if index + 1 < len(slots) else 0
        slot = slots[index]
        for _ in range(slot.gap):
            for row in range(ORDER):  # upwards, in place
                total = 0.0
                for column in range(row, ORDER):
                    total += motion.transition[row, column] * carried[column]
                carried[row] = total
        if slot.gain[0] > 0.0:  # S = R / (1 - K_0); a cycle without a position tells nothing
            told = carried[0]
            variance -= told * told * (1.0 - slot.gain[0]) / (motion.resolution * motion.resolution)
            for row in range(ORDER):
                carried[row] -= slot.gain[row] * told
    return variance
