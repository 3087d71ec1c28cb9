"""On what a residual depends, against torques in closed form; a force on the platform, by virtual work on another
hand's closed chain."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.trace import read_trace
from schemas.axes_description import load_description
from schemas.diagnosis import Located
from service.diagnosis.evidence.located import located
from tests.bench.second_plant.cases import make, placed
from tests.bench.second_plant.robots import as_described
from tests.service.subject import CATALOGUE, Hypothesis, Split, diagnose, document
from tests.service.world import BASE, ROBOT, Course, course, direction, problem

RUNS = [course(seed, 3.0) for seed in (1, 2, 3, 4)]
NOISE = 0.3  # N m a sample
FORCE, REACH = np.array([9.0, -5.0, 6.0]), 0.06  # N on the platform, m


def on(joint: int, values: np.ndarray) -> np.ndarray:
    """(N, 3) of (N,) on one joint, from 0."""
    result = np.zeros((len(values), 3))
    result[:, joint] = values
    return result


def rail(run: Course) -> np.ndarray:
    return on(1, -2.0 * np.tanh((run.motion[0][:, 1] - 0.5) / 0.05))


def rough(run: Course) -> np.ndarray:
    bump = 3.0 * np.exp(-(((run.motion[0][:, 2] - 0.4) / 0.05) ** 2))
    return on(2, bump * direction(run.motion[1])[:, 2])


def turned(run: Course) -> Course:
    """With the first joint in the place of the third."""
    first, second, third = (np.roll(part, -1, axis=1) for part in run.motion)
    return Course(run.time, (first, second, third), run.torque)


def drag(run: Course) -> np.ndarray:
    return on(0, 1.5 * np.exp(-(((run.motion[1][:, 0] - 1.0) / 0.4) ** 2)))


def slopes(run: Course) -> tuple[np.ndarray, np.ndarray]:
    """Platform (N, 3) m of another hand's robot, and its slope (N, 3, 3) with each angle, by differences."""
    plant, angle = as_described(ROBOT.model_dump() | {"gravity_mps2": 9.81}), run.motion[0]
    steps = [(placed(plant, angle + step) - placed(plant, angle - step)) / 2e-5 for step in 1e-5 * np.eye(3)]
    return placed(plant, angle), np.stack(steps, axis=1)


def magnet(run: Course) -> np.ndarray:
    place, slope = slopes(run)
    force = np.exp(-0.5 * ((place - MIDDLE) ** 2).sum(axis=1) / REACH**2)[:, None] * FORCE
    return -np.einsum("nia,na->ni", slope, force)


MIDDLE = slopes(RUNS[0])[0].mean(axis=0)


def found(*causes) -> list[Located]:
    random = np.random.default_rng(3)
    torques = [
        run.torque + sum(cause(run) for cause in causes) + NOISE * random.normal(size=run.torque.shape) for run in RUNS
    ]
    logs = problem(RUNS, torques, NOISE)
    return located(ROBOT, logs, Split.of(logs), Hypothesis(BASE))


def test_a_torque_that_depends_on_the_angle_is_told_with_its_size():
    (one,) = found(rail)
    assert (one.joint, one.over, one.unit, one.at_unit) == (2, "angle", "N m", "rad")
    low, high = one.extremes
    assert high.value[0] - low.value[0] == pytest.approx(4.0, rel=0.1)
    assert low.at[0] > 0.55
    assert high.at[0] < 0.45
    assert one.share_ci95[0] <= one.share <= one.share_ci95[1]
    assert one.share > 0.95


def test_friction_at_an_angle_and_torque_that_depends_on_the_speed_are_told_apart_from_it():
    (one,) = found(rough)
    assert (one.joint, one.over) == (3, "friction_at_angle")
    assert one.extremes[1].at[0] == pytest.approx(0.4, abs=0.03)
    (one,) = found(drag)
    assert (one.joint, one.over, one.at_unit) == (1, "speed", "rad/s")
    assert one.extremes[1].at[0] == pytest.approx(1.0, abs=0.3)


def test_a_pull_at_the_platform_is_one_force_and_not_three_torques():
    (one,) = found(magnet)
    assert (one.joint, one.over, one.unit, one.at_unit) == (None, "platform", "N", "m")
    (most,) = one.extremes
    assert np.linalg.norm(np.array(most.at) - MIDDLE) < REACH
    assert np.linalg.norm(np.array(most.value) - FORCE) < 0.3 * np.linalg.norm(FORCE)


def test_causes_in_two_joints_are_two_answers_however_alike_in_size():
    one, other = found(rough, lambda run: np.roll(rough(turned(run)), 1, axis=1))
    assert {one.joint, other.joint} == {1, 3}
    assert {one.over, other.over} == {"friction_at_angle"}
    assert not one.alternative
    assert not other.alternative
    assert one.share + other.share == pytest.approx(1.0, abs=0.05)


def test_noise_depends_on_nothing():
    assert found() == []


def test_a_magnet_of_another_plant_is_found_where_it_is(tmp_path):
    """Seed 3 of the calibration set; the whole diagnosis, which names nothing."""
    truth = make("outside", 3, tmp_path)["disturbances"]["magnet"]["parameters"]
    robot = load_description(tmp_path / "robot.toml")
    traces = [read_trace(path, robot) for path in sorted(tmp_path.glob("fit_*.csv"))]
    told = document.document(diagnose.diagnose(robot, traces, CATALOGUE))
    (one,) = told.located
    assert (told.effects, one.joint, one.over) == ([], None, "platform")
    reach, away = truth["magnet_reach"], np.array(truth["magnet_point"]) - one.extremes[0].at
    far = float(np.linalg.norm(away))
    assert far < reach
    pull = 4.0 * truth["magnet"] / (1.0 + (far / reach) ** 2) ** 2 * away / (far + 0.25 * reach)
    assert np.linalg.norm(np.array(one.extremes[0].value) - pull) < 0.3 * np.linalg.norm(pull)
