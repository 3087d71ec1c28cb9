"""An arm of known truth, by MuJoCo: its masses, friction, rotor and payload from logs, through the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.trace import read_trace
from schemas.axes_description import load_axes, save_description
from schemas.chain_description import Chain, ChainIdentified
from schemas.errors import DataError
from service.cli.main import app
from service.diagnosis.documents.document import corrected, document
from service.diagnosis.pipeline import diagnose
from service.model.effects import catalogue
from service.model.mechanism import SerialArm
from tests.service import arm

pytest.importorskip("pinocchio")


def run(command: str, *words: object) -> str:
    result = CliRunner().invoke(app, [command, *map(str, words)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def identified(path: Path) -> ChainIdentified:
    description = load_axes(path)
    assert isinstance(description, Chain)
    assert description.identified is not None
    return description.identified


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with three logs and what `identify` writes of two, from a URDF whose masses are wrong."""
    folder = tmp_path_factory.mktemp("arm")
    wrong = arm.URDF.replace('mass value="3"', 'mass value="5"').replace('mass value="1.5"', 'mass value="0.5"')
    arm.write(folder, wrong)
    logs = [arm.record(folder / f"log_{seed}.csv", seed) for seed in range(3)]
    run("identify", *logs[:2], "--robot", folder / "small.toml", "--out", folder / "identified.toml")
    return folder


def test_masses_friction_and_rotor_are_recovered(bench: Path, tmp_path: Path) -> None:
    found, true = identified(bench / "identified.toml"), load_axes(arm.write(tmp_path))
    assert isinstance(true, Chain)
    mechanism = SerialArm.of(true)
    expected = dict(zip(mechanism.coefficients, mechanism.start, strict=True))
    expected |= {f"offset_{j + 1}": value for j, value in enumerate(arm.OFFSET)} | {"rotor_3": arm.ROTOR[2]}
    assert found.rigid.keys() == expected.keys()
    for name, value in expected.items():
        assert found.rigid[name].value == pytest.approx(value, abs=max(0.01, 4 * found.rigid[name].std_error)), name
    for name in ("mx_2", "mx_3", "rotor_2", "Izz_3"):
        assert found.rigid[name].value == pytest.approx(expected[name], rel=0.03), name
    assert found.viscous_friction.value == pytest.approx(arm.VISCOUS, rel=0.05)
    assert found.coulomb_friction.value == pytest.approx(arm.COULOMB, rel=0.05)


def test_a_log_kept_out_is_predicted(bench: Path) -> None:
    shown = json.loads(run("evaluate", bench / "log_2.csv", "--robot", bench / "identified.toml", "--json"))["models"]
    assert max(shown["full"]["rms_nm"]) < 0.08, "torque of 2 to 15 N m, reversals between samples"
    assert min(shown["URDF"]["rms_nm"]) > 0.5, "wrong masses, no friction"


def test_an_effect_sits_on_a_joint_of_an_arm(bench: Path, tmp_path: Path) -> None:
    """Friction that grows as the joint moves slowly, on joint 2: named there and nowhere else."""
    logs = []
    for seed in range(2):
        speed = arm.motion(seed)[1][1][:, 1]
        stuck = np.zeros((len(speed), 3))
        stuck[:, 1] = 1.2 * np.sign(speed) * np.exp(-((speed / 0.3) ** 2))
        logs.append(arm.record(tmp_path / f"log_{seed}.csv", seed, stuck))
    robot = load_axes(bench / "small.toml")
    asked = ("stribeck_friction", "joint_spring", "nonlinear_viscous_friction")
    effects = [effect for effect in catalogue() if effect.name in asked]
    findings = diagnose(robot, [read_trace(log, robot) for log in logs], effects)
    (effect,) = document(findings).effects
    assert (effect.name, effect.joints) == ("stribeck_friction", [2])
    fixed = corrected(findings)
    assert isinstance(fixed, Chain)
    save_description(fixed, tmp_path / "corrected.toml")
    again = run("evaluate", logs[0], "--robot", tmp_path / "corrected.toml", "--json")
    assert max(json.loads(again)["models"]["full"]["rms_nm"]) < 0.08


def test_a_payload_is_weighed_by_an_arm_that_is_known(bench: Path, tmp_path: Path) -> None:
    """0.8 kg on the tool: the same arm with a heavier tool, its masses those that were identified without."""
    text = (bench / "identified.toml").read_text()
    loaded = bench / "loaded.toml"
    loaded.write_text('masses = "known"\npayload = { frame = "tool" }\n' + text)
    true = arm.URDF.replace(
        '<link name="tool"/>', arm.LINK.format(name="tool", xyz="0 0 0", mass=0.8, ixx=5e-3, iyy=5e-3, izz=5e-3)
    )
    log = arm.record(tmp_path / "loaded.csv", 4, urdf=true)
    run("identify", log, "--robot", loaded, "--out", bench / "weighed.toml")
    found = identified(bench / "weighed.toml").rigid
    assert found["payload"].value == pytest.approx(0.8, abs=0.03)
    assert found["mx_2"].value == identified(bench / "identified.toml").rigid["mx_2"].value


def test_degrees_that_are_called_radians(bench: Path, tmp_path: Path) -> None:
    """Three degrees to either side look like three radians, which the limits allow."""
    log = arm.record(tmp_path / "small.csv", 1, share=0.04, unit=np.pi / 180)
    arguments = ["identify", log, "--robot", bench / "small.toml", "--out", tmp_path / "out.toml"]
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert isinstance(result.exception, DataError)
    assert "small.csv: with the masses of the description the torque fits positions in degrees" in str(result.exception)


def test_joints_in_another_order_than_the_log_has_are_told(bench: Path, tmp_path: Path) -> None:
    """A fit of free masses explains much of it."""
    robot = arm.write(tmp_path)
    robot.write_text(robot.read_text().replace('"j1", "j2"', '"j2", "j1"'))
    logs = [bench / "log_0.csv", bench / "log_1.csv"]
    told = " ".join(run("identify", *logs, "--robot", robot, "--out", tmp_path / "out.toml").split())
    assert "order of joints, gear ratio and coupling right?" in told
    own = run("identify", *logs, "--robot", bench / "small.toml", "--out", tmp_path / "own.toml")
    assert "order of joints" not in " ".join(own.split())


def test_a_joint_that_never_moves_and_logs_of_two_arms(bench: Path, tmp_path: Path) -> None:
    heavy = arm.URDF.replace('mass value="3"', 'mass value="6"')
    logs = [bench / "log_0.csv", arm.record(tmp_path / "theirs.csv", 6, urdf=heavy)]
    told = run("identify", *logs, "--robot", bench / "small.toml", "--out", tmp_path / "two.toml")
    assert "the model fits each log alone, but not all together" in " ".join(told.split())
    own = run(
        "identify",
        bench / "log_0.csv",
        bench / "log_1.csv",
        "--robot",
        bench / "small.toml",
        "--out",
        tmp_path / "one.toml",
    )
    assert "each log alone" not in own
    text = (tmp_path / "theirs.csv").read_text().splitlines()
    table = np.array([line.split(",") for line in text[1:]], float)
    table[:, 3] = 0.1
    np.savetxt(tmp_path / "still.csv", table, "%.10g", ",", header=text[0], comments="")
    told = run("identify", tmp_path / "still.csv", "--robot", bench / "small.toml", "--out", tmp_path / "still.toml")
    assert "joint 3 never moves" in " ".join(told.split())
    (left,) = [line for line in told.splitlines() if "still.csv" in line and " / " in line]
    assert left.count("never moves") == 3  # of torque, residual and held out
