"""The monitor on the bus: everything a robot's roles say goes to disk, and once a second how they are doing."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from drivers.bus import Bus
from drivers.health import Health
from schemas.messages import TOPICS, HealthFlag, StopReason
from service.monitor.tally import Tally
from service.monitor.writer import WriterThread

CYCLE_S = 0.02
STALE_NS = 1_000_000_000
DEPTH = 1 << 16  # messages a topic's ring holds: 16 s at 4 kHz


class Monitor:
    """Call `step` every `CYCLE_S`; it empties the rings into the tally and the writer and publishes health."""

    def __init__(self, bus: Bus, writer: WriterThread, flags: HealthFlag) -> None:
        # Zenoh's threads stamp arrivals under the interpreter lock: 5 ms until a busy thread lets go would show there.
        sys.setswitchinterval(50e-6)
        self.tally = Tally()
        self._writer = writer
        self._flags = flags
        self.health = Health(bus, flags)
        # Feed-forward before sample: when the rings are emptied in this order its sample is always known.
        self._rings = {topic: bus.subscribe(topic, DEPTH) for topic in sorted(TOPICS, key=lambda t: t == "sample")}
        self._wall_ns = time.time_ns() - time.monotonic_ns()  # once: log time must not step with the host's clock
        self._sample_at = time.monotonic_ns()

    def step(self) -> None:
        """Take what came."""
        taken = {topic: batch for topic, ring in self._rings.items() if len((batch := ring.take())[0])}
        gaps = []
        for topic, (records, arrival) in taken.items():
            missed = self.tally.add(topic, records, arrival)
            if missed:
                gaps.append(
                    {"topic": topic, "missed": str(missed), "newest": str(records["sequence"][-1]),
                     "log_time": str(arrival[-1] + self._wall_ns)}
                )  # fmt: skip
        if "sample" in taken:
            self._sample_at = int(taken["sample"][1][-1])
        if "feedforward" in taken:
            self.health.time_many(self.tally.latencies(*taken["feedforward"]))
        if taken:
            self._writer.put(
                ({topic: (records, arrival + self._wall_ns) for topic, (records, arrival) in taken.items()}, gaps)
            )
        stale = time.monotonic_ns() - self._sample_at > STALE_NS
        self.health.flags = (
            self._flags
            | (HealthFlag.DISK_ERROR if self._writer.failed or self._writer.dropped else 0)
            | (HealthFlag.STALE_INPUT if stale else 0)
        )
        if self.health.due:
            self.health.publish(**self.counts())

    def counts(self) -> dict[str, int]:
        """Of the health message."""
        counts = self.tally.count()
        return {
            "received": sum(self.tally.received.values()), "published": self._writer.written,
            "lost": counts.lost + self.overflowed + self._writer.dropped, "repeated": counts.repeated,
            "out_of_order": counts.out_of_order, "rejected": self.rejected, "invalid": self.tally.invalid,
        }  # fmt: skip

    @property
    def overflowed(self) -> int:
        """Messages that found a ring full."""
        return sum(ring.lost for ring in self._rings.values())

    @property
    def rejected(self) -> int:
        """Payloads that were not the message of their key."""
        return sum(ring.rejected for ring in self._rings.values())


def run(monitor: Monitor, stopped: Callable[[], bool], show: Callable[[int], object]) -> None:
    """Step until `stopped`; `show` is told how many messages came."""
    with monitor.health:
        while not stopped():
            time.sleep(CYCLE_S)
            monitor.step()
            show(sum(monitor.tally.received.values()))
        monitor.step()
        monitor.health.stop(StopReason.INTERRUPTED, **monitor.counts())
        monitor.step()  # the last word goes on record too
