"""A pull that comes again along the platform's way is told from all else, and takes no name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.plant.mechanism import Design, build, close
from drivers.trace import read_trace
from service.diagnosis.diagnose import diagnose
from service.diagnosis.evidence.wave import wave_of
from service.identification.fit import Problem
from tests.service.diagnosis.logs import ROBOT, record, swing
from tests.service.subject import EFFECTS, Hypothesis, evaluate
from tests.service.world import BASE, PERIOD, TRUTH, at_joints, course, problem

SIGMA = 0.2  # N m, of the noise
RUNS = [course(seed, 3.0) for seed in (1, 2, 3)]


def platform(angles: np.ndarray) -> np.ndarray:
    """(N, 3) m, by the simulated mechanism."""
    mechanism = build(Design(TRUTH), PERIOD)
    return close(mechanism, angles)[:, mechanism.platform]


def belt(angles: np.ndarray, pitch: float, heading: float, force: float = 8.0) -> np.ndarray:
    """(N, 3) N m: the platform drags a toothed belt along `heading`, rad, in the base's plane."""
    along = np.array([np.cos(heading), np.sin(heading), 0.0])
    size = force * np.sin(2 * np.pi * platform(angles) @ along / pitch + 0.7)
    return at_joints((angles, angles, angles), size[:, None] * along)


def bump(angles: np.ndarray) -> np.ndarray:
    """(N, 3) N m: a cable carrier rubs over an edge in one place of the first joint."""
    at = (angles[:, :1] - np.mean(angles[:, 0])) / 0.05
    return 4.0 * at * np.exp(-(at**2) / 2) * [1.0, 0.0, 0.0]


def dirt(angles: np.ndarray) -> np.ndarray:
    """(N, 3) N m: the second joint sticks at random moments."""
    stuck = np.random.default_rng(5).random(-(-len(angles) // 80)) < 0.2
    return 5.0 * np.repeat(stuck, 80)[: len(angles), None] * [0.0, 1.0, 0.0]


def logs(*strangers: np.ndarray) -> Problem:
    random = np.random.default_rng(3)
    torques = [run.torque + SIGMA * random.standard_normal(run.torque.shape) for run in RUNS]
    if strangers:
        torques = [torque + stranger for torque, stranger in zip(torques, strangers, strict=True)]
    return problem(RUNS, torques, SIGMA)


@pytest.mark.parametrize(("pitch", "heading"), [(0.06, 1.57), (0.035, 1.57), (0.05, 0.4), (0.08, 2.4)])
def test_a_belt_is_seen_by_its_pitch_and_heading_and_explained(pitch: float, heading: float) -> None:
    made = logs(*(belt(run.motion[0], pitch, heading) for run in RUNS))
    before = evaluate(made, Hypothesis(BASE))
    found = wave_of(made, before.residuals)
    assert found is not None
    assert found.pitch == pytest.approx(pitch, rel=0.02)
    assert np.sin(np.arctan2(*found.wave[::-1]) - heading) == pytest.approx(0.0, abs=0.03)
    after = evaluate(replace(made, fields=found.fields(made)), Hypothesis(BASE))
    assert after.cost - made.count < 0.1 * (before.cost - made.count)


@pytest.mark.parametrize("late", [0, 1, 2, 3])
def test_a_belt_is_explained_where_the_torque_is_late(late: int) -> None:
    """late: ms. A fiftieth of what the belt takes is left at most."""
    torques = [belt(run.motion[0], 0.05, 1.57) for run in RUNS]
    made = logs(*(np.roll(torque, round(1e-3 * late / PERIOD), axis=0) for torque in torques))
    before = evaluate(made, Hypothesis(BASE))
    found = wave_of(made, before.residuals)
    assert found is not None
    after = evaluate(replace(made, fields=found.fields(made)), Hypothesis(BASE))
    assert after.cost - made.count < 0.02 * (before.cost - made.count)


def test_what_has_no_pitch_is_no_wave() -> None:
    hose = [at_joints((q, q, q), 60.0 * (platform(q) - [0.1, 0.2, -0.3])) for q in (run.motion[0] for run in RUNS)]
    edge, stuck = ([of(run.motion[0]) for run in RUNS] for of in (bump, dirt))
    for strangers in ([], hose, edge, stuck):
        made = logs(*strangers)
        assert wave_of(made, evaluate(made, Hypothesis(BASE)).residuals) is None


@pytest.mark.parametrize("stuck", [2.5, 0.0])
def test_beside_a_belt_friction_is_named_and_nothing_else(tmp_path, stuck: float) -> None:
    traces = []
    for seed in (1, 2, 3):
        trace = read_trace(record(tmp_path / f"run_{seed}.csv", ROBOT, swing(seed), 5.0, seed, stuck), ROBOT)
        traces.append(replace(trace, torque=trace.torque + belt(trace.position, 0.06, 1.57)))
    names = ("stribeck_friction", "position_dependent_friction", "joint_spring", "cogging", "torque_offset")
    found = diagnose(ROBOT, traces, [EFFECTS[name] for name in names])
    assert found.selection.names == (("stribeck_friction",) if stuck else ())
    assert found.verdict == ("partly_explained" if stuck else "unexplained")
    if stuck:
        (friction,) = found.best.hypothesis.terms
        np.testing.assert_allclose(friction.amplitude[:, 0], stuck, rtol=0.1)
        (said,) = (one for one in found.cannot_tell if one.code == "comes_again")
        assert said.pitch_m == pytest.approx(0.06, rel=0.01)
