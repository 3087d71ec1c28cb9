"""Coupled elastic gears: energy, an integrator of its own over the whole range of stiffness and rate, and the MuJoCo
plant with a rotor and a link at each joint."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from drivers.motion import MotionLimits, Planner
from drivers.simulated.plant.effects import two_mass_effects
from drivers.simulated.plant.plant import Plant
from drivers.simulated.plant.plant_trace import simulate
from service.model.elastic import LEFT, coupled, elastic_motion, gears_of, inertias
from service.model.forward import forward_dynamics
from service.model.kinematics import forward
from service.model.nominal import pack
from tests.service.subject import (
    EFFECTS,
    Band,
    Base,
    Delta,
    Hypothesis,
    Recording,
    Scene,
    Term,
    predict,
    segments,
    thin,
)
from tests.service.world import BASE, PERIOD, ROBOT, TRUTH, sines

MODEL = pack(ROBOT)
SPRINGS = {joint: (0.0, 15.0, 0.05, 0.2) for joint in range(3)}


def held(angle: float, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.full((count, 3), angle), np.zeros((count, 3)), np.zeros((count, 3))


def energy(gears: np.ndarray, link: np.ndarray, speed: np.ndarray, twist: np.ndarray) -> np.ndarray:
    """J, (N,): of masses, springs and weight."""
    _, mass = forward_dynamics(MODEL, BASE.rigid, link, speed, np.zeros_like(link))
    mass = mass - np.diag(gears["motor"][0])
    moving = 0.5 * np.einsum("ni,nij,nj->n", speed, mass, speed)
    elbow = -MODEL.active_length * np.sin(link)  # m, heights of what weighs at the elbows
    weight = 9.81 * (MODEL.moving_mass * forward(MODEL, link)[:, 2] + MODEL.link_mass * elbow.sum(axis=1))
    return moving + 0.5 * twist**2 @ gears["stiffness"][0] + weight


@pytest.mark.parametrize(("hz", "lost"), [(8.0, 2e-3), (40.0, 2e-3)])
def test_undamped_links_keep_their_energy(hz, lost):
    """Motors held, links let go by a jolt of the motors: what springs, masses and weight hold together stays."""
    gears = gears_of(MODEL, BASE.rigid, dict.fromkeys(range(3), (0.0, hz, 0.0, 0.2)))
    motion = held(0.4, 3000)
    motion[2][:20, 1] = 300.0  # rad/s^2
    found = elastic_motion(MODEL, BASE.rigid, gears, motion, 2e-4)
    after = slice(25, None)
    kept = energy(gears, motion[0][after] + found.twist[after], found.rate[after], found.twist[after])
    swing = found.rate[after]
    most = 0.5 * np.einsum("ni,i,ni->n", swing, inertias(MODEL, BASE.rigid)[0], swing).max()
    assert most > 0.05
    assert np.ptp(kept) < lost * most


def reference(gears: np.ndarray, path, seconds: float, at: np.ndarray) -> np.ndarray:
    """Torque (M, 3) N m at times (M,) by an adaptive integrator in the links' own angles."""
    stiffness, damping, motor = (gears[name][0] for name in ("stiffness", "damping", "motor"))
    soft = stiffness > 0
    delta = Delta.of(ROBOT)

    def links(time: float, state: np.ndarray):
        angle, speed, change = (signal[0] for signal in path(np.array([time])))
        twist, rate = state[:3], state[3:]
        link, link_dot = (angle + twist)[None], (speed + rate)[None]
        bias = delta.rigid(link, link_dot, 0 * link).torque(BASE.rigid)[0]
        mass = forward_dynamics(MODEL, BASE.rigid, link, link_dot, 0 * link)[1][0] - np.diag(motor)
        passed = -stiffness * twist - damping * rate
        relative = np.zeros(3)
        left = passed - bias - mass @ change
        relative[soft] = np.linalg.solve(mass[np.ix_(soft, soft)], left[soft])
        torque = np.where(soft, motor * change + passed, bias + mass @ (change + relative))
        return relative, torque

    first = elastic_motion(MODEL, BASE.rigid, gears, path(np.zeros(1)), 1.0)
    found = solve_ivp(
        lambda time, state: np.concatenate([state[3:], links(time, state)[0]]),
        (0.0, seconds), np.concatenate([first.twist[0], first.rate[0]]), "LSODA", at, rtol=1e-8, atol=1e-10,
    )  # fmt: skip
    return np.stack([links(time, state)[1] for time, state in zip(found.t, found.y.T, strict=True)])


@pytest.mark.parametrize(
    ("hz", "rate", "joints", "off"),
    [
        (2.0, 1000.0, (0, 1, 2), 0.02),
        (16.0, 250.0, (0, 1, 2), 0.05),
        (16.0, 1000.0, (1,), 0.01),
        (16.0, 8000.0, (0, 1, 2), 0.01),
        (60.0, 1000.0, (0, 2), 0.02),
        (250.0, 1000.0, (0, 1, 2), 0.05),
    ],
)
def test_torque_is_that_of_an_adaptive_integrator(hz, rate, joints, off):
    """off: of what the springs make of the rigid torque, rms."""
    path, seconds = sines(7, 0.25, 5.0, 40.0), 0.6
    gears = gears_of(MODEL, BASE.rigid, dict.fromkeys(joints, (0.0, hz, 0.1, 0.25)))
    time = np.arange(round(seconds * rate)) / rate
    found = elastic_motion(MODEL, BASE.rigid, gears, path(time), 1.0 / rate).torque
    at = np.arange(0, len(time), max(1, round(rate / 250.0)))
    expected = reference(gears, path, seconds, time[at])
    rigid = Delta.of(ROBOT).rigid(*path(time[at])).torque(BASE.rigid)
    assert np.sqrt(np.mean((found[at] - expected) ** 2)) < off * np.sqrt(np.mean((expected - rigid) ** 2)) + 2e-3


@pytest.mark.parametrize("rate", [250.0, 1000.0, 8000.0])
def test_every_gear_that_a_description_allows_stays_stable(rate):
    """Motors that jolt at random from sample to sample: the torque follows what the jolts ask for and no more."""
    rng = np.random.default_rng(3)
    count = 4000
    motion = held(0.4, count)
    motion[2][:] = rng.normal(0.0, 20.0, (count, 3))
    for hz, ratio, share in itertools.product((20.0, 80.0, 250.0), (0.01, 2.0), (0.02, 0.4, 0.9)):
        for joints in ((0, 1, 2), (1,)):
            gears = gears_of(MODEL, BASE.rigid, dict.fromkeys(joints, (0.0, hz, ratio, share)))
            found = elastic_motion(MODEL, BASE.rigid, gears, motion, 1.0 / rate)
            assert found.reached == count
            begun, ended = (np.abs(half).max() for half in np.split(found.twist, 2))
            assert ended < 1.5 * begun
            # a swing that a bounded force keeps up: 2 / (pi ratio) times what it bends at rest
            force = np.abs(Delta.of(ROBOT).rigid(*motion).torque(BASE.rigid)).max()
            assert begun < (1.0 + 2.0 / (math.pi * ratio)) * force / gears["stiffness"][0, 1]
            assert np.isfinite(found.torque).all()


@pytest.mark.parametrize("rate", [250.0, 8000.0])
def test_the_softest_gear_hangs_at_rest_where_its_weight_bends_it(rate):
    gears = gears_of(MODEL, BASE.rigid, dict.fromkeys(range(3), (0.0, 2.0, 0.3, 0.2)))
    count = round(6.0 * rate)
    found = elastic_motion(MODEL, BASE.rigid, gears, held(0.2, count), 1.0 / rate)
    weight = Delta.of(ROBOT).rigid(*(0.2 + found.twist[-1:], *np.zeros((2, 1, 3)))).torque(BASE.rigid)[0]
    assert found.twist[-1] == pytest.approx(-weight / gears["stiffness"][0], rel=1e-3)
    assert found.torque[-1] == pytest.approx(weight, rel=1e-3)


def test_what_a_joint_feels_of_the_others_masses_does_not_turn_with_its_motor():
    """Nine tenths off each diagonal would leave no mass matrix."""
    inertia, most = inertias(MODEL, BASE.rigid)
    _, mass = forward_dynamics(MODEL, BASE.rigid, *np.full((3, 1, 3), 0.4))
    assert inertia == pytest.approx(np.diag(mass[0]))
    for share in (0.3, 0.9):
        motor = gears_of(MODEL, BASE.rigid, dict.fromkeys(range(3), (0.0, 20.0, 0.1, share)))["motor"][0]
        assert motor == pytest.approx(min(share, most) * inertia)
        assert np.linalg.eigvalsh(mass[0] - np.diag(motor)).min() >= 0.99 * LEFT * inertia.min()
    assert most < 0.9


def on_the_plant(effect: two_mass_effects.JointElasticity | two_mass_effects.Backlash) -> Scene:
    """A log of the plant as the true base model sees it."""
    viscous = 2.0
    truth = TRUTH.model_copy(update={"viscous_friction_nms": [viscous] * 3, "peak_torque_nm": 250.0})
    planner = Planner(ROBOT, PERIOD, MotionLimits(speed=10.0, acceleration=240.0, torque=85.0))
    plant = Plant(ROBOT, truth, (effect,), PERIOD)
    (part,) = segments(simulate(plant, planner.multisine(np.random.default_rng(4), 2.5, 1.0)))
    base = Base(BASE.rigid, np.full(3, viscous), np.zeros(3), 0.002)
    return Scene(Recording(thin(part), Delta.of(ROBOT), 0, "plant"), base)


def left(here: Scene, torque: np.ndarray) -> np.ndarray:
    """(3,) N m rms in the band of what `torque` lacks."""
    return np.sqrt(np.mean(Band.of(PERIOD)(here.segment.torque - torque)[60:-60] ** 2, axis=0))


def test_gears_at_every_joint_are_what_the_plant_does():
    """A rotor and a link a joint as six bodies in closed loop, each joint with a spring of its own."""
    springs = [2600.0, 1900.0, 2200.0]
    here = on_the_plant(two_mass_effects.JointElasticity(springs, 0.1))
    whole, _ = inertias(MODEL, BASE.rigid)
    rotor = np.array(TRUTH.rotor_inertia_kgm2)
    terms = []
    for joint, spring in enumerate(springs):
        link = whole[joint] - rotor[joint]
        damper = 0.2 * math.sqrt(spring * rotor[joint])
        hz, ratio = math.sqrt(spring / link) / (2 * math.pi), damper / (2 * math.sqrt(spring * link))
        shape = (hz, ratio, rotor[joint] / whole[joint])
        terms.append(Term(EFFECTS["joint_elasticity"], (joint,), np.zeros((1, 0)), shape))
    rigid = left(here, here.total)
    assert (rigid > 1.0).all()
    assert (left(here, predict(here, Hypothesis(here.base, tuple(terms)))) < 0.04 * rigid).all()


def test_play_is_what_the_plant_does():
    """But for the chatter of its impacts."""
    here = on_the_plant(two_mass_effects.Backlash([0.002, 0.0, 0.0]))
    share = TRUTH.rotor_inertia_kgm2[0] / inertias(MODEL, BASE.rigid)[0][0]
    loose = coupled(here, {0: (0.002, 120.0, 2.0, share)})
    assert (left(here, here.total + loose) < 0.23 * left(here, here.total)).all()
