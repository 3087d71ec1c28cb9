"""The search's parts, each against least squares done the long way."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest

from service.identification.correlated import Correlated
from tests.service.diagnosis.toy import left_out, scored, split_of
from tests.service.injected import INJECTED, reports
from tests.service.subject import (
    EFFECTS,
    Candidate,
    Dictionary,
    Hypothesis,
    Regressors,
    Scene,
    Split,
    candidates,
    evaluate,
    fit,
    on_joint,
    reported,
    selection,
    statistics,
)
from tests.service.world import BASE, course, problem, stub

RANDOM = np.random.default_rng


def logs_of(name: str | None, seeds: tuple[int, ...] = (1, 2, 3), noise: float = 0.3, seconds: float = 2.0):
    runs = [course(seed, seconds) for seed in seeds]
    random = RANDOM(11)
    torques = [
        (reports(name, seed, seconds) if name else run.torque) + noise * random.standard_normal(run.torque.shape)
        for seed, run in zip(seeds, runs, strict=True)
    ]
    return problem(runs, torques, noise)


def test_a_trace_a_fold_and_half_a_second_a_block():
    logs = logs_of(None)
    split = Split.of(logs)
    assert split.folds == 3
    per_run = 4  # 2 s, 0.5 s a block
    assert split.blocks == 3 * per_run
    for number, (fold, block, rows) in enumerate(zip(split.fold, split.block, logs.rows, strict=True)):
        assert len(fold) == len(block) == rows.sum()
        assert (fold == number).all()
        expected = np.concatenate([np.flatnonzero(rows[:, j]) // 100 for j in range(3)]) + number * per_run
        np.testing.assert_array_equal(block, expected)


def test_two_traces_are_cut_into_four_stretches():
    logs = logs_of(None, (1, 2))
    split = Split.of(logs)
    assert split.folds == 4
    for number, rows in enumerate(logs.rows):
        expected = np.concatenate([(400 * number + np.flatnonzero(rows[:, j])) * 4 // 800 for j in range(3)])
        np.testing.assert_array_equal(split.fold[number], expected)


def test_traces_that_tell_unequal_things_share_every_fold():
    slow = [course(seed, 3.0, 0.06, 1.0, 3.0) for seed in (1, 2)]
    for fast, mixed in ((course(3, 3.0, 0.06, 1.0, 3.0), False), (course(3, 5.0), True)):
        runs = [*slow, fast]
        torques = [run.torque + 0.3 * RANDOM(7).standard_normal(run.torque.shape) for run in runs]
        logs = problem(runs, torques)
        fitted = fit(logs, Hypothesis(BASE))
        split = Split.fair(logs, fitted)
        given = np.concatenate(split.fold)
        assert len(given) == logs.count
        if not mixed:
            np.testing.assert_array_equal(given, np.concatenate(Split.of(logs).fold))
            continue
        for number, fold in enumerate(split.fold):
            _, place = logs.rows[number].T.nonzero()
            np.testing.assert_array_equal(fold, (number + place // 200) % 4)  # a second a turn
        # the truth is left with its noise; a trace a fold, it would be off by what slow runs leave open
        whole, apart = (selection.score(fitted, one).loss / logs.count for one in (split, Split.of(logs)))
        assert whole < 1.05
        assert apart > 1.2


def test_held_out_residuals_are_those_of_refits():
    random = RANDOM(1)
    columns = [random.standard_normal((50, 4)) for _ in range(3)]
    target = [random.standard_normal(50) for _ in range(3)]
    split = split_of(3, 50, 5)
    found = scored(columns, target, split)
    for mine, truth in zip(found.residuals, left_out(columns, target), strict=True):
        np.testing.assert_allclose(mine, truth, atol=1e-9)
    block = np.concatenate(split.block)
    squares = [(np.concatenate(found.residuals)[block == b] ** 2).sum() for b in range(split.blocks)]
    np.testing.assert_allclose(found.blocks, squares)
    assert found.loss == pytest.approx(sum(squares))


@pytest.mark.parametrize("opened", [0, 2])
def test_inner_losses_leave_a_fold_out_of_everything(opened):
    """Given discrepancies, too."""
    random = RANDOM(2)
    columns = [random.standard_normal((50, 4)) for _ in range(4)]
    beside = [random.standard_normal((50, opened)) for _ in range(4)]
    target = [random.standard_normal(50) + 3.0 * mine.sum(axis=1) for mine in beside]
    split = split_of(4, 50, 5)
    noise = Correlated(beside, np.full(opened, 1e-12))
    found = statistics._inner(scored(columns, target, split), split, noise)[2]
    truth = left_out([np.hstack(parts) for parts in zip(columns, beside, strict=True)], target, (2,))
    truth[2] = np.zeros(50)
    np.testing.assert_allclose(found, selection.block_loss(truth, split), atol=1e-9)


@pytest.mark.parametrize("name", ["stribeck_friction", "arm_mass", "tool_mass", "cogging"])
def test_the_dictionarys_loss_is_that_of_least_squares(name):
    """Normal equations, a fold left out at a time, against the columns themselves; of two logs a fold is a stretch."""
    logs = logs_of("torque_filter", (1, 2) if name in ("arm_mass", "tool_mass") else (1, 2, 3))
    split = Split.of(logs)
    fold = np.concatenate(split.fold)

    def folded(parts):
        return [np.concatenate(parts)[fold == number] for number in range(split.folds)]

    base = (
        Hypothesis(BASE, tuple(INJECTED[n].term(n) for n in ("torque_filter", "joint_spring")))
        if name == "cogging"
        else Hypothesis(BASE)
    )
    fitted = fit(logs, base)
    effect = EFFECTS[name]
    dictionary = Dictionary(Regressors(logs, split, [effect, EFFECTS["torque_offset"]], base), fitted)
    here = logs.scenes(fitted.hypothesis)
    assert dictionary.nothing == pytest.approx(
        sum(r @ r for r in left_out(folded(fitted.moving), folded(fitted.residuals))), rel=1e-6
    )
    for joints in [(1,), (0, 1, 2)] if effect.per_joint else [()]:
        nonlinear = effect.grid(here[0])[-1]
        columns = []
        for number, scene in enumerate(here):
            parts = []
            for joint in joints or (0,):
                values = effect.regressors(scene, joint, nonlinear)
                values = on_joint(values, joint, 3) if effect.own_joint else values
                parts.append(logs.select(number, logs.band(reported(scene, fitted.hypothesis, values))))
            columns.append(np.hstack([fitted.moving[number], *parts]))
        positive = len(joints) if name == "stribeck_friction" else 0  # friction gives no energy
        left = left_out(folded(columns), folded(fitted.residuals), positive=positive)
        truth = sum(float(r @ r) for r in left)
        assert dictionary.losses([(Candidate(effect, joints, nonlinear),)])[0] == pytest.approx(truth, rel=1e-6)


def test_what_the_hypothesis_already_has_is_nothing_new():
    """A candidate that is a sum of its own columns, to rounding; beside another it does not bend that one's weight."""
    random = RANDOM(12)
    own = [random.standard_normal((60, 2)) for _ in range(3)]
    new = [random.standard_normal((60, 1)) for _ in range(3)]
    target = [random.standard_normal(60) + 2.0 * column[:, 0] for column in new]
    split, again, other = split_of(3, 60, 4), EFFECTS["cogging"], EFFECTS["torque_offset"]
    columns = [np.hstack([mine @ [[3.0], [-1.0]], column]) for mine, column in zip(own, new, strict=True)]
    regressors = stub(
        along=lambda hypothesis: None, index={(again, 0, ()): np.array([0]), (other, 0, ()): np.array([1])},
        effects=[again, other], low=np.full(2, -np.inf), split=split, reach=[np.arange(2)],
        pieces=[candidates.Piece(fold, 0, fold, slice(None), part) for fold, part in enumerate(columns)],
        grams=[part.T @ part for part in columns],
    )  # fmt: skip
    dictionary = Dictionary(regressors, stub(hypothesis=None, moving=own, residuals=target))
    assert dictionary.losses([(Candidate(again, (), ()),)])[0] == dictionary.nothing
    truth = left_out([np.hstack(pair) for pair in zip(own, new, strict=True)], target)
    assert dictionary.losses([(Candidate(other, (), ()),)])[0] == pytest.approx(sum(r @ r for r in truth))


def test_the_ranking_puts_the_true_effect_first_and_leaves_out_what_is_not_offered():
    logs = logs_of("joint_spring")
    split = Split.of(logs)
    fitted = fit(logs, Hypothesis(BASE))
    effects = [EFFECTS[n] for n in ("cogging", "joint_spring", "tool_mass", "air_drag")]
    dictionary = Dictionary(Regressors(logs, split, effects, Hypothesis(BASE)), fitted)
    ranking = dictionary.ranking((), 3, lambda effect, joint: True)
    assert ranking[0][1].effect is EFFECTS["joint_spring"]
    assert ranking[0][1].joints == (0,)
    assert [loss for loss, _ in ranking] == sorted(loss for loss, _ in ranking)
    assert len(ranking) == 4
    # the loss counts two a parameter
    loss, candidate = ranking[0]
    assert loss == pytest.approx(dictionary.losses([(candidate,)])[0] + 4.0)
    term = INJECTED["joint_spring"].term("joint_spring")
    taken = dictionary.ranking((term,), 3, lambda effect, joint: True)
    assert 0 not in next(c for _, c in taken if c.effect is EFFECTS["joint_spring"]).joints
    barred = dictionary.ranking((), 3, lambda effect, joint: effect.per_joint and joint != 0)
    assert {c.effect.name for _, c in barred} == {"cogging", "joint_spring"}
    assert all(0 not in c.joints for _, c in barred)


def test_one_joint_is_preferred_to_all_unless_the_others_gain():
    loads = logs_of("load_dependent_friction")
    start = Hypothesis(BASE)
    ranking = Dictionary(
        Regressors(loads, Split.of(loads), [EFFECTS["load_dependent_friction"]], start), fit(loads, start)
    ).ranking((), 3, lambda effect, joint: True)
    assert ranking[0][1].joints == (0, 1, 2)
    one = logs_of("cogging")
    ranking = Dictionary(Regressors(one, Split.of(one), [EFFECTS["cogging"]], start), fit(one, start)).ranking(
        (), 3, lambda effect, joint: True
    )
    assert ranking[0][1].joints == (1,)


def test_standard_errors_between_two_hypotheses():
    better = np.full(100, 1.0)
    worse = better + np.tile([0.1, 0.3], 50)
    assert selection.z_score(worse, better) >= 0.2 * 100 / (10 * 0.1) - 1e-9
    assert selection.z_score(better, better) == 0.0
    # one violent block hides the sum, not the logarithms
    worse = better * 1.1
    worse[0], violent = 50.0, better.copy()
    violent[0] = 5.0
    difference = np.log(worse) - np.log(violent)
    assert selection.z_score(worse, violent) == pytest.approx(
        max(
            difference.sum() / (10 * np.std(difference)),
            (np.sqrt(worse) - np.sqrt(violent)).sum() / (10 * np.std(np.sqrt(worse) - np.sqrt(violent))),
        ),
        rel=1e-6,
    )
    assert selection.z_score(better, worse) < 0.0


class TestWorth:
    """rows = 1000 in 50 blocks; losses a row in units of the noise."""

    spread = RANDOM(0).normal(0.0, 0.02, 50)

    def losses(self, level: float) -> np.ndarray:
        return np.full(50, level * 20.0) + self.spread

    @pytest.mark.parametrize(
        ("candidate", "without", "none", "worth"),
        [
            (1.00, 1.04, 1.04, True),
            (1.00, 1.025, 1.025, False),  # less than LEAST_GAIN
            (1.03, 1.2, 8.0, True),
            (1.14, 1.2, 8.0, False),  # less than 1 % of the gap and than passes for noise
            (1.73, 2.0, 100.0, True),  # a weak effect beside a strong one: a quarter of what is left
            (1.77, 2.0, 100.0, False),
            (1.0, 1.15, 60.0, True),
            (1.0, 1.1, 60.0, False),  # what the strong effect's own model leaves
            (4.0, 5.5, 5.5, True),
            (5.0, 5.5, 5.5, False),  # less than a quarter of the rest
            (1.0, 1.105, 11.0, True),  # 1 % of a gap of 10, which is less than passes for noise
            (1.0, 1.095, 11.0, False),
            (1.0, 1.041, 1.041, True),
        ],
    )
    def test_enough_of_the_gap(self, candidate, without, none, worth):
        noisy = self.losses(without) + RANDOM(1).normal(0, 0.02, 50)
        assert selection.worth(self.losses(candidate), noisy, self.losses(none), 1000) is worth

    def test_what_noise_may_leave_is_no_gap_of_which_a_quarter_is_wanted(self):
        candidate, without, none = (self.losses(loss) for loss in (1.11, 1.142, 1.2))
        without += RANDOM(1).normal(0, 0.02, 50)
        assert not selection.worth(candidate, without, none, 1000), "a quarter of .142 is .0355"
        assert selection.worth(candidate, without, none, 1000, most=1.02)  # a quarter of .10 is .025
        assert not selection.worth(self.losses(1.115), without, none, 1000, most=1.25), "3 % of the noise in any case"

    @pytest.mark.parametrize(("candidate", "worth"), [(39.2, True), (39.3, False)])
    def test_of_what_is_far_above_the_noise_a_quarter_of_what_begins_there_is_wanted(self, candidate, worth):
        """Twice the noise: three quarters, of the 39 that are left."""
        noisy = self.losses(40.0) + RANDOM(1).normal(0, 0.02, 50)
        assert selection.worth(self.losses(candidate), noisy, self.losses(45.0), 1000) is worth

    @pytest.mark.parametrize(("candidate", "worth"), [(0.99, True), (1.03, False)])
    def test_beside_a_rough_effect_it_is_a_hundredth_of_the_gap(self, candidate, worth):
        noisy = self.losses(2.0) + RANDOM(1).normal(0, 0.02, 50)
        assert selection.worth(self.losses(candidate), noisy, self.losses(101.0), 1000, rough=True) is worth
        assert selection.worth(self.losses(candidate), noisy, self.losses(101.0), 1000)

    def test_not_by_chance(self):
        chance = self.losses(1.04) + 20 * RANDOM(2).normal(0, 0.3, 50)
        chance += 20.8 - chance.mean()
        assert selection.z_score(chance, self.losses(1.0)) < 3.0
        assert not selection.worth(self.losses(1.0), chance, chance, 1000)


def test_the_simplest_of_equals_leads():
    random = RANDOM(5)
    split = split_of(3, 300, 10)
    base = [random.standard_normal((300, 1)) for _ in range(3)]
    column = [random.standard_normal((300, 1)) for _ in range(3)]
    more = [np.hstack([c, random.standard_normal((300, 3))]) for c in column]
    target = [random.standard_normal(300) + 0.6 * c[:, 0] + 0.05 * m[:, 1] for c, m in zip(column, more, strict=True)]
    none = scored(base, target, split)
    small, large = (
        scored([np.hstack(pair) for pair in zip(base, c, strict=True)], target, split, name)
        for c, name in ((column, "small"), (more, "large"))
    )
    assert [s.names for s in selection.simplest_first([large, small], none)] == [("small",), ("large",)]
    # where the larger says more than chance does, it leads
    target = [t + 1.0 * m[:, 1] for t, m in zip(target, more, strict=True)]
    none = scored(base, target, split)
    small, large = (
        scored([np.hstack(pair) for pair in zip(base, c, strict=True)], target, split, name)
        for c, name in ((column, "small"), (more, "large"))
    )
    assert [s.names for s in selection.simplest_first([small, large], none)] == [("large",), ("small",)]


def test_what_others_make_superfluous_is_dropped():
    """An effect that was taken first, and joints that have nothing of theirs."""
    logs = logs_of("joint_spring")
    split = Split.of(logs)
    spring, offset = (
        Candidate(EFFECTS["joint_spring"], (0, 1, 2), ()).term(),
        Candidate(EFFECTS["torque_offset"], (0,), ()).term(),
    )
    none = selection.score(fit(logs, Hypothesis(BASE)), split)
    both = selection.score(fit(logs, Hypothesis(BASE, (offset, spring))), split)
    left = selection.pruned(logs, split, both, none, logs.count, 0)
    assert left.names == ("joint_spring",)
    assert left.hypothesis.terms[0].joints == (0,)
    # what the description carried is never dropped
    given = selection.pruned(logs, split, both, none, logs.count, 2)
    assert given.names == ("torque_offset", "joint_spring")
    assert given.hypothesis.terms[1].joints == (0, 1, 2)


def test_joints_get_shapes_of_their_own_where_they_differ():
    runs = [course(seed, 3.0) for seed in (1, 2, 3)]
    random = RANDOM(4)
    torques = []
    for run in runs:
        speed = run.motion[1]
        extra = 3.0 * np.exp(-((speed / np.array([0.1, 0.4, 0.4])) ** 2)) * np.tanh(speed / 0.004)
        torques.append(run.torque + extra * [1, 1, 0] + 0.2 * random.standard_normal(speed.shape))
    logs = problem(runs, torques, 0.2)
    split = Split.of(logs)
    shared = Candidate(EFFECTS["stribeck_friction"], (0, 1), (0.2,)).term()
    best = selection.score(fit(logs, Hypothesis(BASE, (shared,))), split)
    apart = selection.spread(logs, split, best).hypothesis.terms
    assert [term.joints for term in apart] == [(0,), (1,)]
    assert [term.nonlinear[0] for term in apart] == pytest.approx([0.1, 0.4], rel=0.1)
    mass = selection.score(fit(logs, Hypothesis(BASE, (Candidate(EFFECTS["arm_mass"], (0, 1), ()).term(),))), split)
    assert selection.spread(logs, split, mass) is mass  # nothing to share


def test_nothing_is_found_on_noise():
    logs = logs_of(None)
    effects = [effect for effect in EFFECTS.values() if not effect.rough]
    found = selection.search(Regressors(logs, Split.of(logs), effects, Hypothesis(BASE)), lambda _: None)
    assert found.best is found.none
    assert found.best.names == ()
    assert len(found.path) <= 1, "a round that brings nothing is the last"


def test_two_effects_are_both_found():
    runs = [course(seed, 2.0) for seed in (1, 2, 3)]
    random = RANDOM(6)
    torques = [
        reports("cogging", seed, 2.0)
        + reports("tool_mass", seed, 2.0)
        - run.torque
        + 0.2 * random.standard_normal((2000, 3))
        for seed, run in zip((1, 2, 3), runs, strict=True)
    ]
    logs = problem(runs, torques, 0.2)
    effects = [EFFECTS[n] for n in ("cogging", "tool_mass", "joint_spring", "arm_mass", "torque_offset")]
    found = selection.search(Regressors(logs, Split.of(logs), effects, Hypothesis(BASE)), lambda _: None)
    assert set(found.best.names) == {"cogging", "tool_mass"}
    assert len(found.path) == 2
    taken = found.path[0][1]
    assert taken is not None
    assert found.after(taken).names == taken.names
    assert evaluate(logs, found.best.hypothesis).cost / logs.count == pytest.approx(1.0, abs=0.06)
    assert isinstance(logs.scenes(Hypothesis(BASE))[0], Scene)


def test_what_the_other_folds_leave_open_does_not_run_away_on_the_one_left_out():
    """A column that only the last run knows: its weight from noise would be anything, its reach says how far."""
    random = np.random.default_rng(11)
    size = [1e-4, 1e-4, 10.0]
    columns = [np.column_stack([random.standard_normal(200), s * random.standard_normal(200)]) for s in size]
    target = [c @ [1.0, 0.0] + 0.1 * random.standard_normal(200) for c in columns]
    split = split_of(3, 200, 4)
    free = scored(columns, target, split)
    assert free.loss > 1e4
    fitted = replace(free.fitted, reach=(np.array([-np.inf, -0.01]), np.array([np.inf, 0.01])))
    assert selection.score(fitted, split).loss < 1.5 * fitted.cost  # (0.01 * 10)^2 a row on top of 0.1^2


def test_the_reach_of_the_timing_is_a_quarter_of_a_sample():
    low, high = fit(logs_of("cogging"), Hypothesis(BASE), iterations=0).reach
    assert low[10] == pytest.approx(-0.25e-3)
    assert high[10] == pytest.approx(0.25e-3)
    assert (high[:9] == np.inf).all()


def test_regressors_of_the_recordings_are_worked_out_in_the_pool(monkeypatch):
    """A generator would do it in the thread that reads it, one recording after the other."""
    logs, threads = logs_of("cogging"), set()
    worked_out = candidates.columns_of

    def columns_of(*arguments):
        threads.add(threading.current_thread())
        return worked_out(*arguments)

    monkeypatch.setattr(candidates, "columns_of", columns_of)
    Regressors(logs, Split.of(logs), [EFFECTS["air_drag"]], Hypothesis(BASE)).along(Hypothesis(BASE))
    assert threads
    assert threading.main_thread() not in threads
