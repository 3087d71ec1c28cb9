"""Logs whose torque the drive makes anew only every few samples are taken as they are, and that is said."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.trace import write_trace
from schemas.axes_description import Axes, Axis
from schemas.robot import Robot, save_robot
from schemas.trace import Trace
from service.cli.main import app
from service.identification.evaluation import evaluate
from service.identification.from_traces import identify
from service.identification.held import told_of_held
from service.identification.joint_machines import identify_axes
from service.identification.regression import summarise
from service.model.nominal import pack

Record = Callable[..., Trace]


def held(trace: Trace, samples: int) -> Trace:
    """As a drive logs it that makes its torque anew after so many samples."""
    return replace(trace, torque=trace.torque[np.arange(len(trace)) // samples * samples])


def quick(trace: Trace, every: int) -> Trace:
    """The same motion four times a sample: what is logged faster than the model needs is thinned."""
    fine = np.arange(4 * len(trace) - 3) / 4
    position = np.stack([np.interp(fine, np.arange(len(trace)), column) for column in trace.position.T], axis=1)
    random = np.random.default_rng(3)
    torque = np.stack([np.interp(fine, np.arange(len(trace)), column) for column in trace.torque.T], axis=1)
    made = Trace(trace.path, fine * trace.period, position, torque + 0.1 * random.standard_normal(torque.shape))
    return held(replace(made, flags=np.zeros(len(fine), np.uint32)), every)


@pytest.mark.parametrize(
    ("logs", "said"),
    [
        ({"a": 0.0, "b": 0.0}, []),
        ({"a": 0.004, "b": 0.0}, ["a: the torque is updated only every 4 ms"]),
        (
            {"a": 0.004, "b": 0.0039999, "c": 0.008},
            ["a, b: the torque is updated only every 4 ms", "c: the torque is updated only every 8 ms"],
        ),
    ],
)
def test_logs_are_told_together_by_how_long_a_torque_stands(logs: dict[str, float], said: list[str]) -> None:
    found = told_of_held(logs)
    assert [line[: len(start)] for line, start in zip(found, said, strict=True)] == said


def test_identify_says_which_logs_have_it(robot: Robot, record: Record) -> None:
    logs = [held(record(0), 8), record(1), quick(record(2), 16), held(record(3), 8)]
    found = identify(robot, [summarise(pack(robot), log) for log in logs])
    assert [one for one in found.warnings if "is updated only" in one] == told_of_held(
        {"log_0.csv": 0.008, "log_2.csv": 0.004, "log_3.csv": 0.008}
    )
    plain = identify(robot, [summarise(pack(robot), record(seed)) for seed in range(2)])
    assert not [one for one in plain.warnings if "is updated only" in one]


def test_axes_are_told_as_well(record: Record) -> None:
    axes = Axes(name="axes", kind="axes", axis=[Axis(), Axis(), Axis()])
    found = identify_axes(axes, [held(record(0), 8), record(1)])
    assert [one for one in found.warnings if "is updated only" in one] == told_of_held({"log_0.csv": 0.008})


def test_evaluate_says_so_on_stderr_and_to_programs(robot: Robot, record: Record, tmp_path: Path) -> None:
    save_robot(robot, tmp_path / "robot.toml")
    for name, samples in (("a", 4), ("b", 1)):
        write_trace(held(record(0), samples), tmp_path / f"{name}.csv", robot.name)
    paths = [str(tmp_path / f"{name}.csv") for name in "ab"]
    result = CliRunner().invoke(app, ["evaluate", *paths, "--robot", str(tmp_path / "robot.toml"), "--json"])
    assert result.exit_code == 0, result.output
    assert [one["torque_held_s"] for one in json.loads(result.stdout)["traces"]] == [0.004, 0.0]
    assert result.stderr.count("is updated only") == 1
    assert f"warning: {told_of_held({paths[0]: 0.004})[0]}" in result.stderr
    assert evaluate(robot, record(0)).held == 0.0
