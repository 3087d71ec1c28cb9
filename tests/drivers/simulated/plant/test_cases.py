"""Labelled cases: the files, the answer, and that a gap-free robot has no gap."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.motion import Trajectory
from drivers.simulated.plant.cases import BAND_HZ, random_case, run_case, simulate_case
from drivers.simulated.plant.effects import CATALOGUE
from drivers.simulated.plant.families import (
    FAMILIES,
    JITTER_S,
    RATED_NM,
    WRONG,
    Draw,
    as_recorded,
    coloured_share,
    plan,
)
from drivers.trace import read_trace
from schemas.errors import DataError, PoseError
from schemas.robot import Robot, load_robot
from schemas.trace import Trace

NAMES = ["fit_a_pick", "fit_b_multisine", "fit_c_slow", "fit_d_pick", "test_a_pick", "test_b_multisine"]


@pytest.fixture(scope="module")
def null(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("cases") / "case_000"
    return folder, simulate_case(folder, 12, Draw("null"))


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


def test_why_a_draw_made_no_case_is_kept(
    null: tuple[Path, dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    traces = [read_trace(path) for path in sorted(null[0].glob("*.csv"))]
    failures = [DataError("joint 2 strays"), PoseError("comes apart")]

    def ran(*_: object) -> list[Trace]:
        if failures:
            raise failures.pop(0)
        return traces

    monkeypatch.setattr("drivers.simulated.plant.cases.run_case", ran)
    again = simulate_case(tmp_path, 12, Draw("catalogue", ("backlash",)))
    assert again["refused"] == ["joint 2 strays", "comes apart"]
    assert null[1]["refused"] == []


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


def test_motions_are_of_the_size_of_the_reference_logs(data: Path, null: tuple[Path, dict[str, Any]]) -> None:
    def figures(folder: Path) -> dict[str, np.ndarray]:
        found = {}
        for name in NAMES:
            trace = read_trace(folder / f"{name}.csv")
            assert trace.position_command is not None
            speed = np.abs(np.gradient(trace.position_command, trace.period, axis=0))
            found[name] = np.array([speed.max(), trace.torque.std(), np.ptp(trace.position)])
        return found

    references = json.loads((data / "plant_logs" / "motions.json").read_text())["logs"]  # of all ten cases
    np.testing.assert_allclose(figures(data / "plant_logs" / "case_004")[NAMES[0]], references[NAMES[0]][4], rtol=1e-6)
    ours = figures(null[0])
    for name in NAMES:
        spread = np.array(references[name])
        assert (ours[name] > 0.5 * spread.min(axis=0)).all(), name
        assert (ours[name] < 2.0 * spread.max(axis=0)).all(), name


def test_every_family_has_its_share_of_a_plan_and_the_same_seed_the_same_cases() -> None:
    draws = plan(40, 3, list(FAMILIES))
    assert [draw.kind for draw in draws[10:]] == [kind for kind in list(FAMILIES)[1:] for _ in range(6)]
    assert {draw.kind for draw in draws[:10]} == {"null", "pair", "unknown", "catalogue"}
    assert draws[10:16] == plan(12, 3, ["description", "three"])[6:] != plan(12, 4, ["description", "three"])[6:]
    for draw in draws:
        strange = [name for name in draw.effects if name not in CATALOGUE]
        assert len(strange) == (draw.kind in ("unknown", "outside")), draw
        assert len(set(draw.effects)) == len(draw.effects)
    wanted = {"three": 3, "outside": 3, "description": 0, "production": 1, "scope": 1}
    assert {draw.kind: len(draw.effects) for draw in draws[10:]} == wanted
    assert {draw.wrong for draw in plan(len(WRONG), 0, ["description"])} == set(WRONG)


@pytest.mark.parametrize("quantity", WRONG)
def test_a_wrong_description_differs_in_one_quantity(null: tuple[Path, dict[str, Any]], quantity: str) -> None:
    robot = load_robot(null[0] / "robot.toml")
    wrong = WRONG[quantity].change(robot, np.random.default_rng(0))
    Robot.model_validate(wrong.model_dump())

    def figures(one: Robot) -> dict[str, Any]:
        return {**one.geometry.model_dump(), **one.mass.model_dump()}

    changed = {name for name, value in figures(wrong).items() if value != figures(robot)[name]}
    assert len(changed) == 1
    moved = np.ravel(figures(wrong)[changed.pop()]) - np.ravel(figures(robot)[quantity_key(quantity)])
    assert np.count_nonzero(moved) == 1


def quantity_key(quantity: str) -> str:
    return {
        "active_link_length of an arm": "active_link_length_error",
        "passive_link_length of an arm": "passive_link_length_error",
        "base_radius of an arm": "base_radius_error",
        "azimuth of an arm": "arm_angles_deg",
    }.get(quantity, quantity.removesuffix(" mass"))


def test_a_scope_leaves_coarse_slow_late_and_restless_samples() -> None:
    count, noise = 20_000, 0.4
    time = 1e-3 * np.arange(count)
    smooth = np.stack([20 * np.sin(2 * np.pi * 3 * time)] * 3, axis=1)
    trace = Trace(Path("a"), time, smooth, smooth, smooth, smooth, flags=np.zeros(count, np.uint32))
    (seen,) = as_recorded([trace], noise, np.random.default_rng(5))
    assert len(seen.time) == count // 2
    jitter = seen.time - time[::2]
    assert JITTER_S[0] * 0.9 < jitter.std() < JITTER_S[1] * 1.1
    step = np.diff(np.unique(seen.torque)).min()
    assert RATED_NM[0] / 1000 - 1e-9 < step < RATED_NM[1] / 1000 + 1e-9
    left = seen.torque - smooth[::2]
    late = np.cos(2 * np.pi * 3 * time[::2])  # a filter of 150 to 300 Hz is 0.5 to 1 ms late at 3 Hz
    assert -1.1e-3 < (left[:, 0] @ late) / (late @ late) / (20 * 2 * np.pi * 3) < -0.5e-3
    left = left - late[:, None] * (late @ left / (late @ late))
    assert left.std() == pytest.approx(noise, rel=0.06)
    assert (left[1:] * left[:-1]).mean() / left.var() == pytest.approx(np.exp(-2 / 3), rel=0.05)
    assert coloured_share(BAND_HZ) == pytest.approx(in_band(left, 2e-3), rel=0.1)


def in_band(values: np.ndarray, period: float) -> float:
    """Share of the power below the band's end."""
    power = (np.abs(np.fft.rfft(values, axis=0)) ** 2).sum(axis=1)
    return power[np.fft.rfftfreq(len(values), period) < BAND_HZ].sum() / power.sum()
