"""Axes and arms forward in time: against closed forms, MuJoCo's own integration, and their logs."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's compiled modules carry no types)

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.trace import read_trace
from schemas.axes_description import Axes, load_axes
from schemas.chain_description import Chain
from schemas.errors import DataError
from service.cli.main import app
from service.identification.joint_machines import identify_axes
from service.machines import machine_of
from service.machines.forward_runs import run
from service.model.description import base_of
from service.model.scene import Base
from service.rollout.joints import STILL, compare, named
from tests.service import arm

PERIOD, SAMPLES = 2e-3, 151


def nothing(k: int, share: float, live: np.ndarray, theta: np.ndarray, theta_dot: np.ndarray) -> np.ndarray:
    return np.zeros_like(theta)


def axes(folder: Path, sections: str) -> Axes:
    (folder / "a.toml").write_text(f'name = "a"\nkind = "axes"\n[[axis]]\n[[axis]]\ngravity = false\n{sections}')
    found = load_axes(folder / "a.toml")
    assert isinstance(found, Axes)
    return found


def test_axes_move_as_closed_forms_say(tmp_path: Path) -> None:
    """A pendulum keeps its energy; an axis with viscous friction and a load goes by exponentials."""
    known = axes(
        tmp_path,
        "[identified]\ninertia = { value = [0.4, 0.2] }\noffset = { value = [0.0, -0.5] }\n"
        "gravity_sin = { value = [3.0, 0.0] }\ngravity_cos = { value = [0.0, 0.0] }\n"
        "viscous_friction = { value = [0.0, 0.8] }\ncoulomb_friction = { value = [0.0, 0.0] }\n",
    )
    start = np.array([[1.2, 0.3], [-0.4, 0.0]]), np.array([[0.0, 1.0], [2.0, -3.0]])
    theta, theta_dot = run(machine_of(known), base_of(known), start, nothing, SAMPLES, PERIOD)
    energy = 0.2 * theta_dot[..., 0] ** 2 - 3.0 * np.cos(theta[..., 0])
    assert np.ptp(energy, axis=1).max() < 1e-4
    time = np.arange(SAMPLES) * PERIOD
    final, rate = 0.5 / 0.8, 0.8 / 0.2
    expected = final + (start[1][:, 1:] - final) * np.exp(-rate * time)
    np.testing.assert_allclose(theta_dot[..., 1], expected, atol=1e-4)
    way = start[0][:, 1:] + final * time + (start[1][:, 1:] - final) * (1 - np.exp(-rate * time)) / rate
    np.testing.assert_allclose(theta[..., 1], way, atol=1e-4)


def test_coulomb_friction_stops_an_axis_and_holds_it(tmp_path: Path) -> None:
    known = axes(
        tmp_path,
        "[identified]\ninertia = { value = [0.4, 0.2] }\noffset = { value = [0.0, 0.9] }\n"
        "viscous_friction = { value = [0.0, 0.0] }\ncoulomb_friction = { value = [1.0, 1.0] }\n",
    )
    start = np.zeros((1, 2)), np.array([[0.25, 0.0]])
    theta, theta_dot = run(machine_of(known), base_of(known), start, nothing, SAMPLES, PERIOD)
    assert theta[0, -1, 0] == pytest.approx(0.25**2 / 2 / 2.5, abs=1e-3)  # v^2 / 2 a
    assert np.abs(theta_dot[0, -1]).max() < 1e-3


def test_an_arm_moves_as_another_engine_says(tmp_path: Path) -> None:
    pytest.importorskip("pinocchio")
    chain = load_axes(arm.write(tmp_path))
    assert isinstance(chain, Chain)
    draw = np.random.default_rng(4)
    start = draw.uniform(-1, 1, (5, 3)), draw.uniform(-2, 2, (5, 3))
    mechanism = machine_of(chain).mechanism
    zero = np.zeros(3)
    base = Base(mechanism.start, np.full(3, 0.6), zero)
    theta, theta_dot = run(machine_of(chain), base, start, nothing, SAMPLES, PERIOD)
    model = mujoco.MjModel.from_xml_string(arm.URDF)
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, PERIOD / 10
    data = mujoco.MjData(model)
    model.dof_damping[:3] = 0.6
    model.dof_armature[3] = 1e6  # the finger stands still
    for number in range(5):
        mujoco.mj_resetData(model, data)
        data.qpos[:3], data.qvel[:3] = start[0][number], start[1][number]
        for _ in range(10 * (SAMPLES - 1)):
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(theta[number, -1], data.qpos[:3], atol=5e-4)
        np.testing.assert_allclose(theta_dot[number, -1], data.qvel[:3], atol=5e-3)


def test_an_identified_arm_follows_its_log(tmp_path: Path) -> None:
    pytest.importorskip("pinocchio")
    wrong = arm.URDF.replace('mass value="3"', 'mass value="5"').replace('mass value="1.5"', 'mass value="0.5"')
    chain = load_axes(arm.write(tmp_path, wrong))
    assert isinstance(chain, Chain)
    logs = [read_trace(arm.record(tmp_path / f"{seed}.csv", seed), chain) for seed in range(3)]
    known = identify_axes(chain, logs[:2]).robot
    assert isinstance(known, Chain)
    found = compare(named([("identified", known)]), logs[2:], 0.2)
    plain, identified, floor, still = found.deviations
    assert [one.name for one in found.deviations] == ["plain", "identified", "floor", STILL]
    assert found.windows > 20
    assert identified.good.all()
    assert (identified.joint_rms < 0.05 * still.joint_rms).all()
    assert (identified.joint_rms < 0.2 * plain.joint_rms).all()
    assert identified.tool_rms is not None
    assert identified.tool_rms < 0.01
    assert (floor.joint_rms < identified.joint_rms).all()
    flipped = compare({"identified": known}, [replace(logs[2], torque=-logs[2].torque)], 0.2)
    assert (flipped.deviations[0].joint_rms > 3 * identified.joint_rms).all()
    result = CliRunner().invoke(app, ["rollout", str(tmp_path / "2.csv"), "--robot", str(tmp_path / "small.toml")])
    assert result.exit_code == 0, result.output
    assert "% of their travel" in result.output


def test_axes_that_were_never_identified_are_not_simulated(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="parameters to simulate"):
        compare({"a": axes(tmp_path, "")}, [], 0.2)


def test_a_run_that_is_lost_ends_and_the_others_go_on(tmp_path: Path) -> None:
    """An axis of almost no inertia under its load; one start is already too fast."""
    known = axes(
        tmp_path,
        "[identified]\ninertia = { value = [0.4, 0.2] }\noffset = { value = [0.0, 0.0] }\n"
        "viscous_friction = { value = [0.0, 0.0] }\ncoulomb_friction = { value = [0.0, 0.0] }\n",
    )
    start = np.zeros((2, 2)), np.array([[0.0, 400.0], [1.0, 1.0]])
    theta, _ = run(machine_of(known), base_of(known), start, nothing, SAMPLES, PERIOD)
    assert np.isnan(theta[0, -1]).all()
    np.testing.assert_allclose(theta[1, -1], PERIOD * (SAMPLES - 1))
