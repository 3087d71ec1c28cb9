"""Elasticity and backlash against other code: the ideal spring's closed form, a simulation with small steps, and the
MuJoCo plant with a rotor and a link of their own in closed loop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from drivers.plant.effects import transmission
from drivers.plant.motion import Limits, Planner
from drivers.plant.plant import Plant
from drivers.plant.simulate import simulate
from tests.service.diagnosis.subject import (
    EFFECTS,
    Band,
    Base,
    DecoupledAxes,
    Delta,
    Hypothesis,
    Problem,
    Recording,
    Scene,
    Segment,
    Split,
    Term,
    added,
    predict,
    segments,
    selection,
    statistics,
    thin,
)
from tests.service.diagnosis.world import BASE, PERIOD, ROBOT, TRUTH

INERTIA, LOAD = 0.4, 1.5  # kg m^2, N m: one axis with a constant load on its link
AXIS = DecoupledAxes(np.array([25.0]))
SINGLE = Base(np.array([INERTIA, LOAD]), np.array([0.6]), np.array([0.0]), 0.002)


def elastic(hz: float, ratio: float, share: float) -> tuple[float, float, float, float]:
    """Spring N m/rad, damper N m s/rad, motor's and link's inertia kg m^2 of an axis."""
    motor, link = share * INERTIA, (1 - share) * INERTIA
    spring = link * (2 * math.pi * hz) ** 2
    return spring, 2 * ratio * math.sqrt(spring * link), motor, link


@dataclass(frozen=True)
class Axis:
    """Motor motion (N,) of an axis and the torque that its motor feels, less that of a rigid one."""

    time: np.ndarray
    motion: tuple[np.ndarray, np.ndarray, np.ndarray]
    extra: np.ndarray

    def scene(self) -> Scene:
        """As effects see it."""
        torque = INERTIA * self.motion[2] + LOAD + 0.6 * self.motion[1] + self.extra
        signals = (values[:, None] for values in (*self.motion, torque, np.abs(self.motion[1]) > 0.02))
        part = Segment(np.arange(len(self.time)), self.time, PERIOD, *signals)
        return Scene(Recording(part, AXIS, 0, "axis"), SINGLE)


def swings(seconds: float, size: float = 1.0) -> tuple[np.ndarray, list[tuple[float, float]]]:
    """Clock and (amplitude rad, rad/s) of the sines of a motor's motion."""
    return np.arange(round(seconds / PERIOD)) * PERIOD, [
        (0.5 * size, 5.0),
        (0.05 * size, 31.0),
        (0.01 * size, 83.0),
        (0.005 * size, 107.0),
    ]


def spring_axis(seconds: float, hz: float, ratio: float, share: float) -> Axis:
    """The steady state of every sine through spring and damper, by transfer functions."""
    time, sines = swings(seconds)
    spring, damper, _, link = elastic(hz, ratio, share)
    motion = [np.zeros_like(time) for _ in range(3)]
    extra = np.zeros_like(time)
    for size, rate in sines:
        wave = size * np.exp(1j * rate * time)
        for order in range(3):
            motion[order] += ((1j * rate) ** order * wave).imag
        passed = spring + 1j * rate * damper
        follows = passed / (passed - link * rate**2)  # link over motor
        extra += (-link * rate**2 * (follows - 1) * wave).imag
    return Axis(time, (motion[0], motion[1], motion[2]), extra)


def loose_axis(seconds: float, half: float, hz: float, ratio: float, share: float) -> Axis:
    """A link between two stiff, damped flanks, semi-implicit Euler at 50 us; teeth push, they do not pull."""
    time, sines = swings(seconds, 2.0)
    spring, damper, _, link = elastic(hz, ratio, share)
    fine = 20
    clock = np.arange(len(time) * fine) * PERIOD / fine
    waves = [np.array([size * np.exp(1j * rate * clock) * (1j * rate) ** n for size, rate in sines]) for n in range(3)]
    angle, speed, change = (wave.sum(axis=0).imag for wave in waves)
    q, v = angle[0] - half - (link * change[0] + LOAD) / spring, speed[0]
    force = np.empty(len(clock))
    for k in range(len(clock)):
        gap, rate = angle[k] - q, speed[k] - v
        contact = 0.0
        if gap > half:
            contact = max(0.0, spring * (gap - half) + damper * rate)
        elif gap < -half:
            contact = min(0.0, spring * (gap + half) + damper * rate)
        force[k] = contact
        v += (contact - LOAD) / link * PERIOD / fine
        q += v * PERIOD / fine
    extra = force - link * change - LOAD
    mean = extra.reshape(len(time), fine).mean(axis=1)
    return Axis(time, (angle[::fine], speed[::fine], change[::fine]), mean)


def relative(found: np.ndarray, truth: np.ndarray, band: Band) -> float:
    """rms difference in the analysis band, of the truth's, once the start is forgotten."""
    found, truth = (band(values)[80:-20] for values in (found, truth))
    return float(np.sqrt(np.mean((found - truth) ** 2) / np.mean(truth**2)))


@pytest.mark.parametrize(("hz", "ratio", "share"), [(12.0, 0.2, 0.3), (22.0, 0.1, 0.15), (35.0, 0.4, 0.5)])
def test_a_spring_is_the_closed_form(hz, ratio, share):
    axis = spring_axis(2.0, hz, ratio, share)
    term = Term(EFFECTS["joint_elasticity"], (0,), np.zeros((1, 0)), (hz, ratio, share))
    found = added(axis.scene(), term)[:, 0]
    assert relative(found, axis.extra, Band.of(PERIOD)) < 0.05


@pytest.mark.parametrize(("half", "share"), [(0.0015, 0.2), (0.004, 0.45)])
def test_lost_motion_is_what_small_steps_give(half, share):
    axis = loose_axis(2.0, half, 120.0, 2.0, share)
    term = Term(EFFECTS["backlash"], (0,), np.zeros((1, 0)), (half, 120.0, 2.0, share))
    found = added(axis.scene(), term)[:, 0]
    assert relative(found, axis.extra, Band.of(PERIOD)) < 0.15
    still = Term(EFFECTS["backlash"], (0,), np.zeros((1, 0)), (1e-4, 120.0, 2.0, share))
    assert relative(added(axis.scene(), still)[:, 0], axis.extra, Band.of(PERIOD)) > 0.5


def test_too_much_to_follow_is_no_torque_at_all():
    axis = spring_axis(0.5, 12.0, 0.2, 0.3)
    term = Term(EFFECTS["joint_elasticity"], (0,), np.zeros((1, 0)), (0.2, 0.01, 0.02))
    assert not added(axis.scene(), term).any()


CASES = [
    ("joint_elasticity", spring_axis, (14.0, 0.12, 0.3)),
    ("backlash", loose_axis, (0.0023, 120.0, 2.0, 0.25)),
]


@pytest.mark.parametrize(("name", "make", "shape"), CASES, ids=[case[0] for case in CASES])
def test_it_is_found_again_with_its_parameters_inside_their_intervals(name, make, shape):
    random = np.random.default_rng(3)
    band, noise = Band.of(PERIOD), 0.3
    recordings = []
    axis = make(6.0, *shape)
    for number in range(3):
        part = slice(2000 * number, 2000 * (number + 1))
        one = Axis(axis.time[part], tuple(signal[part] for signal in axis.motion), axis.extra[part])  # pyright: ignore
        clean = one.scene().segment
        moving = clean.moving.copy()
        moving[:600] = moving[-100:] = False  # until the start is forgotten
        noisy = clean.torque + noise * random.standard_normal(clean.torque.shape)
        recordings.append(Recording(replace(clean, torque=noisy, moving=moving), AXIS, number, f"run_{number}"))
    logs = Problem.of(recordings, band, np.array([noise * band.white_share**0.5]))
    split = Split.of(logs)
    rivals = [e for e in EFFECTS.values() if e.name not in ("cogging", "encoder_eccentricity")]
    found = selection.search(logs, split, Hypothesis(SINGLE), rivals, lambda _: None)
    assert found.best.names[0] == name
    term = found.best.hypothesis.terms[0]
    errors = statistics.standard_errors(found.best.fitted, split)[6:]
    # 125 us a step of the catalogue's integration bias damping and share of the motor by 3 %, which no interval covers
    assert (np.abs(np.array(term.shape) - shape) <= 3.0 * errors + 0.03 * np.array(shape)).all()


@pytest.mark.parametrize(
    ("name", "effect", "joint", "left_over"),
    [
        ("joint_elasticity", transmission.JointElasticity([0.0, 2000.0, 0.0], 0.1), 1, 0.05),
        ("backlash", transmission.Backlash([0.002, 0.0, 0.0]), 0, 0.35),  # impacts, but not their chatter
    ],
)
def test_on_the_robot_it_is_what_the_plant_does(name, effect, joint, left_over):
    """Rotor and link as two bodies in closed loop; the other joints feel what the link does."""
    viscous = 2.0
    truth = TRUTH.model_copy(update={"viscous_friction_nms": [viscous] * 3, "peak_torque_nm": 250.0})
    planner = Planner(ROBOT, PERIOD, Limits(speed=10.0, acceleration=240.0, torque=85.0))
    plant = Plant(ROBOT, truth, (effect,), PERIOD)
    trace = simulate(plant, planner.multisine(np.random.default_rng(4), 2.5, 1.0))
    (part,) = segments(trace)
    base = Base(BASE.rigid, np.full(3, viscous), np.zeros(3), 0.002)
    here = Scene(Recording(thin(part), Delta.of(ROBOT), 0, "plant"), base)
    band = Band.of(PERIOD)
    whole = float(np.mean(here.inertia[:, joint, joint]))
    share = TRUTH.rotor_inertia_kgm2[joint] / whole
    link = (1 - share) * whole
    if name == "joint_elasticity":
        spring = effect.stiffness_nmprad[joint]
        damper = 2 * effect.damping_ratio * math.sqrt(spring * TRUTH.rotor_inertia_kgm2[joint])
        shape = (math.sqrt(spring / link) / (2 * math.pi), damper / (2 * math.sqrt(spring * link)), share)
    else:
        shape = (0.002, 120.0, 2.0, share)
    term = Term(EFFECTS[name], (joint,), np.zeros((1, 0)), shape)
    inside = slice(60, -60)
    left = [band(here.segment.torque - predict(here, Hypothesis(base, terms)))[inside] for terms in ((), (term,))]
    rms = [np.sqrt(np.mean(values**2, axis=0)) for values in left]
    assert rms[0][joint] > 1.0
    assert (rms[1] < left_over * rms[0]).all()
