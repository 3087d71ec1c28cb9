"""Offline signals of a trace: joint motion by Kalman smoothing, rest, segments without a fault, the common low-pass.

The smoother is Rauch, Tung and Striebel's on a white-jerk model. Its gains do not depend on the data, so they are
designed once for each bandwidth and sample time: exact over the start, constant once they have settled. The kernel
only applies them.

Both sides of the model are filtered alike: the motion comes from a smoother of wide bandwidth, regressors are built
from it (sign theta_dot among them), and the same zero-phase low-pass is then put on regressors and torque.

What is needed of `scipy.signal`, `scipy.ndimage` and filterpy are a few lines: importing them, `scipy.stats` with
them, takes longer than reading the logs and fitting the base model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from schemas.columns import implausible_rate
from schemas.errors import DataError, TraceError
from schemas.kernels import kernel
from schemas.messages import SampleFlag
from schemas.trace import Trace
from service.model.dynamics import REST_SPEED

# Of the motion. Wide, because the zero crossings of the velocity place the friction's jumps; what noise it lets
# through is taken out after the regressors are built.
MOTION_HZ = 200.0
MOTION_SHARE = 0.2  # of the sample rate, where that is less
ANALYSIS_HZ = 40.0  # of the low-pass on regressors and torque
ANALYSIS_ORDER = 4
PADDING = 15  # samples that a signal goes on beyond its ends, turned round there: SciPy's for this order
REST_HZ = 60.0  # of the position whose slope tells rest from motion
ROUNDING = 1e-12  # of the largest position, that a change of units leaves where samples repeat
LEVER = 0.1  # m: of an axis that goes along a line, a speed or a way of so much counts as one of a radian
REST_TIME = 0.040  # s below REST_SPEED that make a rest
REST_MARGIN = 0.015  # s left out on both sides of a rest
EDGE = 0.1  # s at each end of a segment that the filters' start reaches into
LEAST_S = 4 * EDGE  # of a part without a fault, which is then mostly free of edges
LONGEST_STEP = 1.5  # periods between two samples; beyond is a gap
SAME_RATE = 0.02  # share by which the sample time of two logs of one rate may differ
JITTER = 0.1  # of the period, from the 5 % shortest to the 5 % longest steps: beyond, samples may have been polled
LONGEST_HOLE = 6.0  # periods, bridged where samples were polled
HOLES = 1e-3  # of the steps
SMOOTHER = 0.7  # of the position's noise that is left by the stamps, where they are right
FEWEST = 100  # samples that tell
LEAST_TORQUE = 1e-12  # N m, or N: the smallest motor's noise is a million times that
NOISY = 0.03  # of the acceleration, rms: bends an inertia by its square
LEAST_HZ = 3.0  # of the analysis band
NARROWER = 1.25  # times, from one band that is tried to the next
TAPS = 10  # of the samples that are kept, to either side, in the low-pass before the others are left out: SciPy's
RATE = 1000.0  # Hz, regressors are built at no less than this: plenty for what the motion smoother passes
CHUNK = 32  # columns filtered at a time: what fits in the cache
# A torque that the drive makes anew every few samples and holds between:
HELD_CHANGES = 20  # of a joint's torque, before their rhythm says anything: those of the shortest segment
HELD_MOST = 0.02  # s; beyond, a torque stands still for reasons of its own
HELD_EXCEPT = 0.02  # of its changes that may follow each other at once
HELD_STEP = 1.5  # times its smallest change that a typical one is: one that rises by single steps is coarse, not held
NOISE_HZ = 250.0  # above it (or a quarter of the sample rate) a robot's torque is noise

UNUSABLE = (
    SampleFlag.NOT_A_NUMBER
    | SampleFlag.OUT_OF_RANGE
    | SampleFlag.REPEATED
    | SampleFlag.TIME_BACKWARDS
    | SampleFlag.JUMP
    | SampleFlag.BUS_FAULT
)

START_VARIANCE = 1e4  # of velocity and acceleration before the first sample, in the smoother's own units
_SETTLED = 1e-13  # relative change of the gains that ends the exact start


class Gains(NamedTuple):
    """Smoother gains. filter: (S, 3), sample k uses row min(k, S - 1); smoother: (S, 3, 3) alike."""

    filter: np.ndarray
    smoother: np.ndarray


@lru_cache(maxsize=32)
def design(bandwidth: float) -> Gains:
    """Gains of the smoother, run until they no longer change.

    bandwidth: half-amplitude frequency of the smoother, rad a sample. The unit of time is its inverse, which keeps the
    covariances well conditioned. In the steady state the smoother is 1 / (1 + w^6), w in units of the bandwidth: the
    Wiener filter of a spectrum 1 / w^6 in white noise of density 1.
    """
    b = bandwidth
    transition = np.array([[1.0, b, b**2 / 2], [0.0, 1.0, b], [0.0, 0.0, 1.0]])
    jerk = np.array([[b**5 / 20, b**4 / 8, b**3 / 6], [b**4 / 8, b**3 / 3, b**2 / 2], [b**3 / 6, b**2 / 2, b]])
    noise = 1.0 / b  # of a position
    covariance = np.diag([noise, START_VARIANCE, START_VARIANCE])
    filters: list[np.ndarray] = []
    smoothers: list[np.ndarray] = []
    for _ in range(100_000):
        gain = covariance[:, 0] / (covariance[0, 0] + noise)
        kept = np.eye(3)
        kept[:, 0] -= gain
        updated = kept @ covariance @ kept.T + noise * np.outer(gain, gain)  # Joseph's form stays positive
        covariance = transition @ updated @ transition.T + jerk
        filters.append(gain)
        smoothers.append(np.linalg.solve(covariance, transition @ updated).T)
        if len(filters) > 3:
            change = max(_change(filters), _change(smoothers))
            if change < _SETTLED:
                break
    return Gains(np.array(filters), np.array(smoothers))


def _change(gains: list[np.ndarray]) -> float:
    return float(np.max(np.abs(gains[-1] - gains[-2]) / np.max(np.abs(gains[-1]))))


@kernel(nogil=True)
def _smooth(position, step, filter_gain, smoother_gain, theta, theta_dot, theta_ddot):
    half = 0.5 * step * step
    count, joints = position.shape
    settled = len(filter_gain) - 1
    for joint in range(joints):
        x, v, a = position[0, joint], 0.0, 0.0
        for k in range(count):
            if k > 0:
                x, v = x + step * v + half * a, v + step * a
            gain = filter_gain[min(k, settled)]
            innovation = position[k, joint] - x
            x += gain[0] * innovation
            v += gain[1] * innovation
            a += gain[2] * innovation
            theta[k, joint], theta_dot[k, joint], theta_ddot[k, joint] = x, v, a
        for k in range(count - 2, -1, -1):
            x, v, a = theta[k, joint], theta_dot[k, joint], theta_ddot[k, joint]
            dx = theta[k + 1, joint] - (x + step * v + half * a)
            dv = theta_dot[k + 1, joint] - (v + step * a)
            da = theta_ddot[k + 1, joint] - a
            gain = smoother_gain[min(k, settled)]
            theta[k, joint] = x + gain[0, 0] * dx + gain[0, 1] * dv + gain[0, 2] * da
            theta_dot[k, joint] = v + gain[1, 0] * dx + gain[1, 1] * dv + gain[1, 2] * da
            theta_ddot[k, joint] = a + gain[2, 0] * dx + gain[2, 1] * dv + gain[2, 2] * da


def smooth(
    position: np.ndarray, period: float, bandwidth_hz: float = MOTION_HZ
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """theta, theta_dot, theta_ddot, each (N, n) in rad, rad/s, rad/s^2, of evenly sampled positions (N, n) rad.

    period: s. bandwidth_hz: half-amplitude frequency of the smoother, at most `MOTION_SHARE` of the sample rate.
    """
    bandwidth = 2.0 * np.pi * min(bandwidth_hz * period, MOTION_SHARE)
    gains = design(bandwidth)
    position = np.ascontiguousarray(position, np.float64)
    theta, theta_dot, theta_ddot = np.empty_like(position), np.empty_like(position), np.empty_like(position)
    _smooth(position, bandwidth, gains.filter, gains.smoother, theta, theta_dot, theta_ddot)
    theta_dot *= bandwidth / period
    theta_ddot *= (bandwidth / period) ** 2
    return theta, theta_dot, theta_ddot


@kernel(nogil=True)
def _there_and_back(sections, settled, values):
    """Filter the columns of `values` (N, C) in place, forward and then backward, each time settled at its first row.

    sections: (S, 6) as SciPy's. settled: (S, 2) state behind a constant 1. Row by row, all columns at once: one column
    waits for its own last row, so that it alone would leave the processor idle.
    """
    count, width = values.shape
    near, far = np.empty((len(settled), width)), np.empty((len(settled), width))
    for first, way in ((0, 1), (count - 1, -1)):
        for s in range(len(settled)):
            for c in range(width):
                near[s, c], far[s, c] = settled[s, 0] * values[first, c], settled[s, 1] * values[first, c]
        for k in range(count):
            row = values[first + way * k]
            for s in range(len(settled)):
                b0, b1, b2 = sections[s, 0], sections[s, 1], sections[s, 2]
                a1, a2 = sections[s, 4], sections[s, 5]
                for c in range(width):
                    given = row[c]
                    made = b0 * given + near[s, c]
                    near[s, c] = b1 * given - a1 * made + far[s, c]
                    far[s, c] = b2 * given - a2 * made
                    row[c] = made


@kernel(nogil=True)
def _lowpassed(sections, settled, values, step, result):
    """Fill result (M, C) with every `step`-th row of `values` (N, C), low-passed; what is zero throughout stays so."""
    count, width = values.shape
    nonzero = np.zeros(width, np.bool_)
    for k in range(count):
        for c in range(width):
            nonzero[c] |= values[k, c] != 0.0
    live = np.flatnonzero(nonzero)
    last = PADDING + count - 1
    for at in range(0, len(live), CHUNK):
        some = live[at : at + CHUNK]
        part = np.empty((count + 2 * PADDING, len(some)))  # columns side by side in memory, so that they run at once
        for k in range(count):
            for i, c in enumerate(some):
                part[PADDING + k, i] = values[k, c]
        for k in range(1, PADDING + 1):
            near = min(k, count - 1)
            for i in range(len(some)):
                part[PADDING - k, i] = 2.0 * part[PADDING, i] - part[PADDING + near, i]
                part[last + k, i] = 2.0 * part[last, i] - part[last - near, i]
        _there_and_back(sections, settled, part)
        for k in range(len(result)):
            for i, c in enumerate(some):
                result[k, c] = part[PADDING + k * step, i]


def lowpass(values: np.ndarray, period: float, cutoff_hz: float = ANALYSIS_HZ, step: int = 1) -> np.ndarray:
    """Every `step`-th of `values` (N, ...) through the zero-phase Butterworth low-pass (4th order, forward and back)
    along axis 0.

    What SciPy's `sosfiltfilt` gives, many columns in a third of the time.
    """
    flat = np.ascontiguousarray(values.reshape(len(values), -1), np.float64)
    result = np.zeros((-(-len(flat) // step), flat.shape[1]))
    _lowpassed(*_sections(2.0 * cutoff_hz * period), flat, step, result)
    return result.reshape(-1, *values.shape[1:])


@lru_cache(maxsize=32)
def _sections(share: float) -> tuple[np.ndarray, np.ndarray]:
    """The low-pass, (S, 6) as SciPy's, and the state in which it has settled behind a constant 1. share: cut-off over
    the Nyquist frequency.

    Butterworth's poles, evenly on the left half of a circle, by the bilinear transform; a pair a section, the gain in
    the first.
    """
    angles = np.pi * np.arange(1 - ANALYSIS_ORDER, ANALYSIS_ORDER, 2) / (2 * ANALYSIS_ORDER)
    corner = 4.0 * np.tan(np.pi * share / 2.0)
    poles = corner * -np.exp(1j * angles)
    gain = corner**ANALYSIS_ORDER * np.real(1.0 / np.prod(4.0 - poles))
    sections, settled, level = [], [], 1.0
    for pole in ((4.0 + poles) / (4.0 - poles))[ANALYSIS_ORDER // 2 - 1 :: -1]:
        b, a = np.array([gain, 2.0 * gain, gain]), np.real(np.poly([pole, pole.conj()]))
        sections.append(np.append(b, a))
        settled.append(level * np.linalg.solve([[1.0 + a[1], -1.0], [a[2], 1.0]], b[1:] - a[1:] * b[0]))
        level, gain = level * b.sum() / a.sum(), 1.0
    return np.array(sections), np.array(settled)


def moving(position: np.ndarray, period: float, angular: bool = True) -> np.ndarray:
    """(N, n) bool: False where a joint stands below `REST_SPEED` for `REST_TIME` or more, and `REST_MARGIN` around it.

    position: (N, n) rad, or m where not `angular`, evenly sampled.
    """
    rest = REST_SPEED * (1.0 if angular else LEVER)
    cutoff = min(REST_HZ, MOTION_SHARE / period)
    slow = np.abs(np.gradient(lowpass(position, period, cutoff), period, axis=0)) < rest
    result = np.ones(position.shape, bool)
    margin = int(REST_MARGIN * (1 / period))
    for joint in range(position.shape[1]):
        edges = np.flatnonzero(np.diff(slow[:, joint].astype(np.int8), prepend=0, append=0))
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            if (end - start) * period >= REST_TIME:
                result[max(0, start - margin) : end + margin, joint] = False
    return result


@dataclass(frozen=True)
class Segment:
    """M consecutive usable samples of a trace, motion already smoothed.

    rows: (M,) row numbers in the trace, of the next sample where they were brought to an even clock. time: (M,) s.
    period: s. theta, theta_dot, theta_ddot, torque: (M, n), rad and N m. moving: (M, n), False at rest and, for all
    joints, within `EDGE` of the ends and where something is carried. noise: (n,) rad rms of the positions, which came
    every `sampled` s. held: s for which each torque stood in the log, where that is more than a sample. angular: False
    where joints go along a line: m and N for rad and N m.
    """

    rows: np.ndarray
    time: np.ndarray
    period: float
    theta: np.ndarray
    theta_dot: np.ndarray
    theta_ddot: np.ndarray
    torque: np.ndarray
    moving: np.ndarray
    noise: np.ndarray | None = None
    sampled: float = 0.0
    held: float = 0.0
    angular: bool = True


def usable(trace: Trace) -> np.ndarray:
    """(N,) bool: rows without a flag that spoils position, torque or time."""
    return (trace.flags & np.uint32(UNUSABLE)) == 0 if len(trace.flags) else np.ones(len(trace), bool)


def one_period(parts: Sequence[tuple[str, Segment]]) -> float:
    """Sample time s of segments, each with the name of its log.

    Raises:
        DataError: they are of several rates, naming two logs.
    """
    first, period = parts[0][0], parts[0][1].period
    for name, segment in parts:
        if abs(segment.period / period - 1.0) > SAME_RATE:
            times = f"{1e3 * segment.period:.3g} ms between samples, {first} has {1e3 * period:.3g} ms"
            raise DataError(f"{name}: {times}: give logs with the same sample rate")
    return period


def segments_of(traces: Sequence[Trace]) -> list[list[Segment]]:
    """`segments` of each trace, at one rate where their samples came at one.

    Logs of one recorder are polled all or none. One that hardly moves, or that a coarse encoder read, does not show it
    and would stay at the rate of its stamps beside the others' preferred one.

    Raises:
        TraceError: no part is long enough, naming the file.
    """
    found = [segments(trace) for trace in traces]
    steps = [float(np.median(np.diff(trace.time[usable(trace)]))) for trace in traces]
    if _one_rate([parts[0].period for parts in found]) or not _one_rate(steps):
        return found
    return [segments(trace, polled=True) for trace in traces]


def _one_rate(periods: Sequence[float]) -> bool:
    return max(periods) <= (1.0 + SAME_RATE) * min(periods)


def segments(trace: Trace, polled: bool = False) -> list[Segment]:
    """The parts of `trace` that no gap, no step back of its clock and no unusable row interrupts and that outlast the
    filters' ends.

    Samples that were polled, at instants of their own, are brought to an even clock by straight lines between them, of
    a preferred rate (10, 12.5, 16, 20, ... Hz), so that several such logs have one. polled: they were, whether
    they show it or not.

    Raises:
        TraceError: no part is long enough, naming the file.
    """
    good = np.flatnonzero(usable(trace))
    if len(good) < 2:
        raise TraceError(f"{trace.path}: {len(good)} usable rows of {len(trace)}")
    time, position, torque = trace.time[good], trace.position[good], trace.torque[good]
    steps = np.diff(time)
    period = float(np.median(np.abs(steps)))
    _check_scale(trace, period, len(good), torque)
    shortest = round(LEAST_S / period)
    polled = polled or _polled(time, position)
    gap = steps > (LONGEST_HOLE if polled else LONGEST_STEP) * period
    ends = np.flatnonzero(gap | _set_back(trace, good, steps, period)) + 1
    every = np.split(np.arange(len(good)), ends)
    parts = [part for part in every if len(part) >= shortest]
    if polled and parts:
        rate = float(np.mean([(len(part) - 1) / np.ptp(time[part]) for part in parts]))
        period = 1.0 / 10 ** (round(10 * np.log10(rate)) / 10)
    result = []
    for part in parts:
        mine = time[part], position[part], torque[part]
        if polled:
            count = round(np.ptp(mine[0]) / period) + 1
            clock = mine[0][0] + period * np.arange(count)
            part = part[np.clip(np.searchsorted(mine[0], clock), 0, len(part) - 1)]
            mine = clock, between(clock, mine[0], mine[1]), between(clock, mine[0], mine[2])
        segment = _segment(good[part], *mine, period, trace.angular)
        segment.moving[(trace.flags[segment.rows] & np.uint32(SampleFlag.LOADED)) != 0] = False
        result.append(segment)
    if not result:
        longest = max(len(part) for part in every) * period
        raise TraceError(
            f"{trace.path}: the longest part without a fault lasts {longest:.3g} s; at least {LEAST_S:g} s are needed"
        )
    return result


def _check_scale(trace: Trace, period: float, usable_rows: int, torque: np.ndarray) -> None:
    """
    Raises:
        TraceError: rows so far apart, or torques so small, that no unit in use was meant; or hardly two usable rows
            one behind the other, as in noise.
    """
    steps = np.diff(trace.time)
    if period > LONGEST_STEP * np.median(steps[steps > 0]):
        raise TraceError(
            f"{trace.path}: {usable_rows} of {len(trace)} rows are usable, but hardly any two in succession: this is "
            "not the motion of a machine (deltatwin inspect shows what is wrong with the other rows)"
        )
    if note := implausible_rate(period):
        raise TraceError(f"{trace.path}: {note}")
    if 0 < np.abs(torque).max() < LEAST_TORQUE:
        raise TraceError(f"{trace.path}: no torque exceeds {np.abs(torque).max():.3g}: is its unit N m?")


def _set_back(trace: Trace, good: np.ndarray, steps: np.ndarray, period: float) -> np.ndarray:
    """Whether the clock was set back between one row of `good` and the next, (len(good) - 1,) bool: what lies behind is
    another run, wherever its stamps fall. Behind a single stamp that is wrong the clock goes on as it did before."""
    back = np.cumsum(trace.flags & np.uint32(SampleFlag.TIME_BACKWARDS) != 0) if len(trace.flags) else 0 * trace.time
    return (steps < 0) | ((np.diff(back[good]) > 0) & (steps < 0.5 * period * np.diff(good)))


def _polled(time: np.ndarray, position: np.ndarray) -> bool:
    """Whether samples were taken at the uneven instants that their stamps say, not evenly by a clock whose stamps
    jitter: then the motion is smoother by the stamps, or there are short holes."""
    if len(time) < FEWEST:
        return False
    steps = np.diff(time)
    period = float(np.median(steps))
    early, late = np.quantile(steps, [0.05, 0.95])
    if late - early < JITTER * period:
        return False
    if np.mean((steps > LONGEST_STEP * period) & (steps < LONGEST_HOLE * period)) > HOLES:
        return True
    even = np.linspace(time[0], time[-1], len(time))
    return bool((position_noise(between(even, time, position)) < SMOOTHER * position_noise(position)).any())


def between(clock: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(M, n) values at `clock` (M,) on straight lines between those (N, n) at `time` (N,)."""
    return np.stack([np.interp(clock, time, column) for column in values.T], axis=1)


def position_noise(position: np.ndarray) -> np.ndarray:
    """(n,) rms of the white noise of evenly sampled positions (N, n), from their fourth differences, in which a motion
    leaves next to nothing."""
    fourth = np.abs(np.diff(position, 4, axis=0))
    typical = np.median(fourth, axis=0) / 0.6745  # of a normal distribution
    coarse = np.sqrt(np.mean(fourth**2, axis=0))  # where most samples repeat the last: an encoder's steps
    repeated = typical <= ROUNDING * np.abs(position).max(axis=0)
    return np.where(repeated, coarse, typical) / 70**0.5


def _segment(
    rows: np.ndarray, time: np.ndarray, position: np.ndarray, torque: np.ndarray, period: float, angular: bool
) -> Segment:
    theta, theta_dot, theta_ddot = smooth(position, period)
    mask = moving(position, period, angular)
    edge = round(EDGE / period)
    mask[:edge] = mask[-edge:] = False
    noise = position_noise(position)
    return Segment(rows, time, period, theta, theta_dot, theta_ddot, torque, mask, noise, period, angular=angular)


def resolved_hz(parts: Sequence[Segment]) -> float:
    """Frequency, at most `ANALYSIS_HZ`, below which the noise of the positions is no more than `NOISY` of their
    acceleration.

    Noise in a regressor shrinks what it multiplies: a coarse encoder makes an inertia light.
    """
    period = parts[0].period
    cutoff = min(ANALYSIS_HZ, MOTION_SHARE / period)
    while cutoff > LEAST_HZ:
        signal, noise = np.zeros((2, parts[0].theta.shape[1]))
        for part in parts:
            if part.noise is not None:
                # of white noise, twice differentiated, what passes a sharp low-pass
                rms = part.noise * (2 * np.pi) ** 2 * cutoff**2.5 * (2 * part.sampled / 5) ** 0.5
                signal += (lowpass(part.theta_ddot, part.period, cutoff) ** 2 * part.moving).sum(axis=0)
                noise += rms**2 * part.moving.sum(axis=0)
        live = signal > 0
        if not live.any() or np.median(noise[live] / signal[live]) <= NOISY**2:
            break
        cutoff /= NARROWER
    return max(cutoff, LEAST_HZ)


def held(torque: np.ndarray, period: float) -> int | None:
    """Samples for which each value of a torque (N, n) is held before the drive's next, on the joint with the shortest:
    1 where one is not held. None where too little changes to tell."""
    held_for = []
    for column in torque.T:
        change = np.diff(column)
        places = np.flatnonzero(change)
        if len(places) >= HELD_CHANGES:
            gaps, size = np.diff(places), np.abs(change[places])
            alone = np.mean(gaps < 2) <= HELD_EXCEPT and np.median(size) > HELD_STEP * size.min()
            samples = round(np.median(gaps))
            held_for.append(samples if alone and samples * period <= HELD_MOST else 1)
    return min(held_for, default=None)


def stands(parts: Sequence[Segment]) -> int:
    """Samples for which each torque of the segments of one machine is held, 1 where it is not on one of them."""
    found = [samples for part in parts if (samples := held(part.torque, part.period)) is not None]
    return round(np.median(found)) if min(found, default=1) > 1 else 1


def _anew(segment: Segment, samples: int) -> Segment:
    """The samples at which a torque held for so many `samples` comes anew; those of a joint whose torque comes at other
    times are read off a curve through its own."""
    changes = [np.flatnonzero(np.diff(column)) + 1 for column in segment.torque.T]
    start = int(np.argmax(np.bincount(np.concatenate(changes) % samples, minlength=samples)))
    rows = np.arange(start, len(segment.time), samples)
    torque = segment.torque[rows]
    for joint, places in enumerate(changes):
        if len(places) >= HELD_CHANGES and np.mean(places % samples != start) > HELD_EXCEPT:
            from scipy.interpolate import make_interp_spline

            inside = rows.clip(places[0], places[-1])
            torque[:, joint] = make_interp_spline(places, segment.torque[places, joint], 3)(inside)
    return replace(_every(segment, rows, torque), held=samples * segment.period)


def _every(segment: Segment, rows: np.ndarray, torque: np.ndarray) -> Segment:
    """Evenly spaced `rows` (K,) of a segment, with a torque (K, n) of their own."""
    return replace(
        segment,
        rows=segment.rows[rows],
        time=segment.time[rows],
        period=segment.period * float(rows[1] - rows[0]),
        theta=segment.theta[rows],
        theta_dot=segment.theta_dot[rows],
        theta_ddot=segment.theta_ddot[rows],
        torque=torque,
        moving=segment.moving[rows],
    )


def thin(segment: Segment) -> Segment:
    """Every k-th sample of `segment`, the torque low-passed for it, at no less than `RATE`."""
    step = int(1.0 / (RATE * segment.period) + 1e-6)
    if step < 2:
        return segment
    return _every(segment, np.arange(0, len(segment.time), step), _decimated(segment.torque, step))


def _decimated(values: np.ndarray, step: int) -> np.ndarray:
    """Every `step`-th of (N, n), low-passed below half that rate without a shift; beyond the ends is nothing.

    What SciPy's `decimate` gives with `ftype="fir"`.
    """
    reach = TAPS * step
    weights = np.sinc(np.arange(-reach, reach + 1) / step) * np.hamming(2 * reach + 1)
    padded = np.pad(values, ((reach, reach), (0, 0)))
    return sliding_window_view(padded, len(weights), axis=0)[::step] @ (weights / weights.sum())


def fresh(parts: Sequence[Segment]) -> list[Segment]:
    """`thin` of the segments of one machine; of a torque that the drive holds, the samples at which it comes anew: the
    others say nothing new, and say it late."""
    samples = stands(parts)
    if samples > 1:
        parts = [_anew(part, samples) for part in parts]
    return [thin(part) for part in parts]


def delayed(values: np.ndarray, seconds: float, period: float) -> np.ndarray:
    """(N, ...) later by `seconds`, fractions of a sample by cubic Lagrange interpolation; the ends are held.

    Four taps round the instant: below a tenth of the sample rate the error is under 0.1 %.
    """
    samples = seconds / period
    if samples == 0.0:
        return values
    flat = np.ascontiguousarray(values.reshape(len(values), -1), np.float64)
    result = np.empty_like(flat)
    _delayed(flat, samples, result)
    return result.reshape(values.shape)


@kernel(nogil=True)
def shift_weights(samples):
    """Cubic Lagrange interpolation `samples` back: four weights, and the place of the first, the oldest, in samples
    from where it is asked for."""
    whole = math.floor(samples)
    u = samples - whole
    weights = (
        u * (u - 1) * (u + 1) / 6,
        -u * (u - 2) * (u + 1) / 2,
        (u - 1) * (u - 2) * (u + 1) / 2,
        -u * (u - 1) * (u - 2) / 6,
    )
    return weights, -whole - 2


@kernel(nogil=True)
def _delayed(values, samples, result):
    """Fill result (N, C)."""
    count, width = values.shape
    weights, first = shift_weights(samples)
    w0, w1, w2, w3 = weights
    for k in range(count):
        a, b, c, d = k + first, k + first + 1, k + first + 2, k + first + 3
        if a < 0 or d >= count:
            a, b = min(max(a, 0), count - 1), min(max(b, 0), count - 1)
            c, d = min(max(c, 0), count - 1), min(max(d, 0), count - 1)
        for i in range(width):
            result[k, i] = w0 * values[a, i] + w1 * values[b, i] + w2 * values[c, i] + w3 * values[d, i]


def lagging(values: np.ndarray, cutoff_hz: float, period: float) -> np.ndarray:
    """(N, ...) behind a first-order low-pass, settled at the start.

    Exact where values go straight from sample to sample: one that holds them would be half a sample early or late.
    """
    keep, mean = ramp(period / time_constant(cutoff_hz))
    flat = np.ascontiguousarray(values.reshape(len(values), -1), np.float64)
    result = np.empty_like(flat)
    _lagging(mean, keep, flat, result)
    return result.reshape(values.shape)


@kernel(nogil=True)
def ramp(steps):
    """What a first-order low-pass keeps of its value, and the mean of that, over `steps` time constants."""
    keep = math.exp(-steps)
    return keep, (1.0 - keep) / steps


@kernel(nogil=True)
def _lagging(mean, keep, values, result):
    """Fill result (N, C), settled at the first row. mean, keep: share of the row before, and of its result."""
    count, width = values.shape
    state = mean * values[0]
    for k in range(count):
        for c in range(width):
            result[k, c] = (1.0 - mean) * values[k, c] + state[c]
            state[c] = (mean - keep) * values[k, c] + keep * result[k, c]


def leading(values: np.ndarray, cutoff_hz: float, period: float) -> np.ndarray:
    """(N, ...) such that a first-order low-pass makes `values` of it; fourth-order slopes."""
    held = np.pad(values, ((2, 2), *([(0, 0)] * (values.ndim - 1))), mode="edge")
    slope = (held[:-4] - 8.0 * held[1:-3] + 8.0 * held[3:-1] - held[4:]) / (12.0 * period)
    return values + time_constant(cutoff_hz) * slope


@kernel(nogil=True)
def _recursion(values, keep, result):
    for c in range(values.shape[1]):
        state = 0.0j
        for k in range(len(values)):
            state = keep * state + values[k, c]
            result[k, c] = state


def recursion(values: np.ndarray, keep: complex) -> np.ndarray:
    """(N, C) complex: each row of `values` (N, C) and `keep` times the result before it, from nothing on.

    What `scipy.signal.lfilter([1], [1, -keep], values, axis=0)` gives.
    """
    result = np.empty(values.shape, np.complex128)
    _recursion(np.ascontiguousarray(values, np.float64), complex(keep), result)
    return result


def time_constant(cutoff_hz: float) -> float:
    """s of a first-order low-pass."""
    return 0.5 / (np.pi * cutoff_hz)


def running_mean(values: np.ndarray, width: int, ends: Literal["edge", "constant"] = "edge") -> np.ndarray:
    """(N, ...) means over `width` rows round each, one more before it than after where that is even. ends: beyond them
    is what they are, or nothing."""
    before = width // 2
    pad = ((before + 1, width - before - 1), *([(0, 0)] * (values.ndim - 1)))
    total = np.cumsum(np.pad(values, pad, mode=ends), axis=0)
    return (total[width:] - total[:-width]) / width


@dataclass(frozen=True)
class Band:
    """The analysis band: a zero-phase low-pass, then every `step`-th sample."""

    cutoff_hz: float
    period: float
    step: int

    @classmethod
    def of(cls, period: float, cutoff_hz: float = ANALYSIS_HZ) -> Band:
        """Keeps about five samples a period of the cut-off: at their Nyquist frequency the filter has fallen by 60 dB;
        by 44 where a rate that is no multiple leaves fewest of them."""
        cutoff = min(cutoff_hz, 0.2 / period)
        return cls(cutoff, period, max(1, round(1.0 / (5.0 * cutoff * period))))

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """(N, ...) to (M, ...)."""
        return lowpass(values, self.period, self.cutoff_hz, self.step)

    @cached_property
    def passes(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies, Hz, evenly up to half the sample rate, and the share of a signal's power there that passes."""
        sections, _ = _sections(2.0 * self.cutoff_hz * self.period)
        share = np.linspace(0.0, 0.5, 8192, endpoint=False)
        back = np.exp(-2j * np.pi * share[:, None]) ** np.arange(3)  # by so many samples
        response = np.prod((back @ sections[:, :3].T) / (back @ sections[:, 3:].T), axis=1)
        return share / self.period, np.abs(response) ** 4

    @property
    def white_share(self) -> float:
        """Share of a white signal's power that passes."""
        return float(np.mean(self.passes[1]))
