"""What came in: counts by topic, holes in the sequences, time from sample to feed-forward."""

from __future__ import annotations

import numpy as np

from drivers.sequence import SequenceCounter
from schemas.messages import OF_DELTA, OF_JOINTS, SAMPLES, Role, SampleFlag, Topics, topics_of

INVALID = SampleFlag.NOT_A_NUMBER | SampleFlag.OUT_OF_RANGE

# Told of every n-th sample at a high rate and of none while filters start: a hole in their sequence is no loss.
THINNED = ("payload", "error", "friction", OF_JOINTS.payload, OF_JOINTS.error)
FEEDFORWARDS = (OF_DELTA.feedforward, OF_JOINTS.feedforward)  # a robot has one of them
_ANSWERS = (*FEEDFORWARDS, *THINNED)  # what the estimator's health counts as published
_WAITING = 1 << 17  # answers since its last health, 8 s at the fastest: beyond, none comes, and nothing can be told
_REMEMBERED = 1 << 15  # samples whose time is known when their feed-forward comes; 8 s at 4 kHz


class PublishedCount:
    """What the estimator says to have published beside what came: what is missing beyond the holes of `feedforward`.

    Zenoh's stamps of sending say which messages the count in a health message is about, so it is exact up to the last
    one. What is lost around a restart of the estimator, or while nobody hears its health, is not told.
    """

    def __init__(self) -> None:
        self._since: list[np.ndarray] = []  # sending times of answers since the last health
        self._waiting = 0
        self._told = 0  # of runs of the estimator that are over
        self._sequence = self._published = -1  # of the last health
        self._came = self._first = self._holes = 0  # answers since the first health of this run; its counts

    def came(self, sent_ns: np.ndarray) -> None:
        """Note (N,) answers."""
        self._since.append(sent_ns)
        self._waiting += len(sent_ns)
        if self._waiting > _WAITING:
            self._since.clear()
            self._waiting, self._sequence = 0, -1

    def said(self, health: np.void, sent_ns: int, holes: int) -> None:
        """Take the estimator's HEALTH record; all answers sent before it have come. holes: lost of `feedforward`."""
        sequence, published = int(health["sequence"]), int(health["published"])
        times = np.concatenate([*self._since, np.empty(0, np.int64)])
        later = times[times > sent_ns]
        self._since, self._waiting = [later], len(later)
        self._came += len(times) - len(later)
        if self._sequence < 0 or sequence <= self._sequence or published < self._published:
            self._told = self.lost(holes)
            self._came, self._first, self._holes = 0, published, holes
        self._sequence, self._published = sequence, published

    def lost(self, holes: int) -> int:
        """Messages of the thinned topics that were published and did not come."""
        return self._told + max(0, self._published - self._first - self._came - (holes - self._holes))


class Tally:
    """Running counts over all topics of a robot; `add` takes what the inboxes give.

    Of THINNED topics it can only be told together what was lost (`thinned_lost`), and only where Zenoh stamps.
    """

    def __init__(self, stamped: bool, topics: Topics = OF_DELTA) -> None:
        """stamped: whether the times given to `add` are those of sending. topics: of the kind of machine."""
        self.received = dict.fromkeys(topics_of(topics), 0)
        self.invalid = 0
        self._counters = {(topic, 0): SequenceCounter() for topic in self.received if topic not in ("health", *THINNED)}
        self._counters |= {("health", int(role)): SequenceCounter() for role in Role}  # each role counts its own
        self._published = PublishedCount() if stamped else None
        self._sequence = np.full(_REMEMBERED, -1, np.int64)
        self._sent = np.zeros(_REMEMBERED, np.int64)

    @property
    def thinned_lost(self) -> int | None:
        """Messages of THINNED topics that were lost, up to the estimator's last health; None: cannot be told."""
        return self._published.lost(self._holes) if self._published else None

    @property
    def _holes(self) -> int:
        """Feed-forward messages that were lost."""
        return sum(self.count(topic).lost for topic in FEEDFORWARDS)

    def add(self, topic: str, records: np.ndarray, sent_ns: np.ndarray) -> int:
        """Count (N,) records; how many sequence numbers were missed among them.

        The estimator's health comes after what it has sent before.
        """
        self.received[topic] += len(records)
        before = self.count(topic).lost
        if topic == "health":
            for role in Role:
                self._counters["health", int(role)].update_many(records["sequence"][records["role"] == role])
        elif topic not in THINNED:
            self._counters[topic, 0].update_many(records["sequence"])
        if self._published and topic in _ANSWERS:
            self._published.came(sent_ns)
        if self._published and topic == "health":
            for row in np.flatnonzero(records["role"] == Role.ESTIMATOR):
                self._published.said(records[row], int(sent_ns[row]), self._holes)
        if topic in SAMPLES:
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
        """The sequence counts of `topic`, or of all, added up; of all also what was lost of THINNED topics."""
        total = SequenceCounter()
        if topic is None:
            total.lost += self.thinned_lost or 0
        for (name, _), counter in self._counters.items():
            if topic in (None, name):
                total.lost += counter.lost
                total.repeated += counter.repeated
                total.out_of_order += counter.out_of_order
                total.restarts += counter.restarts
        return total
