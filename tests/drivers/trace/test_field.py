"""Logs as the field has them: each is read as it was, or refused in one line that says why and what to do.

The inputs are those of `../shared/field`, each beside a README that says what is right.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.trace import read_trace
from schemas.columns import load_columns
from schemas.errors import DataError
from service.cli.main import app


@pytest.fixture
def field(shared: Path) -> Path:
    folder = shared / "field"
    if not folder.is_dir():
        pytest.skip("needs ../shared/field")
    return folder


def imported(log: Path, robot: Path, folder: Path, *options: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """Stamps, positions and torques of the log that `import` makes of `log`, and what it says."""
    arguments = ["import", str(log), "--robot", str(robot), "--yes", "--out", str(folder / "log.csv"), *options]
    done = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    trace = read_trace(folder / "log.csv")
    return trace.time, trace.position, trace.torque, " ".join(done.output.split())


def refused(log: Path, robot: Path, folder: Path) -> str:
    """What `import` says of a log that it does not take."""
    arguments = ["import", str(log), "--robot", str(robot), "--yes", "--out", str(folder / "log.csv")]
    with pytest.raises(DataError) as said:
        CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert "\n" not in str(said.value)
    return str(said.value)


def test_joints_go_by_name(field: Path, tmp_path: Path) -> None:
    folder = field / "bag_joint_order"
    _, position, _, said = imported(folder / "ur.mcap", folder / "arm.toml", tmp_path)
    names = [entry.name for entry in load_columns(tmp_path / "log.columns.toml").channel("torque")]
    assert names == ["shoulder_pan_joint.effort", "shoulder_lift_joint.effort", "elbow_joint.effort"]
    assert np.ptp(position[:, 0]) == pytest.approx(1.324 + 1.3177, abs=1e-3)  # of the pan joint, by the README's table
    assert "joints by the names of the description: 1 is 'shoulder_pan_joint.position'" in said


def test_a_velocity_is_no_torque(field: Path, tmp_path: Path) -> None:
    folder = field / "effort_missing"
    assert "no torque was recorded" in refused(folder / "bag.mcap", folder / "robot.toml", tmp_path)
    assert not list(tmp_path.iterdir())
