"""The solver against SciPy's, and fits from a start that is far off."""

from __future__ import annotations

import weakref
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from service.identification.fit import within
from tests.service.injected import INJECTED, reports
from tests.service.subject import EFFECTS, Fit, Hypothesis, Parameters, evaluate, fit, predict, solve
from tests.service.world import BASE, COULOMB, VISCOUS, course, problem


def test_normal_equations_are_least_squares_whatever_the_units():
    random = np.random.default_rng(0)
    columns = random.standard_normal((60, 5)) * [1e-6, 1.0, 1e4, 3.0, 1.0]
    target = random.standard_normal((60, 2))
    expected = np.linalg.lstsq(columns, target, rcond=None)[0]
    np.testing.assert_allclose(solve(columns.T @ columns, columns.T @ target), expected, rtol=1e-8)
    np.testing.assert_allclose(solve(columns.T @ columns, columns.T @ target[:, 0]), expected[:, 0], rtol=1e-8)


def test_directions_without_information_stay_at_zero():
    random = np.random.default_rng(1)
    columns = random.standard_normal((60, 3))
    columns = np.column_stack([columns, columns[:, 0], np.zeros(60)])
    target = random.standard_normal(60)
    found = solve(columns.T @ columns, columns.T @ target)
    np.testing.assert_allclose(found, np.linalg.lstsq(columns, target, rcond=None)[0], atol=1e-9)
    assert found[4] == 0.0
    assert found[0] == pytest.approx(found[3])


def test_what_rounding_leaves_beside_a_column_without_information_is_none():
    """As in a Gram matrix of which one was subtracted that holds all there is of the last two."""
    told = np.diag([10210.6, 27.0, 3e-4])
    gram = np.zeros((5, 5))
    gram[:3, :3], gram[3:, :3], gram[3, 4] = told, 7e-13, 7.6e-14
    gram = np.maximum(gram, gram.T)
    found = solve(gram, np.array([27724.6, 3.0, 1e-3, 5e-12, -4e-12]))
    np.testing.assert_allclose(found, [27724.6 / 10210.6, 3.0 / 27.0, 1e-3 / 3e-4, 0.0, 0.0], rtol=1e-9)


@pytest.mark.parametrize("seed", range(40))
def test_a_step_within_limits_is_the_best_there_is_whatever_the_units(seed: int):
    """Correlated columns, limits on either side of zero, some of no width, torque from 1e-8 to 1e8."""
    random = np.random.default_rng(seed)
    count, size = int(random.integers(2, 7)), 10.0 ** random.uniform(-8.0, 8.0)
    columns = random.standard_normal((60, count)) @ (np.eye(count) + 0.7 * random.standard_normal((count, count)))
    target = columns @ random.standard_normal(count) + 0.3 * random.standard_normal(60)
    low = random.uniform(-1.5, 0.5, count) + (seed % 4 == 0) * 3.0 * np.sign(random.standard_normal(count))
    high = low + np.where(random.random(count) < 0.15, 0.0, random.uniform(0.1, 2.0, count))
    unit = 10.0 ** random.uniform(-4.0, 4.0, count)
    scaled = columns * unit
    found = within(scaled.T @ scaled, scaled.T @ target * size, low * size / unit, high * size / unit)
    best = lsq_linear(columns, target, (low, np.maximum(high, low + 1e-9)), method="bvls", tol=1e-15).x
    np.testing.assert_allclose(found * unit / size, best, atol=1e-7)
    assert (found >= low * size / unit).all()
    assert (found <= high * size / unit).all()


@pytest.mark.parametrize("unit", [1.0, 1e-4, 1e8])
def test_what_was_held_and_would_come_back_is_let_go(unit):
    """Of two alike, both leave their limits; with the first held the second is well inside. The third stands alone."""
    random = np.random.default_rng(0)
    columns = np.linalg.qr(random.standard_normal((50, 3)))[0]
    columns[:, 1] = 0.9 * columns[:, 0] + 0.19**0.5 * columns[:, 1]
    target = columns @ [2.0, -1.2, 0.5]
    scale = np.array([1.0, unit, 1.0])
    low, high = np.array([-1.0, -1.0, -9.0]), np.array([1.0, 1.0, 0.4])
    found = within((columns * scale).T @ (columns * scale), (columns * scale).T @ target, low / scale, high / scale)
    np.testing.assert_allclose(found * scale, lsq_linear(columns, target, (low, high), tol=1e-12).x, atol=1e-6)
    np.testing.assert_allclose(found * scale, [1.0, -0.3, 0.4], atol=1e-9)


def test_many_steps_at_once_are_those_of_each():
    """Columns that are correlated, one of them empty: some steps are free, some held, some held and let go."""
    random = np.random.default_rng(5)
    columns = random.standard_normal((2, 30, 50, 5)) @ (np.eye(5) + 0.8 * random.standard_normal((2, 30, 5, 5)))
    columns[..., 3] = 0.0
    target = random.standard_normal((2, 30, 50))
    gram = np.swapaxes(columns, -2, -1) @ columns
    moment = (np.swapaxes(columns, -2, -1) @ target[..., None])[..., 0]
    low = np.where(random.random((30, 5)) < 0.5, -0.01, -np.inf)
    high = np.full(5, 0.02)
    found = within(gram, moment, low, high)
    every = [[within(gram[i, j], moment[i, j], low[j], high) for j in range(30)] for i in range(2)]
    np.testing.assert_allclose(found, every, atol=1e-12)
    some = [0, 1, 2, 4]
    for i, j in np.ndindex(2, 30):
        best = lsq_linear(columns[i, j][:, some], target[i, j], (low[j, some], high[some]), tol=1e-12)
        np.testing.assert_allclose(found[i, j, some], best.x, atol=1e-6)
    assert 0.1 < np.mean((found == low) | (found == high)) < 0.9
    assert (found[..., 3] == 0.0).all()


@pytest.mark.parametrize("reach", [10.0, 0.3])
def test_one_step_is_least_squares_of_what_moves_within_reach_and_the_next_is_none(reach):
    """Two recordings; the last parameter is rough and stays. reach: of each parameter, either way."""
    random = np.random.default_rng(3)
    columns = [random.standard_normal((40, 4)) @ (np.eye(4) + 0.4 * random.standard_normal((4, 4))) for _ in range(2)]
    target = [c @ [1.0, -0.2, 0.1, 0.5] + 0.1 * random.standard_normal(40) for c in columns]
    free, far = np.array([True, True, True, False]), np.full(4, reach)
    begun = Fit(Hypothesis(BASE), target, columns, np.ones(4, bool), free, (-far, far))
    step, left = begun.stepped()
    moving, wanted = np.concatenate(columns)[:, :3], np.concatenate(target)
    best = lsq_linear(moving, wanted, (-reach, reach), method="bvls", tol=1e-15).x
    np.testing.assert_allclose(step, best, atol=1e-7)
    np.testing.assert_allclose(np.concatenate(left.residuals), wanted - moving @ best, atol=1e-6)
    np.testing.assert_allclose(left.reach, [[*(-reach - best), -reach], [*(reach - best), reach]], atol=1e-7)
    np.testing.assert_allclose(left.stepped()[0], 0.0, atol=1e-7)


def test_a_fit_from_afar_ends_at_the_truth():
    runs = [course(seed, 2.0) for seed in (1, 2)]
    logs = problem(runs, [run.torque for run in runs])
    far = replace(BASE, rigid=np.zeros(3), viscous=np.zeros(3), coulomb=np.zeros(3), transition=0.01)
    found = fit(logs, Hypothesis(far))
    base = found.hypothesis.base
    np.testing.assert_allclose(base.rigid, BASE.rigid, rtol=1e-3)
    np.testing.assert_allclose(base.viscous, VISCOUS, rtol=0.01)
    np.testing.assert_allclose(base.coulomb, COULOMB, rtol=0.01)
    assert base.transition == pytest.approx(BASE.transition, rel=0.05)
    assert abs(base.timing) < 1e-5
    assert found.cost / logs.count < 1e-3
    assert fit(logs, Hypothesis(far), iterations=0).cost == evaluate(logs, Hypothesis(far)).cost


def test_residuals_are_target_less_prediction_in_units_of_the_noise():
    runs = [course(1, 2.0)]
    random = np.random.default_rng(0)
    noise = random.standard_normal((2000, 3))
    logs = replace(problem(runs, [runs[0].torque + noise]), sigma=np.array([0.1, 0.2, 0.5]))
    term = INJECTED["air_drag"].term("air_drag")
    hypothesis = Hypothesis(BASE, (term,))
    (scene,) = logs.scenes(Hypothesis(BASE))
    difference = logs.band(runs[0].torque + noise - predict(scene, hypothesis)) / [0.1, 0.2, 0.5]
    expected = np.concatenate([difference[logs.rows[0][:, j], j] for j in range(3)])
    found = evaluate(logs, hypothesis)
    np.testing.assert_allclose(found.residuals[0], expected, rtol=1e-8)
    assert found.cost == pytest.approx(float(expected @ expected))
    assert logs.count == len(expected) == int(logs.rows[0].sum())
    np.testing.assert_array_equal(logs.joints_of_rows[0], np.repeat([0, 1, 2], logs.rows[0].sum(axis=0)))
    weights = random.uniform(0.1, 1.0, logs.rows[0].shape)
    heavy = replace(logs, weights=[weights])
    mine = np.concatenate([weights[logs.rows[0][:, j], j] for j in range(3)])
    weighed = evaluate(heavy, hypothesis)
    np.testing.assert_allclose(weighed.residuals[0], mine * expected, rtol=1e-8)
    np.testing.assert_allclose(weighed.tangents[0], mine[:, None] * found.tangents[0], rtol=1e-8)
    assert heavy.count == round(float(mine @ mine))


def test_what_stands_at_a_limit_or_is_rough_does_not_move():
    runs = [course(1, 1.0)]
    logs = problem(runs, [runs[0].torque])
    stiff = EFFECTS["torque_filter"].nonlinear["cutoff"].high
    term = replace(INJECTED["torque_filter"].term("torque_filter"), nonlinear=(stiff,))
    found = evaluate(logs, Hypothesis(BASE, (term,)))
    assert found.inside.tolist() == [True] * 11 + [False]
    assert found.free.tolist() == found.inside.tolist()
    assert found.moving[0].shape[1] == 11
    parameters = Parameters(Hypothesis(BASE, (term,)))
    low, high = parameters.limits(logs.recordings[0].mechanism, 1e-3)
    assert (low[9], high[9]) == (2e-4, 2e-2)
    assert (low[10], high[10]) == (-2.5e-4, 2.5e-4)
    assert (low[11], high[11]) == (0.3, 300.0)
    assert low[:9].tolist() == [0.0] * 9
    assert np.isinf(high[:9]).all()


def test_a_filter_is_fitted_up_to_its_limit_and_no_further():
    run = course(1, 2.0)
    logs = problem([run], [run.torque])  # no filter at all: the best one is the fastest there is
    term = replace(INJECTED["torque_filter"].term("torque_filter"), nonlinear=(120.0,))
    found = fit(logs, Hypothesis(replace(BASE, timing=0.0), (term,)))
    assert found.hypothesis.terms[0].nonlinear[0] <= 300.0
    low = problem([run], [reports("torque_filter", 1, 2.0)])
    nonlinear = fit(low, Hypothesis(BASE, (term,))).hypothesis.terms[0].nonlinear[0]
    assert nonlinear == pytest.approx(35.0, rel=1e-2)


def test_of_many_fits_the_tangents_of_a_few_are_kept_and_all_have_theirs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those asked for last; the others come again as they were."""
    run = course(1, 1.0)
    made = problem([run], [run.torque])
    hypotheses = [Hypothesis(replace(BASE, timing=timing)) for timing in (0.0, 1e-4, 2e-4, 3e-4, 4e-4)]
    size = sum(tangent.nbytes for tangent in evaluate(made, hypotheses[0]).tangents)
    monkeypatch.setattr("service.identification.fit.KEPT", 3 * size)
    fits = [evaluate(made, hypothesis) for hypothesis in hypotheses]
    first = [tangent.copy() for tangent in fits[0].tangents]
    held = [weakref.ref(fitted.tangents[0]) for fitted in fits]
    assert sum(ref() is not None for ref in held) == 3
    for one, other in zip(first, fits[0].tangents, strict=True):
        np.testing.assert_array_equal(one, other)
    assert fits[0].tangents[0] is fits[0].tangents[0], "kept again"
    assert len(fits[1].tangents) == len(made.recordings)


@pytest.mark.parametrize("effect", ["torque_delay", "torque_filter", "torque_scale"])
def test_what_is_kept_of_a_recording_is_never_that_of_another_report(effect: str) -> None:
    """Slopes of the torque by what was reported before and after, against finite differences of the prediction."""
    run = course(1, 1.0)
    made = problem([run], [run.torque])
    term = INJECTED[effect].term(effect)
    hypotheses = [Hypothesis(BASE), Hypothesis(BASE, (term,)), Hypothesis(BASE)]
    if term.nonlinear:
        hypotheses.insert(2, Hypothesis(BASE, (replace(term, nonlinear=(1.5 * term.nonlinear[0],)),)))
    for hypothesis in hypotheses:
        parameters = Parameters(hypothesis)
        start = parameters.values[parameters.free]
        for index in (0, 4):  # rho_1, viscous friction of joint 2
            step = 1e-4 * (np.arange(len(start)) == index)
            above, below = (evaluate(made, parameters.at(start + way * step)).residuals[0] for way in (1, -1))
            slope = evaluate(made, hypothesis).tangents[0][:, index]
            np.testing.assert_allclose(slope, (below - above) / 2e-4, atol=1e-6 * np.abs(slope).max())
