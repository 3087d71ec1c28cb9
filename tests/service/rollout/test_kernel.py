"""The simulation forward in time: energy, stiction, and every effect against its own inverse form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from schemas.fitted import JointParameter, Parameter
from schemas.robot import EffectEntry, EffectParameter, Identified, Robot
from service.model import kinematics
from service.model.dynamics import torque_terms
from service.model.forward import forward_dynamics
from service.rollout.gap import simulate
from service.rollout.packed import simulated, stretch
from tests.service.subject import CATALOGUE, Effect, Segment, torque_along
from tests.service.world import BASE, COULOMB, PERIOD, ROBOT, TRANSITION, VISCOUS, sines

# name: joints, parameters; strong enough to be far off without
INJECTED: dict[str, tuple[list[int], dict[str, float]]] = {
    "stribeck_friction": ([1, 2, 3], {"f_s_1": 2.0, "f_s_2": 1.5, "f_s_3": 2.5, "v_s": 0.6}),
    "asymmetric_friction": ([1], {"delta_c": 1.5, "delta_v": 0.3}),
    "load_dependent_friction": ([2], {"mu": 0.12}),
    "nonlinear_viscous_friction": ([1], {"f": 0.4, "p": 1.7}),
    "position_dependent_friction": ([3], {"cosine": 1.0, "sine": -1.5, "order": 3.0}),
    "warmup_friction": ([1], {"f": 1.2, "tau": 3.0}),
    "presliding_friction": ([2], {"f": 2.0, "distance": 0.05}),
    "passive_joint_friction": (
        [], {"dry_elbow": 0.5, "dry_platform": 0.4, "viscous_elbow": 0.2, "viscous_platform": 0.3}
    ),
    "rotor_inertia": ([3], {"delta_i": 0.05}),
    "arm_mass": ([1], {"delta_m": 0.8}),
    "tool_mass": ([], {"delta_m": 0.7}),
    "base_tilt": ([], {"about_x": 0.05, "about_y": -0.06}),
    "joint_spring": ([2], {"k": 4.0, "preload": -2.0}),
    "hose_spring": ([], {"k": 30.0, "force_x": 4.0, "force_y": -6.0, "force_z": 9.0}),
    "air_drag": ([], {"c": 2.0}),
    "shaft_friction": ([], {"dry": 6.0, "viscous": 5.0}),
    "link_length_error": ([2], {"error": 0.012}),
    "forearm_length_error": ([1], {"error": -0.015}),
    "base_radius_error": ([3], {"error": 0.012}),
    "azimuth_error": ([2], {"error": 0.03}),
    "joint_offset": ([1], {"error": 0.03}),
    "angle_scale": ([2], {"epsilon": 0.02}),
    "joint_elasticity": ([2], {"natural_hz": 9.0, "damping_ratio": 0.1, "motor_share": 0.3}),
    "backlash": ([1], {"half": 0.004, "contact_hz": 120.0, "contact_damping": 2.0, "motor_share": 0.3}),
    "torque_scale": ([1], {"epsilon": 0.1}),
    "torque_offset": ([3], {"offset": 1.3}),
    "torque_delay": ([], {"delay": 0.004}),
    "torque_filter": ([], {"cutoff": 20.0}),
    "drive_lag": ([], {"cutoff": 20.0}),
    "cogging": ([2], {"cosine": 0.8, "sine": 1.5, "order": 1.0}),
    "encoder_eccentricity": ([1], {"cosine": 0.003, "sine": -0.002, "order": 1.0}),
}  # fmt: skip
HORIZON = 201  # samples
RHO = np.array([BASE.rigid[0], BASE.rigid[1], 1.0, BASE.rigid[2]])  # of the inverse dynamics' terms


def identified(*effects: EffectEntry) -> Robot:
    found = Identified(
        rho_1=Parameter(value=BASE.rigid[0]),
        rho_2=Parameter(value=BASE.rigid[1]),
        forearm_inertia_kg=Parameter(value=BASE.rigid[2]),
        viscous_friction_nms=JointParameter(value=VISCOUS.tolist()),
        coulomb_friction_nm=JointParameter(value=COULOMB.tolist()),
        friction_transition_radps=TRANSITION,
    )
    return ROBOT.model_copy(update={"identified": found, "effect": list(effects)})


def effect(name: str) -> EffectEntry:
    joints, values = INJECTED[name]
    return EffectEntry(
        name=name, joints=joints, parameters={key: EffectParameter(value=v) for key, v in values.items()}
    )


def recorded(robot: Robot, seconds: float = 1.2) -> Segment:
    """A motion in closed form with the torque that the offline model asks for it."""
    time = np.arange(round(seconds / PERIOD)) * PERIOD
    motion = sines(3, 0.4)(time)
    torque = torque_along(robot, time, *motion)
    return Segment(np.arange(len(time)), time, PERIOD, *motion, torque, np.ones(motion[0].shape, bool))


def off(robot: Robot, part: Segment) -> tuple[float, float]:
    """Rms distance of the platform, m, between simulation and record after the horizon, and of its way."""
    starts = np.array([150, 300, 450, 600, 750])
    seen = stretch(robot, part, part.theta)
    rows = starts[:, None] + np.arange(HORIZON)
    angle = simulate(seen, seen.start[starts], seen.torque[rows], part.time[starts], part.period)
    there, then = (kinematics.forward(seen.model, values) for values in (angle[:, -1], part.theta[rows[:, -1]]))
    begin = kinematics.forward(seen.model, part.theta[starts])
    return (float(np.sqrt(np.mean(np.sum((a - then) ** 2, axis=1)))) for a in (there, begin))  # pyright: ignore


def test_every_effect_of_the_catalogue_is_tried():
    assert {entry.name for entry in CATALOGUE if simulated(entry)} == set(INJECTED)


@pytest.mark.parametrize("name", INJECTED)
def test_under_the_torque_that_a_motion_takes_it_makes_that_motion(name):
    """The torque is the offline model's, which is tested against MuJoCo; the simulation shares no formula of the
    effects that need a state."""
    part = recorded(identified(effect(name)))
    with_it, moved = off(identified(effect(name)), part)
    without, _ = off(identified(), part)
    print(f"{name}: {1e3 * with_it:.3f} mm with, {1e3 * without:.3f} mm without, of {1e3 * moved:.0f} mm")
    assert with_it < 0.01 * moved
    assert with_it < 0.2 * without


def test_the_base_model_makes_the_motion():
    with_it, moved = off(identified(), recorded(identified()))
    assert with_it < 0.002 * moved


def test_energy_is_kept_without_friction():
    found = identified().identified
    assert found is not None
    none = JointParameter(value=[0.0, 0.0, 0.0])
    free = found.model_copy(update={"viscous_friction_nms": none, "coulomb_friction_nm": none})
    robot = identified().model_copy(update={"identified": free})
    part = recorded(robot)
    seen = stretch(robot, part, part.theta)
    start = np.zeros((1, 5, 3))
    start[0, [0, 2]] = [0.2, 0.5, 0.35]
    start[0, [1, 3]] = [3.0, -3.0, 4.0]
    held = RHO @ torque_terms(seen.model, start[0, :1], np.zeros((1, 3)), np.zeros((1, 3)))[0, :4]
    torque = np.tile(held, (1, 301, 1))
    theta = simulate(seen, start, torque, np.zeros(1), PERIOD)[0]
    theta_dot = CubicSpline(PERIOD * np.arange(301), theta).derivative()(PERIOD * np.arange(301))
    _, mass = forward_dynamics(seen.model, BASE.rigid, theta, theta_dot, theta)
    kinetic = 0.5 * np.einsum("ni,nij,nj->n", theta_dot, mass, theta_dot)
    height = kinematics.forward(seen.model, theta)[:, 2]
    g = -ROBOT.gravity_mps2[2]
    links = -BASE.rigid[1] * np.sum(seen.model.link_mass * g * seen.model.active_length * np.sin(theta), axis=1)
    energy = kinetic + seen.model.moving_mass * g * height + links - theta @ held
    assert np.abs(theta - theta[0]).max() > 1.0
    assert np.ptp(energy) < 1e-6 * kinetic.max()


def test_friction_holds_a_robot_that_is_held_by_less_than_its_coulomb_level():
    part = recorded(identified())
    seen = stretch(identified(), part, part.theta)
    still = np.tile([0.3, 0.4, 0.5], (1, 1))
    weight = torque_terms(seen.model, still, 0 * still, 0 * still)[0]
    torque = RHO @ weight[:4] + 0.5 * COULOMB
    start = np.zeros((1, 5, 3))
    start[0, [0, 2]] = still
    angle = simulate(seen, start, np.tile(torque, (1, HORIZON, 1)), np.zeros(1), PERIOD)
    # the described friction creeps: at half its level atanh(1/2) of the transition
    assert np.abs(angle[0, -1] - still).max() == pytest.approx(np.arctanh(0.5) * TRANSITION * 0.2, rel=0.05)
    freed = simulate(seen, start, np.tile(RHO @ weight[:4] + 1.5 * COULOMB, (1, HORIZON, 1)), np.zeros(1), PERIOD)
    assert np.abs(freed[0, -1] - still).min() > 0.02


def test_an_effect_without_a_form_is_told():
    class Odd(Effect):
        name = "odd"

        def regressors(self, scene, joint, nonlinear):
            return scene.segment.theta_dot[:, [joint]]

    assert not simulated(Odd())
