"""What the catalogue explains is named together with a disturbance that it does not hold, and nothing else is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.simulated.plant.mujoco_delta import Design, build, close
from drivers.trace import read_trace
from service.diagnosis.evidence.accepted import _furthest
from service.diagnosis.pipeline import diagnose
from tests.service.diagnosis.logs import ROBOT, record, swing
from tests.service.diagnosis.test_null import disturbance
from tests.service.subject import EFFECTS
from tests.service.world import PERIOD, TRUTH, at_joints


def platform(angles: np.ndarray) -> np.ndarray:
    """(N, 3) m, by the simulated mechanism."""
    mechanism = build(Design(TRUTH), PERIOD)
    return close(mechanism, angles)[:, mechanism.platform]


def hose(angles: np.ndarray) -> np.ndarray:
    """(N, 3) N m: a hose that is too short pulls at the platform, hard where its slack is used up. angles: rad."""
    line = np.array([0.1, 0.2, -0.33]) - platform(angles)
    length = np.linalg.norm(line, axis=1, keepdims=True)
    return at_joints((angles, angles, angles), line / length * 80.0 * np.maximum(length - 0.42, 0.0))


def belt(angles: np.ndarray) -> np.ndarray:
    """(N, 3) N m: the platform drags a toothed belt of 60 mm pitch."""
    size = 8.0 * np.sin(2 * np.pi * platform(angles)[:, 1] / 0.06 + 0.7)
    return at_joints((angles, angles, angles), size[:, None] * [0.0, 1.0, 0.0])


def waves(angles: np.ndarray) -> np.ndarray:
    """(N, 3) N m on the third joint, that nothing in the motion shows."""
    return disturbance(round(1e3 * abs(float(angles[-1, 0]))), len(angles))[:, None] * [0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("ratios", "place"),
    [
        ([], None),
        ([99.0, 40.0], None),
        ([99.0, 101.0, 300.0], 2),  # by how far it is over its null, not by what it explains
        ([np.inf, 101.0], 1),  # what has no null only where no other is accepted
        ([np.inf, 99.0], 0),
        ([99.0, np.inf], None),  # and where it explains most
    ],
)
def test_what_is_added_is_furthest_over_its_null(ratios, place):
    """Of models that explain most first; 100 times are accepted."""
    assert _furthest(ratios) == place


HOSE = ("stribeck_friction", "joint_spring", "hose_spring", "torque_offset")
BELT = ("stribeck_friction", "position_dependent_friction", "joint_spring", "cogging", "torque_offset")


def found_with(tmp_path, added, names, stuck):
    """What is found in three runs with `added` and `stuck` N m of breakaway friction."""
    traces = []
    for seed in (1, 2, 3):
        trace = read_trace(record(tmp_path / f"run_{seed}.csv", ROBOT, swing(seed), 5.0, seed, stuck), ROBOT)
        traces.append(replace(trace, torque=trace.torque + added(trace.position)))
    return diagnose(ROBOT, traces, [EFFECTS[name] for name in names])


@pytest.mark.parametrize("stuck", [2.5, 0.0])
@pytest.mark.parametrize(("added", "names"), [(hose, HOSE), (belt, BELT)])
def test_friction_is_named_together_with_a_disturbance_and_nothing_else(tmp_path, added, names, stuck):
    """Where there is none, nothing is named."""
    found = found_with(tmp_path, added, names, stuck)
    assert found.selection.names == (("stribeck_friction",) if stuck else ())
    assert found.verdict == ("partly_explained" if stuck else "unexplained")
    assert all(friction.joints == (0, 1, 2) for friction in found.best.hypothesis.terms)
    assert sum(len(r) for r in found.after) == found.problem.count == sum(len(r) for r in found.before)


def test_friction_is_found_together_with_a_disturbance_on_another_joint(tmp_path):
    found = found_with(tmp_path, waves, ("stribeck_friction", "torque_scale", "hose_spring"), 2.5)
    assert found.selection.names == ("stribeck_friction",)
    assert found.verdict == "partly_explained"
    (friction,) = found.best.hypothesis.terms
    np.testing.assert_allclose(friction.amplitude[:2, 0], 2.5, rtol=0.1)


@pytest.mark.parametrize(("added", "names"), [(hose, HOSE), (belt, BELT)])
def test_the_friction_has_its_value_together_with_a_disturbance(tmp_path, added, names):
    """All of it: what falls with speed, Coulomb's and the viscous part. And the gap that is claimed is the model's."""
    found = found_with(tmp_path, added, names, 2.5)
    (friction,) = found.best.hypothesis.terms
    np.testing.assert_allclose(friction.amplitude[:, 0], 2.5, rtol=0.1)
    np.testing.assert_allclose(found.best.hypothesis.base.coulomb, 3.0, rtol=0.1)
    np.testing.assert_allclose(found.best.hypothesis.base.viscous, 0.8, rtol=0.1)
    left = (sum(r @ r for r in found.after) / found.best.fitted.cost) ** 0.5
    assert left == pytest.approx(1.0, abs=0.1)
    pitches = [one.pitch_m for one in found.cannot_tell if one.code == "comes_again"]
    assert pitches == ([pytest.approx(0.06, rel=0.01)] if added is belt else [])
