"""Latency of the tap beside a bare AF_PACKET read of the same frames, at the same time, on a veth pair.

    sudo python -m tests.bench.bench_tap [--cycles 40000] [--rates 1000 4000] [--store]

Four processes under SCHED_FIFO: a master that sends every cycle twice (out and back), a reader that only receives, the
tap, and a subscriber of its samples. Latencies count from the kernel's stamp of the returned frame (CLOCK_REALTIME).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from docs.making.figures import store
from drivers.bus import open_bus
from drivers.ethercat.live_tap import FRAME_BYTES, InterfaceSource, Tap
from drivers.health import Health
from replay.clock import wait_until
from replay.realtime import go_realtime
from schemas.messages import Role, stamp_ns
from tests.bench.need import need
from tests.drivers.ethercat.rig import FAR, NEAR, namespace
from tests.drivers.ethercat.wire import cycle, passes, robot


def master(rate: float, cycles: int) -> None:
    """Send both passes of each cycle at its deadline."""
    frames = [passes(cycle(number), cycle(number - 1), index=number) for number in range(256)]
    go_realtime("master", 60)
    with socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0) as wire:
        wire.bind((FAR, 0))
        begin = time.monotonic_ns() + 200_000_000
        late = 0
        for number in range(cycles):
            late = max(late, wait_until(begin + int(number * 1e9 / rate)))
            for frame in frames[number % 256]:
                wire.send(frame)
    print(json.dumps({"late_max_us": late / 1e3}))


def bare(cycles: int) -> None:
    """Receive, note the time, nothing else."""
    source = InterfaceSource(NEAR)
    go_realtime("bare")
    buffer = bytearray(FRAME_BYTES)
    view, ages = memoryview(buffer), np.zeros(2 * cycles, np.int64)
    seen = 0
    while seen < 2 * cycles:
        got = source.receive(view)
        if got is not None:
            ages[seen] = time.time_ns() - got[1]
            seen += 1
        elif seen:
            break
    report({"received": seen // 2, "dropped": source.dropped()}, {"bare": ages[1:seen:2]})


def tap(cycles: int) -> None:
    """The tap as it is, noting when a sample is ready and when it is published."""
    tapping = Tap(InterfaceSource(NEAR), robot(), lambda line: print(line, file=sys.stderr))
    go_realtime("tap")
    ready, out = np.zeros(cycles, np.int64), np.zeros(cycles, np.int64)
    with open_bus("wired", Role.TAP) as bus:
        put = bus.publisher("sample").put
        count = 0

        def timed(message: bytes) -> None:
            nonlocal count
            ready[count] = time.time_ns()
            put(message)
            out[count] = time.time_ns()
            stamps[count] = int.from_bytes(message[4:8], "little") * 10**9 + int.from_bytes(message[8:12], "little")
            count += 1

        stamps = np.zeros(cycles, np.int64)
        with contextlib.suppress(KeyboardInterrupt):
            tapping.run(timed, Health(bus), cycles)
    ready, out, stamps = ready[:count], out[:count], stamps[:count]
    lost = tapping.assembler.count("lost")
    report({"samples": count, "lost": lost}, {"ready": ready - stamps, "published": out - stamps})


def subscriber(cycles: int) -> None:
    """Take the samples from Zenoh."""
    go_realtime("subscriber")
    arrivals, stamps = [], []
    with open_bus("wired", Role.OBSERVER) as bus:
        ring = bus.subscribe("sample")
        taken = 0
        while taken < cycles:
            if not ring.wait(5.0) and taken:
                break
            offset = time.time_ns() - time.monotonic_ns()
            records, arrival = ring.take()
            taken += len(records)
            arrivals.append(arrival + offset)
            stamps.append(stamp_ns(records))
    report({"received": taken}, {"subscriber": np.concatenate(arrivals) - np.concatenate(stamps)})


def report(counts: dict[str, int], latencies: dict[str, np.ndarray]) -> None:
    """Counts, and median, p99, p99.9 and maximum of (N,) ns in µs, as one line of JSON."""
    figures = {
        name: [round(float(np.percentile(values, part)) / 1e3, 2) for part in (50, 99, 99.9, 100)]
        for name, values in latencies.items()
    }
    print(json.dumps(counts | figures))


ROLES: dict[str, Callable[[int], None]] = {"bare": bare, "tap": tap, "subscriber": subscriber}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cycles", type=int, default=40_000)
    parser.add_argument("--rates", type=float, nargs="+", default=[1000, 4000])
    parser.add_argument("--store", action="store_true", help="put the figures of the last rate into results/bus.json")
    parser.add_argument("--role")
    arguments = parser.parse_args()
    if arguments.role == "master":
        master(arguments.rates[0], arguments.cycles)
        return
    if arguments.role:
        ROLES[arguments.role](arguments.cycles)
        return
    need("ip", root=True)
    said, over = {}, ""
    with tempfile.TemporaryDirectory(prefix="dt-") as folder, namespace("bench") as space:
        os.environ["XDG_RUNTIME_DIR"] = folder
        environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
        for rate in arguments.rates:

            def start(role: str, rate: float = rate) -> subprocess.Popen[str]:
                command = space.prefix(sys.executable, __file__, "--role", role, "--cycles", str(arguments.cycles))
                return subprocess.Popen(
                    [*command, "--rates", str(rate)], stdout=subprocess.PIPE, text=True, env=environment
                )

            with open_bus("wired", Role.MONITOR) as bus:
                health = bus.subscribe("health")
                listening = {role: start(role) for role in ("subscriber", "bare", "tap")}
                while not health.wait(1.0):  # the tap's first message: it listens
                    pass
                time.sleep(3)
                listening["master"] = start("master")
                print(f"{rate:g} Hz, {arguments.cycles} cycles (median, p99, p99.9, max in µs)")
                listening["master"].wait()
                time.sleep(2)
                listening["tap"].send_signal(signal.SIGINT)  # where it still waits for what it lost
            said = {role: json.loads(listening[role].communicate()[0]) for role in ("master", *ROLES)}
            for role, figures in said.items():
                print(f"  {role}: {json.dumps(figures)}")
            parts = zip(said["tap"]["published"], said["bare"]["bare"], strict=True)
            over = ", ".join(f"{tap / bare:.2f}" for tap, bare in parts)
            print(f"  tap over bare: {over}")
    if arguments.store:
        heard = said["subscriber"]
        notes = f"over a bare read, median, p99, p99.9, max: {over}"
        measured = {
            "tap_lost": (arguments.cycles - heard["received"], arguments.cycles, None),
            "tap_publish": (round(said["tap"]["published"][0]), arguments.cycles, notes),
        }
        print(f"kept in {store('bus', measured)}")


if __name__ == "__main__":
    main()
