"""One estimator step, bytes in to bytes out, beside the same in plain NumPy; and process replay from memory.

uv run python -m tests.bench.bench_step

In turns of a second of samples; and behind a pause of a millisecond each, when caches hold what others left there. Also
of a robot with every kind of state that an effect may have: gears, bristles, encoders, a late and filtered report.
"""

from __future__ import annotations

import argparse
import gc
import time
from functools import partial

import numpy as np

from docs.making.figures import store
from drivers.trace import read_trace
from replay.demo import LOG, ROBOT
from replay.process import process
from replay.realtime import go_realtime
from schemas.messages import SAMPLE
from schemas.robot import EffectEntry, EffectParameter, Robot, load_robot
from service.estimator.estimator import Estimator
from tests.bench.numpy_step import NumpyEstimator

LOOPS = 4  # of the demo log: 40 000 steps
BLOCK = 1000  # steps of the one, then of the other: shorter turns would time the caches that the other one emptied
PAUSED = 4000  # steps behind a pause
STATES = {
    "joint_elasticity": {"natural_hz": 20.0, "damping_ratio": 0.03, "motor_share": 0.3},
    "presliding_friction": {"f_1": 2.0, "f_2": 2.0, "f_3": 2.0, "distance": 0.02},
    "encoder_eccentricity": {"order": 1.0, **{f"{of}_{n}": 1e-4 for of in ("cosine", "sine") for n in (1, 2, 3)}},
    "load_dependent_friction": {"mu_1": 0.05, "mu_2": 0.05, "mu_3": 0.05, "motor_share": 0.0},
    "torque_delay": {"delay": 0.002}, "torque_filter": {"cutoff": 60.0}, "drive_lag": {"cutoff": 60.0},
}  # fmt: skip


def with_states(robot: Robot) -> Robot:
    """`robot` with all of `STATES`."""
    entries = []
    for name, values in STATES.items():
        given = {key: EffectParameter(value=value) for key, value in values.items()}
        joints = [] if name.startswith(("torque", "drive")) else [1, 2, 3]
        entries.append(EffectEntry(name=name, joints=joints, parameters=given))
    return robot.model_copy(update={"effect": entries})


def main(stored: bool) -> None:
    robot = load_robot(ROBOT)
    samples = np.tile(read_trace(LOG, robot).samples(), LOOPS)
    samples["sequence"] = np.arange(len(samples))
    time_ns = np.arange(len(samples)) * 1_000_000
    samples["stamp_sec"], samples["stamp_nanosec"] = np.divmod(time_ns, 10**9)
    size, data = SAMPLE.dtype.itemsize, samples.tobytes()
    messages = [data[n * size : (n + 1) * size] for n in range(len(samples))]
    messages, paused = messages[:-PAUSED], messages[-PAUSED:]
    compiled, plain = Estimator(robot, 1e-3), NumpyEstimator(robot, 1e-3)
    states = Estimator(with_states(robot), 1e-3)
    compiled.warm_up()

    def answer(estimator: Estimator, message: bytes) -> None:
        estimator.step(message)
        estimator.feedforward.tobytes()
        if estimator.look_back() >= 0:
            estimator.payload.tobytes()
            estimator.error.tobytes()

    ours, stateful = partial(answer, compiled), partial(answer, states)
    for message in messages[:200]:
        ours(message)
        stateful(message)
        plain.step(message)
    go_realtime("bench")
    gc.disable()
    taken = {name: np.zeros(len(messages)) for name in ("compiled", "states", "NumPy")}
    for begin in range(0, len(messages), BLOCK):  # in turns, so that both see the same machine
        for name, step in (("compiled", ours), ("states", stateful), ("NumPy", plain.step)):
            for n in range(begin, min(begin + BLOCK, len(messages))):
                start = time.perf_counter_ns()
                step(messages[n])
                taken[name][n] = time.perf_counter_ns() - start
    taken["paused"] = np.zeros(PAUSED)
    for n, message in enumerate(paused):
        time.sleep(1e-3)
        start = time.perf_counter_ns()
        ours(message)
        taken["paused"][n] = time.perf_counter_ns() - start
    print(f"{'step, µs':<10} {'median':>8} {'p99':>8} {'p99.9':>8} {'max':>9} {'count':>7}")
    for name, nanoseconds in taken.items():
        values = np.quantile(nanoseconds, [0.5, 0.99, 0.999, 1.0]) * 1e-3
        print(f"{name:<10} {values[0]:8.2f} {values[1]:8.2f} {values[2]:8.2f} {values[3]:9.2f} {len(nanoseconds):7d}")
    print(f"NumPy / compiled, median: {np.median(taken['NumPy']) / np.median(taken['compiled']):.1f}")
    rates = []
    for _ in range(5):
        begin = time.perf_counter()
        process(robot, samples)
        rates.append(len(samples) / (time.perf_counter() - begin))
    print(f"process replay from memory: median {np.median(rates):.0f} samples/s of 5 runs of {len(samples)}")
    if stored:
        print(f"kept in {store('speed', _figures(taken, rates))}")


def _figures(taken: dict[str, np.ndarray], rates: list[float]) -> dict[str, tuple[float, int, str | None]]:
    """For `results/speed.json`."""
    told = {}
    for key, name in (("step_median", "compiled"), ("step_states", "states"), ("step_paused", "paused")):
        median, p99, p999 = np.quantile(taken[name], [0.5, 0.99, 0.999]) * 1e-3
        told[key] = (round(float(median), 1), len(taken[name]), f"p99 {p99:.1f}, p99.9 {p999:.1f}")
    ratio = float(np.median(taken["NumPy"]) / np.median(taken["compiled"]))
    told["step_numpy"] = (round(ratio), len(taken["compiled"]), None)
    told["replay_rate"] = (round(float(np.median(rates)), -3), len(rates), None)
    return told


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--store", action="store_true", help="put the figures into results/speed.json")
    main(parser.parse_args().store)
