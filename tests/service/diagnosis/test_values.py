"""Values given discrepancies, against generalised least squares with the whole covariance matrix."""

from __future__ import annotations

import numpy as np
import pytest

from service.diagnosis.evidence.values import Valued, separable
from service.diagnosis.fit.selection import Scored, Selection, score
from service.identification.correlated import Correlated
from tests.service.diagnosis.test_null import SPRING, disturbance, logs, on
from tests.service.subject import Hypothesis, Problem, Split, fit
from tests.service.world import BASE

PRIOR = np.array([3.0, 0.2])


def weights(seed: int, rows: int) -> np.ndarray:
    """(rows, 2) of torques that nothing in the motion shows."""
    return np.stack([disturbance(seed, rows), disturbance(seed + 100, rows)], axis=1)


@pytest.fixture(scope="module")
def found() -> tuple[Problem, Scored, Correlated]:
    """Logs with a spring and waves on its joint, of which the discrepancy knows."""
    made = logs("joint_spring", lambda run, seed: on(0, weights(seed, len(run.torque)) @ [0.7, -0.4]))
    best = score(fit(made, Hypothesis(BASE, (SPRING,))), Split.of(made))
    columns = []
    for number, recording in enumerate(made.recordings):
        waves = weights((1, 2, 3)[number], len(recording.segment.torque))
        columns.append(made.select(number, made.band(waves[:, None] * np.eye(3)[0][:, None])))
    return made, best, Correlated(columns, PRIOR)


def valued_of(made: Problem, best: Scored, noise: Correlated) -> Valued:
    return Valued.of(made, Split.of(made), Selection(best, best, [], {}, noise=noise))


def left(rows: np.ndarray, torque: np.ndarray, columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    """What generalised least squares on `rows` leaves of `target` on all."""
    covariance = np.eye(rows.sum()) + columns[rows] @ np.diag(1.0 / PRIOR) @ columns[rows].T
    weighed = np.linalg.solve(covariance, torque[rows])
    return target - torque @ np.linalg.solve(weighed.T @ torque[rows], weighed.T @ target[rows])


def test_values_and_held_out_residuals_by_the_whole_covariance_matrix(found):
    made, best, noise = found
    split = Split.of(made)
    valued = valued_of(made, best, noise)
    torque, target = np.concatenate(valued.best.fitted.tangents), np.concatenate(valued.best.fitted.residuals)
    columns, fold = np.concatenate(noise.columns), np.concatenate(split.fold)
    told = np.linalg.norm(torque, axis=0) > 0
    whole = left(np.ones(len(fold), bool), torque[:, told], columns, target)
    np.testing.assert_allclose(whole, target, atol=0.05)  # its optimum
    for number in range(split.folds):
        one = left(fold != number, torque[:, told], columns, target)[fold == number]
        np.testing.assert_allclose(np.concatenate(valued.best.residuals)[fold == number], one, atol=0.05)


def test_a_spring_has_its_values_where_waves_on_its_joint_are_known(found):
    made, best, noise = found
    valued = valued_of(made, best, noise)
    clean = fit(logs("joint_spring"), Hypothesis(BASE, (SPRING,))).hypothesis.terms[0].amplitude
    assert np.abs(valued.best.hypothesis.terms[0].amplitude / clean - 1.0).max() < 0.02
    assert np.abs(best.hypothesis.terms[0].amplitude / clean - 1.0).max() > 0.1
    np.testing.assert_array_less(np.abs(valued.best.hypothesis.terms[0].amplitude - clean)[0], 3.0 * valued.errors[-2:])


def test_what_a_discrepancy_explains_is_not_separable_and_is_fitted_without_it(found):
    made, best, _ = found
    spring = [tangent[:, [-2]] for tangent in best.fitted.tangents]
    own = separable(best.fitted, Correlated(spring, np.ones(1)))
    assert not own[-2]
    assert own[-1]
    same = Correlated(spring, np.full(1, 1e-6))
    valued = valued_of(made, best, same)
    np.testing.assert_allclose(valued.best.hypothesis.terms[0].amplitude, best.hypothesis.terms[0].amplitude, rtol=0.02)
