"""Reasons not to believe any name, each on a search made up for it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from drivers.simulated.plant.mujoco_delta import Design, build, required_torque
from schemas.diagnosis import Caution
from tests.service.injected import INJECTED
from tests.service.subject import EFFECTS, Hypothesis, Selection, Split, Term, cautions, evaluate, fit, selection
from tests.service.world import BASE, PERIOD, TRUTH, course, problem, stub

SEEDS = (1, 2)
LIMIT = 1.1
AWAY = np.array([0.48, -0.64, 0.6])  # where gravity pulls too


@pytest.fixture
def not_a_delta(monkeypatch):
    """Of a Delta the residual is opened as discrepancies, whatever its size."""
    monkeypatch.setattr("service.model.mechanism.Delta.described_whole", False)


def found(*terms: Term, left: float = 1.0, gap: float = 9.0, limit: float = LIMIT, **logs) -> list[Caution]:
    """Doubts about `terms` that leave `left` of a gap, both mean squares in units of the noise. limit: rms that passes
    for noise."""
    runs = [course(seed, 1.0) for seed in SEEDS]
    made = logs.get("logs") or problem(runs, [run.torque for run in runs])
    rows = made.count
    best = stub(hypothesis=Hypothesis(BASE, terms), loss=left * rows)
    none = stub(hypothesis=Hypothesis(BASE), loss=gap * rows)
    return cautions.doubts_of(made, Selection(none, best, [], {}), limit)


def term(name: str, joints: tuple[int, ...], *amplitude: float) -> Term:
    return Term(EFFECTS[name], joints, np.array(amplitude).reshape(max(1, len(joints)), -1), ())


@pytest.mark.parametrize(
    ("name", "ours", "beyond"),
    [("torque_scale", 0.49, -0.51), ("joint_offset", -0.29, 0.31), ("link_length_error", 0.071, -0.073)],
)
def test_an_effect_beyond_any_robots_is_doubted(name, ours, beyond):
    """A link's error is a share of its 0.36 m."""
    assert found(term(name, (1,), ours)) == []
    (doubt,) = found(term(name, (1,), beyond))
    assert (doubt.code, doubt.effect, doubt.joints) == ("beyond_any_robot", name, [2])
    assert doubt.advice == "check_description"


def test_several_arms_at_once_are_the_description():
    assert found(term("joint_offset", (0, 1), 0.04, 0.04)) == []
    assert found(term("joint_offset", (1,), 0.06)) == []
    (doubt,) = found(term("joint_offset", (0, 1), 0.01, -0.06))
    assert (doubt.code, doubt.joints) == ("several_arms", [1, 2])
    assert found(term("link_length_error", (0, 1), 0.0, 0.017)) == []
    (doubt,) = found(term("link_length_error", (0, 1), 0.0, 0.019))
    assert doubt.code == "several_arms"


def test_what_carries_over_is_no_accident():
    small = INJECTED["cogging"].term("cogging")
    assert found(small, left=4.0, gap=9.0) == []  # 62 % of the gap above the noise gone


def loud(scale: float):
    """Runs whose torque is not the robot's at all: another mass, seen as so much noise."""
    runs = [course(seed, 1.0) for seed in SEEDS]
    random = np.random.default_rng(0)
    wrong = [run.torque + scale * np.cumsum(random.standard_normal(run.torque.shape), axis=0) / 10 for run in runs]
    made = problem(runs, wrong)
    none = selection.score(fit(made, Hypothesis(BASE)), Split.of(made))
    return made, none


@pytest.mark.usefixtures("not_a_delta")
def test_what_is_left_of_a_wrong_description_is_told_as_a_share_of_the_torque():
    made, none = loud(20.0)
    doubt = cautions.doubts_of(made, Selection(none, none, [], {}), LIMIT)
    assert len(doubt) == 1
    # one joint's mean torque is no motion: what is left is held against the rest
    torque = np.concatenate([t[r] - t[r].mean() for t, r in zip(made.target, made.rows, strict=True)])
    share = np.sqrt(none.loss / made.count * np.mean(made.sigma**2) / np.mean(torque**2))
    if doubt[0].code == "much_is_left":
        assert doubt[0].share == pytest.approx(share, rel=0.01)
    else:
        assert doubt[0].code == "runs_differ"
    assert share > 0.10


def test_runs_of_several_robots_fit_alone_but_not_together():
    runs = [course(seed, 2.0) for seed in (*SEEDS, 3)]
    other = [scale * run.torque for run, scale in zip(runs, (1.0, 1.3, 0.8), strict=True)]
    random = np.random.default_rng(0)
    made = problem(runs, [torque + 0.3 * random.standard_normal(torque.shape) for torque in other])
    together = fit(made, Hypothesis(BASE))
    best = selection.score(together, Split.of(made))
    (doubt,) = cautions.doubts_of(made, Selection(best, best, [], {}), LIMIT)
    assert (doubt.code, doubt.advice) == ("runs_differ", "check_runs")
    alone = cautions._alone(made, Selection(best, best, [], {}))
    each = [
        replace(made, recordings=[r], target=[t], rows=[m])
        for r, t, m in zip(made.recordings, made.target, made.rows, strict=True)
    ]
    expected = sum(fit(part, Hypothesis(BASE)).cost for part in each) / made.count
    assert alone == pytest.approx(expected, rel=0.05)
    half = replace(made, weights=[np.full(rows.shape, 0.5) for rows in made.rows])
    assert cautions._alone(half, Selection(best, best, [], {})) == pytest.approx(alone, rel=1e-3)
    assert evaluate(made, Hypothesis(BASE)).cost > together.cost


@pytest.mark.parametrize(
    ("left", "gap", "alone", "told"),
    [(9.0, 20.9, 3.3, True), (9.0, 21.1, 3.3, False), (9.0, 14.0, 3.5, False), (3.99, 6.0, 1.0, False)],
)
def test_runs_differ_where_each_fits_alone(monkeypatch, left, gap, alone, told):
    """Seven tenths of what is above the noise, of twice the noise or more, and effects take no more than six."""
    monkeypatch.setattr(cautions, "_alone", lambda *_: alone)
    small = INJECTED["cogging"].term("cogging")
    codes = [one.code for one in found(small, left=left, gap=gap)]
    assert ("runs_differ" in codes) == told


@pytest.mark.parametrize(("limit", "told"), [(3.1, False), (2.9, True), (0.5, True)])
def test_what_passes_for_noise_is_no_reason_to_doubt(monkeypatch, limit, told):
    """Three times the noise is left; twice it at least has to be."""
    monkeypatch.setattr(cautions, "_alone", lambda *_: 1.0)
    assert [one.code for one in found(left=9.0, gap=9.0, limit=limit)] == ["runs_differ"] * told
    assert found(left=3.9, gap=9.0, limit=0.5) == []


def test_noise_is_no_reason_to_doubt():
    runs = [course(seed, 1.0) for seed in SEEDS]
    random = np.random.default_rng(0)
    made = problem(runs, [run.torque + 0.3 * random.standard_normal(run.torque.shape) for run in runs])
    best = selection.score(fit(made, Hypothesis(BASE)), Split.of(made))
    assert cautions.doubts_of(made, Selection(best, best, [], {}), LIMIT) == []


@pytest.mark.parametrize(("gap", "told"), [(3.0, True), (60.0, False)])
@pytest.mark.usefixtures("not_a_delta")
def test_a_good_stand_in_does_not_excuse_what_it_leaves_unless_that_is_little_of_the_gap(gap, told):
    """Effects that remove 80 % of a gap leave 12 % of the torque; the same of a gap of which 99 % is gone."""
    made, none = loud(20.0)
    left = none.loss / made.count
    small = INJECTED["cogging"].term("cogging")
    best = stub(hypothesis=Hypothesis(BASE, (small,)), loss=left * made.count)
    before = stub(hypothesis=Hypothesis(BASE), loss=gap * left * made.count)
    codes = [one.code for one in cautions.doubts_of(made, Selection(before, best, [], {}), LIMIT)]
    assert ("much_is_left" in codes) == told


RUNS = [course(seed, 1.0) for seed in SEEDS]


def hum(*hertz: float) -> list[np.ndarray]:
    """(N, 3) N m a run: of the joints, each at its own frequency."""
    return [np.sin(2 * np.pi * np.array(hertz) * run.time[:, None]) for run in RUNS]


STRANGER, OTHER = hum(3.0, 4.0, 5.0), hum(23.0, 27.0, 31.0)


@cache
def pulls() -> list[np.ndarray]:
    """(N, 3, 3) N m a run: MuJoCo's torques of a pull each way, per m/s^2."""

    def pulled(run, pull):
        mechanism = build(Design(TRUTH), PERIOD)
        mechanism.model.opt.gravity[:] += pull
        return required_torque(mechanism, *run.motion)

    return [np.stack([pulled(r, pull) - pulled(r, np.zeros(3)) for pull in np.eye(3)], axis=-1) for r in RUNS]


def leaning(size: float, stranger: float = 0.0, noise: float = 0.3, other: float = 0.0):
    """Logs of a robot that gravity pulls elsewhere too, `size` m/s^2, beside hums of `stranger` and `other` N m; the
    base model on them; the share of its gap that MuJoCo's torques of a pull each way leave."""
    random = np.random.default_rng(1)
    torques = [
        r.torque + size * way @ AWAY + stranger * one + other * two + noise * random.standard_normal(one.shape)
        for r, way, one, two in zip(RUNS, pulls(), STRANGER, OTHER, strict=True)
    ]
    made = problem(RUNS, torques, noise)
    none = selection.score(fit(made, Hypothesis(BASE)), Split.of(made))
    return made, none, (explaining(made, none, pulls()).loss - made.count) / (none.loss - made.count)


def explaining(made, none, torques):
    """The base model with figures for torques (N, 3, K) N m a run."""
    tangents = [
        np.hstack([tangent, made.select(number, made.band(torque))])
        for number, (tangent, torque) in enumerate(zip(none.fitted.tangents, torques, strict=True))
    ]
    columns, wanted = np.concatenate(tangents), np.concatenate(none.fitted.residuals)
    figures = np.linalg.lstsq(columns, wanted, rcond=None)[0]
    left = [r - t @ figures for r, t in zip(none.fitted.residuals, tangents, strict=True)]
    fitted = replace(none.fitted, residuals=left, tangents=tangents)
    return stub(loss=fitted.cost, fitted=fitted)


def gravity_of(made, none, left: float) -> list[Caution]:
    """Doubts where effects that are nothing but a gravity's stand-ins leave such a share of the gap."""
    loss = made.count + left * (none.loss - made.count)
    less = [(loss / none.fitted.cost) ** 0.5 * r for r in none.fitted.residuals]
    best = stub(loss=loss, fitted=replace(none.fitted, residuals=less))
    return cautions.base_doubts(made, [], [], none, best)


@pytest.mark.parametrize(("size", "told"), [(3.1, True), (2.9, False)])
def test_a_gravity_of_three_metres_more_is_no_mistake_of_mounting(size, told):
    made, none, rest = leaning(size)
    assert abs(rest) < 0.01
    doubts = gravity_of(made, none, 0.02)
    assert [one.code for one in doubts] == ["gravity"] * told
    if told:
        assert doubts[0].share == pytest.approx(1.0 - max(rest, 0.0), abs=0.01)
        assert doubts[0].advice == "check_description"
    assert gravity_of(made, none, 1.01) == [], "effects that do nothing stand in for nothing"


def test_gravity_is_blamed_where_it_does_as_well_as_effects():
    """But for a twentieth of the gap."""
    made, none, rest = leaning(6.0, stranger=3.0)
    assert 0.02 < rest < 0.5
    (doubt,) = gravity_of(made, none, rest - 0.03)
    assert doubt.share == pytest.approx(1.0 - rest, abs=0.03)
    assert gravity_of(made, none, rest - 0.08) == []
    made, none, rest = leaning(6.0, stranger=3.0, noise=6.0)
    assert none.loss < 20.0 * made.count, "no gap beside which the noise is nothing"
    assert len(gravity_of(made, none, rest - 0.03)) == 1
    assert gravity_of(made, none, rest - 0.08) == []


@pytest.mark.parametrize(
    ("left", "told", "other"), [(0.25, True, 0.0), (0.15, False, 0.0), (0.3, True, 3.0), (0.1, False, 3.0)]
)
def test_gravity_is_not_blamed_where_effects_leave_a_small_part_of_what_it_leaves(left, told, other):
    """A hose's spring that explains all is no direction of gravity that explains nearly all. What neither explains
    counts for none. left: of the hum that is the effects' own."""
    made, none, rest = leaning(6.0, stranger=0.8, other=other)
    assert (rest > 0.05) == (other > 0.0)
    own = 0.8 * (1.0 - left**0.5)
    effect = [6.0 * (way @ AWAY)[..., None] + own * one[..., None] for way, one in zip(pulls(), STRANGER, strict=True)]
    doubts = cautions.base_doubts(made, [], [], none, explaining(made, none, effect))
    assert [one.code for one in doubts] == ["gravity"] * told


def test_what_is_noise_is_as_good_as_another_noise():
    made, none, rest = leaning(6.0)
    assert abs(rest) < 0.01
    assert len(gravity_of(made, none, 0.0)) == 1


@pytest.mark.parametrize(("gap", "told"), [(79.0, True), (82.0, False)])
@pytest.mark.usefixtures("not_a_delta")
def test_what_leaves_a_twentieth_of_the_gap_above_the_noise_may_be_much_of_the_torque(gap, told):
    """Five times the noise, a fifth of the torque."""
    runs = [course(seed, 1.0) for seed in SEEDS]
    small = INJECTED["cogging"].term("cogging")
    doubts = found(small, left=5.0, gap=gap, logs=problem(runs, [run.torque for run in runs], 3.0))
    assert [one.code for one in doubts] == ["much_is_left"] * told
