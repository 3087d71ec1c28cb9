"""Where the messages of a subscription wait to be taken."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
import zenoh

from schemas.messages import CDR_LITTLE_ENDIAN, NANOSECONDS, Message

WAKE_S = 0.01  # to which a wait on a silent bus keeps its limit

_NEVER = (1 << 63) - 1  # ns
_AT_ONCE = 1 << 16  # messages taken in one call, so that a flood cannot keep it from returning
_BELIEVED_NS = NANOSECONDS  # a sender's stamp further off than that is no time of sending on this host


def arrival(_: zenoh.Sample) -> int:
    """Clock of an inbox: when the message was taken, ns CLOCK_MONOTONIC."""
    return time.monotonic_ns()


def sending(sample: zenoh.Sample) -> int:
    """Clock of an inbox: when the message was put on the bus, ns since 1970.

    Zenoh stamps it where all roles are on one host. Without a stamp, or with one that is not of this host's last
    second, it is the time at which the message was taken.
    """
    now, stamp = time.time_ns(), sample.timestamp
    if stamp is None:
        return now
    sent = stamp.get_time_as_ntp64().as_nanos()
    return sent if abs(now - sent) < _BELIEVED_NS else now


class Inbox:
    """Where a subscription's messages wait to be taken, by one thread: a Zenoh channel, filled without the interpreter.

    A message that finds it full pushes the oldest out, which leaves a hole in the sequence; a reader that is too slow
    never holds up the bus. Bytes that are not the message are counted in `rejected`.
    """

    def __init__(
        self,
        message: Message,
        channel: zenoh.Subscriber[zenoh.Handler[zenoh.Sample]],
        nudge: Callable[[], None],
        clock: Callable[[zenoh.Sample], int] = arrival,
    ) -> None:
        """nudge: puts an empty message into the channel. clock: what `take` says of each message."""
        self.message = message
        self.rejected = 0
        self._size = message.dtype.itemsize
        self._recv, self._try_recv = channel.recv, channel.try_recv
        self._clock = clock
        self._nothing = message.empty(0), np.empty(0, np.int64)
        self._payloads: list[bytes] = []
        self._times: list[int] = []
        self._nudge = nudge
        self._nudged = self._seen = 0  # empty messages of ours: put in (by the waker), taken out
        self._wake_ns = _NEVER
        self._waker: threading.Thread | None = None
        self._closed = threading.Event()

    def wait(self, longest: float) -> bool:
        """Sleep until there is something to take, at most `longest` s (and `WAKE_S`); whether there is.

        It looks for more before it sleeps and not after, so that a message is in the caller's hands as soon as may be.
        """
        self._drain()
        if not self._payloads:
            self._keep(self._sleep(longest))
        return bool(self._payloads)

    def take(self) -> tuple[np.ndarray, np.ndarray]:
        """All that came since the last call, oldest first: (N,) records and (N,) int64 times of the inbox's clock."""
        self._drain()
        if not self._payloads:
            return self._nothing
        records = np.frombuffer(bytearray().join(self._payloads), self.message.dtype)
        times = np.array(self._times, np.int64)
        self._payloads.clear()
        self._times.clear()
        return records, times

    def one(self, longest: float = 0.0) -> bytes | None:
        """The oldest message as it came, waited for at most `longest` s (and `WAKE_S`); None: none came, or no message.

        For who lives on one message at a time: what lies between `recv` and the answer counts twice and more, because
        a cycle leaves the caches cold. What `wait` has found is for `take`.
        """
        sample = self._try_recv()
        if sample is None:
            if not longest:
                return None
            sample = self._sleep(longest)
        payload = sample.payload.to_bytes()
        if len(payload) == self._size and payload.startswith(CDR_LITTLE_ENDIAN):
            return payload
        self._refuse(payload)
        return None

    def close(self) -> None:
        """End the waker; after that nobody may wait. (An interpreter that ends would tear it out of Zenoh's frames, and
        that aborts the process.)"""
        self._closed.set()
        if self._waker is not None:
            self._waker.join()

    def _drain(self) -> None:
        for _ in range(_AT_ONCE):
            sample = self._try_recv()
            if sample is None:
                return
            self._keep(sample)

    def _sleep(self, longest: float) -> zenoh.Sample:
        if self._waker is None:
            self._waker = threading.Thread(target=self._wake, name="waker", daemon=True)
            self._waker.start()
        self._wake_ns = time.monotonic_ns() + int(longest * 1e9)
        sample = self._recv()
        self._wake_ns = _NEVER
        return sample

    def _keep(self, sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        if len(payload) == self._size and payload.startswith(CDR_LITTLE_ENDIAN):
            self._payloads.append(payload)
            self._times.append(self._clock(sample))
        else:
            self._refuse(payload)

    def _refuse(self, payload: bytes) -> None:
        if not payload and self._nudged > self._seen:
            self._seen += 1
        else:
            self.rejected += 1

    def _wake(self) -> None:
        """End a wait that lasts too long: `recv` knows no timeout."""
        while not self._closed.wait(WAKE_S):
            if time.monotonic_ns() >= self._wake_ns:
                self._wake_ns = _NEVER
                self._nudged += 1
                self._nudge()
