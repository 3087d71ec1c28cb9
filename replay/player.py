"""Player: a trace onto the bus at the times it was recorded.

What holds: no sample is left out, sent twice or sent before its predecessor; the first goes out at its time, not in a
burst. A sample that is held up (by the scheduler, by a stuck subscriber) goes out as soon as it can, and those behind
it at twice their rate at most until the loop is back on time: deadlines are absolute and late ones are counted. After
five seconds of standing still it takes another five to be on time again.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from drivers.health import Health
from replay.clock import Pacer
from schemas.errors import TraceError
from schemas.messages import NANOSECONDS, NO_FRAME, SAMPLE, Message, StopReason, stamp_ns
from schemas.trace import Trace

LEAD_NS = 20_000_000  # from the call to the first deadline
REMEMBERED = 1 << 22  # lateness is kept for so many of the newest samples: 17 min at 4 kHz

_STAMP_AND_SEQUENCE = struct.Struct("<iI8sQ")
_STAMP_OFFSET: int = SAMPLE.dtype.fields["stamp_sec"][1]  # pyright: ignore[reportOptionalSubscript]


@dataclass(frozen=True)
class Schedule:
    """What is to be sent, and when.

    payload: N messages of `size` bytes, one behind the other. stamp, due: (N,) int64 ns, bus time and time since the
    start of a loop. sequence: (N,) int64. loops: times to play, 0 without end. A loop adds stamp_span, due_span (ns)
    and sequence_span. period_ns: median time between two samples as they go out.
    """

    payload: bytearray
    size: int
    stamp: np.ndarray
    due: np.ndarray
    sequence: np.ndarray
    loops: int
    stamp_span: int
    due_span: int
    sequence_span: int
    period_ns: int

    def __len__(self) -> int:
        return len(self.stamp)


@dataclass(frozen=True)
class Played:
    """What became of it: samples sent of those planned (None: without end), late ones, lateness of the newest, ns."""

    sent: int
    planned: int | None
    late: int
    lateness: np.ndarray


def schedule(
    trace: Trace,
    message: Message = SAMPLE,
    *,
    rate: float | None = None,
    speed: float = 1.0,
    loops: int = 1,
    start: float = 0.0,
    stop: float | None = None,
) -> Schedule:
    """Encode the samples of `trace` from `start` to `stop` (s after its first) and lay down when each goes out.

    message: of the machine's samples. rate: samples a second, evenly, instead of the recorded times. speed: how many
    times faster than that. The stamps stay those of the trace; over loops stamp and sequence rise on.

    Raises:
        TraceError: fewer than two samples in the range.
    """
    samples = trace.samples(message)
    since = stamp_ns(samples) - stamp_ns(samples)[0]
    chosen = np.flatnonzero(
        (since >= start * NANOSECONDS) & (since <= (np.inf if stop is None else stop * NANOSECONDS))
    )
    if len(chosen) < 2:
        until = "the end" if stop is None else f"{stop:g} s"
        raise TraceError(
            f"{trace.path}: {len(chosen)} samples from {start:g} s to {until}; it lasts {since[-1] / NANOSECONDS:.6g} s"
        )
    samples = samples[chosen[0] : chosen[-1] + 1]
    stamp = stamp_ns(samples)
    sequence = samples["sequence"].astype(np.int64)
    recorded = np.maximum.accumulate(stamp - stamp[0])  # where time goes back, send at once: order is what counts
    period = max(1, int(np.median(np.diff(stamp))))
    if rate is None:
        due, due_period = recorded / speed, period / speed
    else:
        due_period = NANOSECONDS / (rate * speed)
        due = np.arange(len(samples)) * due_period
    due = np.rint(due).astype(np.int64)
    return Schedule(
        payload=bytearray(samples.tobytes()),
        size=message.dtype.itemsize,
        stamp=stamp,
        due=due,
        sequence=sequence,
        loops=loops,
        stamp_span=int(stamp.max() - stamp.min()) + period,
        due_span=int(due[-1]) + round(due_period),
        sequence_span=int(sequence.max() - sequence.min()) + 1,
        period_ns=round(due_period),
    )


def play(
    schedule: Schedule,
    put: Callable[[bytes], object],
    health: Health | None,
    show: Callable[[int], object],
    ask: Callable[[], object] = lambda: None,
) -> Played:
    """Send until the schedule or Ctrl-C ends it.

    put: publishes one message. health: told how it goes, and why it ended. show: told how many were sent, now and then.
    ask: called after each sample, raises KeyboardInterrupt where one was lost.
    A sample is late when it goes out after the next one was due.
    """
    total = len(schedule) * schedule.loops
    kept = np.zeros(min(total, REMEMBERED) if total else REMEMBERED, np.int64)
    sent = late_count = 0
    if health is not None:  # what is called for the first time is slow
        health.time_one(0)
        health.publish(published=0)
    try:
        for sent, late in enumerate(_send(schedule, put), start=1):
            kept[(sent - 1) % len(kept)] = late
            late_count += late > schedule.period_ns
            if sent % 256 == 0:
                show(sent)
            if health is not None:
                health.time_one(late)
                if health.due:
                    health.publish(published=sent, late=late_count)
            ask()
    except KeyboardInterrupt:
        ended = StopReason.INTERRUPTED
    else:
        ended = StopReason.DONE
    show(sent)
    if health is not None:
        health.stop(ended, published=sent, late=late_count)
    order = np.roll(kept, -(sent % len(kept))) if sent > len(kept) else kept[:sent]
    return Played(sent, total or None, late_count, order)


def _send(schedule: Schedule, put: Callable[[bytes], object]) -> Iterator[int]:
    """Yield how late each sample went out, ns, after it did: what the caller does falls into the pause before the next.

    Stamp and sequence are written into the encoded message in that pause too, so that every loop costs the same.
    """
    payload, size, count = schedule.payload, schedule.size, len(schedule)
    stamp, due, sequence = (
        schedule.stamp.data,
        schedule.due.data,
        schedule.sequence.data,
    )
    pack = _STAMP_AND_SEQUENCE.pack_into
    start, loop, pace = time.monotonic_ns() + LEAD_NS, 0, Pacer()
    while schedule.loops == 0 or loop < schedule.loops:
        stamp_shift, sequence_shift = loop * schedule.stamp_span, loop * schedule.sequence_span
        begin = start + loop * schedule.due_span
        for i in range(count):
            offset = i * size
            pack(
                payload,
                offset + _STAMP_OFFSET,
                *divmod(stamp[i] + stamp_shift, NANOSECONDS),
                NO_FRAME,
                sequence[i] + sequence_shift,
            )
            message = bytes(payload[offset : offset + size])
            late = pace(begin + due[i])
            put(message)
            yield late
        loop += 1
