"""The health message of a role: once a second, at once when its flags change, and as its last word."""

from __future__ import annotations

import time
from types import TracebackType

import numpy as np

from drivers.bus import Bus
from schemas.errors import BusError, StorageError
from schemas.messages import HEALTH, HealthFlag, StopReason, set_stamp

PERIOD_NS = 1_000_000_000
CHANGE_NS = 20_000_000  # shortest between two messages for changed flags: one that flickers must not flood the bus
_WINDOW = 16384  # latencies kept between two messages; more than the fastest controller has cycles in a second
_MOST = (1 << 64) - 1  # where a count stands still
_DUPLICATE, _STOPPED = int(HealthFlag.DUPLICATE_SOURCE), int(HealthFlag.STOPPED)


class Health:
    """Standing condition, counts and latencies of the role behind `bus`.

    The role sets `flags` as things change and publishes whenever `due`, which is once a second and at once after a
    change; a flag that came and went between two messages is in the next one. DUPLICATE_SOURCE is added while two roles
    publish samples. What there is to time goes through `time_one` or `time_many`, ns. `stop` says the last word; at the
    end of a `with` block it is said for the role where it has not. (The death that says nothing is told by the
    liveliness token, `Bus.alive`.)
    """

    def __init__(self, bus: Bus, flags: HealthFlag = HealthFlag(0)) -> None:
        self.due_ns = time.monotonic_ns() + PERIOD_NS
        self.stopped = False
        self._bus = bus
        self._put = bus.publisher("health").put
        self._message = HEALTH.empty(1)
        self._message["role"] = bus.role
        self._latencies = np.zeros(_WINDOW, np.int64)
        self._timed = 0
        self._told = self._flags = int(flags)  # what stands at the start is for the first regular message
        self._raised = 0  # set since the last message, and not in it
        self._change_ns = 0  # when the next change may be told

    @property
    def flags(self) -> HealthFlag:
        """What stands now, but for DUPLICATE_SOURCE."""
        return HealthFlag(self._flags)

    @flags.setter
    def flags(self, flags: HealthFlag) -> None:
        self._flags = int(flags)
        self._raised |= self._flags & ~self._told

    @property
    def due(self) -> bool:
        """Whether it is time to publish."""
        now = time.monotonic_ns()
        return now >= self.due_ns or (self._standing() != self._told and now >= self._change_ns)

    def time_one(self, latency_ns: int) -> None:
        """Note one latency, ns."""
        self._latencies[self._timed % _WINDOW] = latency_ns
        self._timed += 1

    def time_many(self, latencies_ns: np.ndarray) -> None:
        """Note (N,) latencies, ns."""
        newest = latencies_ns[-_WINDOW:]
        self._latencies[(self._timed + np.arange(len(newest))) % _WINDOW] = newest
        self._timed += len(newest)

    def publish(self, **counts: int) -> None:
        """Publish now; `counts` are the message's count fields (received, published, lost, ...), the rest stay."""
        message, now, standing = self._message, time.monotonic_ns(), self._standing()
        set_stamp(message, time.time_ns())
        message["flags"] = standing
        for name, count in counts.items():
            message[name] = min(max(count, 0), _MOST)
        message["latency_median"], message["latency_p99"], message["latency_max"] = self._quantiles()
        self._put(message.tobytes())
        message["sequence"] += 1
        self._timed = 0
        self.due_ns = now + PERIOD_NS
        if standing != self._told:
            self._change_ns = now + CHANGE_NS
        self._told, self._raised = standing, 0

    def _quantiles(self) -> np.ndarray:
        """(3,) s: median, p99 and longest latency; a tenth of the time that sorting them would hold the role up."""
        timed = min(self._timed, _WINDOW)
        if not timed:
            return np.zeros(3)
        places = [timed // 2, timed * 99 // 100, timed - 1]
        return np.partition(self._latencies[:timed], places)[places] * 1e-9

    def stop(self, reason: StopReason, **counts: int) -> None:
        """Publish the last message of this role: STOPPED, and why."""
        self.stopped = True
        self._message["reason"] = reason
        self.publish(**counts)

    def _standing(self) -> int:
        return (
            self._flags
            | self._raised
            | (_DUPLICATE if self._bus.duplicate_source else 0)
            | (_STOPPED if self.stopped else 0)
        )

    def __enter__(self) -> Health:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if not self.stopped:
            self.stop(_reason(error))


def _reason(error: BaseException | None) -> StopReason:
    match error:
        case None:
            return StopReason.DONE
        case KeyboardInterrupt():
            return StopReason.INTERRUPTED
        case BusError():
            return StopReason.BUS_FAULT
        case StorageError():
            return StopReason.DISK_ERROR
        case _:
            return StopReason.ERROR
