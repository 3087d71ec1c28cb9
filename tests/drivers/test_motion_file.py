"""A motion as a file: the same motion at any rate, and nothing from a file that the limits do not allow."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.motion import MotionLimits, Planner, Trajectory, limits_of
from drivers.motion_file import read_motion, write_motion
from drivers.trace import read_trace
from schemas.errors import DataError
from schemas.robot import Limits, load_robot

ROBOT = load_robot("d3-1200")
PLANNER = Planner(ROBOT, 1e-3)
MOTION = PLANNER.multisine(np.random.default_rng(3), 2.0)


def written(folder: Path, motion: Trajectory = MOTION) -> Path:
    write_motion(
        motion, PLANNER.torque(motion.position, motion.velocity, motion.acceleration), PLANNER, folder / "m.csv"
    )
    return folder / "m.csv"


def test_the_motion_comes_back_at_another_rate(tmp_path: Path) -> None:
    path = written(tmp_path)
    finer = read_motion(path, ROBOT, Planner(ROBOT, 0.25e-3))
    assert len(finer) == 4 * len(MOTION)
    np.testing.assert_allclose(finer.position[::4], MOTION.position, atol=1e-10)
    inner = slice(10, -10)
    np.testing.assert_allclose(finer.velocity[::4][inner], MOTION.velocity[inner], atol=1e-6)
    np.testing.assert_allclose(finer.acceleration[::4][inner], MOTION.acceleration[inner], atol=1e-3)


def test_the_file_is_a_trace_and_says_where_the_platform_is(tmp_path: Path) -> None:
    trace = read_trace(written(tmp_path), ROBOT)
    assert not trace.flags.any()
    header, *lines = (tmp_path / "m.csv").read_text().splitlines()
    platform = [header.split(",").index(f"platform_{axis}_m") for axis in "xyz"]
    angle, height = MOTION.position[0, 0], float(lines[0].split(",")[platform[2]])
    geometry = ROBOT.geometry
    reach = geometry.base_radius - geometry.platform_radius + geometry.active_link_length * np.cos(angle)
    drop = geometry.active_link_length * np.sin(angle)
    assert height == pytest.approx(-drop - np.sqrt(geometry.passive_link_length**2 - reach**2), abs=1e-9)


def test_what_breaks_a_limit_is_refused_with_its_joint_and_value(tmp_path: Path) -> None:
    path = written(tmp_path)
    fastest = np.abs(MOTION.velocity).max()
    low = Planner(ROBOT, 1e-3, replace(PLANNER.limits, speed=0.9 * fastest))
    with pytest.raises(DataError, match=r"m\.csv: joint \d at \d\.\d+ s: -?\d.* rad/s, must be"):
        read_motion(path, ROBOT, low)
    weak = Planner(ROBOT, 1e-3, replace(PLANNER.limits, torque=0.5 * PLANNER.limits.torque))
    with pytest.raises(DataError, match="N m, must be"):
        read_motion(path, ROBOT, weak)
    soft = Planner(ROBOT, 1e-3, MotionLimits(acceleration=1.0, torque=PLANNER.limits.torque))
    with pytest.raises(DataError, match=r"rad/s\^2, must be"):
        read_motion(path, ROBOT, soft)


def test_a_motion_that_is_cut_or_leaves_the_workspace_or_has_a_hole_is_refused(tmp_path: Path) -> None:
    fast = int(np.abs(MOTION.velocity).max(axis=1).argmax())
    path = written(tmp_path)
    lines = path.read_text().splitlines(keepends=True)
    cut = tmp_path / "cut.csv"
    cut.write_text("".join(lines[: fast + 1]))
    with pytest.raises(DataError, match=r"ends at .* rad/s, not at rest"):
        read_motion(cut, ROBOT, PLANNER)
    hole = tmp_path / "hole.csv"
    hole.write_text("".join(lines[:fast] + lines[fast + 40 :]))
    with pytest.raises(DataError, match="must not contain faults"):
        read_motion(hole, ROBOT, PLANNER)
    still = np.zeros((800, 3))
    share = np.linspace(0, 1, 800)[:, None]
    down = -0.15 + np.array([1.5, -0.6, -0.6]) * share**3 * (10 - 15 * share + 6 * share**2)
    with pytest.raises(DataError, match="outside the workspace"):
        read_motion(written(tmp_path, Trajectory(1e-3, down, still, still)), ROBOT, PLANNER)


def test_declared_limits_bound_what_is_planned() -> None:
    slow = ROBOT.model_copy(update={"limits": Limits(peak_torque_nm=100.0, joint_speed_radps=2.0)})
    assert (limits_of(slow).torque, limits_of(slow).speed) == (60.0, 2.0)
    motion = Planner(slow, 1e-3).pick_and_place(np.random.default_rng(0), 3.0)
    assert np.abs(motion.velocity).max() <= 2.0
    weak = ROBOT.model_copy(update={"limits": Limits(peak_torque_nm=5.0)})  # less than it takes to hold the arms
    with pytest.raises(DataError, match="within these limits"):
        Planner(weak, 1e-3).pick_and_place(np.random.default_rng(0), 3.0)
