"""The belt's pitch and direction, from forces in closed form at the simulated mechanism."""

from __future__ import annotations

import numpy as np
import pytest

from service.diagnosis.discrepancies.discrepancy import Seen
from service.diagnosis.discrepancies.toothed_belt import ToothedBelt
from tests.service.diagnosis.test_accepted import platform
from tests.service.subject import Hypothesis, evaluate
from tests.service.world import BASE, at_joints, course, problem

RUNS, SIGMA = [course(seed, 4.0) for seed in (1, 2, 3)], 0.2


def belt(angles: np.ndarray, pitch: float, heading: float) -> np.ndarray:
    """(N, 3) N m: the platform drags a toothed belt along `heading`, rad, in the base's plane."""
    along = np.array([np.cos(heading), np.sin(heading), 0.0])
    size = 8.0 * np.sin(2 * np.pi * platform(angles) @ along / pitch + 0.7)
    return at_joints((angles, angles, angles), size[:, None] * along)


@pytest.mark.parametrize(("pitch", "heading"), [(0.06, 1.57), (0.035, 1.57), (0.05, 0.4), (0.08, 2.4)])
def test_a_belt_of_any_pitch_and_direction_is_found_and_explained(pitch, heading):
    noise = np.random.default_rng(3)
    torques = [run.torque + belt(run.motion[0], pitch, heading) for run in RUNS]
    made = problem(RUNS, [torque + SIGMA * noise.standard_normal(torque.shape) for torque in torques], SIGMA)
    plain = evaluate(made, Hypothesis(BASE))
    found = ToothedBelt().process(Seen.of(made, Hypothesis(BASE), made.sigma), 0)
    assert found.pitch == pytest.approx(pitch, rel=0.02)
    left, torque = np.concatenate(plain.residuals), np.concatenate(found.columns)
    assert torque.shape == (len(left), 6)
    after = left - torque @ np.linalg.lstsq(torque, left, rcond=None)[0]
    assert after @ after - made.count < 0.1 * (left @ left - made.count)
