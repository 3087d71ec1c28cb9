"""Figures for a controller's own model: put into a rigid model by hand they give the identified torque."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.trace import write_trace
from schemas.robot import save_robot
from service.cli.main import app
from service.codegen.sheet import axis_inertia, to_sheet
from service.estimator.bounds import ARM_ANGLES
from service.model.description import base_of
from service.model.dynamics import GRAVITY, INERTIA, PLATFORM, torque_terms
from service.model.mechanism import mechanism_of
from service.model.nominal import pack
from tests.known import make, robot, trace_of

__all__ = ["make", "robot"]


def row(sheet: str, figure: str) -> list[float]:
    """The numbers of the first row of that name."""
    line = next(line for line in sheet.splitlines() if line.startswith(f"| {figure} |"))
    return [float(re.match(r"[-+.e0-9]+", cell.strip())[0]) for cell in line.split("|")[2:5]]  # pyright: ignore


def test_added_inertia_and_moment_make_the_identified_torque_of_the_drawn_one(robot) -> None:
    sheet, model = to_sheet(robot, []), pack(robot)
    random = np.random.default_rng(1)
    theta, speed, change = random.uniform(0.2, 0.8, (50, 3)), *random.normal(0.0, 20.0, (2, 50, 3))
    terms = torque_terms(model, theta, speed, change)
    drawn = terms[:, INERTIA] + terms[:, GRAVITY] + terms[:, PLATFORM]
    added = np.array(row(sheet, "added inertia, joint side")) * change
    added -= 9.81 * np.array(row(sheet, "added static moment of the arm")) * np.cos(theta)
    identified = mechanism_of(robot).rigid(theta, speed, change).torque(base_of(robot).rigid * [1.0, 1.0, 0.0])
    np.testing.assert_allclose(drawn + added, identified, rtol=1e-4, atol=1e-3)


def test_an_axis_alone_takes_the_inertia_that_the_page_says(robot) -> None:
    """Of the rigid robot without forearm coupling, by accelerating one axis at a standstill."""
    model, found = pack(robot), robot.identified
    sheet, theta = to_sheet(robot, []), np.repeat(ARM_ANGLES[:, None], 3, axis=1)
    still, own = np.zeros_like(theta), np.zeros((3, 3))
    for axis in range(3):
        change = np.zeros_like(theta)
        change[:, axis] = 1.0
        moving, resting = (torque_terms(model, theta, still, one) for one in (change, still))
        step = found.rho_1.value * moving[:, INERTIA] + moving[:, PLATFORM] - resting[:, PLATFORM]
        own[:, axis] = step[:, axis]
    np.testing.assert_allclose(axis_inertia(model, np.full(3, found.rho_1.value)), own, rtol=1e-9)
    np.testing.assert_allclose(row(sheet, "inertia, mean in the middle of the workspace"), own.mean(axis=0), rtol=1e-4)
    gear = robot.drive.gear_ratio
    np.testing.assert_allclose(row(sheet, "inertia at the motor"), own.mean(axis=0) / gear**2, rtol=1e-4)
    assert row(sheet, "Coulomb friction") == found.coulomb_friction_nm.value


def test_each_figure_leaves_less_of_a_held_out_log(robot, make, tmp_path: Path) -> None:
    save_robot(robot, tmp_path / "r.toml")
    write_trace(trace_of(make(2.0, noise=0.1)), tmp_path / "log.csv")
    options = ["--to", "sheet", "--log", str(tmp_path / "log.csv"), "--out", str(tmp_path / "f.md")]
    told = CliRunner().invoke(app, ["export", str(tmp_path / "r.toml"), *options])
    assert told.exit_code == 0, told.output
    sheet = (tmp_path / "f.md").read_text()
    stages = ["masses as drawn", "and added inertia, added static moment", "and friction", "the whole model, as code"]
    left = np.array([row(sheet, stage) for stage in stages])
    assert (np.diff(left, axis=0) <= 0.0).all()
    assert left[-1].max() < 0.1 * left[0].min()
    assert (np.array(row(sheet, "inertia and friction of each axis")) < row(sheet, "no feed-forward")).all()


def test_a_robot_that_was_never_identified_has_no_figures(robot, tmp_path: Path) -> None:
    with pytest.raises(Exception, match="identified: missing"):
        to_sheet(robot.model_copy(update={"identified": None}), [])
