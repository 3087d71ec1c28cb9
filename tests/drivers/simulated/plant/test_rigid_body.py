"""The plant is a rigid-body Delta: it agrees with the inverse dynamics, keeps its loops closed, keeps its energy."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's compiled modules carry no types)

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from drivers.motion import Planner, Trajectory
from drivers.simulated.plant.mujoco_delta import required_torque
from drivers.simulated.plant.plant import Plant, Target
from drivers.simulated.plant.plant_trace import simulate
from drivers.simulated.plant.truth import PlantTruth
from schemas.robot import Robot, load_robot
from service.model import kinematics
from service.model.dynamics import FOREARM, torque_terms
from service.model.nominal import pack


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def differentiated(position: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Joint motion from a noise-free record of positions, by a quintic spline through them."""
    time = np.arange(len(position)) * period
    spline = make_interp_spline(time, position, k=5)
    return spline(time), spline(time, 1), spline(time, 2)


def prediction(robot: Robot, motion: tuple[np.ndarray, np.ndarray, np.ndarray], forearm: bool) -> np.ndarray:
    terms = torque_terms(pack(robot), *motion)
    rod = robot.mass.passive_link * terms[:, FOREARM] if forearm else 0.0
    return terms[:, :3].sum(axis=1) + rod


@pytest.mark.parametrize("name", ["small", "d3-1200", "rl5-1450-6kg"])
def test_inverse_dynamics_predict_the_torque_over_the_whole_workspace(name: str, robot: Robot) -> None:
    robot = robot if name == "small" else load_robot(name)
    planner = Planner(robot, 1e-3)
    plant = Plant(robot, PlantTruth.nominal(robot))
    random = np.random.default_rng(3)
    runs = [
        planner.bound(random, 4.0),
        planner.multisine(random, 4.0),
        planner.pick_and_place(random, 3.0),
        planner.slow(random, 3.0),
    ]
    measured, exact, printed = [], [], []
    reached = []
    for run in runs:
        trace = simulate(plant, run)
        motion = differentiated(trace.position, trace.period)
        inner = slice(10, -10)
        measured.append(trace.torque[inner])
        exact.append(prediction(robot, motion, forearm=True)[inner])
        printed.append(prediction(robot, motion, forearm=False)[inner])
        reached.append(kinematics.forward(pack(robot), trace.position))
    torque = np.concatenate(measured)
    assert rms(torque - np.concatenate(exact)) < 1e-3 * rms(torque)
    # the paper's two point masses a forearm are some per cent off
    without = rms(torque - np.concatenate(printed))
    assert 0.01 * rms(torque) < without < 0.2 * rms(torque)
    print(f"{name}: {rms(torque):.2f} N m rms, off by {without:.3f} N m without the forearm term")
    platform, space = np.concatenate(reached), planner.workspace
    assert np.hypot(platform[:, 0], platform[:, 1]).max() > 0.9 * space.radius
    assert platform[:, 2].min() < space.bottom + 0.1 * (space.top - space.bottom)
    assert platform[:, 2].max() > space.top - 0.1 * (space.top - space.bottom)


@pytest.mark.parametrize("gravity", [[-9.81, 0.0, 0.0], [0.0, 0.0, 9.81]], ids=["wall", "upside down"])
def test_inverse_dynamics_predict_the_torque_however_the_base_is_mounted(gravity: list[float], robot: Robot) -> None:
    turned = robot.model_copy(update={"gravity_mps2": gravity})
    run = Planner(turned, 1e-3).multisine(np.random.default_rng(3), 2.0)
    trace = simulate(Plant(turned, PlantTruth.nominal(turned)), run)
    motion, inner = differentiated(trace.position, trace.period), slice(10, -10)
    left = trace.torque - prediction(turned, motion, forearm=True)
    assert rms(left[inner]) < 1e-3 * rms(trace.torque)
    assert rms((trace.torque - prediction(robot, motion, forearm=True))[inner]) > 0.1 * rms(trace.torque)


def test_payload_is_a_mass_at_the_platform(robot: Robot, planner: Planner, ideal: Plant) -> None:
    run = planner.pick_and_place(np.random.default_rng(1), 4.0, (3.8, 1.2))
    trace = simulate(ideal, run)
    motion = differentiated(trace.position, trace.period)
    terms = torque_terms(pack(robot), *motion)
    residual = trace.torque - prediction(robot, motion, forearm=True)
    assert len(run.payloads) >= 3
    for load in run.payloads:
        held = slice(round(load.pick / 1e-3) + 30, round(load.release / 1e-3) - 30)
        unit, extra = terms[held, 4].ravel(), residual[held].ravel()
        mass = unit @ extra / (unit @ unit)
        assert mass == pytest.approx(load.mass, rel=2e-3)
        assert rms(extra - load.mass * unit) < 2e-3 * rms(trace.torque)
    free = slice(round(run.payloads[0].release / 1e-3) + 30, round(run.payloads[1].pick / 1e-3) - 30)
    assert rms(residual[free]) < 2e-3 * rms(trace.torque)


def test_loops_stay_closed_and_rods_keep_parallel(planner: Planner, ideal: Plant) -> None:
    run = planner.bound(np.random.default_rng(2), 3.0)
    ideal.reset(run.position[0])
    worst = 0.0
    for k in range(len(run)):
        ideal.latch(Target(run.position[k], run.velocity[k]), Target(run.position[k + 1], run.velocity[k + 1]))
        ideal.run()
        worst = max(worst, ideal.closure_error)
    assert 0 < worst < 5e-6
    for i in range(3):
        rods = [ideal.data.body(f"rod{i}{rod}").xmat.reshape(3, 3)[:, 0] for rod in range(2)]
        np.testing.assert_allclose(rods[0], rods[1], atol=1e-4)


def test_joint_angles_and_platform_fit_the_kinematics(robot: Robot, planner: Planner, ideal: Plant) -> None:
    run = planner.multisine(np.random.default_rng(4), 2.0)
    ideal.reset(run.position[0])
    for k in range(len(run)):
        ideal.latch(Target(run.position[k], run.velocity[k]), Target(run.position[k + 1], run.velocity[k + 1]))
        ideal.run()
        if k % 100 == 0:
            np.testing.assert_allclose(kinematics.forward(pack(robot), ideal.theta), ideal.platform, atol=5e-6)


def test_free_fall_keeps_energy_and_friction_takes_it(robot: Robot) -> None:
    def fall(truth: PlantTruth) -> tuple[np.ndarray, np.ndarray]:
        plant = Plant(robot, truth.model_copy(update={"peak_torque_nm": 1e-9}))
        plant.mechanism.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
        plant.reset(np.full(3, 0.3))
        here = Target(np.full(3, 0.3), np.zeros(3))
        energy, speed = [], []
        for _ in range(150):
            plant.latch(here, here)
            plant.run()
            energy.append(plant.data.energy.copy())
            speed.append(plant.theta_dot.copy())
        return np.array(energy), np.array(speed)

    nominal = PlantTruth.nominal(robot)
    energy, speed = fall(nominal)
    assert abs(speed[-1]).min() > 2.0  # it did fall
    swing = np.ptp(energy[:, 1])
    assert np.ptp(energy.sum(axis=1)) < 2e-3 * swing
    # what dry and viscous friction take is their work along the motion
    rubbing, speed = fall(
        nominal.model_copy(update={"coulomb_friction_nm": [0.5] * 3, "viscous_friction_nms": [0.2] * 3})
    )
    power = (0.5 * np.abs(speed) + 0.2 * speed**2).sum(axis=1)
    work = np.concatenate([[0.0], np.cumsum((power[1:] + power[:-1]) / 2) * 1e-3])
    lost = rubbing.sum(axis=1)[0] - rubbing.sum(axis=1)
    np.testing.assert_allclose(lost, work, atol=0.01 * work[-1])


def test_required_torque_is_what_the_plant_needs(planner: Planner, ideal: Plant) -> None:
    run: Trajectory = planner.pick_and_place(np.random.default_rng(5), 2.0)
    trace = simulate(ideal, run)
    theta, theta_dot, theta_ddot = differentiated(trace.position, trace.period)
    inner = slice(10, -10)
    needed = required_torque(ideal.mechanism, theta[inner], theta_dot[inner], theta_ddot[inner])
    assert rms(needed - trace.torque[inner]) < 1e-3 * rms(trace.torque)
