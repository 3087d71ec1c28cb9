"""The load on three arms whose logs MuJoCo made: mass, centre, inertia, and how far the errors can be trusted."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.trace import read_trace
from schemas.axes_description import Description, load_description, save_description
from schemas.chain_description import Chain
from schemas.errors import RobotError
from service.cli.main import app
from service.identification.joint_machines import identify_axes
from service.identification.log_load import load_on
from tests.service.arms import FOUR, SEVEN, SIX, Kind, Load

pytest.importorskip("pinocchio")
KINDS = {kind.name: kind for kind in (FOUR, SIX, SEVEN)}
LOAD = Load(1.7, (0.03, -0.02, 0.09), (0.006, 0.005, 0.004))
INERTIA = np.array([0.006, 0.0, 0.005, 0.0, 0.0, 0.004])


@pytest.fixture(scope="module", params=KINDS)
def known(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Kind, Description, Path]:
    """An arm, what is identified of it from a URDF whose masses are wrong, and the folder."""
    kind, folder = KINDS[request.param], tmp_path_factory.mktemp(request.param)
    (folder / "arm.urdf").write_text(kind.urdf(scale=1.15))
    (folder / "arm.toml").write_text(kind.description())
    plain = load_description(folder / "arm.toml")
    logs = [read_trace(kind.record(folder / f"empty_{seed}.csv", seed), plain) for seed in (0, 1)]
    assert isinstance(plain, Chain)
    robot = identify_axes(plain, logs).robot
    save_description(robot, folder / "identified.toml")
    return kind, load_description(folder / "identified.toml"), folder


def test_mass_centre_and_inertia_are_those_that_hang_there(known: tuple[Kind, Description, Path]) -> None:
    kind, robot, folder = known
    found = load_on(robot, read_trace(kind.record(folder / "load.csv", 50, LOAD), robot), "flange")
    assert found.mass == pytest.approx(LOAD.mass, abs=max(0.02, 0.02 * LOAD.mass))
    np.testing.assert_allclose(found.centre, LOAD.centre, atol=0.01)
    assert found.inertia_told
    np.testing.assert_allclose(found.inertia, INERTIA, atol=0.001)
    errors = np.r_[found.mass_error, found.centre_error, found.inertia_error]
    off = np.r_[found.mass - LOAD.mass, found.centre - LOAD.centre, found.inertia - INERTIA]
    assert np.abs(off / errors).max() < 5
    assert (found.after < found.before + 1e-3).all()
    assert found.after.sum() < 0.2 * found.before.sum()


def test_an_empty_arm_carries_nothing(known: tuple[Kind, Description, Path]) -> None:
    kind, robot, folder = known
    found = load_on(robot, read_trace(kind.record(folder / "none.csv", 51), robot), "flange")
    assert not found.seen
    assert abs(found.mass) < 0.02


def test_the_command_says_it_with_its_errors(known: tuple[Kind, Description, Path]) -> None:
    kind, _, folder = known
    log = kind.record(folder / "said.csv", 50, LOAD)
    line = ["payload", str(log), "--robot", str(folder / "identified.toml"), "--frame", "flange"]
    text = CliRunner().invoke(app, line, catch_exceptions=False).output
    assert "kg on flange, centre within" in text
    (load,) = json.loads(CliRunner().invoke(app, [*line, "--json"], catch_exceptions=False).stdout)["loads"]
    assert load["mass"] == pytest.approx(LOAD.mass, abs=0.034)
    wrong = CliRunner().invoke(app, [*line[:-1], "hand"])
    assert isinstance(wrong.exception, RobotError)
    assert "has no link 'hand'" in str(wrong.exception)
