"""Identification's speed, run by hand: python -m tests.bench.bench_identify

Ratios are measured turn by turn on the same machine state; the absolute times hold for the machine they were taken on.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.trace import read_trace, write_trace
from schemas.robot import Geometry, Mass, Robot, load_robot
from schemas.trace import Trace
from service.identification import paper_method
from service.identification.from_traces import identify
from service.identification.regression import NormalEquations, summarise
from service.model import signals
from service.model.nominal import pack
from tests.service.identification.conftest import Truth, multisine, synthesise
from tests.service.model.test_signals import white_jerk

ROBOT = Robot(
    name="bench",
    geometry=Geometry(active_link_length=0.36, passive_link_length=0.85, base_radius=0.19, platform_radius=0.05),
    mass=Mass(active_link=2.7, passive_link=0.55, platform=1.3),
)
MODEL = pack(ROBOT)


def timed(function: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    start = clock()
    function()
    return clock() - start


def log(seconds: float, period: float) -> Trace:
    return synthesise(MODEL, 1, Truth(), multisine(1, seconds, 2.0, period), period)


def smoother() -> None:
    count, period = 4000, 1e-3
    position = log(count * period, period).position

    def reference() -> None:
        for joint in range(3):
            model = white_jerk(2 * np.pi * signals.MOTION_HZ * period)
            model.x = np.array([[position[0, joint]], [0.0], [0.0]])
            means, covariances, _, _ = model.batch_filter(position[:, joint], update_first=True)
            model.rts_smoother(means, covariances)

    signals.smooth(position, period)
    ratios = []
    for _ in range(7):
        ours = timed(lambda: [signals.smooth(position, period) for _ in range(20)]) / 20
        ratios.append(timed(reference) / ours)
    print(
        f"smoother, {count} samples x 3: filterpy takes {np.median(ratios):.0f} times as long (least {min(ratios):.0f})"
    )


def linearity() -> None:
    logs = {seconds: log(seconds, 1e-3) for seconds in (15.0, 30.0, 60.0, 120.0)}
    least = {
        seconds: min(timed(lambda trace=trace: summarise(MODEL, trace)) for _ in range(5))
        for seconds, trace in logs.items()
    }
    rates = ", ".join(f"{seconds:g} s: {1e9 * least[seconds] / len(trace):.0f}" for seconds, trace in logs.items())
    print(f"pass over the samples at 1 kHz, ns a sample (least of 5): {rates}")


def methods() -> None:
    equations = [summarise(MODEL, synthesise(MODEL, s, Truth(), multisine(s, 8.0, 2.0, 1e-3), 1e-3)) for s in range(4)]
    fit = identify(ROBOT, equations)
    ratios = [
        timed(lambda: paper_method.means(equations)) / timed(lambda: identify(ROBOT, equations)) for _ in range(21)
    ]
    once = timed(lambda: paper_method.refit(equations, fit.fit))
    print(
        f"grid and friction over the pooled fit's time, sums alike: {np.median(ratios):.2f}; {1e3 * once:.1f} ms in all"
    )


def whole() -> None:
    """12 traces of 60 s at 4 kHz, from files."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        write_trace(log(60.0, 2.5e-4), path)
        reading = passing = 0.0
        cpu = time.process_time()
        equations: list[NormalEquations] = []
        for number in range(12):
            start = time.perf_counter()
            trace = read_trace(path, ROBOT)
            reading += time.perf_counter() - start
            trace = replace(trace, path=Path(f"log_{number}.csv"), torque=trace.torque + 1e-6 * number)
            start = time.perf_counter()
            equations.append(summarise(MODEL, trace))
            passing += time.perf_counter() - start
        solving = timed(lambda: identify(ROBOT, equations))
        cpu = time.process_time() - cpu
        size = path.stat().st_size / 1e6
    total = reading + passing + solving
    print(
        f"12 x 60 s x 4 kHz: {total:.2f} s = reading {reading:.2f} ({size:.0f} MB each) + passing {passing:.2f} "
        f"+ solving {solving:.2f}; {cpu:.2f} s of processor time over all threads"
    )


def four_logs() -> None:
    """The four fit logs of a reference case (about 25 s at 1 kHz), after start-up."""
    folder = Path(__file__).resolve().parents[3] / "shared" / "plant_logs" / "case_000"
    paths = sorted(folder.glob("fit_*.csv"))
    if not paths:
        print("no ../shared: four reference logs not timed")
        return

    robot = load_robot(folder / "robot.toml")

    def whole_way() -> None:
        identify(robot, [summarise(pack(robot), read_trace(path, robot)) for path in paths])

    whole_way()
    times = [timed(whole_way) for _ in range(7)]
    cpu = min(timed(whole_way, time.process_time) for _ in range(7))
    print(
        f"four reference logs, read, passed, fitted: {np.median(times):.3f} s (most {max(times):.3f}), "
        f"{cpu:.3f} s of processor time"
    )


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    for part in (smoother, linearity, methods, four_logs, whole):
        part()
