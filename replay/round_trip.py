"""How long an answer takes: paced samples out, `feedforward` back, against the best echo that Zenoh's Python gives."""

from __future__ import annotations

import multiprocessing
import multiprocessing.process
import os
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker

import numpy as np
import zenoh

from drivers.bus import Bus, open_bus
from drivers.inbox import Inbox
from replay.realtime import go_realtime
from schemas.errors import BusError
from schemas.messages import FEEDFORWARD, NANOSECONDS, SAMPLE, Role, set_stamp
from service.stopping import stop_requested, terminate_as_interrupt

LEAD_NS = 20_000_000  # from the call to the first deadline
START_S = 300.0  # an estimator that compiles its kernels on a busy host takes a minute
WARM_UP = 200
BLOCKS = 4
_DEEP = 1 << 14
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
    """Sends samples as a player does and hears the answers; sequence and stamp rise over all calls of `probe`.

    Answers are awaited in a thread of their own, so that a late one does not hold up the samples behind it. The pacing
    sleeps and does not spin: spinning would keep the interpreter from that thread.
    """

    def __init__(self, bus: Bus, samples: np.ndarray, rate: float) -> None:
        """samples: (N,) SAMPLE records, sent round and round. rate: Hz."""
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
        listener = _Listener(self._answers)
        try:
            put, begin = self._publisher.put, time.monotonic_ns() + LEAD_NS
            for n, message in enumerate(messages):
                ahead = begin + n * self._period_ns - time.monotonic_ns()
                if ahead > 0:
                    time.sleep(ahead * 1e-9)
                sent_at[n] = time.monotonic_ns()
                put(message)
                if n % 1024 == 0:
                    show(n)
            time.sleep(STRAGGLE_S)
        finally:  # on Ctrl-C, too: the bus closes under it otherwise
            answers, arrival = listener.stop()
        order = answers["sequence"].astype(np.int64) - self._next
        mine = (order >= 0) & (order < count)
        self._next += count
        return RoundTrip(count, arrival[mine] - sent_at[order[mine]])


class _Listener(threading.Thread):
    """Takes answers as they come until it is stopped."""

    def __init__(self, inbox: Inbox) -> None:
        super().__init__(name="listener")
        self._inbox, self._taken, self._stopped = inbox, [inbox.take()], False
        self.start()

    def run(self) -> None:
        while not self._stopped:
            if self._inbox.wait(0.1):
                self._taken.append(self._inbox.take())

    def stop(self) -> tuple[np.ndarray, np.ndarray]:
        """All (N,) answers and their (N,) arrivals, ns CLOCK_MONOTONIC."""
        self._stopped = True
        self.join()
        answers, arrival = zip(*self._taken, strict=True)
        return np.concatenate(answers), np.concatenate(arrival)


def take_turns(
    answerers: Mapping[str, Callable[[str], object]],
    samples: np.ndarray,
    rate: float,
    count: int,
    show: Callable[[int], object],
) -> dict[str, list[RoundTrip]]:
    """Round trips to each of `answerers`, `BLOCKS` times in turns, so that all see the same machine.

    Each is called in a process of its own with the name of the robot whose samples it has to answer; it is ended with
    SIGTERM, and Ctrl-C does not reach it. Their runtime folder is theirs alone, beside the roles of a running robot.
    count: samples to each. show: is told how many have been sent.

    Raises:
        BusError: one of them ended or does not begin to listen.
    """
    context = multiprocessing.get_context("spawn")
    names = {what: f"latency-{number}" for number, what in enumerate(answerers)}
    trips: dict[str, list[RoundTrip]] = {what: [] for what in answerers}
    with tempfile.TemporaryDirectory(prefix="dt-") as folder, ExitStack() as stack:
        os.environ["XDG_RUNTIME_DIR"] = folder
        processes = {}
        for what, answer in answerers.items():
            processes[what] = context.Process(target=answer, args=(names[what],))
            with _without_interrupts():
                processes[what].start()
                stack.callback(_end, processes[what])
        go_realtime("latency")
        probers = {
            what: Prober(stack.enter_context(open_bus(name, Role.PLAYER)), samples, rate)
            for what, name in names.items()
        }
        give_up = time.monotonic() + START_S
        for what, prober in probers.items():
            while not prober.heard:
                if not processes[what].is_alive() or time.monotonic() > give_up:
                    raise BusError(f"{what}: ended, or did not subscribe within {START_S:g} s")
                time.sleep(0.05)
            prober.probe(WARM_UP, lambda _: None)  # the first samples design the filters
        done, block = 0, count // BLOCKS
        for _ in range(BLOCKS):
            for what, prober in probers.items():
                trips[what].append(prober.probe(block, lambda n, base=done: show(base + n)))
                done += block
    return trips


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Let Ctrl-C wait until this is left, and not reach a process that is started in here: while that starts, it would
    print a traceback.

    Raises:
        KeyboardInterrupt: it came.
    """
    resource_tracker.ensure_running()  # by the first start, and it would let interrupts through
    stopped, blocked = stop_requested(), signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        terminate_as_interrupt()
    if stopped():
        raise KeyboardInterrupt


def _end(process: multiprocessing.process.BaseProcess) -> None:
    process.terminate()
    process.join(10)


def echo(robot: str) -> None:
    """The least that can answer: a channel's `recv`, and the head of every sample goes back as a `feedforward`.

    Until KeyboardInterrupt, as the estimator of `robot` and with its privileges.
    """
    go_realtime("echo")
    with open_bus(robot, Role.ESTIMATOR) as bus:
        _echo(bus)


def _echo(bus: Bus) -> None:
    recv, put = bus.channel("sample", zenoh.handlers.FifoChannel(_DEEP)).recv, bus.publisher("feedforward").put
    size = FEEDFORWARD.dtype.itemsize  # both messages begin with header, stamp and sequence
    while True:
        put(recv().payload.to_bytes()[:size])
