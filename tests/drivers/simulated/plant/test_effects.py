"""Every effect acts, and acts as its physics says."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from drivers.motion import Planner, Trajectory
from drivers.simulated.plant.effects import (
    CATALOGUE,
    EFFECTS,
    OUT_OF_CATALOGUE,
    PlantEffect,
    draw_effect,
    friction,
    make_effects,
    mechanics,
    out_of_catalogue,
    sensing,
    two_mass_effects,
)
from drivers.simulated.plant.mujoco_delta import holding_torque
from drivers.simulated.plant.plant import Plant, Target
from drivers.simulated.plant.plant_trace import simulate
from drivers.simulated.plant.truth import PlantTruth
from schemas.errors import DataError
from schemas.robot import Robot
from schemas.trace import Trace

RUBBING = {"coulomb_friction_nm": [3.0] * 3, "viscous_friction_nms": [1.0] * 3, "rotor_inertia_kgm2": [0.05] * 3}


@pytest.fixture(scope="module")
def run(planner: Planner) -> Trajectory:
    return planner.multisine(np.random.default_rng(21), 1.6)


@pytest.fixture(scope="module")
def truth(robot: Robot) -> PlantTruth:
    return PlantTruth.nominal(robot).model_copy(update=RUBBING | {"gear_ratio": 25.0, "peak_torque_nm": 250.0})


@pytest.fixture(scope="module")
def plain(robot: Robot, truth: PlantTruth, run: Trajectory) -> Trace:
    return simulate(Plant(robot, truth), run)


def watched(plant: Plant, run: Trajectory, look: Callable[[Plant], Any]) -> np.ndarray:
    """`look` at the plant after every cycle of `run`, (N, ...)."""
    plant.reset(run.position[0])
    seen = []
    for k in range(len(run)):
        plant.latch(Target(run.position[k], run.velocity[k]), Target(run.position[k + 1], run.velocity[k + 1]))
        plant.run()
        seen.append(look(plant))
    return np.array(seen)


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_shows_and_the_drives_cope(
    name: str, robot: Robot, truth: PlantTruth, run: Trajectory, plain: Trace
) -> None:
    effect = EFFECTS[name].draw(np.random.default_rng(5), truth, 1.0)
    trace = simulate(Plant(robot, truth, (effect,), seed=2), run)
    assert np.isfinite(trace.torque).all()
    assert np.abs(trace.position - run.position[:-1]).max() < 0.1
    assert np.abs(trace.torque - plain.torque).max() > 0.05
    assert effect.joints
    assert set(effect.joints) <= {0, 1, 2}


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_can_be_written_into_a_truth_file(name: str, truth: PlantTruth) -> None:
    drawn = EFFECTS[name].draw(np.random.default_rng(5), truth, 1.0)
    entry = {"name": name} | {key: value for key, value in vars(drawn).items() if not key.startswith("_")}
    entry.pop("bristle", None)
    assert make_effects([entry], "truth.toml") == (drawn,)


def test_catalogue_is_complete_and_apart_from_what_is_outside() -> None:
    assert len(CATALOGUE) == 31  # and forearm_inertia, which is in every plant
    assert len(OUT_OF_CATALOGUE) >= 5
    assert not set(CATALOGUE) & set(OUT_OF_CATALOGUE)


def test_backlash_lets_the_link_lag_by_its_gap_and_no_more(robot: Robot, truth: PlantTruth, run: Trajectory) -> None:
    gap = 0.002
    plant = Plant(robot, truth, (two_mass_effects.Backlash([0.0, gap, 0.0]),))
    twist = watched(plant, run, lambda p: p.motor - p.theta)
    assert (twist[:, [0, 2]] == 0).all()
    teeth = 80.0 / two_mass_effects.TOOTH_STIFFNESS  # what the teeth themselves bend when they hit each other
    assert gap < twist[:, 1].max() < gap + teeth
    assert -gap - teeth < twist[:, 1].min() < -gap
    assert (np.abs(twist[:, 1]) > 0.9 * gap).mean() > 0.5  # and it rests on a flank most of the time


def test_elasticity_twists_by_the_torque_over_the_stiffness(robot: Robot, truth: PlantTruth, run: Trajectory) -> None:
    stiffness = 3000.0
    plant = Plant(robot, truth, (two_mass_effects.JointElasticity([stiffness, 0.0, 0.0], 0.05),))
    seen = watched(plant, run, lambda p: np.array([p.motor[0] - p.theta[0], p.load[0]]))
    slope = (seen[:, 0] @ seen[:, 1]) / (seen[:, 0] @ seen[:, 0])
    assert slope == pytest.approx(stiffness, rel=0.02)
    soft = simulate(Plant(robot, truth, (two_mass_effects.JointElasticity([2e5, 0.0, 0.0], 0.05),)), run)
    rigid = simulate(Plant(robot, truth), run)
    assert np.abs(soft.position - rigid.position).max() < 2e-4  # without compliance two masses are one


def test_delay_and_filter_act_on_the_report_alone(
    robot: Robot, truth: PlantTruth, run: Trajectory, plain: Trace
) -> None:
    delayed = simulate(Plant(robot, truth, (sensing.TorqueDelay(0.0025),)), run)
    np.testing.assert_array_equal(delayed.position, plain.position)
    assert plain.torque_command is not None
    halfway = (plain.torque_command[7:-3] + plain.torque_command[8:-2]) / 2
    assert np.abs(delayed.torque[10:] - halfway).max() < 0.6  # commands jump between cycles where friction turns
    assert np.median(np.abs(delayed.torque[10:] - halfway)) < 0.01
    filtered = simulate(Plant(robot, truth, (sensing.TorqueFilter(40.0),)), run)
    np.testing.assert_array_equal(filtered.position, plain.position)
    # a step comes through to 1 - 1/e after the time constant
    step, plant = sensing.TorqueFilter(40.0), Plant(robot, truth)
    step.start(plant)
    start = plant.load.copy()
    count = round(1 / (2 * np.pi * 40.0) / plant.step)
    through = start
    for _ in range(count):
        through = step.report(plant, start + 1.0)
    np.testing.assert_allclose(through - start, 1 - np.exp(-count * plant.step * 2 * np.pi * 40.0), rtol=1e-9)


def test_a_drive_that_lags_moves_the_robot_otherwise_and_reports_what_it_was_asked_for(
    robot: Robot, truth: PlantTruth, run: Trajectory, plain: Trace
) -> None:
    lagging = simulate(Plant(robot, truth, (sensing.DriveLag(40.0),)), run)
    assert np.abs(lagging.position - plain.position).max() > 1e-4
    assert lagging.torque_command is not None
    np.testing.assert_array_equal(lagging.torque, lagging.torque_command)
    lag, plant = sensing.DriveLag(40.0), Plant(robot, truth)
    lag.start(plant)
    start, count = plant.load.copy(), round(1 / (2 * np.pi * 40.0) / plant.step)
    acts = [lag.motor_torque(plant, start + 1.0) for _ in range(count)][-1]
    np.testing.assert_allclose(acts - start, 1 - np.exp(-count * plant.step * 2 * np.pi * 40.0), rtol=1e-9)


def test_scale_offset_and_ripple_change_what_acts_not_what_is_said(
    robot: Robot, truth: PlantTruth, run: Trajectory
) -> None:
    for effect, acting in (
        (sensing.TorqueScale([0.1, 0.0, 0.0]), lambda command, motor: command / np.array([1.1, 1.0, 1.0])),
        (sensing.TorqueOffset([0.0, 1.5, 0.0]), lambda command, motor: command - np.array([0.0, 1.5, 0.0])),
        (
            sensing.Cogging([0.0, 0.0, 2.0], 2.0, 0.3),
            lambda command, motor: command + np.array([0.0, 0.0, 1.0]) * 2.0 * np.sin(50.0 * motor + 0.3),
        ),
    ):
        plant = Plant(robot, truth, (effect,))
        plant.reset(run.position[0])
        for k in range(200, 260):
            motor = plant.motor.copy()
            said = plant.latch(
                Target(run.position[k], run.velocity[k]), Target(run.position[k + 1], run.velocity[k + 1])
            )
            np.testing.assert_array_equal(said.torque, said.torque_command)
            plant._advance()
            np.testing.assert_allclose(plant.torque, acting(said.torque_command, motor), atol=1e-12)


def test_masses_tilt_springs_hang_as_they_should(robot: Robot, truth: PlantTruth) -> None:
    pose = np.array([0.2, 0.3, 0.1])
    plain = holding_torque(Plant(robot, truth).mechanism, pose)

    def held(effect: PlantEffect) -> np.ndarray:
        return holding_torque(Plant(robot, truth, (effect,)).mechanism, pose) - plain

    length, g = robot.geometry.active_link_length, -robot.gravity_mps2[2]
    np.testing.assert_allclose(
        held(mechanics.ArmMass([0.0, 0.5, 0.0])), [0.0, -0.5 * g * length / 2 * np.cos(0.3), 0.0], atol=1e-6
    )
    from service.model.kinematics import jacobian
    from service.model.nominal import pack

    lift = jacobian(pack(robot), pose).T @ np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(held(mechanics.ToolMass(0.4)), 0.4 * g * lift, atol=1e-6)
    # a tilt by a about x pulls the platform and links along y
    tilted = Plant(robot, truth, (mechanics.BaseTilt(0.05, 0.0),)).truth.gravity_mps2
    np.testing.assert_allclose(tilted, [0.0, -g * np.sin(0.05), -g * np.cos(0.05)])
    offset = Plant(robot, truth, (mechanics.JointOffset([0.0, 0.0, 0.02]),))
    offset.reset(pose)
    np.testing.assert_allclose(offset.theta - offset.reading, [0.0, 0.0, 0.02], atol=1e-12)
    spring = mechanics.JointSpring([4.0, 0.0, 0.0], [0.1, 0.0, 0.0])
    plant = Plant(robot, truth, (spring,))
    plant.reset(pose)
    np.testing.assert_allclose(spring.joint_torque(plant), [-4.0 * (pose[0] - 0.1), 0.0, 0.0], atol=1e-12)
    hose = mechanics.HoseSpring(20.0, [0.3, 0.0, -0.4])
    np.testing.assert_allclose(hose.platform_force(plant), 20.0 * (np.array([0.3, 0.0, -0.4]) - plant.platform))


def test_drag_goes_with_the_square_of_the_speed(robot: Robot, truth: PlantTruth, run: Trajectory) -> None:
    drag = mechanics.AirDrag(0.8)
    plant = Plant(robot, truth, (drag,))
    force = watched(plant, run, drag.platform_force)
    speed = watched(plant, run, lambda p: p.platform_dot.copy())
    np.testing.assert_allclose(np.linalg.norm(force, axis=1), 0.8 * (speed**2).sum(axis=1), rtol=1e-9, atol=1e-9)
    assert ((force * speed).sum(axis=1) <= 0).all()


def test_a_shaft_rubs_along_itself(robot: Robot, truth: PlantTruth, run: Trajectory) -> None:
    shaft = friction.ShaftFriction(5.0, 2.0)
    plant = Plant(robot, truth, (shaft,))
    force = watched(plant, run, shaft.platform_force)
    place = watched(plant, run, lambda p: p.platform.copy())
    rate = np.gradient(np.linalg.norm(place, axis=1), run.period)
    along = np.sum(force * place, axis=1) / np.linalg.norm(place, axis=1)
    np.testing.assert_allclose(np.linalg.norm(force, axis=1), np.abs(along), rtol=1e-9)
    fast = np.abs(rate) > 0.05
    assert fast.sum() > 50
    np.testing.assert_allclose(along[fast], -5.0 * np.sign(rate[fast]) - 2.0 * rate[fast], atol=0.05)


def test_the_load_of_the_gear_is_what_friction_leaves_of_the_torque(
    robot: Robot, truth: PlantTruth, run: Trajectory
) -> None:
    creeping = truth.model_copy(update={"creep_radps": 0.006})
    plant = Plant(robot, creeping, (friction.LoadDependentFriction([0.05] * 3),))
    seen = watched(plant, run, lambda p: np.array([p.torque, p.load, p.motor_dot]))
    torque, load, speed = seen.transpose(1, 0, 2)
    fast = np.abs(speed) > 0.5
    rubs = np.sign(speed) * (3.0 + 0.05 * np.abs(load)) + speed
    np.testing.assert_allclose((torque - load)[fast], rubs[fast], atol=0.1)


def test_friction_laws(robot: Robot, truth: PlantTruth) -> None:
    plant = Plant(robot, truth)

    def levels(
        effect: PlantEffect, speed: float, load: float = 0.0, angle: float = 0.2, time: float = 0.0
    ) -> np.ndarray:
        plant.effects = plant._on_friction = (effect,)
        plant.motor_dot, plant.load = np.full(3, speed), np.full(3, load)
        plant.motor, plant.time = np.full(3, angle), time
        plant._set_friction()
        return np.array([plant.friction.forward[0], plant.friction.backward[0], plant.friction.viscous[0]])

    stribeck = friction.StribeckFriction([2.0] * 3, 0.1)
    np.testing.assert_allclose(levels(stribeck, 0.0), [5.0, 5.0, 1.0])
    np.testing.assert_allclose(levels(stribeck, 0.1), [3 + 2 / np.e, 3 + 2 / np.e, 1.0])
    np.testing.assert_allclose(levels(friction.AsymmetricFriction([1.0, 0, 0], [0.2, 0, 0]), -1.0), [3.5, 2.5, 0.9])
    np.testing.assert_allclose(levels(friction.LoadDependentFriction([0.1] * 3), 1.0, load=-20.0), [5.0, 5.0, 1.0])
    np.testing.assert_allclose(levels(friction.NonlinearViscousFriction([0.1] * 3), -4.0), [3.0, 3.0, 1.4])
    wobble = friction.PositionDependentFriction([1.0, 0, 0], 4.0, 0.5)
    np.testing.assert_allclose(levels(wobble, 1.0, angle=0.3), [3 + np.sin(1.7)] * 2 + [1.0])
    warm = friction.WarmupFriction([0.8] * 3, 20.0)
    np.testing.assert_allclose(levels(warm, 1.0, time=0.0)[2], 1.8)
    np.testing.assert_allclose(levels(warm, 1.0, time=20.0)[2], 1 + 0.8 / np.e)


def test_presliding_builds_up_over_its_displacement(robot: Robot, truth: PlantTruth) -> None:
    bristles = friction.PreslidingFriction([1000.0] * 3)
    plant = Plant(robot, truth, (bristles,))
    bristles.start(plant)
    plant.motor_dot = np.full(3, 0.1)
    pushed = []
    for _ in range(400):  # 10 mrad one way, then the other
        plant._set_friction()
        pushed.append(plant.friction.torque[0])
    travel = 0.1 * plant.step * np.arange(1, 401)
    np.testing.assert_allclose(pushed, -3.0 * (1 - np.exp(-travel * 1000.0 / 3.0)), rtol=1e-9)
    plant.motor_dot = np.full(3, -0.1)
    plant._set_friction()
    assert -3.0 < plant.friction.torque[0] < 0.0  # still pushing the old way just after the reversal


def test_ball_joints_take_energy_and_nothing_else(robot: Robot, run: Trajectory) -> None:
    nominal = PlantTruth.nominal(robot)
    plain = simulate(Plant(robot, nominal), run)
    effect = friction.PassiveJointFriction(0.2, 0.02)
    plant = Plant(robot, nominal, (effect,))
    worked = watched(plant, run, lambda p: (p.data.xfrc_applied[:, 3:] * p.data.cvel[:, :3]).sum())
    assert (worked[50:-50] < 1e-9).all()
    rubbing = simulate(Plant(robot, nominal, (friction.PassiveJointFriction(0.2, 0.02),)), run)
    speed = run.velocity[:-1]
    extra = ((rubbing.torque - plain.torque) * speed).sum(axis=1).mean()
    assert extra == pytest.approx(-worked.mean(), rel=0.05)


def test_frame_swings_at_its_own_frequency(robot: Robot, truth: PlantTruth) -> None:
    plant = Plant(robot, truth, (out_of_catalogue.BaseResonance(30.0, 8.0, 0.01, 0.4),))
    base = plant.mechanism.model.joint("base").id
    here = Target(np.full(3, 0.2), np.zeros(3))
    plant.reset(here.position)
    plant.data.qvel[base] = 0.2
    place = []
    for _ in range(1000):
        plant.latch(here, here)
        plant.run()
        place.append(plant.data.qpos[base])
    swing = np.array(place) - np.mean(place)
    crossings = np.flatnonzero(np.diff(np.sign(swing)))
    frequency = 500.0 / np.mean(np.diff(crossings))
    robot_kg = 3 * (robot.mass.active_link + robot.mass.passive_link) + robot.mass.platform
    assert frequency == pytest.approx(8.0 * np.sqrt(30.0 / (30.0 + robot_kg)), rel=0.01)  # the drives hold it still
    assert np.abs(swing[-200:]).max() > 1e-4


def test_outside_events_come_and_go(robot: Robot, truth: PlantTruth, run: Trajectory) -> None:
    stick = out_of_catalogue.StickEvents([4.0, 0.0, 0.0], 20.0, 0.02)
    plant = Plant(robot, truth, (stick,), seed=3)
    level = watched(plant, run, lambda p: p.friction.forward[0])
    assert set(np.round(np.unique(level), 6)) == {3.0, 7.0}
    drops = out_of_catalogue.TorqueDropouts([0.0, 0.5, 0.0], 20.0, 0.01)
    plant = Plant(robot, truth, (drops,), seed=3)
    share = watched(plant, run, lambda p: p.torque[1] / p.motor_command[1])
    assert set(np.round(np.unique(share), 6)) == {0.5, 1.0}
    drift = out_of_catalogue.TorqueConstantDrift([0.3] * 3, 12.0, 0.5)
    plant = Plant(robot, truth, (drift,))
    lost = watched(plant, run, lambda p: p.torque[0] / p.motor_command[0])
    assert lost[0] > 0.999
    assert lost[-1] < 0.99
    hose = out_of_catalogue.HoseJerk(200.0, 0.4, [0.2, 0.0, -0.35])
    plant = Plant(robot, truth, (hose,))
    force = watched(plant, run, hose.platform_force)
    slack = watched(plant, run, lambda p: np.linalg.norm(p.platform - hose.point_m)) < 0.4
    assert slack.any() == (force[slack] == 0).all()
    assert (np.abs(force[~slack]).max(axis=1) > 0).all()


def test_an_effect_is_drawn_by_name_at_a_severity(truth: PlantTruth) -> None:
    for name in CATALOGUE:
        found, effect = draw_effect(name, truth, seed=5)
        assert (found, type(effect)) == (name, CATALOGUE[name])
        assert effect.figures == draw_effect(f"{name}:1", truth, seed=5)[1].figures
        assert effect.in_words.startswith(f"{next(iter(effect.figures))} ")
    plain, strong = (draw_effect(text, truth, seed=5)[1] for text in ("torque_delay", "torque_delay:2"))
    assert strong.figures["delay_s"] == pytest.approx(2 * plain.figures["delay_s"])
    stiff, soft = (draw_effect(text, truth, seed=5)[1] for text in ("joint_elasticity:0.5", "joint_elasticity"))
    assert max(stiff.figures["stiffness_nmprad"]) == pytest.approx(2 * max(soft.figures["stiffness_nmprad"]))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("jelly", "--effect 'jelly': unknown effect 'jelly'; known: stribeck_friction, "),
        ("magnet", "unknown effect 'magnet'"),  # no diagnosis can name it
        ("backlash:", "severity '' is not a number above zero"),
        ("backlash:strong", "severity 'strong' is not a number above zero; give for example joint_elasticity:0.5"),
        ("backlash:0", "severity '0' is not a number above zero"),
        ("backlash:nan", "severity 'nan' is not a number above zero"),
    ],
)
def test_what_is_no_effect_is_said(truth: PlantTruth, text: str, said: str) -> None:
    with pytest.raises(DataError) as error:
        draw_effect(text, truth, seed=5)
    assert said in str(error.value)
