"""How long an answer takes: paced samples out, `feedforward` back, against a bare Zenoh echo in the same run."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.bus import Bus
from replay.clock import wait_until
from schemas.messages import FEEDFORWARD, NANOSECONDS, SAMPLE, set_stamp

LEAD_NS = 20_000_000  # from the call to the first deadline
STRAGGLE_S = 0.5  # how long the last answers are waited for


@dataclass(frozen=True)
class RoundTrip:
    """sent: samples. latency: (answers,) ns from the call that sent a sample to the arrival of its answer."""

    sent: int
    latency: np.ndarray

    @property
    def lost(self) -> int:
        return self.sent - len(self.latency)


class Prober:
    """Sends samples as a player does and hears the answers; sequence and stamp rise over all calls of `probe`."""

    def __init__(self, bus: Bus, samples: np.ndarray, rate: float) -> None:
        """samples: (N,) SAMPLE records, sent round and round. rate: Hz."""
        # Zenoh's thread stamps the answers under the interpreter lock, which the pacing loop would keep for 5 ms
        sys.setswitchinterval(50e-6)
        self._publisher = bus.publisher("sample")
        self._answers = bus.subscribe("feedforward", 1 << 17)
        self._samples, self._period_ns = samples.copy(), round(NANOSECONDS / rate)
        self._next = 0

    @property
    def heard(self) -> bool:
        """Whether somebody takes the samples."""
        return self._publisher.heard

    def probe(self, count: int, show: Callable[[int], object]) -> RoundTrip:
        """Send `count` samples at the rate and collect what comes back."""
        sequence = np.arange(self._next, self._next + count, dtype=np.uint64)
        batch = self._samples[np.arange(self._next, self._next + count) % len(self._samples)].copy()
        batch["sequence"] = sequence
        set_stamp(batch, sequence.astype(np.int64) * self._period_ns)
        payload, size = batch.tobytes(), SAMPLE.dtype.itemsize
        messages = [payload[n * size : (n + 1) * size] for n in range(count)]
        sent_at = np.zeros(count, np.int64)
        put, begin = self._publisher.put, time.monotonic_ns() + LEAD_NS
        for n, message in enumerate(messages):
            wait_until(begin + n * self._period_ns)
            sent_at[n] = time.monotonic_ns()
            put(message)
            if n % 1024 == 0:
                show(self._next + n)
        time.sleep(STRAGGLE_S)
        answers, arrival = self._answers.take()
        order = answers["sequence"].astype(np.int64) - self._next
        mine = (order >= 0) & (order < count)
        self._next += count
        return RoundTrip(count, arrival[mine] - sent_at[order[mine]])


def echo(bus: Bus, stopped: Callable[[], bool] = lambda: False) -> None:
    """The least that can answer: the head of every sample goes back as a `feedforward`, through the same ring."""
    ring, put = bus.subscribe("sample"), bus.publisher("feedforward").put
    size = FEEDFORWARD.dtype.itemsize  # both messages begin with header, stamp and sequence
    while not stopped():
        if ring.wait(0.2):
            records, _ = ring.take()
            for n in range(len(records)):
                put(records[n : n + 1].tobytes()[:size])
