"""Drives, friction, sensors and payloads of the plant, and what it takes from a truth file."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from drivers.motion import MotionLimits, Planner, Trajectory
from drivers.simulated.plant.effects import make_effects
from drivers.simulated.plant.mujoco_delta import required_torque
from drivers.simulated.plant.plant import Plant, Target
from drivers.simulated.plant.plant_trace import simulate
from drivers.simulated.plant.truth import PlantTruth, load_truth, shipped_truth
from schemas.errors import DataError, RobotError
from schemas.robot import Robot, load_robot, robot_file
from service.model import kinematics
from service.model.nominal import pack


def standing(cycles: int) -> Trajectory:
    nothing = np.zeros((cycles + 1, 3))
    return Trajectory(1e-3, nothing + 0.2, nothing, nothing)


def test_same_seed_same_bits_other_seed_other_noise(robot: Robot, planner: Planner) -> None:
    truth = PlantTruth.nominal(robot).model_copy(
        update={"torque_noise_nm": [0.3] * 3, "encoder_noise_rad": 1e-6, "coulomb_friction_nm": [3.0] * 3}
    )
    run = planner.slow(np.random.default_rng(0), 1.0)
    first, again = (simulate(Plant(robot, truth, seed=4), run) for _ in range(2))
    other = simulate(Plant(robot, truth, seed=5), run)
    for field in ("time", "position", "torque", "torque_command"):
        np.testing.assert_array_equal(getattr(first, field), getattr(again, field))
    assert np.abs(first.torque - other.torque).max() > 0.1


def test_noise_and_quantisation_are_as_told(robot: Robot) -> None:
    noise, counts = [0.2, 0.4, 0.6], 4096.0
    truth = PlantTruth.nominal(robot).model_copy(
        update={"torque_noise_nm": noise, "encoder_counts_per_turn": counts, "gear_ratio": 25.0}
    )
    still = standing(3000)
    trace = simulate(Plant(robot, truth, seed=1), still)
    np.testing.assert_allclose((trace.torque - trace.torque_command)[500:].std(axis=0), noise, rtol=0.06)
    steps = trace.position / (2 * np.pi / (counts * 25.0))
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    # encoder noise: the spread of a reading
    noisy = PlantTruth.nominal(robot).model_copy(update={"encoder_noise_rad": 2e-6})
    spread = simulate(Plant(robot, noisy, seed=1), still).position.std(axis=0)
    assert (spread > 1.8e-6).all()
    assert (spread < 4e-6).all()


def test_coulomb_and_viscous_friction_show_as_they_are(robot: Robot, planner: Planner) -> None:
    coulomb, viscous = np.array([3.0, 2.0, 4.0]), np.array([1.5, 1.0, 0.5])
    nominal = PlantTruth.nominal(robot)
    rubbing = nominal.model_copy(
        update={"coulomb_friction_nm": coulomb.tolist(), "viscous_friction_nms": viscous.tolist()}
    )
    run = planner.multisine(np.random.default_rng(8), 5.0)
    plant = Plant(robot, rubbing)
    trace = simulate(plant, run)
    spline = make_interp_spline(trace.time, trace.position, k=5)
    speed = spline(trace.time, 1)
    extra = trace.torque - required_torque(plant.mechanism, trace.position, speed, spline(trace.time, 2))
    for i in range(3):
        moving = np.abs(speed[:, i]) > 0.3
        basis = np.stack([np.sign(speed[moving, i]), speed[moving, i]], axis=1)
        found, *_ = np.linalg.lstsq(basis, extra[moving, i], rcond=None)
        np.testing.assert_allclose(found, [coulomb[i], viscous[i]], rtol=0.01)


def test_stiction_holds_a_joint_against_less_than_its_level(robot: Robot) -> None:
    truth = PlantTruth.nominal(robot).model_copy(
        update={"coulomb_friction_nm": [30.0] * 3, "peak_torque_nm": 1e-9, "viscous_friction_nms": [0.0] * 3}
    )
    plant = Plant(robot, truth)  # drives without torque: the weight hangs on friction alone
    plant.reset(np.full(3, 0.3))
    here = Target(np.full(3, 0.3), np.zeros(3))
    for _ in range(1000):
        plant.latch(here, here)
        plant.run()
    assert np.abs(plant.theta - 0.3).max() < 2e-4


def test_drives_hold_the_weight_and_limit_their_torque(robot: Robot, ideal: Plant) -> None:
    still = standing(500)
    trace = simulate(ideal, still)
    np.testing.assert_allclose(trace.position, 0.2, atol=1e-5)
    jump = Target(np.full(3, 0.6), np.zeros(3))
    ideal.latch(jump, jump)
    assert np.abs(ideal.motor_command).max() == ideal.truth.peak_torque_nm


def test_feedforward_of_the_known_torque_takes_the_tracking_error_away(robot: Robot, planner: Planner) -> None:
    run = planner.pick_and_place(np.random.default_rng(2), 3.0)
    plant = Plant(robot)
    known = required_torque(plant.mechanism, run.position, run.velocity, run.acceleration)
    alone = simulate(plant, run)
    # the integrators start with the weight in them, which the feed-forward carries
    plant.reset(run.position[0])
    helped = _with_feedforward(plant, run, known)

    def error(position: np.ndarray) -> float:
        return float(np.sqrt(np.mean((position - run.position[:-1]) ** 2)))

    assert error(helped) < error(alone.position) / 10


def _with_feedforward(plant: Plant, run: Trajectory, torque: np.ndarray) -> np.ndarray:
    plant.take_over(None, torque[0])
    position = np.empty((len(run), 3))
    for k in range(len(run)):
        measured = plant.latch(
            Target(run.position[k], run.velocity[k]), Target(run.position[k + 1], run.velocity[k + 1]), torque[k]
        )
        position[k] = measured.position
        plant.run()
    return position


def test_time_runs_on_over_runs(robot: Robot, planner: Planner) -> None:
    plant = Plant(robot)
    run = planner.slow(np.random.default_rng(0), 1.0)
    first, second = simulate(plant, run), simulate(plant, run)
    assert first.time[0] == 0.0
    assert second.time[0] == pytest.approx(first.time[-1] + 1e-3)


@pytest.mark.parametrize("rate", [500.0, 1000.0, 4000.0])
def test_rate_does_not_change_the_physics(robot: Robot, rate: float) -> None:
    planner = Planner(robot, 1 / rate)
    run = planner.slow(np.random.default_rng(3), 1.0)
    trace = simulate(Plant(robot, period=1 / rate), run)
    assert len(trace) == round(rate)
    theta = np.asarray(run.position[:-1])
    assert np.abs(trace.position - theta).max() < 2e-3


def test_motions_stay_inside_their_limits_and_the_workspace(robot: Robot) -> None:
    limits = MotionLimits(speed=6.0, acceleration=120.0, torque=40.0)
    planner = Planner(robot, 1e-3, limits)
    random = np.random.default_rng(11)
    low, high = robot.geometry.joint_range_rad
    plant = Plant(robot)
    for run in (planner.multisine(random, 4.0), planner.pick_and_place(random, 4.0), planner.bound(random, 4.0)):
        assert np.abs(run.velocity).max() <= limits.speed
        assert np.abs(run.acceleration).max() <= limits.acceleration
        assert low < run.position.min()
        assert run.position.max() < high
        trace = simulate(plant, run)
        # the drives' own correction rides on top of the planned torque
        assert np.abs(trace.torque).max() < 1.15 * limits.torque
        used = max(
            np.abs(run.velocity).max() / limits.speed,
            np.abs(run.acceleration).max() / limits.acceleration,
            np.abs(trace.torque).max() / limits.torque,
        )
        assert used > 0.7  # and it makes use of what it is given
        kinematics.forward(pack(robot), run.position)


def test_planned_velocity_and_acceleration_are_the_derivatives(planner: Planner) -> None:
    random = np.random.default_rng(6)
    for run in (
        planner.multisine(random, 3.0),
        planner.slow(random, 3.0),
        planner.bound(random, 3.0),
        planner.closed(planner.pick_and_place(random, 3.0)),
    ):
        for rate, value in ((run.velocity, run.position), (run.acceleration, run.velocity)):
            numeric = (value[2:] - value[:-2]) / 2e-3
            assert np.abs(numeric - rate[1:-1]).max() < 2e-3 * np.abs(rate).max()


def test_closed_motion_ends_where_it_starts(planner: Planner) -> None:
    run = planner.closed(planner.pick_and_place(np.random.default_rng(6), 3.0))
    np.testing.assert_allclose(run.position[0], run.position[-1], atol=1e-9)
    np.testing.assert_allclose(run.velocity[[0, -1]], 0.0, atol=1e-7)


def test_torn_apart_is_an_error_that_says_where(robot: Robot) -> None:
    plant = Plant(robot, PlantTruth.nominal(robot).model_copy(update={"peak_torque_nm": 1e6}))
    plant.reset(np.full(3, 0.2))
    far = Target(np.array([-1.5, 2.0, 2.0]), np.zeros(3))
    with pytest.raises(DataError, match="closed chain broke at"):  # noqa: PT012
        for _ in range(3000):
            plant.latch(far, far)
            plant.run()


def test_shipped_robots_and_truths_load() -> None:
    for name in ("d3-1200", "rl5-1450-6kg"):
        robot = load_robot(name)
        assert robot.name == name
        truth = shipped_truth(robot)
        assert truth is not None
        make_effects(load_truth(truth, robot).effect, str(truth))
    with pytest.raises(RobotError, match="bundled ones are: d3-1200"):
        robot_file("d3-1300")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("coulomb_friction = [1.0, 1.0, 1.0]", "coulomb_friction: unknown key"),
        ("coulomb_friction_nm = [1.0, -1.0, 1.0]", "coulomb_friction_nm.1"),
        ("coulomb_friction_nm = [1.0, 1.0]", "coulomb_friction_nm"),
        ("= 3", "not TOML"),
    ],
)
def test_truth_file_errors_name_file_and_key(tmp_path: Path, robot: Robot, text: str, complaint: str) -> None:
    path = tmp_path / "truth.toml"
    path.write_text(text)
    with pytest.raises(RobotError, match=f"truth.toml: .*{complaint}".replace(".1", r"\.1")):
        load_truth(path, robot)


@pytest.mark.parametrize(
    ("entry", "complaint"),
    [
        ({"name": "gremlins"}, "unknown effect 'gremlins'; known: stribeck_friction"),
        ({"name": "tool_mass"}, "effect tool_mass: mass_kg: missing key"),
        ({"name": "tool_mass", "mass_kg": 1.0, "colour": "red"}, "colour: unknown key"),
    ],
)
def test_effect_errors_name_effect_and_parameter(entry: dict[str, object], complaint: str) -> None:
    with pytest.raises(RobotError, match=complaint):
        make_effects([entry], "truth.toml")


def test_impossible_payload_is_refused(ideal: Plant) -> None:
    with pytest.raises(DataError, match="payload of -1"):
        ideal.set_payload(-1.0)


def test_the_plant_loads_nothing_that_draws() -> None:
    code = (
        "import os; os.environ.pop('MUJOCO_GL', None)\n"
        "import sys, drivers.simulated.plant.plant; print('glfw' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
