"""`deltatwin init`: what it writes is read again, what cannot be is refused with its key, a terminal is asked."""

from __future__ import annotations

import os
import re
import select
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from typer.testing import CliRunner

from drivers.ethercat.cia402 import scales
from schemas.axes_description import Axes, load_description
from schemas.chain_description import Chain
from schemas.errors import DeltatwinError, RobotError, StorageError
from schemas.robot import load_robot
from service.cli.main import app
from service.interview import DELTA, for_axes
from tests.service.arm import URDF

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
    assert 'urdf = "cad/ur10.urdf"  # as seen from this file\n' in (tmp_path / "arm.toml").read_text()


HEAD = "joint,gear_ratio,counts_per_turn,sign,zero_counts,rated_torque_nm\n"
ROWS = "2,25,1048576,-1,7,2.4\n1,25,1048576,1,0,2.4\n3,20.5,1048576,1,-3,2.4\n"


def test_a_list_of_drives_gives_gears_and_the_scaling_of_the_bus(tmp_path: Path) -> None:
    listed, answers = tmp_path / "drives.csv", {key: value for key, value in ANSWERS.items() if "gear" not in key}
    listed.write_text(HEAD + ROWS)
    init(tmp_path / "robot.toml", answers, "--drives", str(listed))
    robot = load_robot(tmp_path / "robot.toml")
    assert robot.drive.gear_ratio == 25.0
    found = [(one.gear_ratio, one.sign, one.zero_counts, one.torque.full_scale_nm) for one in robot.drive.joint]
    assert found == [(25.0, 1, 0, 2.4), (25.0, -1, 7, 2.4), (20.5, 1, -3, 2.4)]
    assert [scale.zero_counts for scale in scales(robot)] == [0, 7, -3]
    listed.write_text("joint,gear_ratio,counts_per_turn,rated_current_a,torque_constant_nmpa\n"
                      + "".join(f"{joint},25,65536,4,0.6\n" for joint in (1, 2, 3)))  # fmt: skip
    init(tmp_path / "current.toml", answers, "--drives", str(listed))
    torques = [one.torque.full_scale_nm for one in load_robot(tmp_path / "current.toml").drive.joint]
    assert torques == [pytest.approx(2.4)] * 3


def test_a_list_of_drives_of_axes_and_of_an_arm(tmp_path: Path) -> None:
    listed = tmp_path / "drives.csv"
    listed.write_text("joint,gear_ratio\n1,10\n2,50\n")
    init(tmp_path / "axes.toml", {}, "--axes", "2", "--drives", str(listed))
    axes = load_description(tmp_path / "axes.toml")
    assert isinstance(axes, Axes)
    assert [axis.gear_ratio for axis in axes.axis] == [10.0, 50.0]
    (tmp_path / "small.urdf").write_text(URDF)
    listed.write_text("joint,gear_ratio\n1,10\n2,50\n3,7.5\n4,1\n")
    init(tmp_path / "arm.toml", {}, "--urdf", str(tmp_path / "small.urdf"), "--drives", str(listed))
    arm = load_description(tmp_path / "arm.toml")
    assert isinstance(arm, Chain)
    assert arm.gear_ratio == [10.0, 50.0, 7.5, 1.0]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (HEAD + ROWS.replace("20.5", "steep"), "row 4: gear_ratio: .*got 'steep'"),
        (HEAD + ROWS.replace("20.5", "-2"), "row 4: gear_ratio: .*greater than 0"),
        (HEAD + ROWS.replace("-1,7", "2,7"), "row 2: sign: "),
        (HEAD + ROWS.replace("3,20.5", "1,20.5"), "row 4: joint: 1 has a row already"),
        (HEAD + ROWS.rpartition("3,20")[0], "joint: rows for 1, 2; one row for each of 1 to 3"),
        (HEAD + ROWS.replace("3,20.5,1048576", "3,20.5,"), "counts_per_turn: give it for all drives, or for none"),
        (HEAD + ROWS.replace("1,0,2.4", "1,0,"), "row 3: counts_per_turn is given: rated_torque_nm or"),
        (HEAD.replace("sign", "direction") + ROWS, "row 2: direction: unknown key"),
        (
            "joint,gear_ratio,rated_torque_nm\n1,25,2.4\n2,25,2.4\n3,25,2.4\n",
            "joint 1: rated_torque_nm 2.4: counts_per_turn is missing .* use `import --torque-unit`",
        ),
        ("joint,gear_ratio,sign\n1,25,1\n2,25,-1\n3,25,1\n", "joint 2: sign -1: counts_per_turn is missing"),
        ("joint,gear_ratio\n1,2,3\n", "row 2: more cells than the header has columns"),
        ("\xff", "drives.csv: "),
    ],
)
def test_what_is_wrong_in_a_list_of_drives_is_named(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "drives.csv").write_text(text, encoding="latin-1")
    with pytest.raises(RobotError, match=rf"drives\.csv: .*{says}|{says}") as error:
        init(tmp_path / "robot.toml", ANSWERS, "--drives", str(tmp_path / "drives.csv"))
    assert "\n" not in str(error.value)
    assert [path.name for path in tmp_path.iterdir()] == ["drives.csv"]


@pytest.mark.parametrize(
    ("keys", "values", "refused"),
    [
        ("counts_per_turn,rated_torque_nm", "100,1", "counts_per_turn: .* `import --counts-per-rev`"),
        ("rated_current_a,torque_constant_nmpa", "4,0.6", "rated_current_a: .* `import --torque-unit`"),
        ("zero_counts", "7", "zero_counts: .* `zero` in the mapping"),
    ],
)
def test_the_bus_of_axes_is_scaled_elsewhere(tmp_path: Path, keys: str, values: str, refused: str) -> None:
    (tmp_path / "drives.csv").write_text(f"joint,gear_ratio,{keys}\n1,2,{values}\n")
    with pytest.raises(RobotError, match=refused.replace(": ", ": only for a Delta robot; ", 1)):
        init(tmp_path / "axes.toml", {}, "--axes", "1", "--drives", str(tmp_path / "drives.csv"))


def test_joints_that_are_not_in_the_log_are_at_rest(tmp_path: Path) -> None:
    (tmp_path / "small.urdf").write_text(URDF)
    init(tmp_path / "arm.toml", {"joints": "j1, j2,j3"}, "--urdf", str(tmp_path / "small.urdf"))
    arm = load_description(tmp_path / "arm.toml")
    assert isinstance(arm, Chain)
    assert (arm.joints, arm.held) == (["j1", "j2", "j3"], ["grip"])


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


def terminal(command: Sequence[str | Path], lines: Sequence[str]) -> tuple[int, str]:
    """`command` in a terminal in which somebody types `lines`, then Ctrl-C: exit code, and what is on the screen."""
    pty = pytest.importorskip("pty")
    master, slave = pty.openpty()
    process = subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave, start_new_session=True)
    try:
        os.close(slave)
        said, typed = "", iter(lines)
        while process.poll() is None:
            if not select.select([master], [], [], 5.0)[0] and said.endswith(": "):
                process.send_signal(signal.SIGINT)  # again: one between prompt and input waits for a key
                continue
            try:
                said += os.read(master, 4096).decode()
            except OSError:
                break
            if said.endswith(": "):
                if (line := next(typed, None)) is not None:
                    os.write(master, f"{line}\n".encode())
                else:
                    process.send_signal(signal.SIGINT)
        code = process.wait(60)
    finally:  # `with` would wait for it after the time limit of the test, too
        process.kill()
    os.close(master)
    return code, said.replace("\r", "")


def test_a_wrong_answer_in_a_terminal_is_asked_again_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")  # each sentence in one line
    command = [PROGRAM, "init", "--out", tmp_path / "robot.toml", "--answer", "name=cell-3", "--answer"]
    geometry = ["wide", "0.3", "0.1", "0.2", "0.05", "", "0.8", "", ""]  # what was answered is what it is if nothing is
    code, said = terminal([*command, "drive.gear_ratio=two"], [*geometry, "-1", "1", "0.2", "0.5", "25", ""])
    assert code == 0, said
    upper, forearm = "upper arm, from the motor's axis to the elbow, m", "forearm, from the elbow to its joint"
    for told, asked in (
        ("drive.gear_ratio: 'two' is not a number", f"{upper}: wide"),
        ("'wide' is not a number", f"{upper}: 0.3"),
        ("does not reach the axis", f"{upper} [0.3]: \n{forearm} at the platform, m: 0.8\n"),
        ("mass.active_link: Input should be greater", "mass of one upper arm, kg: 1\n"),
    ):
        assert re.search(f"{re.escape(told)}.*; once more:.*\n{re.escape(asked)}", said), said
    robot = load_robot(tmp_path / "robot.toml")
    assert (robot.name, robot.geometry.passive_link_length, robot.drive.gear_ratio) == ("cell-3", 0.8, 25.0)


def test_questions_in_a_narrow_terminal_begin_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    _, said = terminal([PROGRAM, "init", "--out", tmp_path / "robot.toml", "--axes", "1"], ["one", "rad", "1", "false"])
    assert "\naxis 1 turns (rad) or is linear (m) [rad]: rad\n" in said
    assert "\naxis 1: motor turns per turn of the axis [1]: 1\n" in said


def test_ctrl_c_at_a_question_ends_it_as_ctrl_c_does(tmp_path: Path) -> None:
    code, said = terminal([PROGRAM, "init", "--out", tmp_path / "robot.toml"], ["cell-3"])
    assert (code, said.splitlines()[-1]) == (130, "upper arm, from the motor's axis to the elbow, m: ")
    assert not list(tmp_path.iterdir())
