"""The pooled fit on robots whose parameters are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from schemas.errors import DataError
from schemas.robot import Robot
from schemas.trace import Trace
from service.identification.from_traces import identify
from service.identification.pooled import Identification, Plain
from service.identification.regression import summarise
from service.model.nominal import pack
from tests.service.identification.conftest import Truth, multisine

Record = Callable[..., Trace]


def fit(robot: Robot, traces: list[Trace]) -> Plain:
    return identify(robot, [summarise(pack(robot), trace) for trace in traces]).fit


def test_truth_is_recovered_without_noise(robot: Robot, record: Record) -> None:
    truth = Truth(noise=0.0)
    result = fit(robot, [record(seed, truth) for seed in range(3)])
    assert np.allclose(result.values, truth.values, rtol=2e-3)
    assert {estimate.verdict for estimate in result.estimates} == {"identifiable"}


def late(robot: Robot, record: Record, torque: int, position: int, memory: float = 0.0) -> Identification[Robot]:
    """Every fifth of 5 kHz, torque and position old by so many times 0.2 ms. memory: s of the torque's noise."""
    traces = []
    for seed in range(3):
        fine = record(seed, Truth(noise=0.0), period=2e-4)
        keep = np.exp(-2e-4 / memory) if memory else 0.0
        white = 0.3 * (1.0 - keep**2) ** 0.5 * np.random.default_rng(seed).standard_normal(fine.torque.shape)
        fine = replace(fine, torque=fine.torque + lfilter([1.0], [1.0, -keep], white, axis=0))
        now, past, seen = (slice(5 - age, -age or None, 5) for age in (0, torque, position))
        traces.append(replace(fine, time=fine.time[now], position=fine.position[seen], torque=fine.torque[past],
                              flags=fine.flags[now]))  # fmt: skip
    return identify(robot, [summarise(pack(robot), trace) for trace in traces])


def test_a_timing_at_its_limit_is_said(robot: Robot, record: Record) -> None:
    (said,) = (line for line in late(robot, record, 3, 0).warnings if "older than" in line)
    assert said.startswith("the torque is 0.25 ms older than the position, 0.25 of a sample. This is the fit's limit")
    (said,) = (line for line in late(robot, record, 0, 3).warnings if "older than" in line)
    assert said.startswith("the position is 0.25 ms older than the torque")


def test_torque_of_another_instant_within_a_sample_is_told(robot: Robot, record: Record) -> None:
    truth, found = Truth(noise=0.3), late(robot, record, 1, 0)
    assert not any("older than" in line for line in found.warnings)
    assert found.robot.identified is not None
    assert found.robot.identified.torque_timing_s == pytest.approx(2e-4, abs=2e-5)
    np.testing.assert_allclose(found.fit.values, truth.values, rtol=0.02)


def test_torque_whose_noise_has_a_memory_went_through_a_filter_and_is_later(robot: Robot, record: Record) -> None:
    found = late(robot, record, 2, 0, memory=3e-3)
    assert not any("older than" in line for line in found.warnings)
    assert found.robot.identified is not None
    assert found.robot.identified.torque_timing_s == pytest.approx(4e-4, abs=2e-5)
    (said,) = (line for line in late(robot, record, 4, 0, memory=3e-3).warnings if "older than" in line)
    assert said.startswith("the torque is 0.5 ms older than the position, 0.5 of a sample. This is the fit's limit")


def test_standard_errors_cover_the_truth(robot: Robot, record: Record) -> None:
    """Over 20 data sets the errors in units of their standard error have to look like a standard normal variable."""
    truth = Truth(noise=1.0)
    scores = []
    for run in range(20):
        result = fit(robot, [record(1000 + 4 * run + k, truth, seconds=6.0) for k in range(4)])
        error = np.array([estimate.std_error for estimate in result.estimates])
        scores.append((result.values - truth.values) / error)
    scores = np.array(scores)  # 180 of them; 95 % inside 1.96 give 171 with a standard deviation of 2.9 at least
    assert 0.90 <= np.mean(np.abs(scores) < 1.96) <= 0.99
    assert np.all(np.abs(scores.mean(axis=0)) < 4 / np.sqrt(20))


def test_noise_is_that_of_the_torque(robot: Robot, record: Record) -> None:
    result = fit(robot, [record(seed, Truth(noise=0.7)) for seed in range(3)])
    assert np.allclose(result.noise, 0.7, rtol=0.05)


def test_residual_is_held_out_and_at_the_noise(robot: Robot, record: Record) -> None:
    result = fit(robot, [record(seed, Truth(noise=0.7)) for seed in range(4)])
    assert np.all(result.held_out > 0.99 * result.residual)
    assert np.allclose(result.held_out, result.noise_floor, rtol=0.15)


def test_4_khz_and_1_khz_agree(robot: Robot, record: Record) -> None:
    truth = Truth(noise=0.0)
    fine = fit(robot, [record(seed, truth, period=2.5e-4) for seed in range(3)])
    assert np.allclose(fine.values, truth.values, rtol=2e-3)


def test_a_joint_that_never_moves_has_no_friction(robot: Robot, record: Record) -> None:
    result = fit(robot, [record(seed, moves=(1.0, 0.0, 1.0)) for seed in range(3)])
    found = {estimate.name: estimate for estimate in result.estimates}
    for name in ("f_v_2", "f_c_2"):
        assert found[name].verdict == "not identifiable"
        assert found[name].reason.startswith("joint 2 never moves")
        assert found[name].value == 0.0
    assert found["f_c_1"].verdict == "identifiable"
    assert found["rho_1"].value == pytest.approx(1.9, abs=5 * found["rho_1"].std_error)


def test_a_joint_that_never_reverses_is_named(robot: Robot, record: Record) -> None:
    time = np.arange(8000)[:, None] * 1e-3
    logs = []
    for seed in range(3):
        theta, theta_dot, theta_ddot = multisine(seed, 8.0, 2.0, 1e-3)
        theta[:, 1:2] = 0.2 + 0.1 * time + 0.02 * np.sin(2 * time + seed)
        theta_dot[:, 1:2] = 0.1 + 0.04 * np.cos(2 * time + seed)
        theta_ddot[:, 1:2] = -0.08 * np.sin(2 * time + seed)
        logs.append(record(seed, motion=(theta, theta_dot, theta_ddot)))
    found = {estimate.name: estimate for estimate in fit(robot, logs).estimates}
    assert found["f_c_2"].verdict == "not identifiable"
    assert found["f_c_2"].reason == "joint 2 never reverses"
    assert found["f_c_1"].verdict == "identifiable"


def test_slow_motion_does_not_tell_inertia(robot: Robot, record: Record) -> None:
    rng = np.random.default_rng(5)
    logs = []
    for seed in range(3):
        time = np.arange(12_000)[:, None] * 1e-3
        w, phase = 2 * np.pi * rng.uniform(0.08, 0.15, 3), rng.uniform(0, 6, 3)
        motion = (
            0.5 + 0.3 * np.sin(w * time + phase),
            0.3 * w * np.cos(w * time + phase),
            -0.3 * w**2 * np.sin(w * time + phase),
        )
        logs.append(record(seed, Truth(noise=2.0), motion=motion))
    found = {estimate.name: estimate for estimate in fit(robot, logs).estimates}
    assert found["rho_1"].verdict != "identifiable"
    assert found["forearm_inertia_kg"].verdict == "not identifiable"
    assert found["forearm_inertia_kg"].value == robot.mass.passive_link  # the description's mass stands
    assert found["rho_2"].verdict == "identifiable"


def test_too_little_motion_is_an_error(robot: Robot, record: Record) -> None:
    with pytest.raises(DataError, match=r"log_1\.csv: too little motion"):
        fit(robot, [record(1, seconds=3.0)])


def test_angles_in_another_unit_are_told_where_the_range_does_not(robot: Robot, record: Record) -> None:
    """Half a degree to either side looks like half a radian; half a radian like half a degree."""
    logs = []
    for seed in range(2):
        theta, theta_dot, theta_ddot = multisine(seed, 8.0, 2.0, 1e-3)
        small = record(seed, motion=(0.02 * (theta - 0.5), 0.02 * theta_dot, 0.02 * theta_ddot))
        logs.append(replace(small, position=np.degrees(small.position)))
    with pytest.raises(DataError, match=r"the torque fits positions in degrees, not in rad \(residual \d+ % of that"):
        fit(robot, logs)
    still = [
        replace(log, position=np.radians(log.position)) for log in (record(seed, amplitude=1.0) for seed in range(2))
    ]
    with pytest.raises(DataError, match=r"no joint moves further than 0\.0\d+ rad: are positions in another unit"):
        fit(robot, still)


def test_where_neither_fits_the_unit_is_not_blamed(robot: Robot, record: Record) -> None:
    """Positions that jump untold are thousands of times too fast, and a 57th of that is less wrong."""
    rows, logs = np.r_[2000:6000, 500:4000], []
    for log in (record(seed) for seed in range(2)):
        position, torque = log.position[rows], log.torque[rows]
        logs.append(Trace(log.path, log.time[: len(rows)], position, torque, flags=log.flags[: len(rows)]))
    with pytest.raises(DataError, match=r"leaves \S+ times the torque unexplained"):
        fit(robot, logs)
