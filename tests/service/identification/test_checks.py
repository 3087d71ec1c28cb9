"""Bad logs are named: on a robot made here and on the reference plant."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.trace import read_trace
from schemas.errors import DataError
from schemas.robot import Drive, Robot, load_robot
from schemas.trace import Trace
from service.identification.from_traces import identify
from service.identification.pooled import Identification
from service.identification.regression import NormalEquations, summarise
from service.model.nominal import pack
from tests.service.identification.conftest import Truth, multisine

Record = Callable[..., Trace]
Faults = dict[str, Callable[[np.ndarray], np.ndarray]]

FAULTS: Faults = {
    r"joints 1 and 3 are swapped": lambda torque: torque[:, [2, 1, 0]],
    r"joints 1, 2 and 3 are swapped": lambda torque: torque[:, [1, 2, 0]],
    r"joint 2 has the wrong sign": lambda torque: torque * (1, -1, 1),
    r"joints 1, 2 and 3 has the wrong sign": lambda torque: -torque,
    r"not multiplied by the gear ratio 25": lambda torque: torque / 25,
}


def run(robot: Robot, traces: list[Trace]) -> Identification:
    return identify(robot, [summarise(pack(robot), trace) for trace in traces])


@pytest.fixture(scope="module")
def plant(data: Path) -> tuple[Robot, list[Trace]]:
    folder = data / "plant_logs" / "case_000"
    robot = load_robot(folder / "robot.toml")
    return robot, [read_trace(path, robot) for path in sorted(folder.glob("fit_*.csv"))]


@pytest.fixture(scope="module")
def geared(robot: Robot) -> Robot:
    return robot.model_copy(update={"drive": Drive(gear_ratio=25.0)})


@pytest.fixture(scope="module")
def twelve(geared: Robot, record: Record) -> list[tuple[Trace, NormalEquations]]:
    """Twelve good logs and their sums."""
    logs = [record(seed, seconds=5.0) for seed in range(12)]
    return [(log, summarise(pack(geared), log)) for log in logs]


def with_one(
    robot: Robot, twelve: list[tuple[Trace, NormalEquations]], number: int, torque: np.ndarray
) -> Identification:
    """Identify on them with another torque in one."""
    sums = [sums for _, sums in twelve]
    sums[number] = summarise(pack(robot), replace(twelve[number][0], torque=torque))
    return identify(robot, sums)


@pytest.mark.parametrize("fault", FAULTS)
def test_torque_that_is_not_the_joints(geared: Robot, twelve: list[tuple[Trace, NormalEquations]], fault: str) -> None:
    logs = [replace(log, torque=FAULTS[fault](log.torque)) for log, _ in twelve[:3]]
    with pytest.raises(DataError, match=f"all 3 logs: .*{fault}"):
        run(geared, logs)


@pytest.mark.parametrize("fault", [*FAULTS][::4])
def test_torque_that_is_not_the_joints_on_the_plant(plant: tuple[Robot, list[Trace]], fault: str) -> None:
    robot, logs = plant
    with pytest.raises(DataError, match=f"all 4 logs: .*{fault}"):
        run(robot, [replace(log, torque=FAULTS[fault](log.torque)) for log in logs])


@pytest.mark.parametrize("fault", FAULTS)
def test_one_wrong_log_of_twelve_is_named(
    geared: Robot, twelve: list[tuple[Trace, NormalEquations]], fault: str
) -> None:
    with pytest.raises(DataError, match=rf"^log_7\.csv: .*{fault}"):
        with_one(geared, twelve, 7, FAULTS[fault](twelve[7][0].torque))


def test_one_foreign_log_of_twelve_is_named(geared: Robot, twelve: list[tuple[Trace, NormalEquations]]) -> None:
    with pytest.raises(DataError, match=r"^log_4\.csv: "):
        with_one(geared, twelve, 4, np.roll(twelve[4][0].torque, 200, axis=0))  # 0.2 s late


def test_a_log_of_another_robot_is_refused(robot: Robot, record: Record) -> None:
    other = Truth(rho_1=0.2, rho_2=-0.9, coulomb=np.zeros(3))
    with pytest.raises(DataError, match=r"^log_3\.csv: does not match .*is it of another robot\?$"):
        run(robot, [record(seed, other if seed == 3 else None) for seed in range(4)])


def test_what_only_one_motion_excites_is_no_other_robot(robot: Robot, record: Record) -> None:
    """A gear that rings in one log is nothing that a base model could have: a warning, `diagnose` finds the rest."""
    logs = [record(seed) for seed in range(4)]
    ringing = np.sin(2 * np.pi * 11.0 * logs[3].time)[:, None] * np.sqrt(2.0)
    logs[3] = replace(logs[3], torque=logs[3].torque + 0.5 * logs[3].torque.std(axis=0) * ringing)
    warning, *_ = run(robot, logs).warnings
    assert re.match(r"log_3\.csv: does not match .* 4\d % .*does this motion excite an unmodelled effect\?", warning)


def test_all_logs_wrong_beyond_reading(robot: Robot, record: Record) -> None:
    rng = np.random.default_rng(0)
    logs = [replace(log, torque=20 * rng.standard_normal(log.torque.shape)) for log in (record(s) for s in range(3))]
    with pytest.raises(DataError, match=r"log_\d\.csv: "):
        run(robot, logs)


def test_the_same_log_twice_is_refused(robot: Robot, record: Record) -> None:
    log = record(1)
    with pytest.raises(DataError, match=r"copy\.csv: the same motion and torque as log_1\.csv"):
        run(robot, [log, record(2), replace(log, path=Path("copy.csv"))])


def test_payload_on_one_log_is_named(robot: Robot, record: Record) -> None:
    logs = [record(seed, Truth(payload=0.3 if seed == 2 else 0.0)) for seed in range(5)]
    (warning,) = run(robot, logs).warnings
    assert re.match(r"log_2\.csv: its torque fits \+0\.[23]\d kg on the platform compared with .*: a payload", warning)


def test_heavy_payload_on_one_log_is_an_error(robot: Robot, record: Record) -> None:
    logs = [record(seed, Truth(payload=2.0 if seed == 2 else 0.0)) for seed in range(5)]
    with pytest.raises(
        DataError, match=r"^log_2\.csv: does not match the other logs.*\+\d\.\d+ kg on the platform compared with"
    ):
        run(robot, logs)


def test_payload_on_a_plant_log_is_named(data: Path) -> None:
    """3.8 kg with their inertia are a quarter of the torque: no fit to keep, as with the 2 kg above."""
    folder = data / "payload_logs" / "case_001"
    robot = load_robot(folder / "robot.toml")
    logs = [read_trace(path, robot) for path in [*sorted(folder.glob("fit_*.csv")), folder / "pick_a.csv"]]
    with pytest.raises(DataError, match=r"^pick_a\.csv: does not match the other logs.*: a payload\?$") as said:
        run(robot, logs)
    asked = re.search(r"fits \+(\d\.\d+) kg", str(said.value))
    (case,) = (c for c in json.loads((data / "payload_logs/key.json").read_text()) if c["case"] == "case_001")
    picks = case["picks"]["pick_a"]
    least = sum(mass * (until - begin) for begin, until, mass in picks) / (picks[-1][1] - picks[0][0])
    assert asked
    assert least < float(asked[1]) < max(mass for *_, mass in picks)  # it is moved harder while it is carried


def test_clean_logs_pass_without_a_word(robot: Robot, record: Record, plant: tuple[Robot, list[Trace]]) -> None:
    assert run(robot, [record(seed) for seed in range(4)]).warnings == ()
    assert run(*plant).warnings == ()


def test_one_motion_repeated_is_too_similar(robot: Robot, record: Record) -> None:
    motion = multisine(3, 8.0, 2.0, 1e-3)
    (warning,) = run(robot, [record(seed, motion=motion) for seed in range(3)]).warnings
    assert "too similar" in warning


def test_a_single_trajectory_cannot_be_held_out(robot: Robot, record: Record) -> None:
    result = run(robot, [record(1, seconds=16.0)])
    assert "cannot be held out" in result.warnings[0]
    assert np.isnan(result.fit.held_out).all()
