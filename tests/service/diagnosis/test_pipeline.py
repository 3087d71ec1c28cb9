"""Labelled logs of an independent plant: the named effect is the one that was put in, and the correction runs."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.trace import read_trace
from schemas.robot import load_robot
from service.cli.main import app
from service.model.prediction import error_in_band, motion, predict_along


@pytest.mark.parametrize(
    ("case", "name", "joints", "parameter", "truth", "tolerance"),
    [
        ("case_000", None, [], None, 0.0, 0.0),
        ("case_004", "torque_delay", [], "delay", 0.003, 2e-4),
    ],
)
def test_names_what_was_put_in(data, tmp_path, case, name, joints, parameter, truth, tolerance):
    folder = data / "plant_logs" / case
    logs = [str(path) for path in sorted(folder.glob("fit_*.csv"))]
    kept = [argument for path in sorted(folder.glob("test_*.csv")) for argument in ("--test", str(path))]
    arguments = ["diagnose", *logs, "--robot", str(folder / "robot.toml"), "--out", str(tmp_path), *kept]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    document = json.loads((tmp_path / "diagnosis.json").read_text())
    assert document["schema"] == "deltatwin.diagnosis/2"
    if name is None:
        assert document["verdict"] == "within_noise"
        assert document["effects"] == []
    else:
        assert document["verdict"] in ("explained", "partly_explained")
        (effect,) = document["effects"]
        assert (effect["name"], effect["joints"]) == (name, joints)
        assert effect["parameters"][parameter]["value"] == pytest.approx(truth, abs=tolerance)

    # the corrected description predicts logs that the diagnosis never saw, as well as it claims
    robot = load_robot(tmp_path / "corrected.toml")
    errors = []
    for path in sorted(folder.glob("test_*.csv")):
        trace = read_trace(path, robot)
        along = motion(trace)
        errors.append(error_in_band(trace, along, predict_along(robot, trace, along)["full"]))
    measured = np.sqrt(np.nanmean(np.concatenate(errors) ** 2))
    claimed = np.sqrt(np.mean(np.square(document["gap"]["after_nm"])))
    assert measured == pytest.approx(claimed, rel=0.15)
    assert robot.identified is not None
    assert robot.identified.model_error_nm is not None
    assert robot.identified.torque_commanded == (name is None), "as `identify` says of these logs"
    assert robot.identified.torque_command_ahead_s == (pytest.approx(truth, abs=2e-5) if name else None), (
        "which it and the report are apart by"
    )
    left = np.hypot(robot.identified.model_error_nm.value, document["gap"]["noise_floor_nm"])
    assert measured == pytest.approx(np.sqrt(np.mean(left**2)), rel=0.15)

    # and in the simulator, under the torque of those logs, it comes down to what noise alone does
    for test in document["tests"]:
        found = test["simulated"]
        before, after, floor = (found[f"platform_{which}_mm"] for which in ("before", "after", "floor"))
        assert after < 1.5 * floor
        assert after < (1.05 if name is None else 0.5) * before
        assert f"{before:.2g} mm to {after:.2g} mm" in " ".join(result.output.split())
