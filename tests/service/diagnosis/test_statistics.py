"""What the numbers are worth: intervals that cover, residuals that selection has not seen, twins that are named."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.signal import lfilter

from service.identification.correlated import Correlated
from tests.service.diagnosis.toy import named, scored, split_of
from tests.service.injected import INJECTED, reports
from tests.service.subject import (
    Hypothesis,
    Parameters,
    Selection,
    Split,
    document,
    evaluate,
    evidence,
    statistics,
)
from tests.service.world import BASE, course, problem, stub

DRAWS = 200


def coloured(random: np.random.Generator, count: int, rows: int, keep: float) -> np.ndarray:
    """(count, rows) of unit variance, each sample remembering `keep` of the one before."""
    values = random.standard_normal((count, rows))
    values[:, 0] /= np.sqrt(1 - keep**2)
    return np.asarray(lfilter([np.sqrt(1 - keep**2)], [1.0, -keep], values))


@pytest.mark.parametrize("keep", [0.0, 0.8], ids=["white", "coloured"])
def test_intervals_cover_the_truth(keep):
    """On the real tangents of a robot with Stribeck friction, noise drawn anew each time."""
    names = ("stribeck_friction",)
    runs = [course(seed, 3.0) for seed in (1, 2, 3)]
    logs = problem(runs, [reports(names[0], seed, 3.0) for seed in (1, 2, 3)])
    split = Split.of(logs)
    hypothesis = Hypothesis(BASE, (INJECTED[names[0]].term(names[0]),))
    exact = evaluate(logs, hypothesis)
    # transition and timing are held: they have no interval
    free = exact.inside.copy()
    free[9:11] = False
    tangents = [tangent[:, free] for tangent in exact.tangents]
    gram = np.asarray(sum(t.T @ t for t in tangents))
    random = np.random.default_rng(5)
    inside = []
    for _ in range(DRAWS):
        noise = [coloured(random, 1, len(t), keep)[0] for t in tangents]
        moment = np.asarray(sum(t.T @ r for t, r in zip(tangents, noise, strict=True)))
        off = np.linalg.solve(gram, moment)
        residuals = [r - t @ off for t, r in zip(tangents, noise, strict=True)]
        errors = statistics.standard_errors(replace(exact, residuals=residuals, inside=free), split)
        assert errors.shape == (9 + 2 + 3 + 1,)
        inside.append(np.abs(off) < 1.96 * np.delete(errors, [9, 10]))
    assert 0.90 < np.mean(inside) < 0.985


def test_a_parameter_at_its_limit_has_an_interval_as_if_there_were_none():
    runs = [course(1, 3.0)]
    logs = problem(runs, [runs[0].torque])
    fitted = evaluate(logs, Hypothesis(BASE, (INJECTED["torque_filter"].term("torque_filter"),)))
    inside = fitted.inside.copy()
    inside[-1] = inside[1] = False
    noise = [np.random.default_rng(1).standard_normal(len(r)) for r in fitted.residuals]
    errors = statistics.standard_errors(replace(fitted, residuals=noise, inside=inside), Split.of(logs))
    free = statistics.standard_errors(replace(fitted, residuals=noise), Split.of(logs))
    assert errors[-1] == free[-1] > 0
    assert errors[1] == free[1] > 0
    assert (np.delete(errors, [1, 11]) > 0).all()


def test_the_shrinks_interval_covers_the_truth():
    random = np.random.default_rng(2)
    inside = []
    for seed in range(DRAWS):
        common = random.gamma(8.0, 1.0, 80)
        before, after = common * random.gamma(20.0, 1.0, 80) / 20, 0.25 * common * random.gamma(20.0, 1.0, 80) / 20
        found = statistics.shrink(before, after, seed)
        assert found.value == pytest.approx(1 - np.sqrt(after.sum() / before.sum()))
        inside.append(found.low < 0.5 < found.high)
    assert 0.90 <= np.mean(inside) <= 0.985


def test_the_shrinks_interval_over_runs_is_that_of_other_such_runs():
    """Three runs alike in all their blocks: 27 draws with repetition, each as likely; and of one run that of its
    blocks."""
    squares, runs = np.array([1.0, 25.0, 100.0]), np.array([0, 0, 1, 1, 2, 2])
    found = statistics.shrink(squares[runs], np.ones(6), runs=runs)
    every = [1 - np.sqrt(3 / (squares[[a, b, c]]).sum()) for a in range(3) for b in range(3) for c in range(3)]
    assert (found.low, found.high) == pytest.approx((min(every), max(every)))  # of 27 each one is more than 2.5 %
    random = np.random.default_rng(3)
    before, after = random.gamma(5.0, 1.0, 40), random.gamma(5.0, 0.3, 40)
    assert statistics.shrink(before, after, runs=np.full(40, 2)) == statistics.shrink(before, after)
    inside = statistics.shrink(before, after)
    alike = statistics.shrink(np.tile(before, 4), np.tile(after, 4), runs=np.repeat(range(4), 40))
    assert alike.high - alike.low == pytest.approx((inside.high - inside.low) / 2, rel=0.1)  # four times the blocks


def test_a_block_is_of_the_run_of_its_recording():
    logs, split = problem([course(1, 2.0)] * 3, [course(1, 2.0).torque] * 3), Split.of
    parts = [replace(recording, trace=trace) for recording, trace in zip(logs.recordings, (4, 2, 4), strict=True)]
    logs = replace(logs, recordings=parts)
    found = statistics.run_of_blocks(logs, split(logs))
    for recording, block in zip(parts, split(logs).block, strict=True):
        assert set(found[block]) == {recording.trace}


def rows(split: Split) -> int:
    return sum(len(fold) for fold in split.fold)


@dataclass(frozen=True)
class Search:
    """A made-up search of one round over `candidates` columns, the best taken. losses over those of no candidate."""

    chosen: float
    nested: float


def nested_of(found: Selection, split: Split) -> list[np.ndarray]:
    """Residuals on data held out of fitting and of selection."""
    return statistics.by_fold(statistics.walked(found, split, rows(split)), split)


def walk(seed: int, candidates: int, true: float) -> Search:
    """Noise, and `true` times the first candidate's column."""
    random = np.random.default_rng(seed)
    split = split_of(4, 60, 6)
    base = [random.standard_normal((60, 2)) for _ in range(4)]
    columns = [[random.standard_normal((60, 3)) for _ in range(4)] for _ in range(candidates)]
    target = [random.standard_normal(60) + true * columns[0][k][:, 0] for k in range(4)]
    none = scored(base, target, split)
    tried = [
        scored([np.hstack([b, c]) for b, c in zip(base, mine, strict=True)], target, split, f"effect_{number}")
        for number, mine in enumerate(columns)
    ]
    best = min(tried, key=lambda item: item.loss)
    found = Selection(none, best, [(tried, best)], {})
    nested = nested_of(found, split)
    assert [len(r) for r in nested] == [60] * 4
    return Search(best.loss / none.loss, float(sum(r @ r for r in nested)) / none.loss)


def test_what_is_accepted_given_a_discrepancy_is_chosen_again_given_it():
    """Its share of all that is left is small: what the discrepancy explains hides it."""
    random, split = np.random.default_rng(1), split_of(4, 60, 6)
    base, mine, beside = ([random.standard_normal((60, 1)) for _ in range(4)] for _ in range(3))
    target = [random.standard_normal(60) + 2.0 * m[:, 0] + 20.0 * z[:, 0] for m, z in zip(mine, beside, strict=True)]
    none = scored(base, target, split)
    more = scored([np.hstack(parts) for parts in zip(base, mine, strict=True)], target, split, "effect")
    hidden = Selection(none, more, [([more], more)], {})
    given = replace(hidden, noise=Correlated(beside, np.full(1, 1e-3)))
    chosen = [statistics.walked(found, split, rows(split)) for found in (hidden, given)]
    assert [[one is more for one in each] for each in chosen] == [[False] * 4, [True] * 4]


def test_nested_residuals_are_out_of_selection():
    """The best of many candidates on noise looks better than none; left out of its selection it does not."""
    walks = [walk(seed, 60, 0.0) for seed in range(12)]
    assert 1 - np.mean([w.chosen for w in walks]) > 0.02
    nested = np.array([1 - w.nested for w in walks])
    assert nested.mean() <= 2 * nested.std() / np.sqrt(len(nested))


def test_nested_residuals_of_a_true_effect_are_those_of_the_choice():
    for seed in range(5):
        found = walk(seed, 20, 1.0)
        assert found.chosen < 0.8
        assert found.nested == pytest.approx(found.chosen, rel=1e-9)


def test_a_fold_is_predicted_by_what_the_others_choose():
    """Two effects, each at work in another half of the logs: the fold never has a say in its own prediction."""
    random = np.random.default_rng(0)
    split = split_of(4, 400, 8)
    base = [random.standard_normal((400, 1)) for _ in range(4)]
    one, two = ([random.standard_normal((400, 1)) for _ in range(4)] for _ in range(2))
    target = [random.standard_normal(400) * 0.3 + 3.0 * one[k][:, 0] for k in range(3)]
    target.append(random.standard_normal(400) * 0.3 + 3.0 * two[3][:, 0])
    none = scored(base, target, split)
    first = scored([np.hstack(pair) for pair in zip(base, one, strict=True)], target, split, "one")
    second = scored([np.hstack(pair) for pair in zip(base, two, strict=True)], target, split, "two")
    found = Selection(none, second, [([first, second], second)], {})
    nested = nested_of(found, split)
    np.testing.assert_array_equal(nested[3], first.residuals[3])


def test_what_was_not_taken_is_not_claimed():
    """A candidate that leads and fell for another reason: the corrected model has nothing of it."""
    random = np.random.default_rng(0)
    split = split_of(4, 60, 6)
    base, one = ([random.standard_normal((60, 1)) for _ in range(4)] for _ in range(2))
    target = [random.standard_normal(60) + 3.0 * column[:, 0] for column in one]
    none = scored(base, target, split)
    lead = scored([np.hstack(pair) for pair in zip(base, one, strict=True)], target, split, "one")
    nested = nested_of(Selection(none, none, [([lead], None)], {}), split)
    for mine, plain in zip(nested, none.residuals, strict=True):
        np.testing.assert_array_equal(mine, plain)


def test_a_rounds_probabilities_are_akaikes_weights_in_the_mean_over_draws():
    split = split_of(3, 300, 10)
    random = np.random.default_rng(3)
    base = [random.standard_normal((300, 1)) for _ in range(3)]
    column = [random.standard_normal((300, 1)) for _ in range(3)]
    other = [c + 0.02 * random.standard_normal((300, 1)) for c in column]
    target = [random.standard_normal(300) + 0.5 * c[:, 0] for c in column]
    none = scored(base, target, split)
    true, twin = (
        scored([np.hstack(pair) for pair in zip(base, c, strict=True)], target, split, name)
        for c, name in ((column, "true"), (other, "twin"))
    )
    useless = scored([np.hstack([b, random.standard_normal((300, 1))]) for b in base], target, split, "useless")
    found = Selection(none, true, [([true, twin, useless], true), ([useless], None)], {})
    first, second = evidence.comparisons(found, split, rows(split))
    assert first.none == pytest.approx(0.0, abs=1e-9)
    assert first.probability("useless") == pytest.approx(0.0, abs=1e-9)
    assert first.probability("never tried") == 0.0
    assert 0.2 < first.probability("true") < 1.0
    assert first.probability("true") + first.probability("twin") == pytest.approx(1.0)
    assert second.none == pytest.approx(1.0, abs=1e-3)
    # by another road: on each draw the odds of two as large are by half the squares between them, as what is left does
    draw = np.random.default_rng(0).integers(0, split.blocks, (1000, split.blocks))
    losses = np.stack([h.blocks[draw].sum(axis=1) for h in (true, twin)])
    unit = max(1.0, min(true.loss, twin.loss) / rows(split))
    expected = np.mean(1 / (1 + np.exp((losses[0] - losses[1]) / (2 * unit))))
    assert first.probability("true") == pytest.approx(expected, abs=2e-3)


def test_reversals_cost_what_their_place_is_worth():
    """Friction that changes sign between two samples, by the closed form of an impulse through the band."""
    runs = [course(1, 3.0)]
    logs = problem(runs, [runs[0].torque])
    sign, moving = np.sign(runs[0].motion[1]), logs.recordings[0].segment.moving
    turns = ((sign[1:] != sign[:-1]) & moving[1:]).sum(axis=0)
    assert turns.sum() == 0  # rest is left out here, so count one that is not
    moving[:] = True
    turns = (sign[1:] != sign[:-1]).sum(axis=0)
    assert (turns > 3).all()
    found = statistics.reversal_noise(logs, np.array([3.0, 0.0, -2.0]))
    area = (2 * np.array([3.0, 0.0, 2.0]) * 0.2) ** 2
    np.testing.assert_allclose(found, np.sqrt(area * turns * logs.band.white_share / 3000))


def test_squares_are_summed_by_joint_and_block():
    runs = [course(1, 1.0), course(2, 1.0)]
    logs = replace(problem(runs, [run.torque for run in runs]), sigma=np.array([0.1, 0.2, 0.4]))
    split = Split.of(logs)
    residuals = [np.random.default_rng(k).standard_normal(int(rows.sum())) for k, rows in enumerate(logs.rows)]
    joint = logs.joints_of_rows
    for k, rows_ in enumerate(logs.rows):
        np.testing.assert_array_equal(joint[k], np.repeat([0, 1, 2], rows_.sum(axis=0)))
    whole, joints = np.concatenate(residuals), np.concatenate(joint)
    rms = [logs.sigma[j] * np.sqrt(np.mean(whole[joints == j] ** 2)) for j in range(3)]
    np.testing.assert_allclose(statistics.rms_per_joint(logs, residuals), rms)
    block = np.concatenate(split.block)
    squares = [((whole * logs.sigma[joints])[block == b] ** 2).sum() for b in range(split.blocks)]
    np.testing.assert_allclose(statistics.pooled_squares(logs, residuals, split), squares)
    few = np.zeros((4, 3), bool)  # one row of joint 1, none of joint 2, two of joint 3
    few[[0, 1, 2], [0, 2, 2]] = True
    rms = statistics.rms_per_joint(
        replace(logs, recordings=logs.recordings[:1], rows=[few]), [np.array([3.0, 1.0, 7.0])]
    )
    np.testing.assert_allclose(rms, [0.3, 0.0, 0.4 * 5.0])


@pytest.mark.parametrize(("size", "slow"), [(0.19, True), (0.21, False)])
def test_a_run_that_hardly_accelerates_is_no_work(size, slow):
    """size: of its motion, the same in the same time, over that of the two others: up to a fifth it is slow."""
    runs = [course(1, 3.0), course(1, 3.0, 0.3 * size), course(1, 3.0)]
    logs = problem(runs, [run.torque for run in runs])
    at_work = statistics.runs_at_work(logs)
    assert at_work.tolist() == ([0, 2] if slow else [0, 1, 2])
    left = [np.full(len(joints), 1.0 + number) for number, joints in enumerate(logs.joints_of_rows)]
    counts = [np.bincount(joints, minlength=3) for joints in logs.joints_of_rows]
    mean = sum(counts[k] * (1.0 + k) ** 2 for k in at_work) / sum(counts[k] for k in at_work)
    np.testing.assert_allclose(statistics.rms_per_joint(logs, left, at_work), np.sqrt(mean) * logs.sigma)


def test_where_a_terms_parameters_stand():
    terms = tuple(INJECTED[name].term(name) for name in ("stribeck_friction", "torque_scale", "cogging"))
    known = Parameters(Hypothesis(BASE, terms))
    for number, term in enumerate(terms):
        here = known.values[known.free][known.columns(number)]
        np.testing.assert_array_equal(here, np.concatenate([term.amplitude.ravel(), term.nonlinear]))


def test_of_later_rounds_only_what_was_named_is_ranked():
    """A rival that lost in a later round was held against a model that has the first name already."""

    effects = {name: named(name) for name in "abcd"}

    def one(loss: float, *names: str):
        return stub(loss=loss, hypothesis=stub(terms=[stub(effect=effects[name], joints=(1,)) for name in names]))

    rounds = [
        stub(candidates=[(one(50.0, "a"), 0.9), (one(80.0, "c"), 0.1)], before=one(100.0)),
        stub(candidates=[(one(20.0, "a", "b"), 0.8), (one(30.0, "a", "d"), 0.2)], before=one(50.0, "a")),
    ]
    likely = {effects["a"]: stub(probability=0.95), effects["b"]: stub(probability=0.8)}
    found = stub(problem=stub(count=100, sigma=np.ones(3)), selection=stub(standings=likely))
    ranked = document._ranking(found, rounds)
    assert [(one.name, one.joints, one.probability) for one in ranked] == [
        ("a", [2], 0.95), ("b", [2], 0.8), ("c", [2], 0.1),
    ]  # fmt: skip
    assert [one.shrink for one in ranked] == pytest.approx([1 - (0.5) ** 0.5, 1 - (0.4) ** 0.5, 1 - 0.8**0.5], abs=1e-4)


def test_a_step_without_a_fold_is_worth_it_by_the_rows_of_the_others(monkeypatch):
    random, asked = np.random.default_rng(0), []
    split = split_of(4, 25, 2)
    columns = [random.standard_normal((25, 2)) for _ in range(4)]
    target = [random.standard_normal(25) for _ in range(4)]
    none = scored([column[:, :1] for column in columns], target, split)
    more = scored(columns, target, split, "more")
    monkeypatch.setattr(
        statistics, "worth", lambda loss, without, none, rows, most: asked.append((rows, most)) or False
    )
    statistics.walked(Selection(none, more, [([more], more)], {}), split, 100, 1.25)
    assert asked == [(75, 1.25)] * 4
