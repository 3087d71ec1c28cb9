"""A name falls when what it explains does not carry over: runs left out, a log kept out, quantities left open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from schemas.diagnosis import Caution
from service.diagnosis import pipeline
from service.diagnosis.evidence import earned as judged
from service.diagnosis.evidence.earned import earned, together
from service.diagnosis.evidence.values import Valued
from service.diagnosis.fit.selection import Standing
from service.diagnosis.pipeline import Judged
from service.identification.correlated import WHITE
from tests.service.injected import reports
from tests.service.subject import (
    EFFECTS,
    Hypothesis,
    Nonlinear,
    Parameters,
    Problem,
    Regressors,
    Selection,
    Split,
    Term,
    fit,
    selection,
)
from tests.service.world import BASE, course, problem, stub

SECONDS, NOISE = 4.0, 0.3


def logs(seeds: tuple[int, ...], *names: str) -> Problem:
    """Runs with these effects, each put in by other code."""
    runs = [course(seed, SECONDS) for seed in seeds]
    random = np.random.default_rng([*seeds, 1])
    torques = [
        r.torque + sum(reports(n, s, SECONDS) - r.torque for n in names) for r, s in zip(runs, seeds, strict=True)
    ]
    return problem(runs, [torque + NOISE * random.standard_normal(torque.shape) for torque in torques])


def chosen(made: Problem, *terms: Term) -> Selection:
    """A search that took these terms in one step."""
    split = Split.of(made)
    none = selection.score(fit(made, Hypothesis(BASE)), split)
    best = selection.score(fit(made, Hypothesis(BASE, terms)), split)
    return Selection(none, best, [([best], best)], {})


def judge(made: Problem, found: Selection, *kept_out: Problem, limit: float = 1e3) -> tuple[Selection, list[Caution]]:
    """Beside air drag, which is not there. limit: rms that noise may leave."""
    regressors = Regressors(made, Split.of(made), [EFFECTS["air_drag"]], found.none.hypothesis)
    return earned(regressors, found, kept_out, lambda effect, joint: True, limit, lambda _: None)


def codes(found: list[Caution]) -> list[tuple[str, str | None, str | None]]:
    return [(one.code, one.effect, one.run) for one in found]


SPRING = Term(EFFECTS["joint_spring"], (0,), np.zeros((1, 2)), ())
DRAG = Term(EFFECTS["air_drag"], (), np.zeros((1, 1)), ())
RIPPLE = Term(EFFECTS["cogging"], (1,), np.zeros((1, 2)), (2.0,))
OFFSET = Term(EFFECTS["torque_offset"], (1,), np.zeros((1, 1)), ())
GREASE = Term(EFFECTS["nonlinear_viscous_friction"], (0,), np.full((1, 1), 0.5), (2.0,))
DELAY = Term(EFFECTS["torque_delay"], (), np.zeros((1, 0)), (0.0005,))


def test_a_name_that_shrinks_the_gap_everywhere_stands():
    made = logs((1, 2, 3), "joint_spring")
    found = chosen(made, SPRING)
    kept, fallen = judge(made, found, logs((4,), "joint_spring"))
    assert (kept.best, kept.path) == (found.best, found.path)
    assert kept.standings == {SPRING.effect: Standing(found.none, 1.0, [], np.inf)}
    assert fallen == []


def test_a_delay_beside_an_effect_is_worth_what_the_gap_grows_by_when_it_goes():
    """It has no amplitude to take away: the other has to stay and be fitted anew."""
    made = logs((1, 2, 3), "joint_spring", "torque_delay")
    kept, fallen = judge(made, chosen(made, SPRING, DELAY))
    assert fallen == []
    alone = chosen(made, SPRING).best
    assert kept.standings[DELAY.effect].without.loss == pytest.approx(alone.loss, rel=1e-3)
    assert alone.loss < 0.5 * kept.none.loss


def test_a_name_that_shrinks_nothing_falls_and_the_others_stay():
    made = logs((1, 2, 3), "joint_spring")
    found = chosen(made, SPRING, RIPPLE)
    kept, fallen = judge(made, found)
    assert kept.best.names == ("joint_spring",)
    assert [one.effect for one in fallen] == ["cogging"]
    assert fallen[0].code in ("no_shrink", "left_open")
    assert kept.path[-1][1] is None  # nothing was taken there
    assert kept.standings[SPRING.effect].without is found.none, "without what fell"


def test_a_name_that_a_log_kept_out_does_not_bear_out_falls_by_that_logs_name():
    made, other = logs((1, 2, 3), "joint_spring"), logs((4,))
    kept, fallen = judge(made, chosen(made, SPRING), other)
    assert kept.best.names == ()
    assert codes(fallen) == [("no_shrink_on", "joint_spring", "run_0")]
    assert fallen[0].share is not None
    assert fallen[0].share < 0


def test_a_log_kept_out_that_does_not_show_it_says_nothing():
    made = logs((1, 2, 3), "cogging")
    slow = problem([course(4, SECONDS, 1e-3)], [course(4, SECONDS, 1e-3).torque])
    assert len(judge(made, chosen(made, RIPPLE), slow)[1]) == 0


def test_a_delay_that_may_as_well_be_none_is_left_open():
    """Runs of noise alone: whatever shift fits best has no sign."""
    made = logs((1, 2, 3))
    kept, fallen = judge(made, chosen(made, DELAY))
    assert kept.best.names == ()
    assert fallen[0].effect == "torque_delay"


@pytest.mark.parametrize(("relative", "stands"), [(0.9, True), (1.1, False)])
def test_a_shape_that_may_be_any_is_no_finding(monkeypatch, relative, stands):
    """relative: error of the exponent to what a draw from its range scatters by. Seen: an exponent of 0.6 +- 1.7 at
    100 %, of friction that turned over more slowly than the base model's."""
    made = logs((1, 2, 3), "nonlinear_viscous_friction")
    found = chosen(made, GREASE)
    exponent = GREASE.effect.nonlinear["p"]
    errors = judged.statistics.standard_errors

    def of(fitted, split, noise):
        result = errors(fitted, split, noise)
        if fitted.hypothesis.terms:
            result[-1] = relative * (exponent.high - exponent.low) / 12**0.5
        return result

    monkeypatch.setattr(judged.statistics, "standard_errors", of)
    kept, fallen = judge(made, found)
    assert kept.best.names == (("nonlinear_viscous_friction",) if stands else ())
    assert [(one.code, one.quantity) for one in fallen] == ([] if stands else [("any_shape", "p")])


def test_where_no_quantity_is_told_from_nothing_its_shape_is_not_asked_about(monkeypatch):
    made = logs((1, 2, 3), "nonlinear_viscous_friction")
    errors = judged.statistics.standard_errors
    monkeypatch.setattr(judged.statistics, "standard_errors", lambda *fit: np.full(len(errors(*fit)), 1e3))
    kept, fallen = judge(made, chosen(made, GREASE))
    assert kept.best.names == ()
    assert [(one.code, one.quantity) for one in fallen] == [("left_open", None)]


@pytest.mark.parametrize(
    ("errors", "quantity"),
    [((1.1, 1.1), None), ((1.2, 0.5), "p"), ((0.5, 1.2), "q"), ((1.2, 1.2), "p")],
)
@pytest.mark.parametrize("held", [{}, {"fixed": True}, {"minor": True}])
def test_a_shape_is_any_where_a_draw_from_its_range_says_as_much(errors, quantity, held):
    """Of two quantities from 3 to 7: 4 over the root of 12. held: what is not searched, or hardly matters, is never
    said to be open."""
    shape = Nonlinear("", "of p", grid=(4.0,), low=3.0, high=7.0, **held), Nonlinear("", "of q", (4.0,), 3.0, 7.0)
    effect = stub(nonlinear=dict(zip("pq", shape, strict=True)))
    found = judged._any_shape(effect, np.array(errors))
    assert found == ("q" if held and errors[1] > 1.15 else None if held else quantity)


@pytest.mark.parametrize(
    ("offsets", "seconds", "stands"),
    [
        ((2.0, 2.0, 2.0), SECONDS, True),
        ((2.0, 2.1, 0.9), SECONDS, False),
        ((2.0, 2.0, 0.9), 1.6, False),
        ((2.0, 2.0, 0.9), 0.6, True),  # holds a twentieth of what tells it
    ],
)
def test_a_figure_that_changes_from_run_to_run_is_a_stand_in(offsets, seconds, stands):
    """seconds: of the last run."""
    runs = [course(1, SECONDS), course(2, SECONDS), course(3, seconds)]
    random = np.random.default_rng(5)
    pushed = [
        run.torque + [0.0, offset, 0.0] + NOISE * random.standard_normal(run.torque.shape)
        for run, offset in zip(runs, offsets, strict=True)
    ]
    made = problem(runs, pushed)
    kept, fallen = judge(made, chosen(made, OFFSET))
    assert kept.best.names == (("torque_offset",) if stands else ())
    assert codes(fallen) == ([] if stands else [("varies", "torque_offset", "run_2")])


@pytest.mark.parametrize(("left", "stands"), [(0.98, True), (0.99, False)])
def test_a_name_is_worth_more_than_one_and_a_half_percent(left, stands):
    """left: of the gap, on data left out, everywhere alike."""
    made = logs((1, 2, 3), "joint_spring")
    found = chosen(made, SPRING)
    best = replace(found.best, residuals=[left * one for one in found.none.residuals])
    kept, fallen = judge(made, replace(found, best=best, path=[([best], best)]))
    assert kept.best.names == (("joint_spring",) if stands else ())
    assert codes(fallen) == ([] if stands else [("no_shrink", "joint_spring", None)])


@pytest.mark.parametrize(
    ("term", "error", "stands"),
    [
        (replace(SPRING, amplitude=np.array([[-3.0, 0.0]])), 1.0, True),
        (replace(SPRING, amplitude=np.array([[0.0, -3.0]])), 1.0, True),
        (replace(SPRING, amplitude=np.array([[1.5, 1.5]])), 1.0, False),
        (replace(DELAY, nonlinear=(-0.002,)), 0.0009, True),
        (replace(DELAY, nonlinear=(-0.002,)), 0.0011, False),
    ],
)
def test_it_is_open_whether_there_is_any_of_what_is_within_its_own_error(monkeypatch, term, error, stands):
    """One of several amplitudes is enough; without amplitudes the shape has to be known to a half."""
    hypothesis = Hypothesis(BASE, (term,))
    errors = np.full(len(Parameters(hypothesis).values), error)
    monkeypatch.setattr(judged.statistics, "standard_errors", lambda fitted, split, noise: errors)
    said = judged._open(stub(hypothesis=hypothesis, fitted=None), stub(), term.effect, WHITE)
    assert (said is None) == stands


@pytest.mark.parametrize(("worse", "stands"), [(0.0, False), (0.5, True)])
def test_a_name_that_others_would_do_as_well_as_falls(worse, stands):
    """worse: share by which the rivals' loss is above that of the name. Level with it, each is ahead on every other
    block: on nearly every draw one of them wins."""
    made = logs((1, 2, 3), "joint_spring")
    split, found = Split.of(made), chosen(made, SPRING)
    way = 0.01 * found.best.blocks.mean() * (-1.0) ** np.arange(split.blocks)
    rivals = [
        replace(
            found.best,
            fitted=replace(found.best.fitted, hypothesis=Hypothesis(BASE, (term,))),
            blocks=found.best.blocks * (1 + worse) + sign * way,
        )
        for term, sign in ((RIPPLE, 1), (OFFSET, -1))
    ]
    kept, fallen = judge(made, replace(found, path=[([found.best, *rivals], found.best)]))
    assert kept.best.names == (("joint_spring",) if stands else ())
    assert codes(fallen) == ([] if stands else [("rivalled", "joint_spring", None)])
    assert all(one.share is not None and 0 < one.share < 0.3 and one.joints == [1] for one in fallen)


@pytest.mark.parametrize("possible", [True, False])
def test_what_is_told_to_be_better_takes_the_place_of_what_was_taken_before_the_rest_was_known(monkeypatch, possible):
    """A ripple takes some of what the spring does; once the drag is known the spring does better. possible: it can be
    at all."""
    made = logs((1, 2, 3), "joint_spring", "air_drag")
    split = Split.of(made)
    none, first, both, right = (
        selection.score(fit(made, Hypothesis(BASE, terms)), split)
        for terms in ((), (OFFSET,), (OFFSET, DRAG), (DRAG, SPRING))
    )
    if not possible:
        monkeypatch.setattr(judged, "fault_of", lambda *_: "driven by its spring")
    found = Selection(none, both, [([first], first), ([both], both)], {})
    regressors = Regressors(made, split, [SPRING.effect], Hypothesis(BASE))
    kept, fallen = earned(regressors, found, (), lambda effect, joint: True, 1e3, lambda _: None)
    assert kept.names == (("air_drag", "joint_spring") if possible else ("air_drag",))
    assert [one.effect for one in fallen] == ([] if possible else ["torque_offset"])
    assert kept.best.loss == pytest.approx(right.loss if possible else kept.best.loss, rel=0.01)
    before, tried, taken = list(kept.rounds())[-1] if possible else (none, [], None)
    if possible:
        assert (before.names, [one.names for one in tried], taken) == (
            ("air_drag",), [kept.names, both.names], kept.best,
        )  # fmt: skip


@pytest.mark.parametrize("possible", [True, False])
def test_what_is_simpler_and_as_good_takes_the_place_of_what_was_taken(monkeypatch, possible):
    """And where it cannot be, what was taken stands."""
    made = logs((1, 2, 3), "air_drag", "cogging")
    taken, other = (chosen(made, RIPPLE, term).best for term in (OFFSET, DRAG))
    found = Selection(chosen(made, RIPPLE).none, taken, [([taken], taken)], {})
    asked = []

    def standings(regressors, selection, best, refits, allows, explained, seen, counts):
        asked.append(best.names)
        simpler = {"torque_offset": other}
        return {effect: Standing(refit, 0.5, [], np.inf, None, simpler.get(effect.name))
                for effect, refit in refits.items()}  # fmt: skip

    monkeypatch.setattr(judged.rivals, "standings", standings)
    monkeypatch.setattr(judged, "fault_of", lambda *_: None if possible else "driven by its spring")
    monkeypatch.setattr(judged, "_borne_out", lambda regressors, selection, best, *_: (
        best, {term.effect: selection.none for term in best.hypothesis.terms}, []))  # fmt: skip
    kept, fallen = judge(made, found)
    assert asked == ([taken.names, other.names] if possible else [taken.names])
    assert (kept.names, fallen) == (other.names if possible else taken.names, [])


def test_of_two_that_are_each_simpler_than_the_other_neither_takes_the_place_again(monkeypatch):
    """By measures that differ: it has to end."""
    made = logs((1, 2, 3), "air_drag", "cogging")
    one, other = (chosen(made, RIPPLE, term).best for term in (OFFSET, DRAG))
    asked = []

    def standings(regressors, selection, best, refits, allows, explained, seen, counts):
        asked.append(best.names)
        simpler = {"torque_offset": other, "air_drag": one}
        return {effect: Standing(refit, 0.5, [], np.inf, None, simpler.get(effect.name))
                for effect, refit in refits.items()}  # fmt: skip

    monkeypatch.setattr(judged.rivals, "standings", standings)
    monkeypatch.setattr(judged, "_borne_out", lambda regressors, selection, best, *_: (
        best, {term.effect: selection.none for term in best.hypothesis.terms}, []))  # fmt: skip
    found = Selection(chosen(made, RIPPLE).none, one, [([one], one)], {})
    assert judge(made, found)[0].names == other.names
    assert asked == [one.names, other.names]


def stood(
    made: Problem, found: Selection, monkeypatch, limit: float = 1e3, /, **chances: tuple[float, float]
) -> tuple[str, ...]:
    """Names that stand, each with a probability and the standard errors that it is ahead."""

    def standings(regressors, selection, best, refits, allows, explained, seen, counts):
        return {effect: Standing(refit, chances[effect.name][0], [], chances[effect.name][1])
                for effect, refit in refits.items()}  # fmt: skip

    monkeypatch.setattr(judged.rivals, "standings", standings)
    kept, fallen = judge(made, found, limit=limit)
    assert {one.code for one in fallen} <= {"rivalled"}
    assert set(kept.standings) == {EFFECTS[name] for name in kept.names}
    return kept.names


def test_a_name_less_likely_than_what_may_be_in_its_place_falls_and_leaves_the_others(monkeypatch):
    """Also where next to nothing is left beside it."""
    made = logs((1, 2, 3), "joint_spring", "cogging")
    found = chosen(made, SPRING, RIPPLE)
    for spring, ripple, names in (
        (0.51, 0.49, ("joint_spring",)), (0.49, 0.51, ("cogging",)), (0.51, 0.51, ("joint_spring", "cogging")),
        (0.0, 0.49, ()),
    ):  # fmt: skip
        chances = {"joint_spring": (spring, np.inf), "cogging": (ripple, np.inf)}
        assert stood(made, found, monkeypatch, **chances) == names


@pytest.mark.parametrize(("limit", "asked"), [(0.9, True), (1.1, False)])
def test_where_more_than_noise_is_left_effects_are_asked_given_discrepancies(monkeypatch, limit, asked):
    """limit: over what is left. What they do not accept is rejected, with how much of it shifts explain."""
    made = logs((1, 2, 3), "joint_spring", "cogging")
    found = chosen(made, SPRING, RIPPLE)
    spring = selection.score(fit(made, Hypothesis(BASE, (SPRING,))), Split.of(made))

    def accepted(regressors, search, allows, progress):
        assert search is found
        rejected = [(RIPPLE.effect, found.best, 5.0)]
        return stub(
            best=spring,
            rejected=rejected,
            opened=stub(noise=WHITE),
            beside=lambda _: stub(cautions=list, noise=WHITE),
            seen=lambda model: model,
            least=lambda *_: np.inf,
            continued=lambda search: search,
        )

    monkeypatch.setattr(judged, "accepted", accepted)
    kept, fell = judge(made, found, limit=limit * (found.best.loss / made.count) ** 0.5)
    assert kept.names == (("joint_spring",) if asked else ("joint_spring", "cogging"))
    told = [(one.code, one.effect, one.joints, one.share) for one in fell]
    assert told == ([("not_its_own", "cogging", [2], 0.2)] if asked else [])


def test_beside_a_stranger_a_run_may_have_another_figure_by_what_is_left(monkeypatch):
    """What is left of that run, not the effect, has it otherwise: what it takes of all runs is its own."""
    made = logs((1, 2, 3), "joint_spring")
    found = chosen(made, SPRING)
    monkeypatch.setattr(judged, "_varies", lambda *_: Caution(code="varies", advice="record_more"))
    every = stub(
        best=found.best,
        rejected=[],
        opened=stub(noise=WHITE),
        beside=lambda _: stub(cautions=list, noise=WHITE),
        seen=lambda model: model,
        least=lambda *_: np.inf,
        continued=lambda search: search,
    )
    monkeypatch.setattr(judged, "accepted", lambda *_: every)
    assert judge(made, found)[0].names == ()
    assert judge(made, found, limit=0.1)[0].names == ("joint_spring",)


@pytest.mark.parametrize("given", [0, 1])
def test_what_the_description_says_does_not_have_to_earn_it(given):
    made = logs((1, 2, 3))
    found = chosen(made, RIPPLE)
    kept, fallen = judge(made, replace(found, none=found.best) if given else found)
    assert len(fallen) == 1 - given
    assert kept.best.names == ("cogging",) * given


@pytest.mark.parametrize(
    ("left", "vague", "stands"),
    [
        ((0.85, 0.85, 0.85), True, True),
        ((0.95, 0.95, 0.95), False, True),
        ((0.95, 0.95, 0.95), True, False),  # little, where the noise is not known
        ((1.02, 1.02, 1.02), False, False),
        ((0.6, 1.1, 1.1), False, False),  # in one of three runs: smaller on the whole by chance
    ],
)
def test_all_names_fall_where_together_they_leave_the_gap_as_it_is(left, vague, stands):
    """left: of the gap, on stretches that nothing was chosen by, a run."""
    made = logs((1, 2, 3), "joint_spring")
    split, found = Split.of(made), chosen(made, SPRING, RIPPLE)
    after = [share * one for share, one in zip(left, found.none.residuals, strict=True)]
    walked = [stub(residuals=after)] * split.folds
    kept, fallen = together(made, split, found, walked, 0, vague)
    assert kept.best.names == (("joint_spring", "cogging") if stands else ())
    assert codes(fallen) == ([] if stands else [("no_shrink", name, None) for name in ("joint_spring", "cogging")])
    whole = 1 - np.sqrt(np.mean(np.square(left)))
    assert all(one.share == pytest.approx(whole, abs=0.01) for one in fallen)
    kept, fallen = together(made, split, found, walked, 2, vague)
    assert (kept, fallen) == (found, []), "the description's own do not have to earn it"


@pytest.mark.parametrize(("left", "stands"), [(0.9, True), (1.1, False)])
def test_names_fall_whose_values_leave_a_larger_gap_once_the_discrepancies_are_gone(monkeypatch, left, stands):
    """The values are fitted beside discrepancies, which the corrected description does not have. left: of the gap."""
    made = logs((1, 2, 3), "joint_spring")
    split, found = Split.of(made), chosen(made, SPRING)
    values = Valued(replace(found.best, residuals=[left * one for one in found.none.residuals]), np.zeros(1))
    plain = Valued(found.none, np.zeros(0))
    monkeypatch.setattr(Valued, "of", lambda problem, split, selection: values if selection.best.names else plain)
    before = Judged(replace(found, noise=object()), [found.best] * split.folds, [])
    kept, valued = pipeline._valued(made, split, before, 0)
    assert kept.selection.best.names == (("joint_spring",) if stands else ())
    assert valued is (values if stands else plain)
    assert kept.chosen == [valued.best] * split.folds
    assert codes(kept.cautions) == ([] if stands else [("no_shrink", "joint_spring", None)])
    assert all(one.share == pytest.approx(1 - left, abs=0.01) for one in kept.cautions)


def test_a_search_is_told_as_if_it_had_stopped_before_what_fell():
    one, two, three = (stub(names=names) for names in (("a",), ("a", "b"), ("a", "b", "c")))
    path = [([one], one), ([two], two), ([three], three)]
    cut = judged._cut(Selection(stub(names=()), three, path, {}), one)
    assert (cut.best, cut.path) == (one, [([one], one), ([two], None)])


@pytest.mark.parametrize(
    ("keeps", "takes", "told"), [(0.51, 0.9, []), (0.49, 0.9, ["rivalled", "misplaced"]), (0.49, 0.2, ["rivalled"])]
)
def test_a_joint_elsewhere_takes_a_name_that_keeps_nothing_and_is_told_where_it_explains_the_rest(
    monkeypatch, keeps, takes, told
):
    made = logs((1, 2, 3), "joint_spring")
    found = chosen(made, SPRING)
    fewer, best = found.none, found.best

    class Placed:
        """`keeps` of what the spring takes is its own; joint 2 elsewhere takes `takes` of what is left without it."""

        def __init__(self, problem, split, model):
            assert model is best

        def beside(self, model, joint=None):
            if joint is not None:
                return model.loss - (takes if joint == 1 else 0.1) * (model.loss - made.count)
            return best.loss if model is best else best.loss + keeps * (fewer.loss - best.loss)

    monkeypatch.setattr(judged, "Placement", Placed)
    regressors = Regressors(made, Split.of(made), [EFFECTS["air_drag"]], found.none.hypothesis)
    stands, refits, fallen = judged._where_joints_are(regressors, found, best, {SPRING.effect: fewer}, [])
    assert [one.code for one in fallen] == told
    assert stands.names == (() if told else ("joint_spring",))
    assert list(refits) == ([] if told else [SPRING.effect])
    if "misplaced" in told:
        assert (fallen[1].joints, fallen[1].share) == ([2], 0.9)
