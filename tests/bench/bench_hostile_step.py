"""Millions of hostile samples through the estimator step: torque bounded, state finite, recovered in 50 ms.

uv run python -m tests.bench.bench_hostile_step [--samples 10000000] [--seed 1] [--states | --arm]

states: of a robot with every kind of state that an effect may have, gears, bristles and filters among them. arm: of an
arm of four joints.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from docs.making.figures import store
from drivers.trace import read_trace
from replay.demo import LOG, ROBOT
from schemas.robot import load_robot
from tests.bench.bench_step import with_states
from tests.service.arms import FOUR
from tests.service.estimator.test_bounds import strike
from tests.service.estimator.test_joints import described, known, moving
from tests.service.estimator.test_joints import strike as strike_arm


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--samples", type=int, default=10_000_000)
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--states", action="store_true", help="a robot with every kind of state")
    arguments.add_argument("--arm", action="store_true", help="an arm")
    arguments.add_argument(
        "--store", action="store_true", help="put the figures into results/bus.json or arm_online.json"
    )
    given = arguments.parse_args()
    if given.arm:
        count = hostile_arm(given.samples, given.seed)
        if given.store:
            print(f"kept in {store('arm_online', {'hostile': (0, count, None)})}")
        return
    robot = with_states(load_robot(ROBOT)) if given.states else load_robot(ROBOT)
    good = read_trace(LOG, robot).samples()[1200:1600]  # an empty move
    random, count, begin = np.random.default_rng(given.seed), 0, time.monotonic()
    while count < given.samples:
        # behind a restart amid a move gears swing on as they would from rest, until their damping has ended that
        count += strike(robot, good, random, rounds=100, left=0.2 if given.states else 0.05)
        print(f"\r{count} samples, {time.monotonic() - begin:.0f} s", end="", flush=True)
    print(": nothing out of its bounds")
    if given.store:
        print(f"kept in {store('bus', {'hostile_step': (0, count, 'with states' if given.states else None)})}")


def hostile_arm(samples: int, seed: int) -> int:
    """At least so many samples on an arm; how many."""
    with tempfile.TemporaryDirectory() as folder:
        arm = described(known(FOUR, Path(folder)))
    good, random, count, begin = moving(FOUR, 2.0), np.random.default_rng(seed), 0, time.monotonic()
    while count < samples:
        count += strike_arm(arm, good, random, rounds=20)
        print(f"\r{count} samples, {time.monotonic() - begin:.0f} s", end="", flush=True)
    print(": nothing out of its bounds")
    return count


if __name__ == "__main__":
    main()
