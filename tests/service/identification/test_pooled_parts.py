"""The plain model's parts, each against least squares done the long way or just inside and just outside of its rule."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from schemas.axes_description import Axes
from schemas.errors import DataError
from service.identification import folds, pooled
from service.identification.pooled import Plain
from service.model.parameters import Quantity
from tests.service.subject import (
    Band,
    Base,
    DecoupledAxes,
    Fit,
    Hypothesis,
    Problem,
    Recording,
    Segment,
    Split,
    evaluate,
)
from tests.service.world import BASE, ROBOT, course, direction, problem, stub

PERIOD, WIDTH, NOISE = 4e-3, 0.1, 0.05
NAMES = ("inertia_1", "inertia_2", "offset_1", "offset_2", "gravity_sin_1", "gravity_cos_1",
         "f_v_1", "f_v_2", "f_c_1", "f_c_2")  # fmt: skip
TRUTH = np.array([0.4, 0.2, 0.3, 0.0, 3.0, -1.2, 0.8, 0.5, 1.5, 1.0])
AXES = Axes.model_validate({"name": "two", "kind": "axes", "axis": [{}, {"gravity": False}]})


def logs(truth: np.ndarray = TRUTH, widths: tuple[float, float] = (WIDTH, WIDTH), count: int = 3) -> Problem:
    """Two axes of which one weighs, 4 s a log, with white noise."""
    recordings = []
    for number in range(count):
        random = np.random.default_rng(number)
        time = np.arange(1000) * PERIOD
        rate, phase = random.uniform(2, 12, (3, 2)), random.uniform(0, 6, (3, 2))
        wave = time[:, None, None] * rate + phase
        q, v, a = (0.4 * np.sum((1j * rate) ** n * np.exp(1j * wave), axis=1).imag for n in range(3))
        columns = [a, np.ones_like(a), v, np.stack([direction(v, w)[:, j] for j, w in enumerate(widths)], axis=1)]
        torque = np.stack(columns, axis=1) * truth[[[0, 1], [2, 3], [6, 7], [8, 9]]]
        torque = torque.sum(axis=1)
        torque[:, 0] += truth[4] * np.sin(q[:, 0]) + truth[5] * np.cos(q[:, 0])
        torque += NOISE * random.standard_normal(torque.shape)
        segment = Segment(np.arange(1000), time, PERIOD, q, v, a, torque, np.abs(v) > 0.02)
        recordings.append(Recording(segment, DecoupledAxes(np.ones(2), None, (0,)), number, f"log_{number}"))
    band = Band.of(PERIOD)
    return Problem.of(recordings, band, np.array([1.0, 2.0]) * NOISE * band.white_share**0.5)


def linear(problem: Problem, wanted: np.ndarray | None = None) -> Fit:
    """Where nothing is told yet but how friction turns over."""
    base = Base(np.zeros(6), np.zeros(2), np.zeros(2), np.full(2, WIDTH), wanted=wanted)
    return evaluate(problem, Hypothesis(base, timed=False))


def columns_of(problem: Problem) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """What the ten parameters multiply and the torque, (R, 10) and (R,) a log, in units of the noise."""
    fitted = linear(problem)
    return [tangent[:, :10] for tangent in fitted.tangents], fitted.residuals


def solved(columns: list[np.ndarray], target: list[np.ndarray]) -> np.ndarray:
    return np.linalg.lstsq(np.concatenate(columns), np.concatenate(target), rcond=None)[0]


def found(monkeypatch: pytest.MonkeyPatch, made: Problem, wanted: np.ndarray | None = None) -> Plain:
    monkeypatch.setattr(pooled, "_base", lambda problem: linear(problem, wanted))
    return pooled.fit(made, np.full(2, NOISE), AXES)


def test_it_is_least_squares_with_every_block_and_every_log_left_out_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    made = logs()
    result = found(monkeypatch, made)
    columns, target = columns_of(made)
    values = solved(columns, target)
    np.testing.assert_allclose(result.values, values, rtol=1e-7)
    np.testing.assert_allclose(values, TRUTH, atol=0.02)
    assert [estimate.name for estimate in result.estimates] == list(NAMES)
    assert {estimate.verdict for estimate in result.estimates} == {"identifiable"}
    without = []
    split = Split.of(made)
    for block in range(split.blocks):
        kept = [b != block for b in split.block]
        without.append(solved([c[k] for c, k in zip(columns, kept, strict=True)],
                              [t[k] for t, k in zip(target, kept, strict=True)]))  # fmt: skip
    blocks = len(without)
    error = np.sqrt((blocks - 1) ** 2 / blocks * np.var(without, axis=0, ddof=1))
    np.testing.assert_allclose([estimate.std_error for estimate in result.estimates], error, rtol=1e-5)

    def rms(log: int, values: np.ndarray) -> np.ndarray:
        joint, left = made.joints_of_rows[log], target[log] - columns[log] @ values
        return np.array([made.sigma[j] * np.sqrt(np.mean(left[joint == j] ** 2)) for j in range(2)])

    for log in range(3):
        others = solved([c for k, c in enumerate(columns) if k != log], [t for k, t in enumerate(target) if k != log])
        np.testing.assert_allclose(result.without[log], others, rtol=1e-6)
        np.testing.assert_allclose(result.held_out[log], rms(log, others), rtol=1e-6)
        np.testing.assert_allclose(result.alone[log], rms(log, solved([columns[log]], [target[log]])), rtol=1e-6)
        np.testing.assert_allclose(result.residual[log], rms(log, values), rtol=1e-6)
        np.testing.assert_allclose(result.torque[log], rms(log, 0 * values), rtol=1e-6)
    above = np.mean(result.held_out**2, axis=0) - made.sigma**2
    np.testing.assert_allclose(result.model_error, np.sqrt(np.maximum(above, 0.0)), rtol=1e-9)


def test_how_loud_the_noise_is_said_to_be_moves_neither_values_nor_their_errors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As blocks tell the errors. So loud that no block holds any information to speak of."""
    made = logs()
    expected, loud = found(monkeypatch, made), Problem.of(made.recordings, made.band, 1e5 * made.sigma)
    result = found(monkeypatch, loud)
    np.testing.assert_allclose(result.values, expected.values, rtol=1e-6)
    for one, other in zip(result.estimates, expected.estimates, strict=True):
        assert one.std_error == pytest.approx(other.std_error, rel=1e-4)


def test_one_log_is_held_against_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    made = logs(count=1)
    result = found(monkeypatch, made)
    assert np.isnan(result.held_out).tolist() == [[True, True]]
    np.testing.assert_array_equal(result.alone, result.residual)
    np.testing.assert_array_equal(result.without, [result.values])
    above = result.residual[0] ** 2 - made.sigma**2
    np.testing.assert_allclose(result.model_error, np.sqrt(np.maximum(above, 0.0)))


@pytest.mark.parametrize("less", [[7], [6, 7], [0, 7]])
def test_what_would_be_less_than_there_can_be_stands_at_its_least(
    monkeypatch: pytest.MonkeyPatch, less: list[int]
) -> None:
    """And the others are what the torque asks for without it; a load or a weight may well be negative."""
    truth = TRUTH.copy()
    truth[less] = [-0.06, -0.03][: len(less)]
    made = logs(truth)
    result = found(monkeypatch, made)
    columns, target = columns_of(made)
    rest = np.delete(np.arange(10), less)
    np.testing.assert_allclose(result.values[rest], solved([c[:, rest] for c in columns], target), rtol=1e-6)
    for place in less:
        estimate = result.estimates[place]
        assert (estimate.value, estimate.std_error, estimate.verdict) == (0.0, 0.0, "not identifiable")
        assert estimate.reason == "the best fit to these logs is below its physical limit; 0 assumed"


def test_what_data_left_out_do_not_want_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    made = logs()
    result = found(monkeypatch, made, np.array([True, True, True, True, False, False]))
    columns, target = columns_of(made)
    rest = [0, 1, 2, 3, 6, 7, 8, 9]
    np.testing.assert_allclose(result.values[rest], solved([c[:, rest] for c in columns], target), rtol=1e-6)
    for estimate in result.estimates[4:6]:
        assert (estimate.value, estimate.verdict) == (0.0, "not identifiable")
        assert estimate.reason == "held-out data are predicted equally well without it; 0 assumed"


def test_what_slow_logs_leave_open_of_a_delta_stands_as_described(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = [course(seed, 2.0, 0.3, 0.8, 1.6) for seed in (1, 2)]
    torques = [run.torque + 10.0 * np.random.default_rng(k).standard_normal((2000, 3)) for k, run in enumerate(runs)]
    made = problem(runs, torques, 10.0)
    fitted = evaluate(made, Hypothesis(BASE, timed=False))
    monkeypatch.setattr(pooled, "_base", lambda problem: fitted)
    result = pooled.fit(made, np.ones(3), ROBOT)
    held = np.flatnonzero([estimate.std_error == 0.0 for estimate in result.estimates])
    assert held.tolist() == [0, 2, 3, 4]
    assert [result.estimates[k].reason[:26] for k in held] == ["these logs determine it on"] * 2 + [
        "the best fit to these logs"
    ] * 2
    assert result.values[held].tolist() == [1.0, ROBOT.mass.passive_link, 0.0, 0.0]
    columns = [tangent[:, :9] for tangent in fitted.tangents]
    known = np.concatenate([BASE.rigid, BASE.viscous, BASE.coulomb])
    rest = np.delete(np.arange(9), held)
    target = [
        residual + column @ known - column[:, held] @ result.values[held]
        for residual, column in zip(fitted.residuals, columns, strict=True)
    ]
    np.testing.assert_allclose(result.values[rest], solved([c[:, rest] for c in columns], target), rtol=1e-6)


def test_a_delta_whose_forearms_would_weigh_less_than_nothing_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    run = course(1, 2.0)
    forearm = problem([run], [run.torque]).recordings[0].rigid.columns[..., 2]
    noise = 0.1 * np.random.default_rng(0).standard_normal((2000, 3))
    made = problem([run], [run.torque - 0.8 * forearm + noise], 0.1)
    fitted = evaluate(made, Hypothesis(BASE, timed=False))
    monkeypatch.setattr(pooled, "_base", lambda problem: fitted)
    estimate = pooled.fit(made, np.ones(3), ROBOT).estimates[2]
    assert (estimate.value, estimate.reason) == (
        0.0,
        "the best fit to these logs is below its physical limit; 0 assumed",
    )


def test_of_parameters_that_do_not_show_none_are_told_and_of_two_alike_one_is_held() -> None:
    """As near to where they stand as can be; and how much of each column the others do not explain."""
    random = np.random.default_rng(3)
    columns = random.standard_normal((80, 4)) * [1e-3, 1.0, 1e3, 1.0]
    columns[:, 3] = columns[:, 1] + 0.1 * random.standard_normal(80)
    gram = columns.T @ columns
    share = []
    for k in range(4):
        others = np.delete(columns, k, axis=1)
        left = columns[:, k] - others @ np.linalg.lstsq(others, columns[:, k], rcond=None)[0]
        share.append(left @ left / (columns[:, k] @ columns[:, k]))
    np.testing.assert_allclose(pooled._tolerance(gram, np.zeros(4, bool)), share, rtol=1e-6)
    alone = pooled._tolerance(gram, np.array([False, True, False, False]))
    assert alone[1] == 1.0
    assert alone[3] > 0.9
    blind = np.column_stack([columns[:, :2], np.zeros(80), columns[:, 1]])
    target, nominal = random.standard_normal(80), np.array([2.0, 3.0, 4.0, 5.0])
    values = pooled._solve(blind.T @ blind, blind.T @ target, np.zeros(4, bool), nominal)
    assert values[2] == 4.0
    assert values[3] - 5.0 == pytest.approx(values[1] - 3.0)
    np.testing.assert_allclose(blind @ values, blind @ np.linalg.lstsq(blind, target, rcond=None)[0], rtol=1e-6)
    np.testing.assert_array_equal(pooled._solve(gram, columns.T @ target, np.ones(4, bool), nominal), nominal)


@pytest.mark.parametrize(
    ("held", "reason", "relative", "verdict", "why"),
    [
        (True, "joint 2 never moves", 0.0, "not identifiable", "joint 2 never moves; 2.5 assumed"),
        (False, "joint 2 never reverses", 0.01, "not identifiable", "joint 2 never reverses"),
        (False, "", 0.51, "not identifiable", "determined only to 51 %"),
        (False, "", 0.49, "weak", "determined only to 49 %: log more motion that excites it"),
        (False, "", 0.11, "weak", "determined only to 11 %: log more motion that excites it"),
        (False, "", 0.09, "identifiable", "near zero; its error is small beside the torque"),
    ],
)
def test_a_verdict(held: bool, reason: str, relative: float, verdict: str, why: str) -> None:
    made = pooled._estimate(Quantity("f_c_2", "N m"), 2.5, 0.3, relative, held, reason)
    assert (made.name, made.unit, made.value, made.std_error) == ("f_c_2", "N m", 2.5, 0.0 if held else 0.3)
    assert (made.verdict, made.reason) == (verdict, why)
    assert pooled._estimate(Quantity("f_c_2", "N m"), 2.5, 0.2, 0.08, False, "").reason == ""


def test_an_error_is_held_against_the_nominal_value_or_a_twentieth_of_the_torque() -> None:
    """Of the torque in the rows where the parameter acts; what acts nowhere is held against one."""
    tangent = np.array([[2.0, 0.0, 0.0], [2.0, 3.0, 0.0], [2.0, 4.0, 0.0]])
    made = stub(target=[np.array([9.0, 1.0, 3.0])], select=lambda index, values: values)
    base = Base(np.zeros(1), np.zeros(1), np.zeros(1))
    fitted: Any = stub(tangents=[tangent], hypothesis=Hypothesis(base, timed=False))
    scale = pooled._scale(made, fitted, np.full(3, np.nan))
    np.testing.assert_allclose(scale, [0.05 * np.sqrt(91.0 / 12.0), 0.05 * np.sqrt(10.0 / 25.0), 1.0])
    assert pooled._scale(made, fitted, np.array([7.0, np.nan, 0.0]))[[0, 2]].tolist() == [7.0, 1e-12]


@pytest.mark.parametrize(
    ("gain", "scatter", "wants"), [(1.02, 0.1, True), (0.98, 0.1, False), (5.0, 9.0, True), (5.0, 12.0, False)]
)
def test_data_left_out_want_what_gains_a_hundredth_and_not_by_chance(
    monkeypatch: pytest.MonkeyPatch, gain: float, scatter: float, wants: bool
) -> None:
    """Of 100 a block without it; 3 standard errors over 36 blocks."""
    asked = []

    def holding(columns: np.ndarray, values: np.ndarray) -> str:
        asked.append((columns.tolist(), values.tolist()))
        return "without"

    loss = {"with": 100.0 - gain + np.tile([scatter, -scatter], 18), "without": np.full(36, 100.0)}
    monkeypatch.setattr(pooled, "held_out", lambda fitted, split: fitted)
    monkeypatch.setattr(pooled, "block_loss", lambda fitted, split: loss["without" if fitted == "without" else "with"])
    fitted: Any = stub(holding=holding)
    assert pooled._wants(fitted, stub(), np.array([4, 5])) is wants
    assert asked == [([4, 5], [0.0, 0.0])]


@pytest.mark.parametrize(
    ("needless", "kept"),
    [((), None), (("d",), [True, True, True, False]), (("b", "c"), [True, False, False, True])],
)
def test_a_group_that_is_not_wanted_is_out_as_a_whole(
    monkeypatch: pytest.MonkeyPatch, needless: tuple[str, ...], kept: list[bool] | None
) -> None:
    mechanism = stub(own_transitions=True, coefficients=dict.fromkeys("abcd"), optional=[("b", "c"), ("d",)])
    first = stub(hypothesis=Hypothesis(Base(np.array([1.0, 2.0, 3.0, 4.0]), np.ones(1), np.ones(1))))
    monkeypatch.setattr(pooled, "start", lambda problem: first.hypothesis)
    monkeypatch.setattr(pooled.solver, "fit", lambda problem, hypothesis: stub(hypothesis=hypothesis))
    monkeypatch.setattr(pooled, "_turning", lambda problem, fitted: fitted)
    monkeypatch.setattr(pooled.Split, "of", lambda problem: None)
    monkeypatch.setattr(pooled, "_wants", lambda fitted, split, columns: "abcd"[columns[0]] not in needless)
    base = pooled._still(stub(recordings=[stub(mechanism=mechanism)])).hypothesis.base
    if kept is None:
        assert base.wanted is None
    else:
        assert base.wanted is not None
        assert base.wanted.tolist() == kept
        np.testing.assert_array_equal(base.rigid, np.where(kept, [1.0, 2.0, 3.0, 4.0], 0.0))


@pytest.mark.parametrize(("share", "timed"), [(0.94, False), (0.96, True)])
def test_a_timing_that_does_harm_on_data_left_out_is_held(
    monkeypatch: pytest.MonkeyPatch, share: float, timed: bool
) -> None:
    loss = {False: np.full(4, 100.0 * share), True: np.full(4, 100.0)}
    monkeypatch.setattr(pooled, "_still", lambda problem: stub(hypothesis=Hypothesis(BASE, timed=False)))
    monkeypatch.setattr(pooled.solver, "fit", lambda problem, hypothesis: stub(hypothesis=hypothesis))
    monkeypatch.setattr(pooled.Split, "fair", lambda problem, fitted: None)
    monkeypatch.setattr(pooled, "held_out", lambda fitted, split: fitted.hypothesis.timed)
    monkeypatch.setattr(pooled, "block_loss", lambda fitted, split: loss[fitted])
    assert pooled._base(stub()).hypothesis.timed is timed


def test_without_what_they_share_with_the_timing_parameters_are_those_fitted_beside_it() -> None:
    made = logs()
    rigid, viscous, coulomb = np.split(TRUTH, [6, 8])
    base = Base(rigid, viscous, coulomb, np.full(2, WIDTH))
    fitted = evaluate(made, Hypothesis(base))
    beside = solved([tangent[:, [*range(10), 12]] for tangent in fitted.tangents], fitted.residuals)
    assert abs(beside[10]) > 1e-6
    apart = [tangent[:, :10] for tangent in pooled._timing_apart(fitted).tangents]
    np.testing.assert_allclose(solved(apart, fitted.residuals), beside[:10], rtol=1e-9)
    still = evaluate(made, Hypothesis(base, timed=False))
    assert pooled._timing_apart(still) is still


@pytest.mark.parametrize(("widths", "tried"), [((0.045, 0.13), [0.04, 0.15]), ((0.35, 0.045), [0.4, 0.04])])
def test_each_friction_goes_on_from_the_width_that_suits_it(
    monkeypatch: pytest.MonkeyPatch, widths: tuple[float, float], tried: list[float]
) -> None:
    """Of those tried, the nearest; kept if the fit from there is better."""
    made = logs(widths=widths, count=1)
    fitted = linear(made)
    fitted = replace(fitted, hypothesis=replace(fitted.hypothesis, base=replace(
        fitted.hypothesis.base, transition=np.full(2, 0.002))))  # fmt: skip
    for cost, taken in ((-1.0, True), (1.0, False)):
        monkeypatch.setattr(
            pooled.solver, "fit", lambda _, asked, more=cost: stub(hypothesis=asked, cost=fitted.cost + more)
        )
        found = pooled._turning(made, fitted)
        assert (found is not fitted) is taken
        if taken:
            assert np.array_equal(found.hypothesis.base.transition, tried)


def test_of_logs_that_ask_for_several_widths_all_rows_count_by_their_square(monkeypatch: pytest.MonkeyPatch) -> None:
    """What each width leaves of all logs together; by their levels the second axis would turn at
    0.04, and by the loudest of them the first at 0.15."""
    each = [logs(widths=(width, width), count=4) for width in (0.02, 0.03, 0.3, 0.05)]
    made = replace(each[0], recordings=[one.recordings[number] for number, one in enumerate(each)])
    made = Problem.of(made.recordings, made.band, made.sigma)
    left, fits = [], []
    for width in (0.002, *pooled.WIDER_TRANSITIONS):
        base = replace(linear(made).hypothesis.base, transition=np.full(2, width))
        fits.append(fitted := evaluate(made, Hypothesis(base, timed=False)))
        columns = [tangent[:, :10] for tangent in fitted.tangents]
        values = solved(columns, fitted.residuals)
        rest = np.concatenate([r - c @ values for r, c in zip(fitted.residuals, columns, strict=True)])
        joints = np.concatenate(made.joints_of_rows)
        left.append([np.sum(rest[joints == joint] ** 2) for joint in range(2)])
    best = np.array([0.002, *pooled.WIDER_TRANSITIONS])[np.argmin(left, axis=0)]
    assert best.tolist() == [0.04, 0.15]
    monkeypatch.setattr(pooled.solver, "fit", lambda _, asked: stub(hypothesis=asked, cost=-1.0))
    np.testing.assert_array_equal(pooled._turning(made, fits[0]).hypothesis.base.transition, best)


def test_ripple_is_followed_as_far_as_its_strongest_orders_at_the_middle_speed() -> None:
    """A motor behind a gear of 10, half a turn a second backwards; the four strongest of joint 1's six orders."""
    period, time = 1e-3, np.arange(10_000) * 1e-3
    theta = -2 * np.pi * 0.05 * time[:, None] * [1.0, 1.0]
    ripple = sum(size * np.sin(2 * np.pi * order * 0.5 * time) for order, size in
                 ((1, 5.0), (3, 4.0), (7, 3.0), (16, 2.0), (40, 1.0), (60, 0.9)))  # fmt: skip
    noise = 0.01 * np.random.default_rng(0).standard_normal((10_000, 2))
    for moving, hz in ((np.ones(10_000, bool), 1.3 * 16.0 * 0.5), (time < 0.1, 0.0)):
        segment = stub(theta=theta, period=period, moving=np.stack([moving, moving], axis=1))
        recording: Any = stub(segment=segment, mechanism=stub(gear_ratio=np.full(2, 10.0)))
        above = np.stack([ripple, 0 * time], axis=1) + noise
        assert pooled._ripple_hz([recording], [above]) == pytest.approx(hz, rel=0.02)


@pytest.mark.parametrize("longer", [1.019, 1.021])
def test_logs_of_several_rates_are_refused_by_name(monkeypatch: pytest.MonkeyPatch, longer: float) -> None:
    def go_on(segments: object) -> float:
        raise StopIteration

    monkeypatch.setattr(pooled, "resolved_hz", go_on)
    recordings: Any = [stub(segment=stub(period=1e-3), name="a"), stub(segment=stub(period=1e-3 * longer), name="b")]
    if longer < 1.02:
        with pytest.raises(StopIteration):
            pooled.problem_of(recordings)
    else:
        with pytest.raises(
            DataError, match=r"b: 1\.02 ms between samples, a has 1 ms: give logs with the same sample rate"
        ):
            pooled.problem_of(recordings)


def test_the_noise_is_read_from_what_a_first_fit_leaves() -> None:
    made = logs()
    again, noise = pooled.problem_of(made.recordings)
    np.testing.assert_allclose(noise.sample, NOISE, rtol=0.2)
    np.testing.assert_array_equal(again.sigma, noise.band)
    np.testing.assert_allclose(noise.band, NOISE * again.band.white_share**0.5, rtol=0.25)


@pytest.mark.parametrize("count", [2, 3])
def test_a_log_a_fold_or_four_stretches_and_half_a_second_a_block(count: int) -> None:
    made = logs(count=count)
    split, length = Split.of(made), round(0.5 / (PERIOD * made.band.step))
    total, done, first = sum(len(rows) for rows in made.rows), 0, 0
    for number, rows in enumerate(made.rows):
        place = rows.T.nonzero()[1]
        fold = np.full(len(place), number) if count == 3 else (done + place) * 4 // total
        np.testing.assert_array_equal(split.fold[number], fold)
        np.testing.assert_array_equal(split.block[number], first + place // length)
        done, first = done + len(rows), first + -(-len(rows) // length)
    assert (split.folds, split.blocks) == ({2: 4, 3: 3}[count], first)


@pytest.mark.parametrize(
    ("count", "uneven", "mixed"), [(3, 0.98, False), (3, 1.02, True), (4, 0.98, False), (4, 1.02, True)]
)
def test_folds_are_mixed_where_one_log_left_out_tells_the_others_too_much(
    count: int, uneven: float, mixed: bool
) -> None:
    """Two parameters that each log tells alike, one log more than the others: how far the answer moves without each log
    in turn, over how far it moves where all tell as much."""
    made = logs(count=count)

    def moves(share: float) -> float:
        return share / (1 - share) + (count - 1) ** 2 * (1 - share) / (count - 2 + share) / (count - 1)

    limit = uneven * folds.UNEVEN * count / (count - 1)
    share: Any = brentq(lambda share: moves(share) - limit, 1 / count, 0.999)
    tangents = []
    for number, rows in enumerate(made.joints_of_rows):
        tangent = np.zeros((len(rows), 2))
        tangent[::2, 0] = tangent[1::2, 1] = 1.0
        tangents.append(tangent * np.sqrt((share if not number else (1 - share) / (count - 1)) / tangent.sum(axis=0)))
    split = Split.fair(made, stub(moving=tangents, residuals=[np.zeros(len(one)) for one in tangents]))
    assert np.array_equal(split.fold[1], Split.of(made, mixed=mixed).fold[1])
    assert len(np.unique(np.concatenate(split.fold))) == split.folds


@pytest.mark.parametrize("mixed", [False, True])
def test_rows_of_the_analysis_band_are_folds_and_blocks_by_their_time(mixed: bool) -> None:
    """Of logs at 1 kHz, whose last block is one row; mixed, a second of each log in turn."""
    runs = [course(seed, 2.005) for seed in (1, 2, 3)]
    made = problem(runs, [run.torque for run in runs])
    step, split = made.band.period * made.band.step, Split.of(made, mixed=mixed)
    assert len(made.rows[0]) % round(0.5 / step) == 1
    for number, rows in enumerate(made.rows):
        time = rows.T.nonzero()[1] * step
        second = np.floor(time + 1e-9).astype(int)
        np.testing.assert_array_equal(split.fold[number], (number + second) % 4 if mixed else number)
        np.testing.assert_array_equal(split.block[number], 5 * number + np.floor(time / 0.5 + 1e-9))
    assert (split.folds, split.blocks) == (4 if mixed else 3, 15)
