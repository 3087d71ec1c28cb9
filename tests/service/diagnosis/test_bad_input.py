"""Bad input on the command line: the honest answer or one line, never a confident name."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.trace import read_trace
from schemas.errors import DeltatwinError
from schemas.robot import Mass, Robot, save_robot
from service.cli.main import app
from tests.service.diagnosis.logs import ROBOT, Angles, one_way, record, swing
from tests.service.diagnosis.said import sentences
from tests.service.subject import EFFECTS, diagnose, document

Write = Callable[..., str]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def log(
        name: str, angles: Angles, seconds: float = 4.0, robot: Robot = ROBOT, seed: int = 0, stuck: float = 0.0
    ) -> str:
        return record(tmp_path / f"{name}.csv", robot, angles, seconds, seed, stuck)

    save_robot(ROBOT, tmp_path / "robot.toml")
    return log


@pytest.fixture
def diagnosed(tmp_path: Path) -> Callable[..., tuple[dict[str, Any], str]]:
    """The command's document and text, spaces as one."""

    def command(*logs: str, **options: Path) -> tuple[dict[str, Any], str]:
        arguments = {"robot": tmp_path / "robot.toml", "out": tmp_path / "out"} | options
        words = [word for key, value in arguments.items() for word in (f"--{key}", str(value))]
        result = CliRunner().invoke(app, ["diagnose", *logs, *words], catch_exceptions=False)
        assert result.exit_code == 0
        found = json.loads((arguments["out"] / "diagnosis.json").read_text())
        return found, " ".join(result.output.split())

    return command


def test_one_short_log(write: Write, diagnosed) -> None:
    found, text = diagnosed(write("short", swing(1), seconds=1.5, stuck=3.0))
    assert found["effects"] == []
    assert "The data cannot separate the effects" in text
    assert "Record three or more runs" in text
    assert "no effect in the catalogue explains it" not in text  # none was tried


def test_no_reversals(write: Write, diagnosed) -> None:
    logs = [write(f"down_{seed}", one_way, seconds=3.0, seed=seed, stuck=3.0) for seed in range(2)]
    found, text = diagnosed(*logs)
    assert not {effect["name"] for effect in found["effects"]} & {"stribeck_friction", "asymmetric_friction"}
    for joint in (1, 2, 3):
        assert f"Joint {joint} moves in one direction only" in text
    assert "Record runs with reversals" in text


def test_a_single_joint_moving(write: Write, diagnosed) -> None:
    found, text = diagnosed(*(write(f"one_{seed}", swing(seed, (1,)), seed=seed) for seed in range(2)))
    assert found["effects"] == []
    assert "Joints 1 and 3 hardly move:" in text
    assert "Record runs in which all joints move" in text
    assert "Joint 1 hardly moves: no statement about it is possible." in text


def test_two_robots_mixed(write: Write, diagnosed) -> None:
    other = ROBOT.model_copy(update={"mass": Mass(active_link=3.4, passive_link=0.7, platform=2.4)})
    found, text = diagnosed(
        *(write(f"mine_{seed}", swing(seed), seed=seed) for seed in (1, 2)),
        *(write(f"theirs_{seed}", swing(seed), robot=other, seed=seed) for seed in (3, 4)),
    )
    assert found["effects"] == []
    assert found["verdict"] == "unexplained"
    assert "the data cannot separate" in text


def test_grossly_wrong_geometry(write: Write, diagnosed, tmp_path: Path) -> None:
    geometry = ROBOT.geometry.model_copy(update={"active_link_length": 0.25, "base_radius": 0.35})
    save_robot(ROBOT.model_copy(update={"geometry": geometry}), tmp_path / "wrong.toml")
    logs = [write(f"run_{seed}", swing(seed), seconds=3.0, seed=seed) for seed in range(2)]
    found, text = diagnosed(*logs, robot=tmp_path / "wrong.toml")
    assert found["effects"] == []
    assert found["verdict"] == "unexplained"
    assert "check_description" in [one["advice"] for one in found["cannot_tell"]]
    assert "Check the description" in text


def test_gravity_of_another_direction_is_a_wrong_base_and_no_hose(write: Write) -> None:
    """Forces on the platform and offsets stood in for it at 100 %."""
    robot = ROBOT.model_copy(update={"gravity_mps2": [9.81, 0.0, 0.0]})
    traces = [read_trace(Path(write(f"run_{seed}", swing(seed), seconds=2.5, seed=seed)), ROBOT) for seed in range(2)]
    effects = [EFFECTS[name] for name in ("hose_spring", "torque_offset")]
    found = document.document(diagnose.diagnose(robot, traces, effects))
    assert found.effects == []
    assert found.cannot_tell[0].code == "gravity"
    assert "different direction" in " ".join(sentences(found))


def test_a_log_already_corrected(write: Write, diagnosed, tmp_path: Path) -> None:
    logs = [write(f"run_{seed}", swing(seed), seconds=3.0, seed=seed, stuck=3.0) for seed in range(3)]
    found, _ = diagnosed(*logs)  # without commands
    assert [effect["name"] for effect in found["effects"]] == ["stribeck_friction"]
    corrected = tmp_path / "out" / "corrected.toml"
    for options in ({"robot": corrected}, {"baseline": corrected}):
        again, text = diagnosed(*logs, **options, out=tmp_path / "again")
        assert again["effects"] == []
        assert again["verdict"] == "within_noise"
        assert "The description already contains stribeck friction." in text
        assert again["gap"]["shrink"] == pytest.approx(0.0, abs=0.05)

    identified = tmp_path / "identified.toml"
    arguments = ["identify", *logs, "--robot", str(tmp_path / "robot.toml"), "--out", str(identified)]
    assert CliRunner().invoke(app, arguments, catch_exceptions=False).exit_code == 0
    from_there, _ = diagnosed(*logs, baseline=identified)
    assert [effect["name"] for effect in from_there["effects"]] == ["stribeck_friction"]
    assert from_there["gap"]["shrink"] == pytest.approx(found["gap"]["shrink"], abs=0.1)


def test_a_baseline_of_another_robot_is_one_line(write: Write, tmp_path: Path) -> None:
    heavier = ROBOT.model_copy(update={"mass": Mass(active_link=3.4, passive_link=0.7, platform=2.4)})
    save_robot(heavier, tmp_path / "heavier.toml")
    arguments = ["diagnose", write("run", swing(1), seconds=1.0), "--robot", str(tmp_path / "robot.toml")]
    arguments += ["--baseline", str(tmp_path / "heavier.toml"), "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 1
    assert isinstance(result.exception, DeltatwinError)
    assert str(result.exception) == "baseline bench: its mass differs from that of robot bench"


def test_an_effect_of_ones_own_is_found(write: Write, diagnosed, tmp_path: Path) -> None:
    own = tmp_path / "own.py"
    own.write_text(
        "from __future__ import annotations\n"
        "from dataclasses import dataclass\n"
        "import numpy as np\n"
        "from service.model.effects.base import Amplitude, Effect\n"
        "@dataclass(frozen=True)\n"
        "class EndStop(Effect):\n"
        "    stiffness: Amplitude = Amplitude('N m/rad', 'of a rubber stop from 0.5 rad on')\n"
        "    name = 'rubber_stop'\n"
        "    settles = 'a slow sweep to the end'\n"
        "    def regressors(self, scene, joint, nonlinear):\n"
        "        return np.maximum(scene.segment.theta[:, [joint]] - 0.5, 0.0)\n"
    )
    logs = []
    for seed in range(2):
        path = tmp_path / write(f"run_{seed}", swing(seed), seed=seed)
        header, *rows = path.read_text().splitlines()
        names = header.split(",")
        table = np.array([line.split(",") for line in rows], float)
        angle, torque = names.index("position_2_rad"), names.index("torque_2_nm")
        table[:, torque] += 20.0 * np.maximum(table[:, angle] - 0.5, 0.0)
        np.savetxt(path, table, fmt="%.17g", delimiter=",", header=header, comments="")
        logs.append(str(path))
    found, text = diagnosed(*logs, effects=own)
    (effect,) = found["effects"]
    assert (effect["name"], effect["joints"]) == ("rubber_stop", [2])
    assert effect["parameters"]["stiffness"]["value"] == pytest.approx(20.0, rel=0.05)
    assert effect["parameters"]["stiffness"]["unit"] == "N m/rad"
    assert "rubber stop in joint 2" in text
