"""`deltatwin init`: what it writes is read again, what cannot be is refused with its key, a terminal is asked."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from schemas.axes_description import Axes, load_description
from schemas.chain_description import Chain
from schemas.errors import DeltatwinError, RobotError, StorageError
from schemas.robot import load_robot
from service.cli.main import app
from service.interview import DELTA, for_axes

PROGRAM = Path(sys.executable).with_name("deltatwin")
ANSWERS = {
    "name": "cell-3", "geometry.active_link_length": "0.3", "geometry.passive_link_length": "0.8",
    "geometry.base_radius": "0.2", "geometry.platform_radius": "0.05", "mass.active_link": "1",
    "mass.passive_link": "0.2", "mass.platform": "0.5", "drive.gear_ratio": "25", "limits.max_payload_kg": "4",
}  # fmt: skip


def init(out: Path, answers: dict[str, str], *options: str) -> None:
    given = [word for key, value in answers.items() for word in ("--answer", f"{key}={value}")]
    done = CliRunner().invoke(app, ["init", "--out", str(out), *options, *given], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert f"next: deltatwin import YOUR_LOG --robot {out}" in done.stdout


def test_a_delta_is_what_was_answered(tmp_path: Path) -> None:
    init(tmp_path / "robot.toml", ANSWERS)
    robot = load_robot(tmp_path / "robot.toml")
    for key, value in ANSWERS.items():
        table, _, name = key.rpartition(".")
        assert str(getattr(getattr(robot, table) if table else robot, name)).removesuffix(".0") == value
    text = (tmp_path / "robot.toml").read_text()
    assert all(question.comment in text for question in DELTA), "each value with its unit and meaning"
    with pytest.raises(StorageError, match="exists already"):
        init(tmp_path / "robot.toml", ANSWERS)


def test_axes_and_an_arm_by_its_urdf(data: Path, tmp_path: Path) -> None:
    init(tmp_path / "axes.toml", {"axis.2.unit": "m", "axis.1.gravity": "false"}, "--axes", "2")
    axes = load_description(tmp_path / "axes.toml")
    assert isinstance(axes, Axes)
    assert [(axis.unit, axis.gravity) for axis in axes.axis] == [("rad", False), ("m", None)]
    (tmp_path / "cad").mkdir()
    urdf = tmp_path / "cad" / "ur10.urdf"
    shutil.copy(data / "real" / "ur10_unisa" / "ur10_robot.urdf", urdf)
    init(tmp_path / "arm.toml", {}, "--urdf", str(urdf))
    arm = load_description(tmp_path / "arm.toml")
    assert isinstance(arm, Chain)
    assert (arm.name, arm.urdf, arm.count, arm.joints[0]) == ("ur10", "cad/ur10.urdf", 6, "shoulder_pan_joint")


@pytest.mark.parametrize(
    ("answers", "options", "says"),
    [
        ({"geometry.base_radius": None}, (), "geometry.base_radius: not answered"),
        ({"geometry.base_radius": "wide"}, (), "geometry.base_radius: 'wide' is not a number"),
        ({"geometry.passive_link_length": "0.1"}, (), "passive_link_length 0.1 m does not reach the axis"),
        ({"mass.platform": "-1"}, (), "mass.platform"),
        ({}, ("--axes", "99"), "--axes 99: 1 to 12"),
        ({}, ("--urdf", "nothing.urdf"), "nothing.urdf"),
    ],
)
def test_what_cannot_be_is_one_line_with_its_key_and_nothing_is_written(
    tmp_path: Path, answers: dict, options: tuple[str, ...], says: str
) -> None:
    given = {} if options else {key: value for key, value in (ANSWERS | answers).items() if value is not None}
    with pytest.raises(DeltatwinError, match=says) as error:
        init(tmp_path / "robot.toml", given, *options)
    assert isinstance(error.value, RobotError)
    assert not list(tmp_path.iterdir())


def test_an_unknown_key_names_those_that_there_are(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["init", "--out", str(tmp_path / "r.toml"), "--answer", "geometry.arm=1"])
    assert done.exit_code == 2
    assert "geometry.active_link_length" in done.output
    assert len({question.key for question in for_axes(12)}) == 37


def test_a_terminal_is_asked_and_asked_again_where_it_cannot_be(tmp_path: Path) -> None:
    pty = pytest.importorskip("pty")
    master, slave = pty.openpty()
    command = [PROGRAM, "init", "--out", tmp_path / "robot.toml", "--answer", "name=cell-3"]
    with subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave) as process:
        os.close(slave)
        asked = [value for key, value in ANSWERS.items() if key != "name"]
        too_short = [asked[0], "0.1", *asked[2:]]
        again = ["", "", "0.8", *[""] * 7]  # what was answered is what it is if nothing is
        os.write(master, "\n".join([*too_short, *again, ""]).encode())
        said = b""
        while process.poll() is None:
            try:
                said += os.read(master, 4096)
            except OSError:
                break
        assert process.wait(60) == 0, said.decode()
    os.close(master)
    assert b"does not reach the axis" in said
    assert b"upper arm, from the motor's axis to the elbow, m" in said
    robot = load_robot(tmp_path / "robot.toml")
    assert (robot.name, robot.geometry.passive_link_length, robot.drive.gear_ratio) == ("cell-3", 0.8, 25.0)
