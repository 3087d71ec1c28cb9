"""`deltatwin evaluate` as a user runs it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from schemas.errors import TraceError
from service.cli.main import app

run = CliRunner().invoke


@pytest.fixture(scope="module")
def case(data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A reference case and its identified description."""
    folder = data / "plant_logs" / "case_000"
    out = tmp_path_factory.mktemp("identified") / "robot.toml"
    logs = [str(path) for path in sorted(folder.glob("fit_*.csv"))]
    result = run(app, ["identify", *logs, "--robot", str(folder / "robot.toml"), "--out", str(out)])
    assert result.exit_code == 0, result.output
    return folder, out


def test_predictions_hold_every_row(case: tuple[Path, Path], tmp_path: Path) -> None:
    folder, robot = case
    traces = sorted(folder.glob("test_*.csv"))
    result = run(app, ["evaluate", *map(str, traces), "--robot", str(robot), "--predictions", str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert sorted(path.name for path in tmp_path.iterdir()) == [path.name for path in traces]
    for path in traces:
        measured = np.loadtxt(path, delimiter=",", skiprows=1)
        header = (tmp_path / path.name).read_text().splitlines()[0]
        predicted = np.loadtxt(tmp_path / path.name, delimiter=",", skiprows=1)
        assert header == "time_s,torque_model_1_nm,torque_model_2_nm,torque_model_3_nm"
        assert np.array_equal(predicted[:, 0], measured[:, 0])
        assert np.std(predicted[:, 1:] - measured[:, 10:13]) < 0.1 * np.std(measured[:, 10:13])


def test_json_has_a_smaller_error_for_each_larger_model(case: tuple[Path, Path]) -> None:
    folder, robot = case
    result = run(app, ["evaluate", str(folder / "test_a_pick.csv"), "--robot", str(robot), "--json"])
    document = json.loads(result.stdout)
    rms = [np.linalg.norm(model["rms_nm"]) for model in document["models"].values()]
    assert list(document["models"]) == ["M_KH", "M_Id", "M_Id+F", "full"]
    assert rms == sorted(rms, reverse=True)
    assert document["traces"][0]["rows"] == 5001


def test_two_traces_for_one_prediction_are_refused(case: tuple[Path, Path], tmp_path: Path) -> None:
    folder, robot = case
    trace = str(folder / "test_a_pick.csv")
    result = run(app, ["evaluate", trace, trace, "--robot", str(robot), "--predictions", str(tmp_path)])
    assert isinstance(result.exception, TraceError)
    assert "a second log that would be written to" in str(result.exception)
