"""Replay lateness beside cyclictest's, in turns in one run, and what a subscriber lost.

    python -m tests.bench.bench_replay [--seconds 20] [--rounds 3] [--rates 1000 4000]

Both wake at the same rate under SCHED_FIFO 50 with locked memory. Needs root (or the privileges) and `cyclictest`.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from drivers.trace import write_trace
from replay.realtime import PRIORITY
from schemas.trace import Trace
from tests.bench.need import need

PEER = Path(__file__).parents[1] / "drivers" / "bus_peer.py"
COMMAND = Path(sys.executable).with_name("deltatwin")
ROBOT = """name = "bench"
[geometry]
active_link_length = 0.3
passive_link_length = 0.8
base_radius = 0.2
platform_radius = 0.05
[mass]
active_link = 1.0
passive_link = 0.2
platform = 0.5
"""
LINE = re.compile(r"sent (\d+) .*median ([\d.]+), p99 ([\d.]+), p99.9 ([\d.]+), max ([\d.]+) µs")


def cyclictest(rate: float, seconds: float) -> tuple[float, ...]:
    """Median, p99, p99.9, max wake-up latency in µs, and the number of wake-ups."""
    with tempfile.NamedTemporaryFile(suffix=".json") as out:
        subprocess.run(
            ["cyclictest", "-q", "-m", "-t1", f"-p{PRIORITY}", f"-i{round(1e6 / rate)}", f"-l{round(rate * seconds)}",
             "-h100000", f"--json={out.name}"],
            check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        thread = json.load(out)["thread"]["0"]
    latency = np.array([int(us) for us in thread["histogram"]])
    share = np.cumsum([thread["histogram"][str(us)] for us in latency]) / sum(thread["histogram"].values())
    return (
        *(float(latency[np.searchsorted(share, part)]) for part in (0.5, 0.99, 0.999)),
        thread["max"],
        thread["cycles"],
    )


def replay(folder: Path, rate: float, seconds: float) -> tuple[tuple[float, ...], dict]:
    """The same of `deltatwin replay`, and what a process that subscribed counted."""
    command = [
        "chrt",
        "-f",
        str(PRIORITY),
        sys.executable,
        PEER,
        "bench",
        "MONITOR",
        "count",
    ]  # in real time, as roles are
    said = folder / "peer.txt"  # a pipe that nobody reads for minutes would fill up and stop the peer
    with said.open("w") as stream:
        peer = subprocess.Popen(command, stdout=stream)
    while not said.read_text():
        time.sleep(0.05)
    loops = max(1, round(rate * seconds / 4000))
    done = subprocess.run(
        [COMMAND, "replay", folder / "log.mcap", "--robot", folder / "robot.toml", "--rate", str(rate),
         "--loop", str(loops), "--wait", "10"],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    peer.send_signal(signal.SIGTERM)
    peer.wait(30)
    counts = json.loads(said.read_text().splitlines()[-1])
    match = LINE.search(done.stdout)
    assert match, done.stdout + done.stderr
    sent, *lateness = map(float, match.groups())
    return (*lateness, sent), counts


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--seconds", type=float, default=20.0)
    arguments.add_argument("--rounds", type=int, default=3)
    arguments.add_argument("--rates", type=float, nargs="+", default=[1000.0, 4000.0])
    given = arguments.parse_args()
    need("cyclictest", root=True)
    with tempfile.TemporaryDirectory(prefix="dt-") as name:
        folder = Path(name)
        os.environ["XDG_RUNTIME_DIR"] = name
        (folder / "robot.toml").write_text(ROBOT)
        instants = np.arange(4000) / 4000.0
        position = 0.3 * np.sin(2 * np.pi * instants[:, None] + np.arange(3))
        write_trace(Trace(folder / "log.mcap", instants, position, position), folder / "log.mcap", "bench")
        print(f"{'':<11} {'Hz':>6} {'median':>9} {'p99':>9} {'p99.9':>9} {'max':>9} µs {'count':>9}")
        for rate in given.rates:
            for _ in range(given.rounds):
                show("cyclictest", rate, cyclictest(rate, given.seconds))
                figures, counts = replay(folder, rate, given.seconds)
                show("replay", rate, figures, f"received {counts['received']}, lost {counts['lost']}")


def show(what: str, rate: float, figures: tuple[float, ...], more: str = "") -> None:
    *lateness, count = figures
    print(f"{what:<11} {rate:>6.0f}", *(f"{us:>9.2f}" for us in lateness), f"  {count:>9.0f}  {more}", flush=True)


if __name__ == "__main__":
    main()
