"""What the monitor loses and costs: a replay, a process that answers every sample on three topics, and the monitor.

    python -m tests.bench.bench_monitor [--seconds 20] [--rates 2000 4000]

At 2 kHz that is 8 000 messages a second, at 4 kHz 16 000.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from drivers.bus import open_bus
from drivers.trace import write_trace
from replay.realtime import go_realtime
from schemas.messages import HEALTH, TOPICS, Role
from schemas.trace import Trace
from tests.bench.bench_replay import COMMAND, ROBOT

ANSWERS = ("feedforward", "payload", "error")


def answer() -> None:
    """Publish the three results of an estimator for every sample, empty but for the sequence."""
    running = True

    def stop(*_: object) -> None:
        nonlocal running
        running = False

    signal.signal(signal.SIGTERM, stop)
    go_realtime("answer")
    with open_bus("bench", Role.ESTIMATOR) as bus:
        ring = bus.subscribe("sample")
        publishers = [(bus.publisher(topic), TOPICS[topic].empty(1)) for topic in ANSWERS]
        while running:
            if ring.wait(0.1):
                for sample in ring.take()[0]:
                    for publisher, record in publishers:
                        record["sequence"] = sample["sequence"]
                        publisher.put(record.tobytes())


def cpu_seconds(process: int) -> float:
    """Processor time of a process so far."""
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(folder: Path, rate: float, seconds: float) -> None:
    path = folder / f"{rate:.0f}.mcap"
    robot = folder / "robot.toml"
    monitor = subprocess.Popen([COMMAND, "monitor", "--robot", robot, "--out", path], stdout=subprocess.DEVNULL)
    answering = subprocess.Popen([sys.executable, __file__, "--answer"])
    time.sleep(4)
    before, start = cpu_seconds(monitor.pid), time.monotonic()
    loops = max(1, round(rate * seconds / 4000))
    subprocess.run(
        [COMMAND, "replay", folder / "log.mcap", "--robot", robot, "--rate", str(rate), "--loop", str(loops)],
        check=True, stdout=subprocess.DEVNULL,
    )  # fmt: skip
    used, elapsed = cpu_seconds(monitor.pid) - before, time.monotonic() - start
    time.sleep(1)
    answering.terminate()
    answering.wait()
    monitor.send_signal(signal.SIGINT)
    monitor.wait()
    with path.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        counts = {
            summary.channels[i].topic.rsplit("/")[-1]: n for i, n in summary.statistics.channel_message_counts.items()
        }
        health = np.frombuffer(
            b"".join(m.data for _, _, m in reader.iter_messages(["/deltatwin/bench/health"])), HEALTH.dtype
        )
    own = health[health["role"] == Role.MONITOR]
    missing = {topic: loops * 4000 - counts.get(topic, 0) for topic in ("sample", *ANSWERS)}
    latency = np.median(own["latency_median"][own["latency_median"] > 0]) * 1e6
    print(
        f"{4 * rate:.0f} messages/s for {elapsed:.1f} s: not in the file {missing}, lost {own['lost'][-1]}; "
        f"{used / elapsed:.2f} cores; sample to answer median {latency:.0f} µs",
        flush=True,
    )


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--seconds", type=float, default=20.0)
    arguments.add_argument("--rates", type=float, nargs="+", default=[2000.0, 4000.0])
    arguments.add_argument("--answer", action="store_true", help=argparse.SUPPRESS)
    given = arguments.parse_args()
    if given.answer:
        answer()
        return
    with tempfile.TemporaryDirectory(prefix="dt-") as name:
        os.environ["XDG_RUNTIME_DIR"] = name
        (Path(name) / "robot.toml").write_text(ROBOT)
        position = np.random.default_rng(0).normal(scale=1e-5, size=(4000, 3))  # noise: what compresses worst
        write_trace(Trace(Path("log"), np.arange(4000) / 4000.0, position, position), Path(name) / "log.mcap", "bench")
        for rate in given.rates:
            measure(Path(name), rate, given.seconds)


if __name__ == "__main__":
    main()
