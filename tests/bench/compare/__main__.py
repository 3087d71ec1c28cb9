"""The same logs of one axis through deltatwin, plain least squares, `mujoco.sysid` and BAM's published parameters.

uv run --group compare python -m tests.bench.compare --store

Each learns from the same rows and predicts the same rows that it has not seen: the first and the last third of EMPS
from the rest, and every third log of the XL330 from the others. Two scores: torque left while the axis moves, as in
`bench_real`, and how far a simulation that the recorded torque drives is off after 0.2 s, from the measured state. The
simulation is the same few lines for all, with Coulomb friction that jumps. BAM's parameters were fitted by its authors
to all of these logs, so they have seen what they are scored on; they are scaled by the ratio of their torque constant
to that of the log's columns.

Who chose what: rows, scores, the least squares and the setup of `mujoco.sysid` (model, bounds, windows, firm joint
friction) are ours; its optimiser and settings are MuJoCo's.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from docs.making import figures
from drivers.trace import read_trace
from schemas.axes_description import Axes, load_axes
from schemas.trace import Trace
from service.identification.joint_machines import identify_axes
from service.model.prediction import FULL, error_in_band, motion, predict_along
from tests.bench.bench_real import DATA, SETS, LeastSquares, Set, folds
from tests.bench.compare.rollout_tuner import STEP, tuned, windows

TAKEN = {"emps": 1, "xl330": 3}  # of so many stretches held out one is taken: a tuner takes a minute for each
VOLT = 8.43e-5 * 885  # N m of the XL330's log per volt, as its columns have it
GRAVITY = 9.80665  # m/s^2
METHODS = {"ours": "deltatwin", "ls": "least squares", "sysid": "mujoco.sysid", "bam": "BAM M1, published"}


def published() -> np.ndarray:
    """BAM's M1 of the XL330 in the log's torque unit: inertia, viscous, Coulomb, constant, weight as sine, cosine."""
    found = json.loads((DATA / "bam_xl330" / "params" / "m1.json").read_text(encoding="utf-8"))
    mass, length, constant = 0.49, 0.1, found["kt"] / found["R"]
    weight, offset = mass * GRAVITY * length, found["q_offset"]
    own = [
        mass * length**2 + found["armature"],
        found["friction_viscous"] + constant * found["kt"],
        found["friction_base"],
        0.0,
        weight * np.cos(offset),
        weight * np.sin(offset),
    ]
    return np.array(own) * VOLT / constant


def off_after(trace: Trace, values: np.ndarray) -> list[float]:
    """rad or m that a simulation is off at the end of each window."""
    inertia, viscous, coulomb, constant, sine, cosine = values
    result = []
    for clock, position, torque, speed in windows(trace):
        angle, rate = float(position[0, 0]), float(speed[0])
        times = np.arange(0.0, clock[-1], STEP)
        for push in np.interp(times + STEP / 2, clock, torque[:, 0]).tolist():
            rate += STEP * (push - constant - sine * np.sin(angle) - cosine * np.cos(angle) - viscous * rate) / inertia
            most = STEP * coulomb / inertia
            rate -= float(np.clip(rate, -most, most))
            angle += STEP * rate
        result.append(angle - float(np.interp(times[-1] + STEP, clock, position[:, 0])))
    return result


def parameters(robot: Axes) -> np.ndarray:
    """What `identify` found, in that order."""
    found = robot.identified
    assert found is not None
    parts = (found.inertia, found.viscous_friction, found.coulomb_friction, found.offset)
    weights = [0.0 if part is None else part.value[0] for part in (found.gravity_sin, found.gravity_cos)]
    return np.array([part.value[0] for part in parts] + weights)


def compared(one: Set, folder: Path) -> Iterator[tuple[str, float, float, int]]:
    """Each method with rms torque left, rms off after a window, and count of windows."""
    (folder / "columns.toml").write_text(one.columns)
    (folder / "robot.toml").write_text(f'name = "{one.name}"\ncolumns = "columns.toml"\n{one.description}')
    robot = load_axes(folder / "robot.toml")
    assert isinstance(robot, Axes)
    by_hand = LeastSquares(robot, one)
    left: dict[str, list[np.ndarray]] = {}
    off: dict[str, list[float]] = {}
    for learn, test in folds([read_trace(path, robot) for path in one.logs()])[:: TAKEN[one.name]]:
        along, known = motion(test), identify_axes(robot, learn).robot
        assert isinstance(known, Axes)
        values = {"ours": parameters(known), "ls": by_hand.fit(learn), "sysid": tuned(learn, robot.linear)}
        if one.name == "xl330":
            values["bam"] = published()
        if robot.linear:
            values["ls"] = np.r_[values["ls"], 0.0, 0.0]
        torques = {name: by_hand.predict(found[: 4 if robot.linear else 6], test) for name, found in values.items()}
        torques["ours"] = predict_along(known, test, along)[FULL]
        errors = {name: error_in_band(test, along, torque) for name, torque in torques.items()}
        counted = np.isfinite(np.stack(list(errors.values()))).all(axis=0) & (np.abs(along.theta_dot) >= one.least)
        for name, found in values.items():
            left.setdefault(name, []).append(errors[name][counted])
            off.setdefault(name, []).extend(off_after(test, found))
            print(f"  {test.name} {name}: {np.array2string(found, precision=5)}", flush=True)
    for name, errors_of in left.items():
        torque, place = (float(np.sqrt(np.mean(np.square(part)))) for part in (np.concatenate(errors_of), off[name]))
        yield name, torque, place, len(off[name])


def main() -> None:
    """Print each, and store the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="*", help=f"of {', '.join(TAKEN)}; default: all")
    parser.add_argument("--store", action="store_true", help="put the figures into results/compare.json")
    given = parser.parse_args()
    stored: dict[str, tuple[float | int | str, int | str | None, str | None]] = {}
    for one in SETS:
        if one.name not in (given.sets or TAKEN):
            continue
        with tempfile.TemporaryDirectory() as folder:
            for name, torque, place, count in compared(one, Path(folder)):
                print(f"{one.name}, {METHODS[name]}: {torque:.4g} {one.unit}, {1e3 * place:.3g} mrad or mm", flush=True)
                stored[f"{one.name}_{name}_torque"] = (float(f"{torque:.3g}"), None, None)
                stored[f"{one.name}_{name}_place"] = (float(f"{1e3 * place:.3g}"), count, None)
    if given.store:
        versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in ("mujoco", "pin", "numpy"))
        stored["versions"] = (versions, None, None)
        print(f"stored in {figures.store('compare', stored)}")


if __name__ == "__main__":
    main()
