"""Robots, faults and logs of picks drawn once and kept in a folder, scored in seconds after every change of the code.

`draw` simulates, identifies and, for a fault that `diagnose` can name, corrects the description by the one effect that
is there; `score` runs the estimator over what is kept and judges it as `bench_payload` does. Robots that constants are
chosen on and robots that are reported are drawn into two folders.

uv run python -m tests.bench.payload_draws draw chosen --robots d3-1200 911 912 --seed 11
uv run python -m tests.bench.payload_draws score chosen --only clean cold air_drag
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from docs.making.figures import store
from drivers.motion import Planner
from drivers.simulated.plant.cases import PERIOD
from drivers.simulated.plant.effects import EFFECTS
from drivers.simulated.plant.effects.sensing import TorqueFilter
from drivers.simulated.plant.plant_trace import simulate
from drivers.trace import read_trace
from schemas.axes_description import load_description, save_description
from schemas.errors import DataError
from schemas.robot import Robot
from schemas.trace import Trace
from service.diagnosis.documents.document import corrected
from service.diagnosis.pipeline import diagnose
from service.identification.from_traces import identify
from service.identification.regression import summarise
from service.identification.weighed_picks import Pick
from service.model.effects import CATALOGUE
from service.model.nominal import pack
from tests.bench.bench_payload import MASSES, SCENARIOS, SPEED, Fault, Machine, Scenario, judge, stack

FIT_SECONDS = (4.0, 6.0, 6.0)  # of pick and place, multisine, slow motion
PICK_SECONDS, SLOW_SECONDS = 10.0, 20.0  # of picks
NAMED = {effect.name: effect for effect in CATALOGUE}
CARRIED = (
    "joint_elasticity", "backlash", "presliding_friction", "torque_delay", "torque_filter", "drive_lag",
    "load_dependent_friction", "stribeck_friction", "nonlinear_viscous_friction", "shaft_friction",
    "passive_joint_friction", "asymmetric_friction", "position_dependent_friction", "warmup_friction", "air_drag",
    "joint_spring", "hose_spring", "rotor_inertia", "tool_mass", "arm_mass", "base_tilt", "link_length_error",
    "joint_offset", "torque_scale", "torque_offset", "cogging",
)  # fmt: skip
ORDER = (
    "clean", "cold", "shaft_friction", "constant_since", "one_constant_since", "constant", "slow", "air_drag",
    "joint_spring", "hose_spring", "rotor_inertia", "load_dependent_friction", "shaft_since", "warm", "stacked",
    "tool_since", "tilted", "gentle", "stribeck_since", "ball_joints_since", "stribeck_friction",
    "nonlinear_viscous_friction", "joint_elasticity", "backlash", "presliding_friction", "torque_delay",
    "torque_filter", "drive_lag", "passive_joint_friction", "asymmetric_friction", "position_dependent_friction",
    "warmup_friction", "tool_mass", "arm_mass", "base_tilt", "link_length_error", "joint_offset", "torque_scale",
    "torque_offset", "cogging",
)  # fmt: skip


@dataclass(frozen=True)
class Kept:
    """One log of picks. descriptions: `identified` and, where a fault can be named, `corrected`. late: s by which the
    torque is reported late."""

    robot: str
    scenario: str
    descriptions: dict[str, Robot]
    log: Trace
    picks: tuple[Pick, ...]
    late: float = 0.0


def scenario_of(name: str, machine: Machine, seed: int) -> Scenario:
    """A scenario by its name or, for an effect's, with a random one that maintenance would want to know of."""
    if name in SCENARIOS:
        return SCENARIOS[name]
    fault = Fault(effects=(EFFECTS[name].draw(np.random.default_rng([seed, 72]), machine.truth, 1.0),))
    return Scenario(fault, fault)


def late_by(fault: Fault) -> float:
    """s by which the reported torque is behind the one that acts."""
    delays = (getattr(effect, "delay_s", 0.0) for effect in fault.effects)
    filters = (1 / (2 * np.pi * one.cutoff_hz) for one in fault.effects if isinstance(one, TorqueFilter))
    return sum(delays) + sum(filters)


def fit_logs(machine: Machine, planner: Planner, scenario: Scenario, seed: int) -> list[Trace]:
    """The four empty logs that a robot is identified on."""
    rng = np.random.default_rng([seed, 73])
    pick, sine, slow = FIT_SECONDS
    empty = [
        planner.pick_and_place(rng, pick, speed=rng.uniform(*SPEED)),
        planner.multisine(rng, sine, rng.uniform(*SPEED)),
        planner.slow(rng, slow),
        planner.pick_and_place(rng, pick, speed=rng.uniform(*SPEED)),
    ]
    plant = scenario.fitted.plant(machine.robot, machine.truth, seed)
    return [simulate(plant, motion, f"fit_{number}") for number, motion in enumerate(empty)]


def draw(folder: Path, robot: str, seed: int, names: list[str]) -> Iterator[str]:
    """Keep the logs of `names` on a robot in `folder`; those that are there stay. Yields each name that is done."""
    machine = Machine.of(robot)
    planner = Planner(machine.robot, PERIOD)

    @lru_cache
    def fits(name: str) -> list[Trace]:
        return fit_logs(machine, planner, scenario_of(name, machine, seed), seed)

    @lru_cache
    def identified(name: str) -> Robot:
        base = pack(machine.robot)
        return identify(machine.robot, [summarise(base, trace) for trace in fits(name)]).robot

    for name in names:
        place = folder / f"{robot}_{name}"
        if (place / "pick.npz").exists():
            continue
        place.mkdir(parents=True, exist_ok=True)
        scenario = scenario_of(name, machine, seed)
        fitted = "clean" if scenario.fitted == Fault() else name
        try:
            save_description(identified(fitted), place / "identified.toml")
            if fitted in NAMED:
                found = corrected(diagnose(machine.robot, fits(fitted), [NAMED[fitted]]))
                save_description(found, place / "corrected.toml")
        except DataError as refused:
            yield f"{name}: {refused}"
            continue
        rng = np.random.default_rng([seed, 74, ORDER.index(name)])
        seconds = SLOW_SECONDS if scenario.speed < 0.1 else PICK_SECONDS
        motion = planner.pick_and_place(rng, seconds, MASSES, scenario.speed)
        motion = stack(motion, rng) if scenario.stacked else motion
        log = simulate(scenario.picking.plant(machine.robot, machine.truth, seed + 1), motion, "pick")
        assert log.position_command is not None
        assert log.torque_command is not None
        np.savez(
            place / "pick.npz", time=log.time, position=log.position, torque=log.torque,
            position_command=log.position_command, torque_command=log.torque_command,
            picks=[(one.pick, one.release, one.mass) for one in motion.payloads], late=late_by(scenario.picking),
        )  # fmt: skip
        yield name


def kept(folder: Path, only: list[str], robots: list[str]) -> Iterator[Kept]:
    """What is kept in a folder, by `draw` or as the scenarios of a `key.json` with logs beside it."""
    key = folder / "key.json"
    if key.exists():
        yield from _scenarios(folder, json.loads(key.read_text()), only)
        return
    for file in sorted(folder.glob("*/pick.npz")):
        robot, _, name = file.parent.name.partition("_")
        if (only and name not in only) or (robots and robot not in robots):
            continue
        with np.load(file) as held:
            arrays = dict(held)
        picks = tuple(Pick(*row) for row in arrays.pop("picks"))
        late = float(arrays.pop("late", 0.0))
        yield Kept(robot, name, _descriptions(file.parent), Trace(Path("pick"), **arrays), picks, late)


def _descriptions(place: Path) -> dict[str, Robot]:
    found = {file.stem: load_description(file) for file in sorted(place.glob("*.toml")) if file.stem != "robot"}
    return {name: one for name, one in found.items() if isinstance(one, Robot)}


def _scenarios(folder: Path, keys: list[dict[str, Any]], only: list[str]) -> Iterator[Kept]:
    for row in keys:
        name, place = row["scenario"], folder / row["scenario"]
        if only and name not in only:
            continue
        plain = load_description(place / "robot.toml")
        assert isinstance(plain, Robot)
        descriptions = _descriptions(place)
        if not descriptions:
            traces = [read_trace(file, plain) for file in sorted(place.glob("fit_*.csv"))]
            descriptions = {"identified": identify(plain, [summarise(pack(plain), one) for one in traces]).robot}
        log, late = read_trace(place / "pick.csv", plain), row.get("late", 0.0)
        yield Kept(folder.name, name, descriptions, log, tuple(Pick(*one) for one in row["picks"]), late)


def score(one: Kept, commands: bool) -> Iterator[dict[str, Any]]:
    """The figures of each description of what is kept."""
    seen = one.log if commands else replace(one.log, position_command=None, torque_command=None)
    picks = [Pick(pick.begin + one.late, pick.end + one.late, pick.mass) for pick in one.picks]
    for description, robot in one.descriptions.items():
        row = {"scenario": one.scenario, "robot": one.robot, "by": description, "commands": commands}
        yield row | judge(robot, seen, picks)


FIGURES = ("changes", "in_time", "moving", "rms", "covered", "trusted", "false", "missed", "wild", "z", "z_all", "off")


def table(rows: list[dict[str, Any]]) -> str:
    """Lines a scenario and description, over its robots: mean, of events a minute also the worst, of missed the sum."""
    groups: dict[tuple[str, str, bool], list[dict[str, Any]]] = defaultdict(list)
    for row in rows:
        groups[row["scenario"], row["by"], row["commands"]].append(row)
    lines = [f"{'scenario':27} {'by':11} {'cmd':5} n " + "".join(f"{name:>9}" for name in FIGURES)]
    for (scenario, by, commands), some in groups.items():
        shown = []
        for name in FIGURES:
            values = np.array([row[name] for row in some], float)
            values = values if np.isfinite(values).any() else np.full(len(values), -1.0)  # none to be judged
            if name in ("changes", "missed", "wild"):
                shown.append(f"{values.sum():9.0f}")
            elif name == "false":
                shown.append(f"{values.mean():4.1f}<{values.max():4.1f}")
            elif name in ("z", "z_all", "off", "rms"):
                shown.append(f"{np.sqrt(np.nanmean(values**2)):9.3f}")
            else:
                shown.append(f"{np.nanmean(values):9.3f}")
        lines.append(f"{scenario:27.27} {by:11} {commands!s:5}{len(some):2} " + "".join(shown))
    return "\n".join(lines)


def figures(rows: list[dict[str, Any]]) -> dict[str, tuple[float, int, str | None]]:
    """For `results/online.json`, of each effect with its corrected description and of none as identified."""
    told: dict[str, tuple[float, int, str | None]] = {}
    for name in (*CARRIED, "clean"):
        by = "identified" if name == "clean" else "corrected"
        some = [row for row in rows if (row["scenario"], row["by"]) == (name, by)]
        if not some:
            continue
        changes = int(sum(row["changes"] for row in some))
        right, trusted, wrong, z = (np.array([row[key] for row in some], float) for key in
                                    ("moving", "trusted", "false", "z"))  # fmt: skip
        told[f"{name}_right"] = round(float(np.nanmean(right)), 3), changes, f"worst robot {np.nanmin(right):.2f}"
        told[f"{name}_trusted"] = round(float(trusted.mean()), 3), len(some), f"worst robot {trusted.min():.2f}"
        told[f"{name}_false"] = round(float(wrong.mean()), 2), len(some), f"worst robot {wrong.max():.1f}"
        told[f"{name}_z"] = round(float(np.sqrt(np.nanmean(z**2))), 2), len(some), None
    return told


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("draw", "score"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robots", nargs="+", default=[], help="names, or seeds of random ones")
    parser.add_argument("--only", nargs="+", choices=ORDER, default=[], metavar="NAME", help="scenarios or effects")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--commands", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--store", action="store_true", help="put the figures into results/online.json")
    parser.add_argument("--json", type=Path, help="file for a row a log and description")
    asked = parser.parse_args()
    if asked.what == "draw":
        for number, robot in enumerate(asked.robots):
            for done in draw(asked.folder, robot, asked.seed + number, asked.only or list(ORDER)):
                print(robot, done, flush=True)
        return
    rows = [row for one in kept(asked.folder, asked.only, asked.robots) for row in score(one, asked.commands)]
    print(table(rows))
    if asked.store:
        print(f"kept in {store('online', figures(rows))}")
    if asked.json:
        asked.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
