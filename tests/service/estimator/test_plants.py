"""`trusted` means it on simulated plants: bodies and effects of MuJoCo's, not of the model, picks made at rest."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from drivers.motion import Payload, Planner, Trajectory
from drivers.simulated.plant.effects import make_effects
from drivers.simulated.plant.effects.friction import PassiveJointFriction, StribeckFriction
from drivers.simulated.plant.effects.sensing import TorqueScale
from drivers.simulated.plant.effects.two_mass_effects import JointElasticity
from drivers.simulated.plant.plant import Plant
from drivers.simulated.plant.plant_trace import Course
from drivers.simulated.plant.truth import TRUTHS, load_truth
from schemas.messages import REFERENCE, SAMPLE, set_stamp, stamp_ns
from schemas.robot import Robot, load_robot
from schemas.trace import Trace
from service.diagnosis.documents.document import corrected
from service.diagnosis.pipeline import diagnose
from service.estimator.estimator import Estimator
from service.experiment.experiment_logs import excitations, record
from service.identification.from_traces import identify
from service.identification.regression import summarise
from service.model import kinematics
from service.model.effects import CATALOGUE
from service.model.nominal import pack

PERIOD = 1e-3
SETTLED = 0.15  # s after a pick or release
RARE = 0.3  # share of samples that are trusted at least, so that what is covered says something
UNMODELLED = {"nothing": (), "scale": (TorqueScale([0.05] * 3),), "shafts": (PassiveJointFriction(0.2, 0.01),)}


@functools.cache
def machine(name: str, unmodelled: str = "nothing") -> tuple[Robot, Plant, Planner]:
    """A robot as identified from its plant's logs, the plant, and its planner."""
    robot = load_robot(name)
    truth = load_truth(TRUTHS / f"{name}.toml", robot)
    planner = Planner(robot, PERIOD)
    plant = Plant(robot, truth, (*make_effects(truth.effect, "test"), *UNMODELLED[unmodelled]), seed=2)
    fits = record(plant, excitations(planner, np.random.default_rng(3), 3, 4.0), "fit")
    found = identify(robot, [summarise(pack(robot), log) for log in fits]).robot
    assert found.identified is not None
    assert found.identified.torque_commanded, "a plant's drives do what they are told"
    return found, plant, planner


def outside(payload: np.ndarray, time: np.ndarray, payloads: tuple[Payload, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Of answers with these times, s: which are trusted, and settled behind each change of load; and of those, which
    are beyond their error."""
    hung, fresh = np.zeros(len(time)), np.zeros(len(time), bool)
    for load in payloads:
        hung[(time >= load.pick) & (time < load.release)] = load.mass
        for edge in (load.pick, load.release):
            fresh |= (time >= edge) & (time < edge + SETTLED)
    judged = payload["trusted"].astype(bool) & ~fresh
    return judged, judged & (np.abs(payload["mass"] - hung) > 2 * payload["std_dev"] + 0.02)


def weighed(robot: Robot, picks: Trace) -> tuple[np.ndarray, np.ndarray]:
    """What the estimator says of a log without torque commands, as on most machines, and when, s from its begin."""
    samples = picks.samples()
    samples["torque_command"] = np.nan
    payload = Estimator(robot, PERIOD).run(samples).payload
    return payload, stamp_ns(payload) * 1e-9 - picks.time[0]


@functools.cache
def picked(name: str, masses: tuple[float, ...], unmodelled: str) -> tuple[np.ndarray, float, tuple[Payload, ...]]:
    """Samples of picks made at rest, when they begin, and what hung when."""
    _, plant, planner = machine(name, unmodelled)
    motion = planner.pick_and_place(np.random.default_rng(5), 4.0, masses, speed=0.8)
    (picks,) = record(plant, iter([motion]), "picks")
    samples = picks.samples()
    samples["torque_command"] = np.nan  # as on most machines
    return samples, picks.time[0], motion.payloads


@pytest.mark.parametrize(
    ("name", "masses", "unmodelled", "since"),
    [
        ("d3-1200", (0.2, 3.8), "nothing", 1.0),
        ("rl5-1450-6kg", (0.2, 5.0), "nothing", 1.0),
        ("d3-1200", (2.0, 3.8), "scale", 1.0),
        ("d3-1200", (0.2, 2.0), "shafts", 1.0),
        ("d3-1200", (0.2, 3.8), "nothing", 1.05),
    ],
)
def test_a_trusted_mass_is_within_its_error(name, masses, unmodelled, since):
    """since: by what torque constants have changed since the fit."""
    robot, *_ = machine(name, unmodelled)
    samples, begins, payloads = picked(name, masses, unmodelled)
    samples = samples.copy()
    samples["torque"] *= since
    payload = Estimator(robot, PERIOD).run(samples).payload
    judged, wrong = outside(payload, stamp_ns(payload) * 1e-9 - begins, payloads)
    assert judged.mean() > RARE
    assert wrong.sum() <= 0.05 * judged.sum()


def test_behind_a_hole_in_which_the_drives_stood_no_wrong_mass_is_trusted():
    """A master that was held up: no frame for a while, commands and drives stand, then all goes on at full speed."""
    robot, plant, planner = machine("d3-1200")
    random = np.random.default_rng(6)
    motion = planner.pick_and_place(random, 6.0, (1.5, 1.5), speed=0.5)
    held = np.zeros(len(motion) + 1, int)
    at = np.arange(300, len(held), 400)
    held[at] = random.integers(5, 50, len(at))
    source = np.repeat(np.arange(len(held)), 1 + held)
    stands = np.r_[False, source[1:] == source[:-1]]
    still = np.where(stands, 0.0, 1.0)[:, None]

    def later(time: float) -> float:
        return time + PERIOD * held[: round(time / PERIOD)].sum()

    slowed = Trajectory(
        PERIOD, motion.position[source], motion.velocity[source] * still, motion.acceleration[source] * still,
        tuple(Payload(later(load.pick), later(load.release), load.mass) for load in motion.payloads),
    )  # fmt: skip
    (picks,) = record(plant, iter([slowed]), "held")
    samples = picks.samples()[~stands[: len(picks.samples())]]
    samples["torque_command"] = np.nan
    payload = Estimator(robot, PERIOD).run(samples).payload
    judged, wrong = outside(payload, stamp_ns(payload) * 1e-9 - picks.time[0], slowed.payloads)
    assert judged.mean() > RARE
    assert not wrong.any()


def test_gears_that_stick_more_than_they_did_make_no_picks():
    """2.5 N m of breakaway friction since the fit, half a kilogram while a joint sets out or stops."""
    robot, _, planner = machine("rl5-1450-6kg")
    truth = load_truth(TRUTHS / "rl5-1450-6kg.toml", robot)
    plant = Plant(robot, truth, (*make_effects(truth.effect, "test"), StribeckFriction([2.5] * 3, 0.2)), seed=4)
    motion = planner.pick_and_place(np.random.default_rng(7), 8.0, (0.5, 2.0), speed=0.8)
    (picks,) = record(plant, iter([motion]), "sticking")
    payload, time = weighed(robot, picks)
    judged, wrong = outside(payload, time, motion.payloads)
    assert wrong.sum() <= 0.05 * judged.sum()
    edges = np.array([edge for load in motion.payloads for edge in (load.pick, load.release)])
    late = time[payload["event"] != 0][:, None] - edges
    unexplained = ~((late >= 0.0) & (late < 0.4)).any(axis=1)
    assert unexplained.sum() <= 1, "before it is known"


@functools.cache
def soft_machine() -> tuple[Robot, Robot, Plant, Planner]:
    """A robot with gears that yield: as identified, as corrected by a diagnosis, the plant, and its planner."""
    robot = load_robot("d3-1200")
    truth = load_truth(TRUTHS / "d3-1200.toml", robot)
    planner = Planner(robot, PERIOD)
    plant = Plant(robot, truth, (JointElasticity([9000.0] * 3, 0.05),), seed=9)
    fits = list(record(plant, excitations(planner, np.random.default_rng(9), 3, 5.0), "fit"))
    named = [effect for effect in CATALOGUE if effect.name == "joint_elasticity"]
    found = diagnose(robot, fits, named)
    soft = corrected(found)
    assert isinstance(soft, Robot)
    assert [entry.name for entry in soft.effect] == ["joint_elasticity"]
    return identify(robot, [summarise(pack(robot), log) for log in fits]).robot, soft, plant, planner


@pytest.mark.slow
def test_behind_soft_gears_a_mass_is_known_as_soon_as_behind_stiff_ones():
    """The links swing for half a second behind a pick, and friction hides a part of it while the joints set out."""
    _, soft, plant, planner = soft_machine()
    motion = planner.pick_and_place(np.random.default_rng(10), 8.0, (0.5, 1.0, 3.8), speed=0.9)
    (picks,) = record(plant, iter([motion]), "soft")
    payload, time = weighed(soft, picks)
    judged, wrong = outside(payload, time, motion.payloads)
    assert judged.mean() > 1.5 * RARE
    assert wrong.sum() <= 0.05 * judged.sum()
    right = []
    for load in motion.payloads:
        held = (time >= load.pick + SETTLED) & (time < load.release)
        right.append((np.abs(payload["mass"][held] - load.mass) < max(0.05, 0.05 * load.mass)).mean() > 0.95)
    assert np.mean(right) >= 0.8, right


@pytest.mark.slow
def test_the_links_follow_a_plan_where_the_motors_go_before_it():
    """MuJoCo's platform, with the torque and the position offset that come for each cycle of a plan."""
    rigid, soft, plant, planner = soft_machine()
    motion = planner.pick_and_place(np.random.default_rng(11), 4.0, (1.0,), speed=0.9)
    errors = []
    for robot in (rigid, soft):
        estimator, course = Estimator(robot, PERIOD), Course(motion)
        plant.set_payload(0.0)
        plant.reset(motion.position[0])
        sample, plan = SAMPLE.empty(1)[0], REFERENCE.empty(1)[0]
        torque, ahead, missed = np.zeros(3), np.zeros(3), []
        for k in range(len(motion)):
            before, ahead = ahead, estimator.feedforward["position_offset"][0].copy() if k else ahead
            measured = course.latch(plant, k, torque, ahead, ahead - before)
            wanted = kinematics.forward(plant.mechanism.geometry, motion.position[k] + plant.offset)
            missed.append(np.linalg.norm(plant.platform - wanted))
            plan["sequence"], plan["position"], plan["velocity"] = k + 1, motion.position[k + 1], motion.velocity[k + 1]
            plan["acceleration"] = motion.acceleration[k + 1]
            estimator.plan(plan)
            set_stamp(sample, k * 1_000_000)
            sample["sequence"] = k
            sample["position"], sample["torque"], _ = measured
            sample["torque_command"], sample["position_command"] = np.nan, motion.position[k]
            estimator.step(sample.tobytes())
            torque = estimator.feedforward["torque"][0].copy()
            estimator.look_back()
            plant.run()
        errors.append(np.sqrt(np.mean(np.square(missed[500:]))))
    assert errors[0] > 2e-3, "gears that yield, m"
    assert errors[1] < 0.3 * errors[0]
