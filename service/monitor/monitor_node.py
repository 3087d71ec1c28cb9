"""The monitor on the bus: everything a robot's roles say goes to disk, and once a second how they are doing."""

from __future__ import annotations

import time
from collections.abc import Callable

from drivers.bus import Bus
from drivers.health import Health
from drivers.inbox import sending
from schemas.messages import OF_DELTA, SAMPLES, HealthFlag, StopReason, Topics, topics_of
from service.monitor.tally import FEEDFORWARDS, Tally
from service.monitor.writer import WriterThread

CYCLE_S = 0.02
STALE_NS = 1_000_000_000
DEPTH = 1 << 15  # messages a topic's inbox holds: 4 s at 8 kHz


def _order(topic: str) -> int:
    return 2 if topic in SAMPLES else int(topic != "health")


class Monitor:
    """Call `step` every `CYCLE_S`; it empties the inboxes into the tally and the writer and publishes health."""

    def __init__(self, bus: Bus, writer: WriterThread, flags: HealthFlag, topics: Topics = OF_DELTA) -> None:
        self.tally = Tally(bus.stamped, topics)
        self._writer = writer
        self._flags = flags
        self.health = Health(bus, flags)
        # When the inboxes are emptied in this order, and their messages counted in the reverse one, the sample of every
        # feed-forward is known, and all that the estimator's health counts is there before it.
        self._inboxes = {topic: bus.subscribe(topic, DEPTH, sending) for topic in sorted(topics_of(topics), key=_order)}
        self._sample_at = time.monotonic_ns()

    def step(self) -> None:
        """Take what came."""
        taken = {topic: batch for topic, inbox in self._inboxes.items() if len((batch := inbox.take())[0])}
        gaps = []
        for topic, (records, sent) in reversed(taken.items()):
            missed = self.tally.add(topic, records, sent)
            if missed:
                gaps.append(
                    {"topic": topic, "missed": str(missed), "newest": str(records["sequence"][-1]),
                     "log_time": str(sent[-1])}
                )  # fmt: skip
        if any(topic in taken for topic in SAMPLES):
            self._sample_at = time.monotonic_ns()
        for topic in FEEDFORWARDS:
            if topic in taken:
                self.health.time_many(self.tally.latencies(*taken[topic]))
        if taken:
            self._writer.put((taken, gaps))
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
            "lost": counts.lost + self._writer.dropped, "repeated": counts.repeated,
            "out_of_order": counts.out_of_order, "rejected": self.rejected, "invalid": self.tally.invalid,
        }  # fmt: skip

    @property
    def rejected(self) -> int:
        """Payloads that were not the message of their key."""
        return sum(inbox.rejected for inbox in self._inboxes.values())


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
