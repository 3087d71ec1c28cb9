"""What came in: counts by topic, holes in the sequences, time from sample to feed-forward."""

from __future__ import annotations

import numpy as np

from drivers.bus import SequenceCounter
from schemas.messages import TOPICS, Role, SampleFlag

INVALID = SampleFlag.NOT_A_NUMBER | SampleFlag.OUT_OF_RANGE

# Told of every n-th sample at a high rate and of none while filters start: a hole in their sequence is no loss.
THINNED = ("payload", "error")
_REMEMBERED = 1 << 15  # samples whose time is known when their feed-forward comes; 8 s at 4 kHz


class Tally:
    """Running counts over all topics of a robot; `add` takes what the inboxes give.

    Of THINNED topics it cannot be told what was lost.
    """

    def __init__(self) -> None:
        self.received = dict.fromkeys(TOPICS, 0)
        self.invalid = 0
        self._counters = {(topic, 0): SequenceCounter() for topic in TOPICS if topic not in ("health", *THINNED)}
        self._counters |= {("health", int(role)): SequenceCounter() for role in Role}  # each role counts its own
        self._sequence = np.full(_REMEMBERED, -1, np.int64)
        self._sent = np.zeros(_REMEMBERED, np.int64)

    def add(self, topic: str, records: np.ndarray, sent_ns: np.ndarray) -> int:
        """Count (N,) records; how many sequence numbers were missed among them."""
        self.received[topic] += len(records)
        before = self.count(topic).lost
        if topic == "health":
            for role in Role:
                self._counters["health", int(role)].update_many(records["sequence"][records["role"] == role])
        elif topic not in THINNED:
            self._counters[topic, 0].update_many(records["sequence"])
        if topic == "sample":
            self.invalid += int(np.count_nonzero(records["flags"] & INVALID))
            sequence = records["sequence"].astype(np.int64)
            self._sequence[sequence % _REMEMBERED] = sequence
            self._sent[sequence % _REMEMBERED] = sent_ns
        return max(0, self.count(topic).lost - before)

    def latencies(self, feedforward: np.ndarray, sent_ns: np.ndarray) -> np.ndarray:
        """(M,) ns from the sending of a sample to that of its feed-forward, for those of `feedforward` that have both.

        Where Zenoh stamps no sending times these are the times of taking, with the monitor's cycle between them.
        """
        sequence = feedforward["sequence"].astype(np.int64)
        known = self._sequence[sequence % _REMEMBERED] == sequence
        return sent_ns[known] - self._sent[sequence[known] % _REMEMBERED]

    def count(self, topic: str | None = None) -> SequenceCounter:
        """The sequence counts of `topic`, or of all, added up."""
        total = SequenceCounter()
        for (name, _), counter in self._counters.items():
            if topic in (None, name):
                total.lost += counter.lost
                total.repeated += counter.repeated
                total.out_of_order += counter.out_of_order
                total.restarts += counter.restarts
        return total
