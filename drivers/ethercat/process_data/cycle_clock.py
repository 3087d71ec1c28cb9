"""The time of a cycle, the cycle time, and which cycles are missing."""

from __future__ import annotations

import numpy as np

from drivers.ethercat.frames import u32
from drivers.ethercat.process_data.frame_state import CAPTURE_CLOCK, DISTRIBUTED_CLOCK, INTERVALS, UNDECIDED, new_state
from schemas.kernels import kernel
from schemas.messages import SampleFlag

STOPPED_CYCLES, STOPPED_NS = 20, 20_000_000  # without a frame for the longer of the two: they have stopped
GAP_PERIODS = 1.5  # a step of the stamps above this many cycles has lost cycles
_PERIOD_AFTER = 16  # cycles before the cycle time is known
BUNCHED_SHARE = 0.2  # of the steps below a tenth of the mean step: stamps of bunches; catching up gives single ones
BUNCHED = (
    "stamps come in bunches, as the network card coalesces interrupts: the cycle time is computed from the number of "
    "frames, and missing cycles cannot be located (to switch it off: ethtool -C INTERFACE rx-usecs 0)"
)
_CATCH_UP = 64  # cycles after a gap in which late ones can turn out not to be lost


@kernel
def stamp_kernel(time, clock):
    """Bus time of the cycle that this frame completes, ns; `time` is the capture's."""
    ticks = clock.dc_now
    clock.dc_now = 0
    if clock.mode == UNDECIDED:
        clock.mode = DISTRIBUTED_CLOCK if ticks != 0 else CAPTURE_CLOCK
    if clock.mode == CAPTURE_CLOCK:
        return time
    if ticks != 0 and ticks != clock.dc_last:
        clock.dc_last = ticks
        clock.dc_offset = ticks - time
    return time + clock.dc_offset


@kernel
def distributed_clock_kernel(data, at, length, time, clock):
    """System time of the reference clock, ns since 2000; 32-bit clocks are continued over their wraps.

    time: ns of the capture, whose clock tells how often a 32-bit one has wrapped since it was last read.
    """
    low = u32(data, at)
    high = u32(data, at + 4) if length >= 8 else 0
    if high or not clock.dc_last:
        return low | (high << 32)
    expected = time + clock.dc_offset
    return expected + ((low - expected + (1 << 31)) & 0xFFFFFFFF) - (1 << 31)


@kernel
def interval_kernel(stamp, state):
    """Flags of the step from the last stamp to this one; keeps the cycle time."""
    clock, counts, intervals = state.clock, state.counts, state.intervals
    flags = 0
    number = counts.samples
    step = stamp - clock.last
    clock.last = stamp
    if number == 0:
        return flags
    if step < 0:
        counts.backwards += 1
        return SampleFlag.TIME_BACKWARDS.value
    period = clock.period
    catching_up = clock.owed > 0 and number - clock.since < _CATCH_UP
    if period > 0 and step > GAP_PERIODS * period:
        flags = SampleFlag.GAP_BEFORE.value
        lost = max((step + period // 2) // period - 1, 1)
        counts.gaps += 1
        if counts.sent > 0 and step >= max(STOPPED_CYCLES * period, STOPPED_NS):  # what was sent tells
            unanswered = min(max(state.passes.sent - 1, 0), lost)
            counts.pauses += lost - unanswered >= STOPPED_CYCLES
            counts.lost += unanswered
            return flags
        counts.lost += lost
        if not catching_up:
            clock.owed, clock.slip = 0, 0
        clock.owed += lost
        clock.slip += step - (lost + 1) * period
        clock.since = number
    elif catching_up:
        clock.slip += step - period
        if 2 * clock.slip < -period:  # nothing was lost: that cycle was late, and those behind it caught up
            clock.slip += period
            clock.owed -= 1
            counts.lost -= 1
    if step == 0:
        counts.repeated += 1
        return SampleFlag.REPEATED.value
    if not catching_up or 2 * step > period:  # cycles that run after a stall say nothing of the cycle time
        steps = clock.steps
        intervals[steps % INTERVALS] = step
        clock.steps = steps + 1
        if (steps + 1) % _PERIOD_AFTER == 0:
            clock.period = np.int64(np.median(intervals[: min(steps + 1, INTERVALS)]))
    return flags


@kernel
def _follow(times, state):
    for time in times:
        interval_kernel(time, state[0])
        state[0].counts.samples += 1


def lost_cycles(times: np.ndarray) -> int:
    """Cycles missing among (N,) int64 ns of one cyclic frame, without those that only were late."""
    state = new_state()
    _follow(times, state)
    return int(state["counts"]["lost"][0])


class Bunches:
    """Whether cycles are stamped in bunches, by a card that waits for several frames before it says that they came."""

    def __init__(self) -> None:
        self._steps = self._short = self._passed = 0

    def add(self, times: np.ndarray) -> None:
        """(N,) int64 ns of cycles one after the other."""
        steps = np.diff(times)
        steps = steps[steps >= 0]
        if len(steps):
            self._steps += len(steps)
            self._passed += int(steps.sum())
            self._short += int(np.count_nonzero(10 * steps < steps.mean()))

    @property
    def period_ns(self) -> float | None:
        """Mean cycle time, ns; None where cycles are stamped one by one."""
        bunched = self._steps > 2 and self._short > BUNCHED_SHARE * self._steps
        return self._passed / self._steps if bunched and self._passed else None
