"""The watch over simulated production motion, faster than real time: what comes on is named, and nothing else is.

uv run python -m tests.bench.bench_watch --seeds 1 2 3 --minutes 60

Robots are those of `drivers.plant.cases`, identified from its logs without an effect; the motion is pick-and-place.
Seconds to the name: motion from the change to the moment the diagnosis starts, and the time that it took.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from drivers.motion import MotionLimits, Planner
from drivers.plant.cases import PERIOD, Case, random_case, run_case
from drivers.plant.effects import EFFECTS
from drivers.plant.later import Later, changes
from drivers.plant.plant import Plant
from drivers.plant.simulate import simulate
from schemas.messages import WatchState
from schemas.robot import Robot
from schemas.trace import Trace
from service.identification.identify import identify
from service.identification.regression import summarise
from service.model.effects import catalogue
from service.model.nominal import pack
from service.watch.examine import examine
from service.watch.watch import Case as Rise
from service.watch.watch import Watch

TEN = (
    "stribeck_friction", "asymmetric_friction", "load_dependent_friction", "tool_mass", "arm_mass", "joint_spring",
    "hose_spring", "torque_scale", "torque_offset", "cogging",
)  # fmt: skip
ONSET, WHOLE = 60.0, 110.0  # s
PIECE = 120.0  # s simulated at a time while nothing changes
CHUNK = 500  # samples, as they come
SAME = {"torque_offset": "asymmetric_friction", "asymmetric_friction": "torque_offset"}  # no motion tells them apart


def production(case: Case, plant: Plant, seconds: float, seed: int, coming: dict[int, Plant] | None = None) -> Trace:
    """Picks, at nine tenths of the limits."""
    planner = Planner(case.robot, PERIOD, MotionLimits(speed=10.0, acceleration=240.0, torque=85.0))
    motion = planner.pick_and_place(np.random.default_rng([seed, 9]), seconds, (), 0.9)
    return simulate(plant, motion, changes=coming or {})


def identified(case: Case, seed: int) -> Robot:
    """The description from logs without an effect."""
    model = pack(case.robot)
    logs = [summarise(model, trace) for trace in run_case(case, (), seed) if trace.name.startswith("fit")]
    return identify(case.robot, logs).robot


def over(watch: Watch, samples: np.ndarray) -> tuple[Rise | None, int]:
    """Samples through the watch, to the first case; and seconds above the level."""
    raised = 0
    for k in range(0, len(samples), CHUNK):
        raised += sum(int(gap["state"][0]) == WatchState.RAISED for gap in watch.add(samples[k : k + CHUNK]))
        rise = watch.case()
        if rise is not None:
            return rise, raised
    return None, raised


def named(name: str, seed: int) -> bool:
    """One effect on one robot; prints what was found."""
    case = random_case(seed)
    robot = identified(case, seed)
    plant = Plant(case.robot, case.truth, (), PERIOD, seed)
    effect = EFFECTS[name].draw(np.random.default_rng([seed, 2]), case.truth, 1.0)
    trace = production(case, plant, WHOLE, seed, changes(plant, seed, [Later(effect, name, ONSET)]))
    rise, _ = over(Watch(robot), trace.samples())
    if rise is None:
        print(f"{name:28} seed {seed}: not risen")
        return False
    begin = time.perf_counter()
    found = examine(robot, rise, catalogue()).diagnosis
    took, waited = time.perf_counter() - begin, float(rise.after.time[-1]) - ONSET
    names = [one.name for one in found.effects]
    right = names[:1] in ([name], [SAME.get(name)])
    where = not right or not found.effects[0].joints or found.effects[0].joints == [j + 1 for j in effect.joints]
    print(
        f"{name:28} seed {seed}: {'named' if right and where else 'MISSED'} as {', '.join(names) or 'nothing'} "
        f"(joints {found.effects[0].joints if names else []}, truly {[j + 1 for j in effect.joints]}), "
        f"since {rise.since:.1f} s, after {waited:.0f} s + {took:.0f} s",
        flush=True,
    )
    return right and where


def quiet(seed: int, minutes: float) -> tuple[int, float]:
    """False alarms over unchanged motion, and times real time."""
    case = random_case(seed)
    watch, plant = Watch(identified(case, seed)), Plant(case.robot, case.truth, (), PERIOD, seed)
    alarms, spent, first = 0, 0.0, 0
    for piece in range(round(minutes * 60.0 / PIECE)):
        samples = production(case, plant, PIECE, seed + 1000 * piece).samples()
        samples["sequence"] += first
        first += len(samples)
        begin = time.process_time()
        rise, raised = over(watch, samples)
        spent += time.process_time() - begin
        alarms += rise is not None
        watch.diagnosing = False
        told = f"{raised} s above the level, {alarms} alarms"
        print(f"seed {seed}, {(piece + 1) * PIECE / 60:.0f} min: {told}", flush=True)
    return alarms, first * PERIOD / max(spent, 1e-9)


def main() -> None:
    """Print every case, then the share that is named and the false alarms."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--effects", nargs="*", choices=tuple(EFFECTS), default=TEN)
    parser.add_argument("--seeds", nargs="*", type=int, default=(1, 2, 3))
    parser.add_argument("--minutes", type=float, default=60.0, help="of unchanged motion")
    given = parser.parse_args()
    hits = [named(name, seed) for seed in given.seeds for name in given.effects]
    if hits:
        print(f"named right: {sum(hits)} of {len(hits)} (bound 90 %)")
    if given.minutes:
        alarms, speed = quiet(given.seeds[0], given.minutes)
        print(f"unchanged, {given.minutes:g} min: {alarms} false alarms (bound 0), core at {speed:.0f} times real time")


if __name__ == "__main__":
    main()
