"""The watch over simulated production, faster than real time: what comes on is named, and nothing else is.

uv run python -m tests.bench.bench_watch --seeds 1 2 3 --minutes 60

Robots are those of `drivers.simulated.plant.cases`, identified from its logs without an effect; the motion is
pick-and-place with masses, of which the bus has the gripper or, with --no-gripper, the estimator alone tells. A watch
as `deltatwin watch` makes it learns for 30 s of free motion (18 s without a gripper, where less of it is free), at 60 s
the effect comes on.
Time to the name: from the change to the moment the diagnosis starts, in samples, and the processor's time of the
process that makes it and stores what it found. The unchanged hour is five motions of two minutes, each six times with
torque noise of its own.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from docs.making.figures import store
from drivers.motion import MotionLimits, Planner, Trajectory
from drivers.simulated.plant.cases import PERIOD, Case, random_case, run_case
from drivers.simulated.plant.effects import EFFECTS
from drivers.simulated.plant.plant import Plant
from drivers.simulated.plant.plant_trace import Course
from replay.process import process
from schemas.messages import Gripper, WatchState
from schemas.robot import Robot, save_robot
from schemas.trace import Trace
from service.identification.from_traces import identify
from service.identification.regression import summarise
from service.model.nominal import pack
from service.watch import watch_node
from service.watch.state_machine import Patience, Rise, Watch
from service.watch.watch_node import Examination

TEN = (
    "stribeck_friction", "asymmetric_friction", "load_dependent_friction", "tool_mass", "arm_mass", "joint_spring",
    "hose_spring", "torque_scale", "torque_offset", "cogging",
)  # fmt: skip
ONSET, WHOLE = 60.0, 110.0  # s
MASSES = (0.0, 0.5, 1.5)  # kg
PIECE, TIMES = 120.0, 6  # s simulated of an unchanged robot, and how often each piece comes
CHUNK = 500  # samples, as they come
WITHIN = 60.0  # s
SAME = {"torque_offset": "asymmetric_friction", "asymmetric_friction": "torque_offset"}  # no motion tells them apart


def production(case: Case, seconds: float, seed: int) -> Trajectory:
    """Picks, at nine tenths of the limits."""
    planner = Planner(case.robot, PERIOD, MotionLimits(speed=10.0, acceleration=240.0, torque=85.0))
    return planner.pick_and_place(np.random.default_rng([seed, 9]), seconds, MASSES, 0.9)


def along(plant: Plant, motion: Trajectory, first: int, last: int) -> np.ndarray:
    """(last - first, 2, 3): position and torque in these cycles of a motion that `plant` is in."""
    course, rows = Course(motion), np.empty((last - first, 2, 3))
    for k in range(first, last):
        rows[k - first, 0], rows[k - first, 1], _ = course.latch(plant, k, None)
        plant.run()
    return rows


def as_trace(motion: Trajectory, rows: np.ndarray, gripper: bool) -> Trace:
    """As the bus carries it."""
    closed = np.zeros(len(motion), bool)
    for load in motion.payloads:
        closed[round(load.pick / PERIOD) : round(load.release / PERIOD)] = True
    return Trace(
        Path("bus"),
        np.arange(len(rows)) * PERIOD,
        rows[:, 0],
        rows[:, 1],
        position_command=motion.position[: len(rows)],
        gripper=np.where(closed[: len(rows)], Gripper.CLOSED, Gripper.OPEN) if gripper else None,
    )


def identified(case: Case, seed: int) -> Robot:
    """The description from logs without an effect."""
    model = pack(case.robot)
    logs = [summarise(model, trace) for trace in run_case(case, (), seed) if trace.name.startswith("fit")]
    return identify(case.robot, logs).robot


def over(robot: Robot, watch: Watch, samples: np.ndarray) -> tuple[Rise | None, int]:
    """Samples through estimator and watch, to the first case; and seconds above the level."""
    raised, payload = 0, process(robot, samples).payload
    for k in range(0, len(samples), CHUNK):
        told = watch.add(samples[k : k + CHUNK], payload[k : k + CHUNK])
        raised += sum(int(gap["state"][0]) == WatchState.RAISED for gap in told)
        rise = watch.rise()
        if rise is not None:
            return rise, raised
    return None, raised


def named(robot: Robot, name: str, joints: list[int], seed: int, trace: Trace) -> bool:
    """Whether what came on at `ONSET` is; prints what was found."""
    patience = Patience() if trace.gripper is not None else Patience(learn=18.0)
    rise, _ = over(robot, Watch(robot, patience), trace.samples())
    if rise is None:
        print(f"{name:24} seed {seed}: not risen", flush=True)
        return False
    with TemporaryDirectory() as folder:
        found, took = examined(robot, rise, Path(folder))
    waited = float(rise.after.time[-1]) - ONSET
    names = [one["name"] for one in found["effects"]]
    where = found["effects"][0]["joints"] if names else []
    right = names[:1] in ([name], [SAME.get(name)]) and (not where or where == joints)
    late = waited + took > WITHIN
    print(
        f"{name:24} seed {seed}: {'named' if right else 'MISSED'}{', LATE' if late else ''} as "
        f"{', '.join(names) or 'nothing'} (joints {where}, truly {joints}), "
        f"since {rise.since:.1f} s, after {waited:.0f} s + {took:.0f} s",
        flush=True,
    )
    return right and not late


def examined(robot: Robot, rise: Rise, folder: Path) -> tuple[dict, float]:
    """The diagnosis in finding.json, and processor's s of the process that wrote it."""
    save_robot(robot, folder / "robot.toml")
    begin = spent_by_children()
    examination = Examination(folder / "robot.toml", None, folder, rise)
    while not examination.done:
        time.sleep(0.2)
    examination.result()
    (written,) = folder.glob("*/finding.json")
    return json.loads(written.read_text())["diagnosis"], spent_by_children() - begin


def spent_by_children() -> float:
    """Processor's s of processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def changed(names: list[str], seed: int, gripper: bool) -> list[bool]:
    """One robot, each of the effects coming on in the same motion."""
    case = random_case(seed)
    robot, motion, onset = identified(case, seed), production(case, WHOLE, seed), round(ONSET / PERIOD)
    plant = Plant(case.robot, case.truth, (), PERIOD, seed)
    plant.reset(motion.position[0])
    before, hits = along(plant, motion, 0, onset), []
    for name in names:
        effect = EFFECTS[name].draw(np.random.default_rng([seed, 2]), case.truth, 1.0)
        other = Plant(case.robot, case.truth, (effect,), PERIOD, seed)
        other.adopt(plant)
        rows = np.concatenate([before, along(other, motion, onset, round(WHOLE / PERIOD))])
        hits.append(named(robot, name, [joint + 1 for joint in effect.joints], seed, as_trace(motion, rows, gripper)))
    return hits


def quiet(seed: int, minutes: float, gripper: bool) -> tuple[int, float]:
    """False alarms over unchanged motion, and times real time."""
    case = random_case(seed)
    robot = identified(case, seed)
    noise = np.array(case.truth.torque_noise_nm)
    plant = Plant(case.robot, case.truth.model_copy(update={"torque_noise_nm": [0.0] * 3}), (), PERIOD, seed)
    watch, rng, alarms, spent, first = Watch(robot), np.random.default_rng(seed), 0, 0.0, 0
    pieces = math.ceil(minutes * 60.0 / PIECE)  # as they are watched
    for piece in range(math.ceil(pieces / TIMES)):
        motion = production(case, PIECE, seed + 1000 * piece)
        plant.set_payload(0.0)
        plant.reset(motion.position[0])
        clean = as_trace(motion, along(plant, motion, 0, round(PIECE / PERIOD)), gripper)
        for _ in range(min(TIMES, pieces - piece * TIMES)):
            torque = clean.torque + noise * rng.standard_normal(clean.torque.shape)
            samples = replace(clean, torque=torque, time=clean.time + first * PERIOD).samples()
            samples["sequence"] += first
            first += len(samples)
            begin = time.process_time()
            rise, raised = over(robot, watch, samples)
            spent += time.process_time() - begin
            alarms += rise is not None
            watch.diagnosing = False
            print(
                f"seed {seed}, {first * PERIOD / 60:.0f} min: {raised} s above the level, {alarms} alarms", flush=True
            )
    return alarms, first * PERIOD / max(spent, 1e-9)


def main() -> None:
    """Print every case, then the share that is named and the false alarms."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--effects", nargs="*", choices=tuple(EFFECTS), default=list(TEN))
    parser.add_argument("--seeds", nargs="*", type=int, default=(1, 2, 3))
    parser.add_argument("--minutes", type=float, default=60.0, help="of unchanged motion")
    parser.add_argument("--gripper", action=argparse.BooleanOptionalAction, default=True, help="known on the bus")
    parser.add_argument("--store", action="store_true", help="put the figures into results/watch.json")
    given = parser.parse_args()
    kept: dict[str, tuple[int, int, str | None]] = {}
    watch_node.NICENESS = 0  # beside other work it would not have its turn; what counts is the processor's time
    hits = [hit for seed in given.seeds if given.effects for hit in changed(given.effects, seed, given.gripper)]
    if hits:
        print(f"named right within {WITHIN:g} s: {sum(hits)} of {len(hits)} (bound 90 %)")
        kept["named" if given.gripper else "named_without"] = (sum(hits), len(hits), None)
    if given.minutes:
        alarms, speed = quiet(given.seeds[0], given.minutes, given.gripper)
        print(
            f"unchanged, {given.minutes:g} min: {alarms} false alarms (bound 0), watched at {speed:.0f} times real time"
        )
        kept["false_hour"] = (alarms, 1, f"{given.minutes:g} min, {'with' if given.gripper else 'without'} gripper")
    if given.store:
        print(f"kept in {store('watch', kept)}")


if __name__ == "__main__":
    main()
