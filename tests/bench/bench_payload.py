"""The mass where the model is not quite right: robots and faults of our own, judged as a scale is.

Each robot makes empty motions to be identified on, and then picks, with a fault in both or only since the fit. Judged
from 0.15 s after each change of the mass, events within 0.4 s of one. Where the robot stands until then nobody can tell
the mass to 50 g, for friction at rest is anything within Coulomb's: `moving` is `in_time` of the other changes.

uv run python -m tests.bench.bench_payload --robots d3-1200 rl5-1450-6kg 901 --seed 1
uv run python -m tests.bench.bench_payload --only shaft_friction slow --no-commands --store
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from joblib import Parallel, delayed

from docs.making.figures import store
from drivers.motion import Payload, Planner, Trajectory
from drivers.simulated.plant.cases import PERIOD, random_case
from drivers.simulated.plant.effects import EFFECTS, PlantEffect
from drivers.simulated.plant.plant import Plant
from drivers.simulated.plant.plant_trace import simulate
from drivers.simulated.plant.truth import PlantTruth, load_truth, shipped_truth
from schemas.errors import DataError
from schemas.robot import Robot, load_robot
from schemas.trace import Trace
from service.identification.from_traces import identify
from service.identification.regression import summarise
from service.identification.weighed_picks import Pick, Weighed, weighed
from service.model.nominal import pack

MASSES = (0.3, 0.5, 1.0, 2.0, 3.0, 3.8)  # kg
SETTLED, FOUND, STEADY = 0.15, 0.4, 0.3  # s after a change: judged, told, trust is counted
AWAKE, LEAST_SPEED = 0.03, 0.05  # s, rad/s: of motion until it is judged, for a change to count as moving
LEAST_CHANGE, SLACK = 0.01, 0.02  # kg
WILD = (-0.1, 6.0)  # kg
SPEED = (0.5, 1.0)  # of the motion limits


@dataclass(frozen=True)
class Fault:
    """What is not as the description or the fit has it. truth: factors of fields of `PlantTruth`. effects: figures."""

    truth: tuple[tuple[str, float], ...] = ()
    effects: tuple[PlantEffect, ...] = ()

    def plant(self, robot: Robot, truth: PlantTruth, seed: int) -> Plant:
        """A plant that has it."""
        changed = {name: _times(getattr(truth, name), factor) for name, factor in self.truth}
        return Plant(robot, truth.model_copy(update=changed), self.effects, PERIOD, seed)


def _times(value: float | list[float], factor: float) -> float | list[float]:
    return [one * factor for one in value] if isinstance(value, list) else value * factor


def _effect(name: str, *figures) -> Fault:
    return Fault(effects=(EFFECTS[name](*figures),))


@dataclass(frozen=True)
class Scenario:
    """A fault while the robot is identified, one while it picks, and how it picks."""

    fitted: Fault = Fault()
    picking: Fault = Fault()
    speed: float = 1.0
    stacked: bool = False


NONE = Fault()
FRICTION = ("coulomb_friction_nm", "viscous_friction_nms")
COLD, WARM = (Fault(truth=tuple((name, factor) for name in FRICTION)) for factor in (1.25, 0.8))
SHAFT, BALLS = _effect("shaft_friction", 5.0, 1.5), _effect("passive_joint_friction", 0.17, 0.015)
SCALE, ONE_SCALE = _effect("torque_scale", [0.05] * 3), _effect("torque_scale", [0.0, 0.06, 0.0])
TILT, TOOL = _effect("base_tilt", 0.025, 0.025), _effect("tool_mass", 0.2)
STRIBECK = _effect("stribeck_friction", [1.0, 1.3, 0.8], 0.1)
SOFT = _effect("joint_elasticity", [4000.0] * 3, 0.05)
SCENARIOS = {
    "clean": Scenario(),
    "stacked": Scenario(stacked=True),
    "cold": Scenario(NONE, COLD),
    "warm": Scenario(NONE, WARM),
    "slow": Scenario(speed=0.06),
    "gentle": Scenario(speed=0.2),
    "tilted": Scenario(TILT, TILT),
    "shaft_friction": Scenario(SHAFT, SHAFT),
    "shaft_since": Scenario(NONE, SHAFT),
    "ball_joints_since": Scenario(NONE, BALLS),
    "constant": Scenario(SCALE, SCALE),
    "constant_since": Scenario(NONE, SCALE),
    "one_constant_since": Scenario(NONE, ONE_SCALE),
    "tool_since": Scenario(NONE, TOOL),
    "stribeck_since": Scenario(NONE, STRIBECK),
    "elastic": Scenario(SOFT, SOFT),
}


@dataclass(frozen=True)
class Machine:
    """A robot as described, and what it is."""

    robot: Robot
    truth: PlantTruth

    @classmethod
    def of(cls, name: str) -> Machine:
        """A number is the seed of a random one, else a description or the name of one."""
        if name.isdigit():
            case = random_case(int(name))
            return cls(case.robot, case.truth)
        robot = load_robot(name)
        shipped = shipped_truth(robot)
        return cls(robot, load_truth(shipped, robot) if shipped else PlantTruth.nominal(robot))


def stack(motion: Trajectory, rng: np.random.Generator) -> Trajectory:
    """Each product comes in two parts, or leaves in two."""
    parts = []
    for begin, end, mass in motion.payloads:
        middle = begin + rng.uniform(0.4, 0.6) * (end - begin)
        lighter = mass * rng.uniform(0.3, 0.6)
        first, second = (lighter, mass) if rng.random() < 0.5 else (mass, lighter)
        parts += [Payload(begin, middle, first), Payload(middle, end, second)]
    return dataclasses.replace(motion, payloads=tuple(parts))


def logs(machine: Machine, scenario: Scenario, seed: int, seconds: float) -> tuple[list[Trace], Trace, Trajectory]:
    """Empty logs to fit on, the log of picks, and what was carried in it."""
    rng = np.random.default_rng([seed, 71])
    planner = Planner(machine.robot, PERIOD)
    empty = [
        planner.pick_and_place(rng, 5.0, speed=rng.uniform(*SPEED)),
        planner.multisine(rng, 8.0, rng.uniform(*SPEED)),
        planner.slow(rng, 8.0),
        planner.pick_and_place(rng, 5.0, speed=rng.uniform(*SPEED)),
    ]
    plant = scenario.fitted.plant(machine.robot, machine.truth, seed)
    fitted = [simulate(plant, motion, f"fit_{number}") for number, motion in enumerate(empty)]
    motion = planner.pick_and_place(rng, seconds, MASSES, scenario.speed)
    if scenario.stacked:
        motion = stack(motion, rng)
    plant = scenario.picking.plant(machine.robot, machine.truth, seed + 1)
    return fitted, simulate(plant, motion, "pick"), motion


def judge(robot: Robot, log: Trace, picks: Sequence[Pick]) -> dict[str, float]:
    """The figures of one log.

    z: rms of what is left of the error by its random standard deviation, where `off`, the share of the mass by which
    all masses of the log are off alike, is taken off; z_all: rms of the error by its standard deviation; both of
    samples that are trusted, of each mass from when its change has been told (that it comes late is `in_time`'s) or
    may be waited for no longer.
    """
    found = weighed(robot, log)
    time = found.time - found.time[0]
    true, end = np.zeros(len(time)), time[-1]
    for pick in picks:
        true[(time >= pick.begin) & (time < pick.end)] = pick.mass
    at = np.flatnonzero(np.abs(np.diff(true)) > LEAST_CHANGE) + 1
    changes = time[at]
    judged = changes[changes < end - FOUND]
    error = np.abs(found.mass - true)
    moves = np.abs(np.gradient(log.position, time, axis=0)).max(axis=1) > LEAST_SPEED
    told = time[found.event != 0]
    right, awake, covered, steady, squares, sure = [], [], [], [], [], np.zeros(len(time), bool)
    for begin, until in pairwise([*judged, *changes[len(judged) :], end][: len(judged) + 1]):
        span = (time >= begin + SETTLED) & (time < until)
        late = (time >= begin + STEADY) & (time < until)
        right.append(span.any() and (error[span] <= np.maximum(0.05 * true[span], 0.05)).all())
        since = slice(round(begin / log.period), round((begin + SETTLED) / log.period))
        awake.append(np.count_nonzero(moves[since]) * log.period >= AWAKE)
        trusted = span & found.trusted
        sure |= trusted & (time >= min([*told[(told >= begin) & (told < begin + FOUND)], begin + FOUND]))
        covered.append(error[trusted] <= 2 * found.std_dev[trusted] + SLACK)
        steady.append(found.trusted[late])
        squares.append(error[late] ** 2)
    lag = told[:, None] - changes
    false = ~((lag >= 0) & (lag <= FOUND)).any(axis=1)
    after = told[:, None] - judged
    missed = ~((after >= 0) & (after <= FOUND)).any(axis=0)
    return {
        "changes": len(judged),
        "in_time": float(np.mean(right)),
        "moving": float(np.mean(np.array(right)[awake])) if any(awake) else float("nan"),
        "rms": float(np.mean(np.concatenate(squares)) ** 0.5),
        "covered": float(np.mean(np.concatenate(covered))) if any(map(len, covered)) else float("nan"),
        "trusted": float(np.mean(np.concatenate(steady))),
        "false": 60 * float(false.sum()) / end,
        "missed": int(missed.sum()),
        "wild": int(((found.mass < WILD[0]) | (found.mass > WILD[1])).sum()),
        **_calibration(found, true, sure),
    }


def _calibration(found: Weighed, true: np.ndarray, sure: np.ndarray) -> dict[str, float]:
    """z, z_all and off, as `judge` has them, over the rows that are `sure`."""
    error, mass, spread = found.mass[sure] - true[sure], true[sure], found.random_std_dev[sure]
    if not (mass > 0.0).any():
        return {"z": float("nan"), "z_all": float("nan"), "off": float("nan")}
    off = float(np.sum(error * mass / spread**2) / np.sum(mass**2 / spread**2))
    return {
        "z": float(np.sqrt(np.mean(((error - off * mass) / spread) ** 2))),
        "z_all": float(np.sqrt(np.mean((error / found.std_dev[sure]) ** 2))),
        "off": off,
    }


def one(robot: str, name: str, seed: int, seconds: float, commands: Sequence[bool]) -> list[dict]:
    """The figures of a scenario on a robot, with its commands and without as asked; why it cannot be identified."""
    machine = Machine.of(robot)
    fitted, log, motion = logs(machine, SCENARIOS[name], seed, seconds)
    rows = []
    for known in commands:
        seen = (
            (lambda trace: trace) if known else partial(dataclasses.replace, position_command=None, torque_command=None)
        )
        base = pack(machine.robot)
        row = {"robot": robot, "scenario": name, "commands": known}
        try:
            identified = identify(machine.robot, [summarise(base, seen(trace)) for trace in fitted]).robot
        except DataError as refused:
            rows.append(row | {"error": str(refused)})
        else:
            rows.append(row | judge(identified, seen(log), [Pick(*one) for one in motion.payloads]))
    return rows


def figures(rows: Sequence[dict]) -> dict[str, tuple[str, str, str | None]]:
    """Of all rows of one scenario, for `results/payload.json`: ranges over robots, with and without commands."""
    judged = [row for row in rows if "error" not in row]
    count = f"{len({row['robot'] for row in rows})} robots, {len(judged)} logs"
    if not judged:
        return {}
    changes, missed = (sum(row[name] for row in judged) for name in ("changes", "missed"))
    rms = f"rms of the error {_range(1e3 * row['rms'] for row in judged)} g"
    found = {
        "right": (_range(100 * row["moving"] for row in judged), count, rms),
        "trusted": (_range(100 * row["trusted"] for row in judged), count, None),
        "missed": (f"{missed} of {changes}", count, None),
        "false": (_range((row["false"] for row in judged), 1), count, None),
    }
    return {f"{rows[0]['scenario']}_{what}": figure for what, figure in found.items()}


def _range(values: Iterable[float], digits: int = 0) -> str:
    """From the least to the greatest, of those that there are."""
    there = [value for value in values if value == value]
    if not there:
        return "n/a"
    low, high = (f"{one:.{digits}f}" for one in (min(there), max(there)))
    return low if low == high else f"{low} to {high}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", default=["d3-1200", "rl5-1450-6kg", "901"], help="names, or seeds")
    parser.add_argument("--only", nargs="+", choices=SCENARIOS, default=list(SCENARIOS))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=24.0, help="of picks a log")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--commands", action=argparse.BooleanOptionalAction, default=None, help="default: both")
    parser.add_argument("--store", action="store_true", help="put the figures into results/payload.json")
    asked = parser.parse_args()
    commands = (True, False) if asked.commands is None else (asked.commands,)
    calls = (
        delayed(one)(robot, name, asked.seed, asked.seconds, commands) for name in asked.only for robot in asked.robots
    )
    found: dict[str, list[dict]] = {}
    for rows in Parallel(asked.jobs, return_as="generator")(calls):
        for row in rows or ():
            found.setdefault(row["scenario"], []).append(row)
            print(json.dumps({k: round(v, 3) if isinstance(v, float) else v for k, v in row.items()}), flush=True)
    if asked.store:
        print(f"kept in {store('payload', {k: v for rows in found.values() for k, v in figures(rows).items()})}")


if __name__ == "__main__":
    main()
