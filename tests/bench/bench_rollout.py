"""The forward simulation against real time, on one core at 4 kHz: bare, and with the whole catalogue at once.

uv run python -m tests.bench.bench_rollout
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from docs.making.figures import store
from schemas.robot import EffectParameter, Robot
from service.rollout.gap import simulate
from service.rollout.packed import stretch
from tests.service.rollout.test_kernel import INJECTED, effect, identified, recorded

PERIOD = 0.25e-3  # s
HORIZON = 0.2  # s
RUNS = 40
ROUNDS = 5
BOUND = 50.0


def whole() -> Robot:
    """Every effect once; those that would make a joint of two masses twice share it out."""
    effects = [effect(name) for name in INJECTED if name not in ("torque_filter", "torque_delay")]
    for entry in effects:
        if "motor_share" in entry.parameters:
            entry.parameters["motor_share"] = EffectParameter(value=0.1)
    return identified(*effects)


def speed(robot: Robot) -> float:
    """Simulated over spent seconds, best of `ROUNDS`."""
    part = recorded(identified())
    seen = stretch(robot, part, part.theta)
    at = np.linspace(150, 900, RUNS).astype(int)
    samples = round(HORIZON / PERIOD) + 1
    rows = at[:, None, None] + np.arange(samples)[None, :, None] * (PERIOD / part.period)
    low = rows.astype(int)
    joint = np.arange(3)[None, None]
    torque = seen.torque[low, joint] + (rows - low) * (seen.torque[low + 1, joint] - seen.torque[low, joint])
    spent, angle = [], np.empty((1, 1, 3))
    for _ in range(ROUNDS + 1):
        begin = time.thread_time()
        angle = simulate(seen, seen.start[at], torque, part.time[at], PERIOD)
        spent.append(time.thread_time() - begin)
    good = float(np.mean(np.isfinite(angle[..., 0])))
    return good * RUNS * HORIZON / min(spent[1:])


def main() -> None:
    """Print both and what is asked."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--store", action="store_true", help="put the figures into results/rollout.json")
    given, rates = arguments.parse_args(), {}
    for name, key, robot in (("base model", "rate_base", identified()), ("whole catalogue", "rate_all", whole())):
        rates[key] = speed(robot)
        print(f"{name}: {rates[key]:.0f} times real time at {1 / PERIOD:.0f} Hz (bound {BOUND:g})")
    if given.store:
        print(f"kept in {store('rollout', {key: (round(rate), 1, None) for key, rate in rates.items()})}")


if __name__ == "__main__":
    main()
