"""The paper's method: its grid against a search over the samples, its means against a known robot."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from schemas.robot import Robot
from schemas.trace import Trace
from service.identification import paper_method
from service.identification.from_traces import identify
from service.identification.pooled import ParameterEstimate, Plain
from service.identification.regression import summarise
from service.model.dynamics import torque_terms
from service.model.nominal import pack
from service.model.signals import lowpass, smooth
from tests.service.identification.conftest import Truth

Record = Callable[..., Trace]


def test_grid_is_the_minimum_over_the_samples(robot: Robot, record: Record) -> None:
    trace = record(4, Truth(noise=0.5))
    rho_1, rho_2 = paper_method.grid(paper_method.six_sums(summarise(pack(robot), trace).gram.sum(axis=0)))

    terms = torque_terms(pack(robot), *smooth(trace.position, 1e-3))
    columns = [lowpass(part, 1e-3)[100:-100].ravel() for part in (terms[:, 0], terms[:, 1], trace.torque - terms[:, 2])]

    def rms(first: float, second: float) -> float:
        return float(np.sqrt(np.mean((columns[2] - first * columns[0] - second * columns[1]) ** 2)))

    least = rms(rho_1, rho_2)
    step = 2e-3
    around = [rms(rho_1 + i * step, rho_2 + j * step) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    assert least <= min(around) * (1 + 1e-9)


def test_literal_takes_every_sample_and_the_raw_torque(robot: Robot, record: Record) -> None:
    """Against least squares written out over the samples, rests and all."""
    trace = record(4, Truth(noise=0.5))
    values, errors = paper_method.literal(pack(robot), [trace])
    theta, theta_dot, theta_ddot = smooth(trace.position, 1e-3)
    terms = torque_terms(pack(robot), theta, theta_dot, theta_ddot)
    left = trace.torque - terms[:, 2]
    columns = np.stack([terms[:, 0].ravel(), terms[:, 1].ravel()], axis=1)
    rho = np.linalg.lstsq(columns, left.ravel(), rcond=None)[0]
    assert np.allclose(values[:2], rho, atol=3e-4)  # the grid's step is 2.5e-4
    left = left - values[0] * terms[:, 0] - values[1] * terms[:, 1]
    for joint in range(3):
        phi = np.stack([theta_dot[:, joint], np.sign(theta_dot[:, joint])], axis=1)
        friction = np.linalg.lstsq(phi, left[:, joint], rcond=None)[0]
        assert np.allclose(values[[3 + joint, 6 + joint]], friction, atol=1e-8)
    assert np.isnan(errors).all()  # one trajectory has no spread
    filtered = paper_method.means([summarise(pack(robot), trace)])[0]
    assert not np.allclose(filtered[:2], values[:2], atol=1e-3)


def test_means_without_forearm_and_friction_are_the_truth(robot: Robot, record: Record) -> None:
    truth = Truth(forearm=0.0, viscous=np.zeros(3), coulomb=np.zeros(3), noise=0.1)
    logs = [summarise(pack(robot), record(seed, truth)) for seed in range(4)]
    values, errors = paper_method.means(logs)
    assert np.allclose(values, truth.values, atol=0.01)
    assert np.all(np.abs(values - truth.values)[:2] < 5 * errors[:2] + 1e-4)


def test_grid_soaks_up_what_the_model_lacks(robot: Robot, record: Record) -> None:
    """With friction and forearm in the torque the paper's rho are off where the pooled ones are not."""
    truth = Truth()
    logs = [summarise(pack(robot), record(seed, truth)) for seed in range(4)]
    paper_fit = identify(robot, logs, "paper")
    pooled_fit = identify(robot, logs)
    assert paper_fit.robot.identified is not None
    assert paper_fit.robot.identified.method == "paper"
    assert paper_fit.robot.identified.forearm_inertia_kg.value == 0.0
    assert abs(paper_fit.fit.values[0] - truth.rho_1) > 10 * abs(pooled_fit.fit.values[0] - truth.rho_1)
    assert np.all(paper_fit.fit.held_out > pooled_fit.fit.held_out)


def test_a_grid_whose_edge_is_hit_is_widened_and_says_so(robot: Robot, record: Record) -> None:
    """An inertia seven times, and a gravity eleven times, what the description says."""
    truth = Truth(rho_1=7.0, rho_2=11.0, forearm=0.0, viscous=np.zeros(3), coulomb=np.zeros(3), noise=0.1)
    trajectory = summarise(pack(robot), record(4, truth))
    assert np.allclose(paper_method.means([trajectory])[0][:2], [7.0, 11.0], atol=0.01)
    warnings = paper_method.edges([trajectory])
    assert [re.match(r"log_4\.csv: (rho_\d) = ", line)[1] for line in warnings] == ["rho_1", "rho_2"]  # pyright: ignore[reportOptionalSubscript]
    assert paper_method.edges([summarise(pack(robot), record(4))]) == []


def test_a_motion_that_asks_for_less_than_no_inertia_is_named(robot: Robot, record: Record) -> None:
    trajectory = summarise(pack(robot), record(4, Truth(rho_1=-0.5)))
    (warning,) = paper_method.edges([trajectory])
    assert warning.startswith("log_4.csv: rho_1 is at the grid's lower limit, 0")


def test_a_verdict_is_weak_at_best_where_trajectories_disagree_or_there_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    estimates = tuple(ParameterEstimate(f"p{k}", "", 9.0, 9.0, "identifiable") for k in range(8))
    estimates += (ParameterEstimate("p8", "", 9.0, 9.0, "not identifiable", "rests"),)
    errors = np.array([0.19, 0.21, 0.0, np.nan, 0.1, 0.1, 0.1, 0.1, 0.1])
    monkeypatch.setattr(paper_method, "means", lambda logs: (np.full(9, float(len(logs) - 4)), errors))
    monkeypatch.setattr(paper_method, "rms_residual", lambda log, values: np.full(3, log * values[0]))
    known: Any = {
        name: None for name in ("problem", "fitted", "noise", "residual", "torque", "without", "alone", "runs")
    }
    fit = Plain(estimates=estimates, held_out=np.zeros((1, 3)), **known)
    logs: Any = [5.0, 7.0]
    found = paper_method.refit(logs, fit)
    assert [(one.verdict, one.reason) for one in found.estimates] == [
        ("identifiable", ""), ("weak", "the trajectories disagree"),
        ("not identifiable", "two point masses in the paper's model"),
        ("weak", "one trajectory only: the spread is unknown"), *[("identifiable", "")] * 4,
        ("not identifiable", "rests"),
    ]  # fmt: skip
    single = paper_method.refit(logs[:1], fit)
    assert (found.estimates[4].value, single.estimates[4].value) == (-2.0, -3.0)
    assert single.estimates[3].std_error == 0.0
    assert single.held_out is fit.held_out
    np.testing.assert_array_equal(single.residual, [[-15.0] * 3])
    np.testing.assert_array_equal(found.residual, [[-10.0] * 3, [-14.0] * 3])
    np.testing.assert_array_equal(found.held_out, [[-15.0] * 3, [-21.0] * 3])


def test_a_trajectory_in_which_a_joint_rests_has_no_say_in_its_mean() -> None:
    values, errors = paper_method._average([np.array(each) for each in ([1.0, np.nan], [3.0, 2.0], [5.0, np.nan])])
    assert values.tolist() == [3.0, 2.0]
    np.testing.assert_allclose(errors, [2.0 / 3**0.5, np.nan])
