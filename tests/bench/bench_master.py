"""What the estimator inside the cycle costs the cycle: the same loop with and without it, in turns on one wire.

`uv run python tests/bench/bench_master.py [--minutes 10] [--rate 1000]`, as root.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from drivers.ethercat.course import course
from drivers.ethercat.master import Master, TorqueOffset, follow
from drivers.plant.motion import Planner
from replay.clock import wait_until
from replay.realtime import go_realtime
from service.cli.master import InCycle, nothing
from service.estimator.estimator import Estimator
from tests.drivers.ethercat import rig

TURN = 10.0  # s of each before the other's turn
TURNS = ("without", "with")


def main(minutes: float, rate: float) -> None:
    """Print both loops' cycle times and work, and the ratio of the standard deviations."""
    with tempfile.TemporaryDirectory() as name, rig.namespace("deltatwin-bench") as space:
        folder = Path(name)
        robot = rig.robot(folder)
        motion = Planner(robot, 1 / rate).pick_and_place(np.random.default_rng(0), TURN, (1.5,), speed=0.5)
        inside = InCycle(Estimator(robot, 1 / rate))
        segment = rig.SegmentProcess(space, "--robot", str(folder / "robot.toml"), "--rate", str(rate))

        def run() -> dict[str, list[np.ndarray]]:
            go_realtime("bench")
            found: dict[str, list[np.ndarray]] = {turn: [] for turn in TURNS}
            with Master(rig.NEAR, robot, 1 / rate, wait_until) as master:
                here = master.operate()
                offset = TorqueOffset(master.scale, None, 5000.0, 1 / rate)
                for number in range(2 * max(1, round(minutes * 60 / (2 * (TURN + 1))))):
                    turn = TURNS[number % 2]
                    plan = course(here, motion)
                    rows = np.zeros((len(plan), 4), np.int64)  # frame sent, work done, CPU time of the work, missed
                    feedforward = inside if turn == "with" else nothing
                    began_cpu = 0

                    def timed(sample, course_, k, feedforward=feedforward):  # the work begins when the frame is back
                        nonlocal began_cpu
                        began_cpu = time.thread_time_ns()
                        return feedforward(sample, course_, k)

                    for k, _ in enumerate(follow(master, plan, timed, offset)):
                        rows[k] = (
                            master.sent_ns, time.monotonic_ns(), time.thread_time_ns() - began_cpu, master.counts.missed
                        )  # fmt: skip
                    found[turn].append(rows)
                    here = plan.position[-1]
                    if sys.stderr.isatty():
                        print(f"\r{number + 1} turns", end="", file=sys.stderr)
            return found

        try:
            found = space.call(run)
        finally:
            segment.stop()
    report(found, 1 / rate)


def report(found: dict[str, list[np.ndarray]], period: float) -> None:
    """Cycle time: from frame to frame. Work: CPU time from the frame's return until the next command is ready."""
    deviations, central = {}, {}
    for turn, runs in found.items():
        cycle = np.concatenate([np.diff(rows[:, 0]) for rows in runs]) * 1e-3
        work = np.concatenate([rows[:, 2] for rows in runs]) * 1e-3
        missed = sum(int(rows[-1, 3] - rows[0, 3]) for rows in runs)
        ours = int((work > period * 1e6).sum())
        deviations[turn] = cycle.std()
        low, high = np.quantile(cycle, (0.0005, 0.9995))
        central[turn] = cycle[(cycle >= low) & (cycle <= high)].std()
        print(
            f"{turn:8s} {len(cycle)} cycles: time median {np.median(cycle):.1f}, std {cycle.std():.2f}, "
            f"p99 {np.quantile(cycle, 0.99):.1f}, p99.9 {np.quantile(cycle, 0.999):.1f}, max {cycle.max():.1f} µs; "
            f"missed {missed}, of which by our own work {ours}; "
            f"work median {np.median(work):.1f}, p99.9 {np.quantile(work, 0.999):.1f}, max {work.max():.1f} µs"
        )
    for what, values in (("all cycles", deviations), ("the middle 99.9 %, without what stopped the host", central)):
        print(f"ratio of standard deviations with/without, {what}: {values['with'] / values['without']:.2f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    main(**vars(parser.parse_args()))
