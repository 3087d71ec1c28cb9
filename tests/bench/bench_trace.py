"""How fast traces load and save; MCAP beside the library alone. `uv run python -m tests.bench.bench_trace [N]`."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from docs.making.figures import store
from drivers.trace import read_trace, write_trace
from drivers.trace.mcap_file import read_samples
from replay.demo import ROBOT
from replay.process import process
from schemas.robot import load_robot
from schemas.trace import Trace

REPEATS = 7
FILE_ORDER = "mcap library alone, file order"


def main(count: int, stored: bool) -> None:
    """Print samples a second, median of interleaved runs, and the ratio to reading with the mcap library alone."""
    rng, robot = np.random.default_rng(0), load_robot(ROBOT)
    time_s = np.arange(count) / 4000
    position = 0.7 * np.sin(time_s)[:, None] * [1, 0.8, 0.6] + rng.normal(0, 1e-6, (count, 3))
    torque = rng.normal(0, 20, (count, 3))
    trace = Trace(Path("made"), time_s, position, torque, position, torque)
    with tempfile.TemporaryDirectory() as folder:
        mcap, csv = Path(folder, "a.mcap"), Path(folder, "a.csv")

        def library(in_log_order: bool) -> None:
            with mcap.open("rb") as stream:
                for _ in make_reader(stream).iter_messages(log_time_order=in_log_order):
                    pass

        def samples() -> None:
            with mcap.open("rb") as stream:
                read_samples(stream, mcap)

        runs: dict[str, Callable[[], object]] = {
            "write csv": lambda: write_trace(trace, csv),
            "write mcap": lambda: write_trace(trace, mcap),
            "mcap library alone, its default order": lambda: library(True),
            FILE_ORDER: lambda: library(False),
            "mcap -> sample records": samples,
            "mcap -> checked trace": lambda: read_trace(mcap),
            "mcap -> checked trace -> samples": lambda: read_trace(mcap).samples(),
            "mcap -> process replay, estimator behind": lambda: process(robot, read_trace(mcap).samples()),
            "csv -> checked trace": lambda: read_trace(csv),
        }
        process(robot, trace.samples()[:100])  # compiles
        taken: dict[str, list[float]] = {name: [] for name in runs}
        for _ in range(REPEATS):
            for name, run in runs.items():
                start = time.perf_counter()
                run()
                taken[name].append(time.perf_counter() - start)
    alone = np.median(taken["mcap library alone, its default order"])
    for name, seconds in taken.items():
        median = np.median(seconds)
        print(f"{name:40s} {count / median:12.0f} samples/s   {alone / median:6.2f} x library   n={len(seconds)}")
    ours, theirs = (np.median(taken[name]) for name in ("mcap -> process replay, estimator behind", FILE_ORDER))
    print(f"process replay from MCAP over {FILE_ORDER}: {theirs / ours:.2f}, bound 1.0")
    if stored:
        read = theirs / np.median(taken["mcap -> sample records"])
        figures = {"mcap_read": (round(read, 1), count, None), "replay_mcap": (round(theirs / ours, 2), count, None)}
        print(f"kept in {store('speed', figures)}")


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("samples", type=int, nargs="?", default=240_000)
    arguments.add_argument("--store", action="store_true", help="put the figures into results/speed.json")
    given = arguments.parse_args()
    main(given.samples, given.store)
