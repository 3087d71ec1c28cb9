"""A process on the bus for the tests: `bus_peer.py ROBOT ROLE count|send [N PERIOD_S]`; answers in JSON lines."""

import json
import signal
import sys
import time

from drivers.bus import open_bus
from drivers.sequence import SequenceCounter
from schemas.errors import BusError
from schemas.messages import SAMPLE, Role


def say(**what: object) -> None:
    print(json.dumps(what), flush=True)


def count(robot: str, role: Role) -> None:
    """Count samples; a line once ready, at every tenth of a second with news, and at SIGTERM."""
    running = True

    def stop(*_: object) -> None:
        nonlocal running
        running = False

    signal.signal(signal.SIGTERM, stop)
    counter, received, said, said_at = SequenceCounter(), 0, 0, 0.0
    with open_bus(robot, role) as bus:
        inbox = bus.subscribe("sample")
        say(ready=True)
        while running:
            if inbox.wait(0.1):
                records, _ = inbox.take()
                counter.update_many(records["sequence"])
                received += len(records)
            if received != said and time.monotonic() - said_at > 0.1:  # a pipe nobody reads yet must not fill up
                said, said_at = received, time.monotonic()
                say(received=received, newest=counter.newest, lost=counter.lost)
        say(
            end=True, received=received, newest=counter.newest, lost=counter.lost, repeated=counter.repeated,
            out_of_order=counter.out_of_order, restarts=counter.restarts, rejected=inbox.rejected,
        )  # fmt: skip


def send(robot: str, role: Role, total: int, period: float) -> None:
    """Wait for a subscriber, send `total` numbered samples, wait for SIGTERM."""
    with open_bus(robot, role) as bus:
        publisher = bus.publisher("sample")
        say(ready=True)
        while not publisher.heard:
            time.sleep(0.01)
        records = SAMPLE.empty(total)
        records["sequence"] = range(total)
        start = time.monotonic()
        for number, record in enumerate(records):
            publisher.put(record.tobytes())
            time.sleep(max(0.0, start + (number + 1) * period - time.monotonic()))
        say(sent=total)
        signal.sigwait({signal.SIGTERM})


if __name__ == "__main__":
    try:
        if sys.argv[3] == "count":
            count(sys.argv[1], Role[sys.argv[2]])
        else:
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
            send(sys.argv[1], Role[sys.argv[2]], int(sys.argv[4]), float(sys.argv[5]))
    except BusError as error:
        say(error=str(error))
        sys.exit(1)
