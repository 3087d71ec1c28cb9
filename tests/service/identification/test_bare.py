"""The base model where nothing is looked for beside it: what it takes from a log and what it leaves alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.trace import read_trace
from schemas.axes_description import Axes, load_axes
from schemas.trace import Trace
from service.identification import bare
from service.identification.fit import Problem, evaluate, fit
from service.identification.folds import gains
from service.identification.joint_machines import identify_axes
from service.identification.pooled import Identification
from service.model.mechanism import DecoupledAxes
from service.model.prediction import FULL, error_in_band, motion, predict_along
from service.model.signals import lowpass
from tests.service import arm
from tests.service.sines import sines

PERIOD, SECONDS = 4e-3, 10.0
INERTIA, VISCOUS, COULOMB = 0.3, 0.6, 1.5


def axes(count: int) -> Axes:
    return Axes.model_validate({"name": "bench", "kind": "axes", "axis": [{"gravity": False}] * count})


def log(seed: int, late: float = 0.0, width: float = 0.002, noise: float = 0.02, count: int = 1) -> Trace:
    """Axes whose torque is `late` s behind the position; friction of each turns over `width` rad/s."""
    time = np.arange(round(SECONDS / PERIOD)) * PERIOD
    parts = ((1.1, 0.2), (0.3, 0.8), (0.08, 2.3))
    position = sines(seed, time, parts)[0]
    _, speed, acceleration = sines(seed, time - late, parts)
    torque = INERTIA * acceleration + VISCOUS * speed + COULOMB * np.tanh(speed / width)
    torque += np.random.default_rng(seed).normal(0, noise, torque.shape)
    return Trace(Path(f"log_{seed}.csv"), time, position[:, :count], torque[:, :count])


def identified(*logs: Trace) -> Identification[Axes]:
    found = identify_axes(axes(logs[0].position.shape[1]), logs)
    assert isinstance(found.robot, Axes)
    return Identification(found.robot, found.fit, found.warnings)


@pytest.mark.parametrize("late", [0.011, -0.006])
def test_a_delay_of_whole_samples_bends_no_parameter(late: float) -> None:
    result = identified(log(1, late), log(2, late), log(3, late))
    found = result.robot.identified
    assert found is not None
    assert found.torque_timing_s == pytest.approx(late, abs=2e-4)
    assert found.inertia.value[0] == pytest.approx(INERTIA, rel=0.01)
    assert found.coulomb_friction.value[0] == pytest.approx(COULOMB, rel=0.01)
    older = "torque" if late > 0 else "position"
    assert any(f"the {older} is" in line and "torque_timing_s" in line for line in result.warnings)


def test_friction_is_wide_where_data_left_out_want_it_and_narrow_elsewhere() -> None:
    for width, wide in ((0.2, True), (0.002, False)):
        found = identified(*(log(seed, width=width) for seed in range(3))).robot.identified
        assert found is not None
        assert isinstance(found.friction_transition, list)
        if wide:
            assert found.friction_transition[0] == pytest.approx(width, rel=0.05)
        else:
            assert found.friction_transition[0] <= bare.TRANSITION[1]
        assert found.coulomb_friction.value[0] == pytest.approx(COULOMB, rel=0.02)


def test_a_width_that_only_the_rows_fitted_like_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fit finds a wide friction; as data left out do no better by it, the narrow one stands."""
    plain = identified(*(log(seed, width=0.2) for seed in range(3))).fit
    wide = plain.fitted.hypothesis.base
    monkeypatch.setattr(bare, "gains", lambda lost, kept: False)
    narrow = bare.narrowed(plain.problem, plain.fitted).hypothesis.base
    assert np.asarray(wide.transition)[0] > 0.1
    assert np.asarray(narrow.transition)[0] == pytest.approx(bare.TRANSITION[1])
    assert narrow.widest is not None


def test_a_gain_counts_by_its_size_and_by_how_many_blocks_have_it() -> None:
    lost = np.full(20, 10.0)
    assert gains(lost, lost - 1.0)
    assert not gains(lost, lost - 0.05), "half a percent"
    one_block = lost - 30.0 * (np.arange(20) == 3) + 0.5
    assert not gains(lost, one_block)


def test_an_axis_weighs_by_what_is_left_on_it_not_by_its_noise() -> None:
    """Axis 2 is ten times as noisy as its floor says, as a model's own error makes it."""
    result = identified(*(log(seed, count=2) for seed in range(3)))
    problem, hypothesis = result.fit.problem, result.fit.fitted.hypothesis
    quiet = replace(problem, sigma=problem.sigma * [1.0, 0.1])
    weighed = bare.by_what_is_left(quiet, hypothesis)
    residuals = evaluate(weighed, hypothesis).residuals
    joints = np.concatenate(problem.joints_of_rows)
    each = [np.median(np.abs(np.concatenate(residuals)[joints == joint])) for joint in (0, 1)]
    assert each == pytest.approx([bare.NORMAL] * 2, rel=0.02)
    unweighed = evaluate(quiet, hypothesis).residuals
    assert np.median(np.abs(np.concatenate(unweighed)[joints == 1])) > 5.0 * bare.NORMAL


def test_a_stop_takes_no_weight_from_the_axis() -> None:
    """In one row of ten friction is anything, as near a stop: the axis weighs by what is left in motion."""
    result = identified(*(log(seed) for seed in range(3)))
    problem, hypothesis = result.fit.problem, result.fit.fitted.hypothesis
    still = [np.where(np.arange(len(t)) % 10 == 0, 50.0, 0.0)[:, None] for t in problem.target]
    stopped = replace(problem, target=[t + s for t, s in zip(problem.target, still, strict=True)])
    clean, beside = (bare.by_what_is_left(one, hypothesis).weights[0][0, 0] for one in (problem, stopped))
    assert beside == pytest.approx(clean, rel=0.25)


@pytest.mark.parametrize("better", [True, False])
def test_slow_rows_are_masked_where_all_are_predicted_better_without(
    better: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the slow rows say of friction is then not in the fit."""
    log_ = log(1)
    speed = np.gradient(log_.position, PERIOD, axis=0)
    slow = np.abs(speed) < 0.025 * np.sqrt(np.mean(speed**2))
    held = replace(log_, torque=log_.torque - 20.0 * np.sign(speed) * slow)
    monkeypatch.setattr(bare, "predicts", lambda lost, kept: False)
    plain = identified(held).fit
    monkeypatch.setattr(bare, "predicts", lambda lost, kept: better)
    problem = bare.by_what_is_left(plain.problem, plain.fitted.hypothesis)
    masked, fitted = bare.without_slow(problem, evaluate(problem, plain.fitted.hypothesis))
    rows = np.concatenate(masked.rows)
    assert rows.sum() < 0.99 * np.concatenate(problem.rows).sum() if better else masked is problem
    wrong, before = (abs(float(one.hypothesis.base.coulomb[0]) - COULOMB) for one in (fitted, plain.fitted))
    assert (wrong < 0.6 * before) == better


def test_the_model_is_cut_off_above_the_band_of_a_recorder() -> None:
    """One that filters torque and motion alike, there and back: friction's jumps are gone from its torque."""
    sharp, filtered = log(1), []
    for seed in range(3):
        one = log(seed)
        position, torque = (lowpass(values, PERIOD, 4.0) for values in (one.position, one.torque))
        filtered.append(replace(one, position=position, torque=torque))
    found, plain = (identified(*logs).robot for logs in (filtered, (sharp, log(2), log(3))))
    assert found.identified is not None
    assert plain.identified is not None
    assert plain.identified.torque_band_hz is None
    assert found.identified.torque_band_hz == pytest.approx(4.0, rel=0.4)
    along = motion(filtered[0])
    cut, whole = (predict_along(robot, filtered[0], along)[FULL] for robot in (found, plain))
    left = [np.nanstd(error_in_band(filtered[0], along, torque)) for torque in (cut, whole)]
    assert left[0] < 0.6 * left[1]


def test_axes_have_no_masses_to_be_drawn_to() -> None:
    problem: Problem = identified(*(log(seed) for seed in range(3))).fit.problem
    mechanism = problem.recordings[0].mechanism
    assert isinstance(mechanism, DecoupledAxes)
    assert mechanism.links.tolist() == [False] * len(mechanism.coefficients)


def test_errors_are_compared_where_the_encoder_tells_the_acceleration() -> None:
    """Of 4096 counts a turn the acceleration is noise above some hertz."""
    fine = log(1)
    coarse = replace(fine, position=np.round(fine.position / 1.5e-3) * 1.5e-3)
    assert motion(fine).band_hz == 40.0
    assert 3.0 <= motion(coarse).band_hz < 25.0


@pytest.mark.parametrize(
    ("share", "noise", "masses", "draws"), [(0.12, 1.5, 1.0, True), (0.12, 1.5, 4.0, False), (1.0, 0.0, 1.0, False)]
)
def test_masses_are_drawn_to_a_urdf_as_far_as_data_left_out_gain_by_it(tmp_path, share, noise, masses, draws) -> None:
    """Small motion in noise tells little of the masses: a right URDF is worth its prior, a wrong one is not. What large
    motion tells needs none."""
    pytest.importorskip("pinocchio")
    more = noise * np.random.default_rng(4).standard_normal((round(arm.SECONDS / arm.PERIOD), 3))
    logs = [read_trace(arm.record(tmp_path / f"log_{seed}.csv", seed, more, share=share)) for seed in range(2)]
    urdf = arm.URDF
    for kg in (4, 3, 1.5):
        urdf = urdf.replace(f'mass value="{kg}"', f'mass value="{masses * kg}"')
    robot = load_axes(arm.write(tmp_path, urdf))
    found = identify_axes(robot, logs).fit
    weighed = bare.by_what_is_left(found.problem, found.fitted.hypothesis)
    fitted = fit(weighed, found.fitted.hypothesis)
    assert (bare.drawn(weighed, fitted) > 0) == draws
