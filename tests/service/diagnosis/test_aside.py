"""What the catalogue explains is named beside something that it does not hold."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.plant.mechanism import Design, build, close
from drivers.trace import read_trace
from schemas.diagnosis import Caution
from service.diagnosis import diagnose as diagnosis
from service.diagnosis.diagnose import diagnose
from service.diagnosis.evidence import aside
from service.diagnosis.evidence.aside import WIDTH, Quiet
from tests.service.diagnosis.logs import ROBOT, record, swing
from tests.service.diagnosis.toy import left_out
from tests.service.subject import EFFECTS, Hypothesis, Regressors, Split, Term, added, evaluate, fit, selection
from tests.service.world import BASE, PERIOD, TRUTH, at_joints, course, problem, stub

JOINT = 2  # that the stranger sits on
SIGMA = 0.2  # N m, of the noise


def stranger(seed: int, rows: int) -> np.ndarray:
    """(rows,) N m, 6 rms: a torque that nothing in the motion tells, of 1 to 5 Hz."""
    rng = np.random.default_rng(seed)
    time = np.arange(rows) * PERIOD
    wave = np.sin(time[:, None] * 2 * np.pi * rng.uniform(1, 5, 6) + rng.uniform(0, 6, 6))
    return 6.0 * (2 / 6) ** 0.5 * wave.sum(axis=1)


def made(share: float = 1.0, offset: float = 0.0):
    """Logs of three runs with the stranger in the first `share` of each, and on the first joint a constant torque."""
    torques = []
    for seed in (1, 2, 3):
        run = course(seed, 2.0)
        torque = run.torque + SIGMA * np.random.default_rng(seed).standard_normal(run.torque.shape)
        early = round(share * len(torque))
        torque[:early, JOINT] += stranger(seed, len(torque))[:early]
        torque[:, 0] += offset
        torques.append(torque)
    return problem([course(seed, 2.0) for seed in (1, 2, 3)], torques, SIGMA)


def beside(logs, names=("torque_offset",)) -> Quiet:
    split, start = Split.of(logs), Hypothesis(BASE)
    regressors = Regressors(logs, split, [EFFECTS[name] for name in names], start)
    regressors.along(start)
    none = selection.score(fit(logs, start), split)
    return Quiet.beside(regressors, none, none, 0, lambda effect, joint: True, lambda _: None)


@pytest.fixture(scope="module")
def quiet():
    logs = made()
    return logs, beside(logs)


def test_a_joint_of_which_far_more_than_noise_is_left_weighs_next_to_nothing(quiet):
    logs, found = quiet
    weighs = [
        np.concatenate([w[r[:, j], j] for w, r in zip(found.problem.weights, logs.rows, strict=True)]) for j in range(3)
    ]
    assert np.mean(weighs[JOINT]) < 0.1
    assert np.mean(np.concatenate(weighs[:JOINT]) == 1.0) > 0.99
    assert found.problem.count == pytest.approx(sum(float((w**2).sum()) for w in weighs), abs=0.5)
    said = found.caution()
    assert (said.code, said.joints) == ("set_aside", [JOINT + 1])
    assert said.share == pytest.approx(1 - found.problem.count / logs.count, abs=1e-4)


def test_of_a_joint_without_rows_nothing_is_set_aside():
    logs = made()
    still = replace(logs, rows=[rows & [False, True, True] for rows in logs.rows])
    assert beside(still).caution().joints == [JOINT + 1]


def test_what_comes_and_goes_leaves_the_rest_of_its_joint_as_it_is():
    logs = made(share=0.3)
    found = beside(logs)
    edge = round(0.5 * WIDTH / (logs.band.period * logs.band.step)) + 4  # and what the band smears
    for weights, rows in zip(found.problem.weights, logs.rows, strict=True):
        at = np.flatnonzero(rows[:, JOINT])
        far = at - 0.3 * len(rows)
        assert np.mean(weights[at[far < -edge], JOINT] < 0.2) > 0.8  # but where it crosses zero
        assert np.mean(weights[at[far > edge], JOINT] == 1.0) > 0.99


def test_rows_that_an_effect_explains_weigh_in_full():
    """Ten times the noise on the first joint, which the catalogue holds, or does not."""
    logs = made(offset=10 * SIGMA)
    for names, explained in ((("torque_offset",), True), (("air_drag",), False)):
        first = [w[r[:, 0], 0] for w, r in zip(beside(logs, names).problem.weights, logs.rows, strict=True)]
        assert (np.mean(np.concatenate(first) == 1.0) > 0.9) == explained


@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("field", [False, True])
def test_regressors_weigh_as_their_rows(quiet, field, mixed):
    """mixed: stretches of one log are in several folds."""
    logs, found = quiet
    start, split = Hypothesis(BASE), Split.of(logs, mixed)
    raw = Regressors(logs, split, found.regressors.effects, start)
    raw.along(start)
    asked = replace(found.problem, fields=aside._by_place(logs, split) if field else ())
    again = Regressors(asked, split, found.regressors.effects, start)
    again.along(start)
    weighed = raw.weighing(asked)
    for mine, other in zip(weighed.pieces, again.pieces, strict=True):
        np.testing.assert_allclose(mine.columns, other.columns, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(weighed.grams, again.grams, rtol=1e-9, atol=1e-9)


def pulled(angles: np.ndarray) -> np.ndarray:
    """(N, 3) N m: a hose that is too short pulls at the platform, hard where its slack is used up. angles: rad."""
    mechanism = build(Design(TRUTH), PERIOD)
    line = np.array([0.1, 0.2, -0.33]) - close(mechanism, angles)[:, mechanism.platform]
    length = np.linalg.norm(line, axis=1, keepdims=True)
    return at_joints((angles, angles, angles), line / length * 80.0 * np.maximum(length - 0.42, 0.0))


def test_what_goes_by_the_platforms_place_says_nothing_where_that_is_left_open():
    """On each run and joint with figures of its own; a constant too."""
    runs = [course(seed, 2.0) for seed in (1, 2, 3)]
    random = np.random.default_rng(4)
    for mixed in (False, True):
        torques = []
        for run in runs:
            mechanism = build(Design(TRUTH), PERIOD)
            x, y, z = close(mechanism, run.motion[0])[:, mechanism.platform].T
            terms = np.stack([np.ones(len(x)), x, y, z, x * x, x * y, y * z, z * z], axis=1)
            torques.append(run.torque + 20.0 * terms @ random.standard_normal((8, 3)))
        logs = problem(runs, torques, SIGMA)
        beside = replace(logs, fields=aside._by_place(logs, Split.of(logs, mixed)))
        assert evaluate(logs, Hypothesis(BASE)).cost > 1000 * logs.count
        assert evaluate(beside, Hypothesis(BASE)).cost < 0.05 * logs.count
        assert beside.count == logs.count - 3 * 3 * 10 * (2 if mixed else 1)  # a second each


def test_torque_by_place_is_left_open_only_where_that_frees_rows():
    """A hose at the platform pulls on all joints at once; what sits on one joint leaves the others free."""
    runs = [course(seed, 2.0) for seed in (1, 2, 3)]
    random = np.random.default_rng(5)
    noisy = [run.torque + SIGMA * random.standard_normal(run.torque.shape) for run in runs]
    hose = [torque + pulled(run.motion[0]) for run, torque in zip(runs, noisy, strict=True)]
    found = beside(problem(runs, hose, SIGMA))
    assert found.problem.fields
    assert found.problem.count > 0.9 * found.whole.count
    assert found.caution().code == "by_place"
    assert not beside(made()).problem.fields


def test_what_is_told_of_a_hypothesis_is_all_that_it_leaves(quiet):
    """However little the stranger weighs in the fit; against the hypothesis it weighs no more than that."""
    logs, found = quiet
    scored = selection.score(fit(found.problem, Hypothesis(BASE)), Split.of(logs))
    seen = found.on_all(scored)
    assert seen.blocks is scored.blocks
    plain = evaluate(logs, scored.hypothesis)
    for number, (residual, fitted) in enumerate(zip(seen.residuals, plain.residuals, strict=True)):
        assert np.corrcoef(residual, fitted)[0, 1] > 0.99  # but for parameters learnt from the other runs
        mine = logs.joints_of_rows[number] == JOINT
        true = logs.band(stranger(number + 1, 2000)[:, None])[logs.rows[number][:, JOINT], 0] / logs.sigma[JOINT]
        assert np.corrcoef(residual[mine], true)[0, 1] > 0.95  # its own friction is not known as well
    assert seen.loss / logs.count > 5 * scored.loss / found.problem.count


def test_what_is_told_beside_a_torque_that_is_left_open_is_all_that_it_leaves_too():
    """Effects keep their figures, the base model does for all rows what it can."""
    runs = [course(seed, 2.0) for seed in (1, 2, 3)]
    random = np.random.default_rng(6)
    torques = [r.torque + pulled(r.motion[0]) + SIGMA * random.standard_normal(r.torque.shape) for r in runs]
    logs = problem(runs, [torque + 4.0 * np.tanh(torque / 9.0) for torque in torques], SIGMA)
    found, split = beside(logs), Split.of(logs)
    rubs = Term(EFFECTS["load_dependent_friction"], (0, 1), np.array([[0.1], [0.2]]), (0.0,))
    scored = selection.score(fit(found.problem, Hypothesis(BASE, (rubs,)), iterations=2), split)
    seen = found.on_all(scored)
    assert seen.blocks is scored.blocks
    amplitude = scored.hypothesis.terms[0].amplitude
    np.testing.assert_array_equal(seen.hypothesis.terms[0].amplitude, amplitude)
    known = [
        logs.select(n, logs.band(added(s, scored.hypothesis.terms[0])))
        for n, s in enumerate(logs.scenes(Hypothesis(BASE)))
    ]
    plain = evaluate(logs, Hypothesis(BASE))
    wanted = [r - k for r, k in zip(plain.residuals, known, strict=True)]
    for number, rest in enumerate(left_out(plain.tangents, wanted)):
        assert np.corrcoef(seen.residuals[number], rest)[0, 1] > 0.98
    best = selection.score(fit(found.problem, Hypothesis(BASE)), split)
    assert evaluate(logs, found.on_all(best).hypothesis).cost < 1.01 * fit(logs, Hypothesis(BASE)).cost


def test_the_level_round_a_row_is_the_rms_of_the_rows_within_six_hundredths_of_a_second():
    random = np.random.default_rng(2)
    rows = random.random((60, 2)) < 0.5
    rows[20:40, 1] = False
    joints = np.repeat([0, 1], rows.sum(axis=0))
    left = random.standard_normal(len(joints))
    made = stub(band=stub(period=3e-3, step=4), rows=[rows], joints_of_rows=[joints])  # 5 samples
    (level,) = aside._levels(made, [left])
    for joint in range(2):
        square = np.full(60, np.nan)
        square[rows[:, joint]] = left[joints == joint] ** 2
        for row in range(60):
            near = square[max(row - 2, 0) : row + 3]
            expected = np.sqrt(np.nanmean(near)) if rows[row, joint] else 1.0
            assert level[row, joint] == pytest.approx(expected)


def settling(monkeypatch, *levels: float):
    """A problem of 100 rows whose fits leave these levels in turn, however they weigh; the weights asked for."""
    weights, left = [], iter(levels)

    def fitted(problem, hypothesis, iterations):
        assert iterations == 2
        weights.append(float(problem.weights[0][0, 0]))
        return next(left) * problem.weights[0][:, 0]

    monkeypatch.setattr(aside, "fit", fitted)
    monkeypatch.setattr(aside, "score", lambda residual, split: stub(hypothesis="same", residuals=[residual]))
    rows = np.ones((100, 1), bool)
    whole = replace(made(), recordings=[], target=[], rows=[rows], sigma=np.ones(1))
    problem, best = aside._settled(whole, stub(), stub(hypothesis="same"), [np.full(100, levels[0])])
    return weights, problem, best


@pytest.mark.parametrize(("level", "weight"), [(1.4, 1.0), (3.0, 0.5), (6.0, 0.25)])
def test_rows_weigh_less_from_one_and_a_half_times_the_noise(monkeypatch, level, weight):
    weights, problem, best = settling(monkeypatch, *[level] * 5)
    assert weights == pytest.approx([weight] * 3)
    np.testing.assert_allclose(problem.weights[0], weight)
    np.testing.assert_allclose(best.residuals[0], level * weight)


def test_rows_are_weighed_by_what_the_fit_before_left(monkeypatch):
    weights, problem, _ = settling(monkeypatch, 6.0, 3.0, 2.0)
    assert weights == pytest.approx([0.25, 0.25, 0.5])
    assert problem.weights[0][0, 0] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("gains", "taken"),
    [
        ([10.0, 3.1, 2.9, 9.0], 2), ([10.0, 9.0, 8.0, 7.0, 6.0], 4), ([10.0, None, 9.0], 1), ([2.0], 0),
        ([10.0, "fault", 9.0], 1), ([10.0, "chance", 9.0], 1),
    ],
)  # fmt: skip
def test_effects_are_added_while_they_gain_and_what_they_leave_far_above_the_noise_weighs_little(
    monkeypatch, gains, taken
):
    """3 of 100 rows each, and not by chance; the last of their levels weigh by their squares where above two."""
    asked = []

    def state(number: int):
        blocks = np.linspace(99.0, 101.0, 100) - sum(
            10.0 if isinstance(g, str) else g / 100 for g in gains[:number] if g
        )
        return stub(number=number, blocks=blocks, residuals=[np.where(np.arange(100) < 50, 1.9, 2.1 + number)])

    def additions(weighing, best, base, given, allows, progress):
        assert (base.number, given, allows, progress) == (0, 7, "allows", "progress")
        assert weighing == ("weighing", best.number)
        asked.append(best.number)
        gain = gains[best.number]
        return ([] if gain is None else [state(best.number + 1)]), "fault" if gain == "fault" else None

    def settled(whole, split, best, left):
        return stub(count=100, number=best.number, weights=[np.ones((100, 1))], pick=lambda n, w: w[:, 0]), best

    monkeypatch.setattr(aside, "additions", additions)
    monkeypatch.setattr(aside, "_settled", settled)
    monkeypatch.setattr(aside, "z_score", lambda worse, better: 2.9 if "chance" in gains and len(asked) == 2 else 3.1)
    monkeypatch.setattr(aside, "_levels", lambda whole, left: [left[0][:, None]])
    whole = replace(made(), recordings=[], target=[], rows=[np.ones((100, 1), bool)], sigma=np.ones(1))
    regressors = stub(
        problem=whole, split=stub(), weighing=lambda problem: ("weighing", getattr(problem, "number", problem))
    )
    asked_of: Any = (regressors, whole, state(0), 7, "allows", "progress")
    settled_on = Quiet._settled_on(*asked_of)
    weighed: Any = settled_on.regressors
    assert asked == list(range(min(taken + 1, 4)))
    weights = weighed[1].weights[0][:, 0]
    np.testing.assert_allclose(weights, np.where(np.arange(100) < 50, 1.0, 1.0 / (2.1 + taken) ** 2))
    loud = 2.1 + taken  # 50 rows of 1.9 that weigh in full, and these
    assert settled_on.left == pytest.approx(np.sqrt((1.9**2 + loud**-2) / (1 + loud**-4)), rel=0.02)


@pytest.mark.parametrize(("keeps", "joints"), [((0.89, 0.91, 0.5), [1, 3]), ((0.95, 0.92, 1.0), [2])])
def test_joints_that_keep_less_than_nine_tenths_are_told_or_the_one_that_keeps_least(keeps, joints):
    rows = [np.ones((30, 4), bool), np.ones((70, 4), bool)]
    rows[0][:, 3] = rows[1][:, 3] = False  # rests
    weights = [np.tile(np.sqrt([*keeps, 0.3]), (len(part), 1)) for part in rows]
    weighed = stub(weights=weights, fields=(), count=120)
    found = Quiet(stub(rows=rows, count=300), stub(problem=weighed), 1.0)
    said = found.caution()
    assert (said.joints, said.share, said.advice) == (joints, 0.6, "look_there")


def test_where_much_is_left_one_force_on_the_platform_goes_before_one_on_every_arm():
    def of(name, joints, loss):
        return stub(hypothesis=stub(terms=(stub(effect=EFFECTS[name], joints=joints),)), loss=loss)

    arms, hose, none = of("joint_spring", (0, 1, 2), 40.0), of("hose_spring", (), 42.0), stub(loss=100.0)
    assert selection.one_cause_first([arms, hose], none, 5) == [hose, arms]
    assert selection.one_cause_first([arms, hose], none, 20) == [arms, hose]  # only 1.4 times the noise is left
    far = of("hose_spring", (), 44.0)  # gains 7 % less
    assert selection.one_cause_first([arms, far], none, 5) == [arms, far]
    rubs = of("stribeck_friction", (0, 1, 2), 40.0)  # may be in every gear
    assert selection.one_cause_first([rubs, hose], none, 5) == [rubs, hose]


def test_an_effect_is_named_beside_a_stranger_on_another_joint(tmp_path):
    traces = []
    for seed in (1, 2, 3):
        trace = read_trace(record(tmp_path / f"run_{seed}.csv", ROBOT, swing(seed), 5.0, seed, 2.5), ROBOT)
        torque = trace.torque.copy()
        torque[:, JOINT] += stranger(seed, len(torque))
        traces.append(replace(trace, torque=torque))
    found = diagnose(ROBOT, traces, [EFFECTS[name] for name in ("stribeck_friction", "torque_scale", "hose_spring")])
    assert found.verdict == "partly_explained"
    assert set(found.selection.names) == {"stribeck_friction"}
    assert {joint for term in found.best.hypothesis.terms for joint in term.joints} == {0, 1}
    assert ("set_aside", [JOINT + 1]) in [(one.code, one.joints) for one in found.cannot_tell]
    # the gap that is told is that of all rows
    assert sum(len(r) for r in found.after) == found.problem.count == sum(len(r) for r in found.before)


@pytest.mark.parametrize("code", ["rivalled", "no_shrink"])
def test_a_name_that_quiet_rows_do_not_tell_from_another_falls_on_all_rows_too(monkeypatch, tmp_path, code):
    """What speaks for it on the others is the stranger. For any other reason it stands: fewer rows say less."""
    traces = []
    for seed in (1, 2, 3):
        trace = read_trace(record(tmp_path / f"run_{seed}.csv", ROBOT, swing(seed), 5.0, seed, 2.5), ROBOT)
        torque = trace.torque.copy()
        torque[:, JOINT] += 0.05 * stranger(seed, len(torque))
        traces.append(replace(trace, torque=torque))
    whole = diagnosis._judged

    def judged(regressors, found, *others):
        made = whole(regressors, found, *others)
        if not regressors.problem.weights:
            return made
        fell = Caution(code=code, effect="stribeck_friction", joints=[1, 2], advice="record_more")
        return replace(made, selection=replace(made.selection, best=made.selection.none), cautions=[fell])

    monkeypatch.setattr(diagnosis, "_judged", judged)
    found = diagnose(ROBOT, traces, [EFFECTS["stribeck_friction"]])
    assert found.selection.names == (() if code == "rivalled" else ("stribeck_friction",))
    told = [(one.code, one.effect) for one in found.cannot_tell]
    assert (("rivalled", "stribeck_friction") in told) == (code == "rivalled")
    assert found.verdict == ("unexplained" if code == "rivalled" else "partly_explained")


@pytest.mark.parametrize("stuck", [2.5, 0.0])
def test_beside_a_hose_that_is_too_short_friction_is_named_and_no_spring(monkeypatch, tmp_path, stuck):
    """Where there is none, nothing is, though nobody doubts the gravity."""
    if not stuck:
        monkeypatch.setattr("service.diagnosis.diagnose.base_doubts", lambda *_: [])
    traces = []
    for seed in (1, 2, 3):
        trace = read_trace(record(tmp_path / f"run_{seed}.csv", ROBOT, swing(seed), 5.0, seed, stuck), ROBOT)
        traces.append(replace(trace, torque=trace.torque + pulled(trace.position)))
    names = ("stribeck_friction", "joint_spring", "hose_spring", "torque_offset")
    found = diagnose(ROBOT, traces, [EFFECTS[name] for name in names])
    assert "by_place" in [one.code for one in found.cannot_tell]
    if stuck:
        assert found.verdict == "partly_explained"
        assert found.selection.names == ("stribeck_friction",)
        (friction,) = found.best.hypothesis.terms
        assert friction.joints == (0, 1, 2)
        np.testing.assert_allclose(friction.amplitude[:, 0], stuck, rtol=0.1)
    else:
        assert found.verdict == "unexplained"
        assert not found.best.hypothesis.terms
        assert sum(len(r) for r in found.after) == found.problem.count
