"""A real servo axis: the EMPS benchmark's published parameters, its friction by direction, its injected pulses."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.trace import read_trace
from schemas.axes_description import load_axes
from schemas.errors import DataError, RobotError, TraceError
from service.cli.main import app
from service.model.prediction import motion
from service.model.signals import lowpass

# Janot, Gautier, Brunot 2019: M kg, F_v N s/m, F_c N, offset N; with friction by direction F_v+ and F_v-; relative
# error without and with that
PUBLISHED = {"inertia_1": 95.1089, "f_v_1": 203.5034, "f_c_1": 20.3935, "offset_1": -3.1648}
FORWARD, BACKWARD = 166.7, 240.3
RELATIVE = (0.0404, 0.0306)
DESCRIPTION = 'name = "emps"\nkind = "axes"\ncolumns = "emps"\n[[axis]]\nunit = "m"\n'

run = CliRunner().invoke


class Diagnosed(NamedTuple):
    robot: Path
    log: Path
    pulses: Path
    out: Path
    document: dict[str, Any]
    text: str


@pytest.fixture(scope="module")
def emps(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Diagnosed:
    """The command as a user gives it: diagnose one log, try the correction on the other."""
    folder = tmp_path_factory.mktemp("emps")
    robot = folder / "emps.toml"
    robot.write_text(DESCRIPTION)
    log, pulses = (data / "real" / "emps" / name for name in ("emps.csv", "emps_pulses.csv"))
    out = folder / "out"
    arguments = ["diagnose", log, "--robot", robot, "--out", out, "--test", pulses]
    result = run(app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert result.exit_code == 0
    document = json.loads((out / "diagnosis.json").read_text())
    return Diagnosed(robot, log, pulses, out, document, " ".join(result.output.split()))


def test_published_parameters(emps: Diagnosed) -> None:
    for name, value in PUBLISHED.items():
        assert emps.document["plain"][name] == pytest.approx(value, rel=0.01)
    assert emps.document["base"]["inertia_1"]["unit"] == "kg"


def test_friction_by_direction_is_named(emps: Diagnosed) -> None:
    (effect,) = emps.document["effects"]
    assert effect["name"] == "asymmetric_friction"
    assert effect["probability"] > 0.95
    delta = effect["parameters"]["delta_v"]
    assert delta["unit"] == "N s/m"
    viscous = emps.document["base"]["f_v_1"]["value"]
    assert viscous + delta["value"] == pytest.approx(FORWARD, rel=0.01)
    assert viscous - delta["value"] == pytest.approx(BACKWARD, rel=0.01)


def test_error_left_is_no_larger_than_the_published_one(emps: Diagnosed) -> None:
    trace = read_trace(emps.log, load_axes(emps.robot))
    moving = motion(trace).moving
    torque = np.sqrt(np.mean(lowpass(trace.torque, 1e-3)[moving] ** 2))
    gap = emps.document["gap"]
    assert gap["before_nm"][0] / torque <= RELATIVE[0]
    assert gap["after_nm"][0] / torque <= RELATIVE[1]


def pulse_edges(path: Path) -> np.ndarray:
    """Moments in s at which the injected force switches."""
    time, force = np.loadtxt(path, delimiter=",", skiprows=1, usecols=(0, 4), unpack=True)
    return time[1:][np.diff(force) != 0]


def near(moments: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(moments, stretches) bool, to within a few hundredths of a second."""
    return (moments[:, None] > start - 0.05) & (moments[:, None] < end + 0.05)


def test_shrink_on_the_other_log_outside_the_pulses(emps: Diagnosed) -> None:
    (test,) = emps.document["tests"]
    edges = pulse_edges(emps.pulses)
    assert len(edges) == 49
    start, end = (np.array([burst[key] for burst in test["bursts"]]) for key in ("from_s", "to_s"))
    hit = near(edges, start, end)
    assert hit.any(axis=1).sum() >= 47  # pulses found
    assert hit.any(axis=0).sum() >= len(start) - 4  # and little else
    assert test["rhythm_s"] == pytest.approx(0.5, rel=0.01)  # half a second on, half a second off
    assert "most of them every 0.5 s" in emps.text

    # the claim by other means: the corrected description along the log, without the stretches that are called bursts
    axes = load_axes(emps.out / "corrected.toml")
    trace = read_trace(emps.pulses, axes)
    arguments = ["evaluate", emps.pulses, "--robot", emps.out / "corrected.toml", "--predictions", emps.out]
    assert run(app, [str(argument) for argument in arguments], catch_exceptions=False).exit_code == 0
    predicted = np.loadtxt(emps.out / "emps_pulses.csv", delimiter=",", skiprows=1, usecols=1)
    error = lowpass(trace.torque[:, 0] - predicted, 1e-3)
    moves = motion(trace).moving[:, 0]
    away = moves & ~near(trace.time, edges - 0.02, edges + 0.08).any(axis=1)
    told = moves & ~near(trace.time, start, end).any(axis=1)
    assert told.sum() > 0.9 * away.sum()  # by the pulses' own record, no more is left out than they take
    assert test["outside"]["after_nm"][0] == pytest.approx(np.sqrt(np.mean(error[told] ** 2)), rel=0.01)
    low, high = test["outside"]["shrink_ci95"]
    assert 0.1 < low < 1 - RELATIVE[1] / RELATIVE[0] < high < 0.3  # what friction by direction takes, as published
    assert low < test["outside"]["shrink"] < high


def test_pulses_alone_are_outside_the_catalogue(emps: Diagnosed, tmp_path: Path) -> None:
    arguments = ["diagnose", emps.pulses, "--robot", emps.robot, "--out", tmp_path]
    assert run(app, [str(argument) for argument in arguments], catch_exceptions=False).exit_code == 0
    found = json.loads((tmp_path / "diagnosis.json").read_text())
    assert found["verdict"] in ("unexplained", "partly_explained")
    assert "asymmetric_friction" in [effect["name"] for effect in found["effects"]]


def test_what_was_found_is_not_found_again(emps: Diagnosed, tmp_path: Path) -> None:
    corrected = emps.out / "corrected.toml"
    arguments = ["diagnose", emps.log, "--robot", corrected, "--out", tmp_path]
    assert run(app, [str(argument) for argument in arguments], catch_exceptions=False).exit_code == 0
    found = json.loads((tmp_path / "diagnosis.json").read_text())
    assert found["effects"] == []
    assert found["gap"]["before_nm"] == pytest.approx(emps.document["gap"]["after_nm"], rel=0.02)
    assert load_axes(tmp_path / "corrected.toml").effect[0].name == "asymmetric_friction"


def test_evaluate_inspect_and_convert_take_axes(emps: Diagnosed, tmp_path: Path) -> None:
    converted = tmp_path / "emps.csv"
    assert run(app, ["convert", str(emps.log), str(converted), "--robot", str(emps.robot)]).exit_code == 0
    assert "position_1_m" in converted.read_text()[:200]
    shown = run(app, ["inspect", str(converted), "--robot", str(emps.robot), "--json"])
    assert json.loads(shown.stdout)["traces"][0]["channels"]["torque_1"]["unit"] == "N"
    corrected = str(emps.out / "corrected.toml")
    figures = [
        json.loads(run(app, ["evaluate", str(log), "--robot", corrected, "--json"]).stdout)
        for log in (emps.log, converted)
    ]
    assert figures[0]["models"] == figures[1]["models"]
    assert figures[0]["unit"] == "N"
    rms = [model["rms_nm"][0] for model in figures[0]["models"].values()]
    assert rms == sorted(rms, reverse=True)


def test_what_does_not_fit_is_one_line(emps: Diagnosed, data: Path, tmp_path: Path) -> None:
    delta = data / "plant_logs" / "case_000"
    log = delta / "test_a_pick.csv"
    two = tmp_path / "two.toml"
    two.write_text(DESCRIPTION + "[[axis]]\n")
    for arguments, error, words in (
        (["evaluate", emps.log, "--robot", emps.robot], DataError, "no .identified."),
        (["evaluate", log, "--robot", emps.out / "corrected.toml"], TraceError, "3 joints, emps is described with 1"),
        (["inspect", log, "--robot", two], None, "3 joints, emps is described with 2"),
        (["evaluate", log, "--robot", tmp_path / "none.toml"], RobotError, "No such file"),
        (
            ["diagnose", emps.log, "--robot", emps.robot, "--out", tmp_path, "--baseline", delta / "robot.toml"],
            RobotError,
            "baseline .*: its kind differs from that of robot emps",
        ),
    ):
        result = run(app, [str(argument) for argument in arguments])
        assert result.exit_code == 1
        told = str(result.exception) if error else result.stderr
        assert error is None or isinstance(result.exception, error)
        assert re.search(words, told)
        assert "\n" not in told.strip()
