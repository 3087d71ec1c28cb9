"""Round trip sample to feed-forward, in turns in one run: an echo in a callback, the echo with `recv()`, the estimator.

    python -m tests.bench.bench_round_trip [--rate 4000] [--count 40000]

Bounds at 4 kHz, estimator over recv() echo: median 1.25, p99 1.3, p99.9 1.5; at 8 kHz median 1.3; 0 lost.
"""

from __future__ import annotations

import argparse
import threading

import zenoh

from drivers.bus import open_bus
from drivers.trace import read_trace
from replay.demo import LOG, ROBOT
from replay.latency import take_turns
from replay.realtime import go_realtime
from schemas.keys import topic_key
from schemas.messages import FEEDFORWARD, Role
from schemas.robot import load_robot
from service.cli.latency import echo, estimator, latency_table, round_trips
from service.cli.output import console
from service.cli.signals import terminate_as_interrupt


def echo_in_callback(robot: str) -> None:
    """The way that does not pay: Zenoh's thread calls Python, which wakes a second thread, which answers."""
    terminate_as_interrupt()
    go_realtime("callback echo")
    came: list[bytes] = []
    ready = threading.Semaphore(0)

    def receive(sample: zenoh.Sample) -> None:
        came.append(sample.payload.to_bytes())
        ready.release()

    with open_bus(robot, Role.ESTIMATOR) as bus:
        put, size = bus.publisher("feedforward").put, FEEDFORWARD.dtype.itemsize
        bus._session.declare_subscriber(topic_key(robot, "sample"), zenoh.handlers.Callback(receive, indirect=False))
        try:
            while True:
                ready.acquire()
                put(came.pop(0)[:size])
        except KeyboardInterrupt:
            return


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--rate", type=float, default=4000.0)
    arguments.add_argument("--count", type=int, default=40_000)
    given = arguments.parse_args()
    samples = read_trace(LOG, load_robot(ROBOT)).samples()
    answerers = {"callback echo": echo_in_callback, "echo": echo, "estimator": estimator}
    trips = take_turns(answerers, samples, given.rate, given.count, lambda _: None)
    console().print(latency_table(given.rate, round_trips(trips)[1]))


if __name__ == "__main__":
    main()
