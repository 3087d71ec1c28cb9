"""The sums of a log, against products over its samples."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from schemas.robot import Robot
from schemas.trace import Trace
from service.identification.regression import BLOCK, ONE_COLUMN, information, selection, summarise, target
from service.model.dynamics import FOREARM, GRAVITY, INERTIA, PAYLOAD, PLATFORM, torque_terms
from service.model.nominal import pack
from service.model.signals import EDGE, lowpass

PERIOD = 1e-3


def test_sums_are_products_of_what_parameters_multiply_over_moving_samples(
    robot: Robot, record: Callable[..., Trace]
) -> None:
    """Half a second a block, both ends left out: inertia, gravity, forearm, speed, its sign, the platform, a kilogram
    at rest, the torques and one; all but the one low-passed."""
    trace = record(5, seconds=3.3)
    log = summarise(pack(robot), trace)
    (recording,) = log.recordings
    segment = recording.segment
    terms = torque_terms(pack(robot), segment.theta, segment.theta_dot, segment.theta_ddot)
    still = torque_terms(pack(robot), segment.theta, 0.0 * segment.theta, 0.0 * segment.theta)
    columns = np.stack([
        terms[:, INERTIA], terms[:, GRAVITY], terms[:, FOREARM], segment.theta_dot, np.sign(segment.theta_dot),
        terms[:, PLATFORM], still[:, PAYLOAD], *(np.tile(trace.torque[:, [j]], 3) for j in range(3)),
    ], axis=-1)  # fmt: skip
    columns = np.concatenate([lowpass(columns, PERIOD), np.ones((*segment.theta.shape, 1))], axis=-1)
    edge = round(EDGE / PERIOD)
    bounds = edge + np.linspace(0, len(columns) - 2 * edge, 7).astype(int)
    assert (len(columns) - 2 * edge) * PERIOD / 6 == pytest.approx(BLOCK, abs=0.04)
    assert log.gram.shape == (6, 3, 11, 11)
    for block in range(6):
        rows = np.arange(len(columns))
        inside = (rows >= bounds[block]) & (rows < bounds[block + 1])
        for joint in range(3):
            mine = columns[inside & segment.moving[:, joint], joint]
            expected = PERIOD * mine.T @ mine
            scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
            np.testing.assert_allclose(log.gram[block, joint] / scale, expected / scale, atol=1e-6)
            assert log.seconds[block, joint] == pytest.approx(PERIOD * len(mine))
    np.testing.assert_array_equal(log.seconds, log.gram[..., ONE_COLUMN, ONE_COLUMN])
    assert (log.name, log.commanded) == ("log_5.csv", False)


def test_information_is_that_of_all_joints_together() -> None:
    columns = np.random.default_rng(0).standard_normal((3, 40, 11))
    found = information(np.einsum("jna,jnc->jac", columns, columns))
    places = [[0, 1, 2, 3 + joint, 6 + joint] for joint in range(3)]
    expected = np.zeros((9, 9))
    for joint, place in enumerate(places):
        expected[np.ix_(place, place)] += columns[joint, :, :5].T @ columns[joint, :, :5]
        np.testing.assert_array_equal(selection(joint).nonzero(), (range(5), place))
        np.testing.assert_array_equal(target(joint), np.eye(11)[7 + joint] - np.eye(11)[5])
    np.testing.assert_allclose(found, expected)
