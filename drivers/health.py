"""The health message a role publishes once a second."""

from __future__ import annotations

import time

import numpy as np

from drivers.bus import Bus
from schemas.messages import HEALTH, HealthFlag, set_stamp

PERIOD_NS = 1_000_000_000
_WINDOW = 16384  # latencies kept between two messages; more than the fastest controller has cycles in a second


class Health:
    """Standing condition, counts and latencies of the role behind `bus`.

    `flags` is the role's to change; DUPLICATE_SOURCE is added while two roles publish samples. `latencies` is where to
    put what there is to time since the last message, ns, through `time_one` or `time_many`.
    """

    def __init__(self, bus: Bus, flags: HealthFlag = HealthFlag(0)) -> None:
        self.flags = flags
        self.due_ns = time.monotonic_ns() + PERIOD_NS
        self._bus = bus
        self._put = bus.publisher("health").put
        self._message = HEALTH.empty(1)
        self._message["role"] = bus.role
        self._latencies = np.zeros(_WINDOW, np.int64)
        self._timed = 0

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
        """Publish now; `counts` are the message's count fields (received, published, lost, ...), the rest stay zero."""
        message, now = self._message, time.monotonic_ns()
        set_stamp(message, time.time_ns())
        message["flags"] = self.flags | (HealthFlag.DUPLICATE_SOURCE if self._bus.duplicate_source else 0)
        for name, count in counts.items():
            message[name] = count
        timed = np.sort(self._latencies[: min(self._timed, _WINDOW)]) * 1e-9
        message["latency_median"], message["latency_p99"], message["latency_max"] = (
            (timed[len(timed) // 2], timed[len(timed) * 99 // 100], timed[-1]) if len(timed) else (0.0, 0.0, 0.0)
        )
        self._put(message.tobytes())
        message["sequence"] += 1
        self._timed = 0
        self.due_ns = now + PERIOD_NS
