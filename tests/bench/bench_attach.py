"""The corrected robot attached to MuJoCo beside `rollout`, on labelled logs kept out of the diagnosis.

How far each is off the measured platform after 0.2 s, from the measured state under the recorded torque.

Each case is a folder with robot.toml, fit_*.csv and test_*.csv. Windows in which something is carried are left out:
`rollout` takes a mass for each, the MuJoCo model has none.

uv run python -m tests.bench.bench_attach ../shared/plant_logs --case case_001 --case case_003
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's compiled modules carry no types)

from __future__ import annotations

import argparse
from pathlib import Path

import mujoco
import numpy as np

from deltatwin.mujoco import attach, model_of
from docs.making.figures import store
from drivers.simulated.plant.mujoco_delta import CompiledMechanism, close, dependence
from drivers.trace import read_trace
from schemas.errors import DataError
from schemas.robot import Robot, load_robot
from service.diagnosis.documents.document import corrected
from service.diagnosis.pipeline import diagnose
from service.model import kinematics
from service.model.effects import CATALOGUE
from service.rollout.gap import HORIZON, Windows, cut_up, simulate
from service.rollout.packed import SeenStretch, stretch

BOUND = 1.2
NOTHING = 0.02  # kg, that a window may carry
MOST = 30  # windows a log, evenly over it


class Attached:
    """A corrected robot in MuJoCo."""

    def __init__(self, robot: Robot) -> None:
        self.robot, self.model = robot, model_of(robot)
        joints = {self.model.joint(number).name for number in range(self.model.njnt)}

        def places(names: list[str]) -> np.ndarray:
            return np.array([self.model.joint(name).qposadr[0] for name in names])

        self.arm = places([f"arm{i}" for i in range(3)])
        self.motor = places([f"motor{i}" if f"motor{i}" in joints else f"arm{i}" for i in range(3)])
        self.platform = places(["x", "y", "z"])

    def end(self, seen: SeenStretch, row: int, samples: int, period: float, clock: float) -> np.ndarray:
        """(3,) rad that the encoders give so many samples after `row`."""
        model = self.model
        geometry = seen.model._replace(joint_offset=np.zeros(3))
        mechanism = CompiledMechanism(model, geometry, self.arm, self.motor, self.platform, 0)
        data = mujoco.MjData(model)
        link, link_dot, angle, speed, _ = seen.start[row]
        true = link + seen.model.joint_offset
        data.qpos[:] = close(mechanism, true[None])[0]
        data.qvel[:] = dependence(mechanism, true[None])[0] @ link_dot
        data.qpos[self.arm], data.qpos[self.motor], data.qvel[self.motor] = link, angle, speed
        if model.na:
            data.act[:] = seen.torque[row]
        data.time = clock
        steps = round(period / model.opt.timestep)
        torque = seen.torque / model.actuator_gainprm[:, 0]  # a drive takes the torque that its scale is known of
        with attach(model, self.robot):
            for k in range(row, row + samples - 1):
                for part in range(steps):
                    data.ctrl[:] = torque[k] + (torque[k + 1] - torque[k]) * (part + 0.5) / steps
                    mujoco.mj_step(model, data)
        return seen.measured(data.qpos[self.motor].copy())


def errors(robot: Robot, seen: SeenStretch, cut: Windows, attached: Attached) -> np.ndarray:
    """(2, W) m of the platform, of `rollout` and attached."""
    empty = np.flatnonzero(np.abs(cut.payload) < NOTHING)
    starts = cut.starts[empty[:: max(1, len(empty) // MOST)]]
    segment, samples = cut.segment, cut.samples
    result = []
    for start in starts.tolist():
        rows, clock = slice(start, start + samples), segment.time[[start]]
        ours = simulate(seen, seen.start[[start]], seen.torque[None, rows], clock, segment.period)[0, -1]
        theirs = attached.end(seen, start, samples, segment.period, float(clock[0]))
        real, one, other = (
            kinematics.forward(seen.model, angle) for angle in (segment.theta[start + samples - 1], ours, theirs)
        )
        result.append((np.linalg.norm(one - real), np.linalg.norm(other - real)))
    return np.array(result).T.reshape(2, -1)


def one_case(folder: Path) -> tuple[float, float, int, str]:
    """Rms mm of `rollout` and attached, count of windows, and what was found."""
    robot = load_robot(folder / "robot.toml")
    fits, tests = ([read_trace(p, robot) for p in sorted(folder.glob(f"{part}_*.csv"))] for part in ("fit", "test"))
    found = corrected(diagnose(robot, fits, CATALOGUE))
    assert isinstance(found, Robot)
    attached, every = Attached(found), []
    for trace, cut in cut_up({"corrected": found}, tests, HORIZON).parts:
        seen = stretch(found, cut.segment, trace.position[cut.segment.rows])
        every.append(errors(found, seen, cut, attached))
    both = np.concatenate(every, axis=1)
    rollout, there = 1e3 * np.sqrt(np.mean(both**2, axis=1))
    names = ", ".join(dict.fromkeys(effect.name for effect in found.effect)) or "no effect"
    return float(rollout), float(there), both.shape[1], names


def main() -> None:
    """Print each case; store each and the largest ratio."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--case", action="append", help="only these")
    parser.add_argument("--store", action="store_true", help="put the figures into results/attach.json")
    given, stored = parser.parse_args(), {}
    for folder in sorted(given.folder.glob("case_*")):
        if given.case and folder.name not in given.case:
            continue
        try:
            rollout, there, count, names = one_case(folder)
        except DataError as error:
            print(f"{folder.name}: {error}", flush=True)
            stored[folder.name] = ("not attached", None, str(error))
            continue
        said = f"rollout {rollout:.3g} mm, attached {there:.3g} mm; {names}"
        print(f"{folder.name}: {there / rollout:.2f}, {said}, {count} windows", flush=True)
        stored[folder.name] = (float(f"{there / rollout:.3g}"), count, said)
    if given.store:
        print(f"kept in {store('attach', stored)}")


if __name__ == "__main__":
    main()
