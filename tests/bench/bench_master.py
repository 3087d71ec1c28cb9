"""What the estimator inside the cycle costs the cycle: the same loop with and without it, in turns on one wire.

    sudo python -m tests.bench.bench_master [--minutes 10] [--rate 1000] [--turn 30]

What the host does hits both alike, so the figure is the ratio of neighbouring turns. A missed cycle is put down to our
own work where that took longer than a cycle in processor time; to the frame where that came back later than the cycle
was long; to the host where the thread slept and was woken that late, or was put aside (`run_delay` of
/proc/thread-self/schedstat is the time it was ready and waited for a processor). A virtual processor that its host
takes away while it runs looks like own work: the turns without the estimator, which do none, tell how often.
"""

from __future__ import annotations

import argparse
import math
import os
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from docs.making.figures import store
from drivers.ethercat.setpoints import SetpointPlan
from drivers.ethercat.soem_master import Master, OffsetRamp, PositionRamp, follow
from drivers.motion import Planner
from replay.clock import wait_until
from replay.realtime import go_realtime
from service.estimator.estimator import Estimator
from service.feedforward_source import InCycle, nothing
from tests.drivers.ethercat import rig

TURNS = ("without", "with")
SENT, BACK, WORK, MISSED, RUN_DELAY = range(5)  # ns; work: processor time from the frame's return to the command
CENTRAL = 0.999  # share of the cycles, without what stopped the host


def main(minutes: float, rate: float, turn: float, stored: bool) -> None:
    """Print both loops' cycle times and work, and the ratio of the standard deviations."""
    with tempfile.TemporaryDirectory() as name, rig.namespace("deltatwin-bench") as space:
        folder = Path(name)
        robot = rig.robot(folder)
        motion = Planner(robot, 1 / rate).pick_and_place(np.random.default_rng(0), turn, (1.5,), speed=0.5)
        inside, course = InCycle(Estimator(robot, 1 / rate)), SetpointPlan(motion, robot.geometry.joint_range_rad)
        segment = rig.SegmentProcess(space, "--robot", str(folder / "robot.toml"), "--rate", str(rate))

        def run() -> dict[str, list[np.ndarray]]:
            go_realtime("bench")
            found: dict[str, list[np.ndarray]] = {kind: [] for kind in TURNS}
            schedstat = os.open("/proc/thread-self/schedstat", os.O_RDONLY)
            with Master(rig.NEAR, robot, 1 / rate, wait_until) as master:
                here = master.operate()
                fade = robot.limits.torque_fade_s
                offset, ahead = OffsetRamp(master.scale, math.inf, 5000.0, fade, 1 / rate), PositionRamp(fade, 1 / rate)
                for number in range(2 * max(1, round(minutes * 30 / turn))):
                    kind = TURNS[number % 2]
                    plan = course.begin(here)
                    rows = np.zeros((len(plan), 5), np.int64)
                    feedforward = inside if kind == "with" else nothing
                    began = back = 0

                    def timed(sample, course_, k, feedforward=feedforward):  # the work begins when the frame is back
                        nonlocal began, back
                        began, back = time.thread_time_ns(), time.monotonic_ns()
                        return feedforward(sample, course_, k)

                    before = resource.getrusage(resource.RUSAGE_THREAD)
                    for k, _ in enumerate(follow(master, plan, timed, offset, ahead)):
                        work = time.thread_time_ns() - began
                        delay = int(os.pread(schedstat, 64, 0).split()[1])
                        rows[k] = master.sent_ns, back, work, master.counts.missed, delay
                    after = resource.getrusage(resource.RUSAGE_THREAD)
                    found[kind].append(rows)
                    here = plan.position[-1]
                    aside, minor, major = (
                        getattr(after, name) - getattr(before, name) for name in ("ru_nivcsw", "ru_minflt", "ru_majflt")
                    )
                    print(
                        f"turn {number + 1}, {kind}: cycle time std {np.diff(rows[:, SENT]).std() * 1e-3:.2f} µs, "
                        f"{rows[-1, MISSED] - rows[0, MISSED]} missed, {aside} times put aside, "
                        f"page faults {minor} minor, {major} major",
                        file=sys.stderr,
                    )
            os.close(schedstat)
            return found

        try:
            found = space.call(run)
        finally:
            segment.stop()
    figures = report(found, 1e9 / rate)
    if stored:
        print(f"kept in {store('bus', {'master_cycle': figures})}")


def report(found: dict[str, list[np.ndarray]], period: float) -> tuple[float, int, str]:
    """Print cycle times, from frame to frame; returns the ratio of the standard deviations, the number of cycles with
    the estimator, and both. found: per turn (N, 5) int64, columns as above. period: ns."""
    deviations: dict[str, np.ndarray] = {}
    central: dict[str, np.ndarray] = {}
    for kind, runs in found.items():
        cycles = [np.diff(rows[:, SENT]) * 1e-3 for rows in runs]
        deviations[kind] = np.array([times.std() for times in cycles])
        central[kind] = np.array([_central_std(times) for times in cycles])
        ours, frame, host = np.sum([_blame(rows, period) for rows in runs], axis=0)
        cycle, work = np.concatenate(cycles), np.concatenate([rows[:, WORK] for rows in runs]) * 1e-3
        delay = np.concatenate([np.diff(rows[:, RUN_DELAY]) for rows in runs]) * 1e-3
        print(
            f"{kind:8s} {len(cycle)} cycles: time median {np.median(cycle):.1f}, std {cycle.std():.2f}, "
            f"p99 {np.quantile(cycle, 0.99):.1f}, p99.9 {np.quantile(cycle, 0.999):.1f}, max {cycle.max():.1f} µs; "
            f"work median {np.median(work):.1f}, p99.9 {np.quantile(work, 0.999):.1f}, max {work.max():.1f} µs; "
            f"waiting for a processor p99.9 {np.quantile(delay, 0.999):.1f}, max {delay.max():.1f} µs\n"
            f"         missed {ours + frame + host}: {ours} by our own work, {frame} by a late frame, {host} woken late"
        )
    for what, values in (("all cycles", deviations), (f"the middle {CENTRAL:.1%}", central)):
        pairs = values["with"] / values["without"]
        whole = np.sqrt((values["with"] ** 2).mean() / (values["without"] ** 2).mean())
        print(
            f"ratio of standard deviations with/without, {what}: {whole:.2f}; of neighbouring turns median "
            f"{np.median(pairs):.2f}, {pairs.min():.2f} to {pairs.max():.2f} ({len(pairs)} pairs)"
        )
    both = {kind: float(np.sqrt((values**2).mean())) for kind, values in deviations.items()}
    cycles_with = sum(len(rows) - 1 for rows in found["with"])
    return round(both["with"] / both["without"], 2), cycles_with, f"{both['with']:.0f} against {both['without']:.0f} µs"


def _central_std(times: np.ndarray) -> float:
    low, high = np.quantile(times, ((1 - CENTRAL) / 2, (1 + CENTRAL) / 2))
    return float(times[(times >= low) & (times <= high)].std())


def _blame(rows: np.ndarray, period: float) -> tuple[int, int, int]:
    """Missed cycles of one turn: by our own work, by a late frame, woken late."""
    missed = np.diff(rows[:, MISSED])
    ours = rows[:-1, WORK] > period
    frame = ~ours & (rows[:-1, BACK] - rows[:-1, SENT] > period)
    return int(missed[ours].sum()), int(missed[frame].sum()), int(missed[~ours & ~frame].sum())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--turn", type=float, default=10.0, help="s of each before the other's turn")
    parser.add_argument("--store", action="store_true", help="put the figure into results/bus.json")
    given = parser.parse_args()
    main(given.minutes, given.rate, given.turn, given.store)
