"""Labelled cases: the files, the answer, and that a gap-free robot has no gap."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.motion import Trajectory
from drivers.plant.cases import random_case, run_case, simulate_case
from drivers.plant.effects import CATALOGUE
from drivers.trace import read_trace
from schemas.robot import load_robot

NAMES = ["fit_a_pick", "fit_b_multisine", "fit_c_slow", "fit_d_pick", "test_a_pick", "test_b_multisine"]


@pytest.fixture(scope="module")
def null(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("cases") / "case_000"
    return folder, simulate_case(folder, seed=12)


def test_gap_free_case_is_explained_by_the_plain_model_down_to_its_noise(null: tuple[Path, dict[str, Any]]) -> None:
    _, key = null
    assert (key["case"], key["kind"], key["effects"], key["joints"]) == ("case_000", "null", [], [])
    assert 0.9 < key["lift"] < 1.05


def test_files_are_one_session_of_logs(null: tuple[Path, dict[str, Any]]) -> None:
    folder, key = null
    assert sorted(path.stem for path in folder.glob("*.csv")) == NAMES
    robot = load_robot(folder / "robot.toml")
    assert robot.identified is None
    end = -1.0
    for name in NAMES:
        trace = read_trace(folder / f"{name}.csv", robot)
        assert not trace.findings
        assert trace.time[0] > end
        end = trace.time[-1]
        assert trace.period == pytest.approx(1e-3)
        assert trace.position_command is not None
        assert trace.torque_command is not None
        np.testing.assert_allclose((trace.torque - trace.torque_command).std(axis=0), key["noise"], rtol=0.06)


def test_effects_leave_robot_and_motion_as_they_are_and_the_same_seed_gives_the_same_bits() -> None:
    case = random_case(13)
    name, motion = case.motions[0]
    first = slice(0, 1501)  # 1.5 s
    begun = Trajectory(motion.period, motion.position[first], motion.velocity[first], motion.acceleration[first])
    short = dataclasses.replace(case, motions=((name, begun),))
    backlash = CATALOGUE["backlash"].draw(np.random.default_rng(0), case.truth, 1.0)
    (plain,), (worn,), (again,) = (run_case(short, effects, 13) for effects in ((), (backlash,), (backlash,)))
    assert plain.position_command is not None
    assert worn.position_command is not None
    np.testing.assert_array_equal(plain.position_command, worn.position_command)
    np.testing.assert_array_equal(worn.torque, again.torque)
    assert np.abs(worn.torque - plain.torque).max() > 1.0
    assert random_case(13).robot == case.robot
    assert random_case(14).robot != case.robot


def test_motions_are_of_the_size_of_the_reference_logs(shared: Path, null: tuple[Path, dict[str, Any]]) -> None:
    def figures(folder: Path) -> dict[str, np.ndarray]:
        found = {}
        for name in NAMES:
            trace = read_trace(folder / f"{name}.csv")
            assert trace.position_command is not None
            speed = np.abs(np.gradient(trace.position_command, trace.period, axis=0))
            found[name] = np.array([speed.max(), trace.torque.std(), np.ptp(trace.position)])
        return found

    references = [figures(shared / "plant_logs" / f"case_00{n}") for n in range(10)]
    ours = figures(null[0])
    for name in NAMES:
        spread = np.array([reference[name] for reference in references])
        assert (ours[name] > 0.5 * spread.min(axis=0)).all(), name
        assert (ours[name] < 2.0 * spread.max(axis=0)).all(), name
