"""How sure a name is beside what may be in its place, and what a diagnosis hands on to the planning of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from service.diagnosis.fit.selection import Standing
from tests.service.diagnosis.toy import named, split_of
from tests.service.injected import INJECTED, reports
from tests.service.subject import (
    EFFECTS,
    Hypothesis,
    Regressors,
    Scored,
    Selection,
    Split,
    diagnose,
    document,
    evidence,
    fit,
    selection,
    terms_of,
)
from tests.service.world import BASE, course, problem, stub

ROWS, BLOCKS = 400, 40
SPLIT = split_of(4, ROWS // 4, BLOCKS // 4)


def model(left: float, *names: str, size: int = 3, away: float = 0.0) -> Scored:
    """Leaves `left` squares, alike in all blocks but for `away` up and down."""
    alone = {"joints": (0,), "places": (0,), "amplitude": np.zeros((1, 1)), "nonlinear": ()}
    terms = tuple(stub(effect=named(name), **alone) for name in names)
    hypothesis = stub(terms=terms, base=stub(viscous=np.zeros(2)))
    return stub(  # pyright: ignore[reportReturnType]
        names=names, hypothesis=hypothesis, fitted=stub(hypothesis=hypothesis, free=np.ones(size, bool)),
        loss=left, blocks=left / BLOCKS + np.tile([away, -away], BLOCKS // 2),
    )  # fmt: skip


def standings(found: Selection, *refits: Scored, rows: int = ROWS, explained: bool = False) -> dict[str, Standing]:
    """By name. refits: what was found without each of its effects, in their order. explained: what is left is noise."""
    regressors = stub(problem=stub(count=rows), split=SPLIT)
    by_effect = dict(zip((term.effect for term in found.best.hypothesis.terms), refits, strict=True))
    made = evidence.standings(regressors, found, found.best, by_effect, lambda effect, joint: True, explained)
    return {effect.name: one for effect, one in made.items()}


NONE = model(4000.0, size=2)


@pytest.mark.parametrize(
    ("left", "size", "probability", "confusable"),
    [
        (0.0, 3, 0.5, ["twin"]),
        (0.0, 4, 1 / (1 + np.exp(-1.0)), ["twin"]),  # a parameter more: two squares
        (4.0, 3, 1 / (1 + np.exp(-2.0)), ["twin"]),
        (100.0, 3, 1.0, []),
        (-100.0, 3, 0.0, ["twin"]),
        (-71.0, 4, 1 / (1 + np.exp(-1.0)), ["twin"]),  # ahead with a parameter more: by a fiftieth of the gain at least
        (-73.0, 4, 0.0, ["twin"]),
    ],
)
def test_a_name_is_as_likely_as_it_does_better_than_what_may_be_in_its_place(left, size, probability, confusable):
    """left: squares that the other leaves more. A name that is sure has nothing that it cannot be told from."""
    taken, twin = model(ROWS, "taken"), model(ROWS + left, "twin", size=size)
    found = Selection(NONE, taken, [([taken, twin], taken)], {})
    (one,) = standings(found, NONE).values()
    assert one.probability == pytest.approx(probability, abs=1e-6)
    assert one.confusable == confusable


@pytest.mark.parametrize(("left", "likely"), [(-71.0, 1 / (1 + np.exp(1.0))), (-73.0, 1.0)])
def test_in_a_round_too_more_parameters_have_to_be_ahead_by_a_fiftieth_of_the_gain(left, likely):
    taken, other = model(ROWS, "taken"), model(ROWS + left, "other", size=4)
    (found,) = evidence.comparisons(Selection(NONE, taken, [([taken, other], taken)], {}), SPLIT, ROWS)
    assert [found.probability(name) for name in ("taken", "other")] == pytest.approx([1 - likely, likely], abs=1e-6)
    assert found.none == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("probability", "confusable", "first"), [(0.91, [], "early"), (0.89, [], "late"), (0.91, ["twin"], "late")]
)
def test_the_open_round_is_that_of_the_first_name_that_others_might_replace(probability, confusable, first):
    """By how it stands in the end; where all are sure, it is the first round."""
    early, late = model(2000.0, "early"), model(ROWS, "early", "late")
    path: list[tuple[list[Scored], Scored | None]] = [([early], early), ([late], late)]
    stands = {
        term.effect: Standing(NONE, *told, 0.0)
        for term, told in zip(late.hypothesis.terms, ((1.0, []), (probability, confusable)), strict=True)
    }
    found = replace(Selection(NONE, late, path, {}), standings=stands)
    rounds = evidence.comparisons(found, SPLIT, ROWS)
    chosen = evidence.undecided(found, rounds)
    assert chosen is rounds[("early", "late").index(first)]


def test_blocks_that_differ_leave_it_open():
    """The other is ahead in every other block: on half of the draws."""
    taken, other = model(ROWS, "taken", away=5.0), model(ROWS, "other", away=-5.0)
    found = Selection(NONE, taken, [([taken, other], taken)], {})
    assert 0.4 < standings(found, NONE)["taken"].probability < 0.6


def test_where_far_more_than_noise_is_left_a_difference_counts_by_that():
    taken, other = model(9.0 * ROWS, "taken"), model(9.0 * ROWS + 18.0, "other")
    found = Selection(NONE, taken, [([taken, other], taken)], {})
    assert standings(found, NONE)["taken"].probability == pytest.approx(1 / (1 + np.exp(-1.0)), abs=1e-6)


def test_a_name_is_ahead_by_standard_errors_over_blocks_of_the_next():
    """Half a square a block, up and down by one: half of the root of forty of them."""
    taken, near, far = model(ROWS, "taken"), model(1.05 * ROWS, "near", away=1.0), model(2.0 * ROWS, "far", away=1.0)
    made = standings(Selection(NONE, taken, [([taken, near, far], taken)], {}), NONE)["taken"]
    assert made.ahead == pytest.approx(0.5 * BLOCKS**0.5, rel=0.02)
    assert standings(Selection(NONE, taken, [([taken], taken)], {}), NONE)["taken"].ahead == np.inf


def test_an_effect_has_to_be_worth_it():
    """Three hundredths of the noise."""
    for more, least in ((0.04, 0.8), (0.02, 0.0)):
        taken, none = model(ROWS, "taken"), model((1 + more) * ROWS, size=3)
        probability = standings(Selection(none, taken, [([taken], taken)], {}), none)["taken"].probability
        assert least < probability < least + 0.2


@pytest.mark.parametrize("accepted", [True, False])
def test_what_does_better_and_is_not_accepted_is_no_rival(accepted):
    """Air drag does better than a true backlash beside a sloshing load, and is a share of what the load does."""
    taken, other = model(ROWS, "taken"), model(ROWS - 100.0, "other")
    effect, asked = taken.hypothesis.terms[0].effect, []

    def counts(model, instead):
        asked.append((model.names, instead))
        return accepted

    made = evidence.standings(
        stub(problem=stub(count=ROWS), split=SPLIT), Selection(NONE, taken, [([taken, other], taken)], {}), taken,
        {effect: NONE}, lambda effect, joint: True, False, counts=counts,
    )[effect]  # fmt: skip
    assert asked == [(("other",), ("other",))]
    assert made.probability == pytest.approx(0.0 if accepted else 1.0, abs=1e-6)
    assert made.confusable == (["other"] if accepted else [])


def test_what_has_the_effect_too_is_no_rival_of_it():
    """Two were added at once, of which one went again; the other couples hold the one that stayed."""
    taken, kept = model(ROWS, "offset", "spring"), model(ROWS + 1.0, "offset")
    couples = [taken, model(ROWS, "offset", "ripple"), model(ROWS + 1.0, "offset", "drag")]
    found = Selection(NONE, kept, [(couples, taken)], {id(taken): kept})
    assert standings(found, NONE) == {"offset": Standing(NONE, 1.0, [], np.inf)}


def test_what_was_tried_beside_a_name_and_not_taken_does_not_speak_for_it():
    """A delay for a filter of the torque: with a filter beside it, hardly a delay any more, it left least, and was
    sure."""
    delay, true = model(ROWS, "delay"), model(ROWS, "filter")
    path: list[tuple[list[Scored], Scored | None]] = [
        ([delay, true], delay),
        ([model(ROWS - 20.0, "delay", "filter")], None),
    ]
    (one,) = standings(Selection(NONE, delay, path, {}), NONE).values()
    assert one.probability == pytest.approx(0.5)
    assert one.confusable == ["filter"]


@pytest.mark.parametrize(
    ("left", "alone", "probability", "confusable"),
    [
        (0.0, 100.0, 0.5, ["other"]),
        (4.0, 100.0, 1 / (1 + np.exp(-2.0)), ["other"]),
        (-100.0, 100.0, 0.5, ["other"]),  # no less than even
        (100.0, 100.0, 1.0, []),
        (-100.0, -100.0, 0.0, ["other"]),  # it was even less before
    ],
)
def test_what_all_joints_may_have_alike_leaves_a_name_even(monkeypatch, left, alone, probability, confusable):
    """left, alone: squares that the other leaves more with one figure for all joints, and with one each."""
    taken, other, shared = model(ROWS, "taken"), model(ROWS + alone, "other", away=1e-3), model(ROWS + left, "other")
    monkeypatch.setattr(evidence, "in_common", lambda one, number, split: shared if one is other else None)
    made = standings(Selection(NONE, taken, [([taken, other], taken)], {}), NONE)["taken"]
    assert made.probability == pytest.approx(probability, abs=1e-6)
    assert made.confusable == confusable
    assert (made.ahead > 0) == (alone > 0), "by those that have a figure a joint"


def whole(left: float, name: str, *, figures: int = 1, size: int = 3, nonlinear: tuple[float, ...] = ()) -> Scored:
    """Of a mass at the platform, or what else the whole robot has one of, and not a joint."""
    made = model(left, name, size=size)
    made.hypothesis.terms[0].__dict__.update(joints=(), amplitude=np.zeros((1, figures)), nonlinear=nonlinear)
    return made


@pytest.mark.parametrize(
    ("taken", "left", "size", "told"),
    [
        (whole(ROWS, "mass"), 70.0, 3, False),
        (whole(ROWS, "mass"), 74.0, 3, True),
        (whole(ROWS, "mass"), 70.0, 4, True),
        (whole(ROWS, "mass", figures=2), 70.0, 3, True),
        (whole(ROWS, "mass", nonlinear=(1.0,)), 70.0, 3, True),
        (model(ROWS, "mass"), 70.0, 3, True),
    ],
)
def test_a_mass_is_told_from_a_scale_of_all_torques_by_a_fiftieth_of_what_it_takes(
    monkeypatch, taken, left, size, told
):
    """left: squares that one scale for all leaves more, of 3600 that the mass takes."""
    other, shared = model(ROWS + 400.0, "scale", away=1e-3), model(ROWS + left, "scale", size=size)
    monkeypatch.setattr(evidence, "in_common", lambda one, number, split: shared if one is other else None)
    made = standings(Selection(NONE, taken, [([taken, other], taken)], {}), NONE)["mass"]
    assert (made.probability, made.confusable) == ((pytest.approx(1.0), []) if told else (0.5, ["scale"]))
    assert made.simpler is None


@pytest.mark.parametrize(
    ("rival", "shared", "told"),
    [
        (whole(ROWS + 70.0, "mass"), 70.0, False),
        (whole(ROWS + 74.0, "mass"), 70.0, True),
        (whole(ROWS + 70.0, "mass"), 74.0, True),  # one scale for all does worse: the joints' scales differ
        (whole(ROWS + 70.0, "mass", size=4), 70.0, True),
        (model(ROWS + 70.0, "mass"), 70.0, True),  # of one joint
        (None, 70.0, True),
    ],
)
def test_a_scale_of_all_torques_is_told_from_a_mass_by_a_fiftieth_of_what_it_takes(monkeypatch, rival, shared, told):
    """shared: squares that one scale for all leaves more than one for each."""
    taken, alike = model(ROWS, "scale", size=5), model(ROWS + shared, "scale")
    monkeypatch.setattr(evidence, "in_common", lambda one, number, split: alike if one is taken else None)
    tried = [taken] if rival is None else [taken, rival]
    made = standings(Selection(NONE, taken, [(tried, taken)], {}), NONE)["scale"]
    assert (made.probability, made.confusable) == ((pytest.approx(1.0), []) if told else (0.5, ["mass"]))
    assert made.simpler is (None if told else rival)


@pytest.mark.parametrize(
    ("joints", "figures", "nonlinear", "told"),
    [((0,), 1, (), False), ((1,), 1, (), True), ((0,), 2, (), True), ((0,), 1, (1.0,), True)],
)
def test_a_mass_is_told_from_the_scale_that_the_last_joint_lacked_by_a_fiftieth_of_what_it_takes(
    monkeypatch, joints, figures, nonlinear, told
):
    """joints: of two, that another scale beside the first one's is offered on."""
    monkeypatch.setattr(evidence, "in_common", lambda *_: None)
    monkeypatch.setattr(evidence, "_in_its_place", lambda *_: [])
    both, other, fewer = model(ROWS, "scale", "mass"), model(ROWS + 70.0, "scale", "scale"), model(4000.0, "scale")
    mass = both.hypothesis.terms[1]
    for term, sits in ((both.hypothesis.terms[0], (1,)), (fewer.hypothesis.terms[0], (1,)), (mass, ()),
                       (other.hypothesis.terms[0], (1,)), (other.hypothesis.terms[1], joints)):  # fmt: skip
        term.__dict__.update(joints=sits, places=sits or (0,))
    other.hypothesis.terms[1].__dict__.update(amplitude=np.zeros((1, figures)), nonlinear=nonlinear)
    made = standings(Selection(NONE, both, [([both, other], both)], {}), model(4000.0, "mass"), fewer)["mass"]
    assert (made.probability, made.confusable) == ((pytest.approx(1.0), []) if told else (0.5, ["scale"]))
    assert made.simpler is None, "it has as many figures"


@pytest.mark.parametrize("better", [0, 1])
def test_a_model_that_was_found_in_two_ways_counts_once(monkeypatch, better):
    """A figure on each of two joints, found at once or one after the other."""
    monkeypatch.setattr(evidence, "in_common", lambda *_: None)
    taken = model(ROWS, "taken")
    ways = [model(ROWS + 2.0, "other"), model(ROWS + 2.0, "other", "other")]
    ways[better].blocks[:] -= 2.0 / BLOCKS
    ways[better].__dict__["loss"] = ROWS
    for way, joints in zip(ways, (((0, 1),), ((1,), (0,))), strict=True):
        for term, sits in zip(way.hypothesis.terms, joints, strict=True):
            term.__dict__.update(joints=sits, places=sits)
    made = standings(Selection(NONE, taken, [([taken, *ways], taken)], {}), NONE)["taken"]
    assert (made.probability, made.confusable) == (pytest.approx(0.5), ["other"])


def test_one_figure_for_all_joints_is_asked_of_what_is_in_its_place_wherever_that_stands(monkeypatch):
    """What both models have would have one figure in both."""
    asked = []

    def in_common(one, number, split):
        asked.append((one.names, one.names[number]))

    monkeypatch.setattr(evidence, "in_common", in_common)
    monkeypatch.setattr(evidence, "_in_its_place", lambda *_: [])
    both = model(ROWS, "shared", "taken")
    one, two = model(ROWS, "shared", "other"), model(ROWS, "other", "more", "shared")
    standings(Selection(NONE, both, [([both, one, two], both)], {}), model(900.0, "shared"), model(900.0, "taken"))
    beside = [(one.names, "other"), (two.names, "other"), (two.names, "more")]
    assert asked == [*beside, (both.names, "shared"), (both.names, "taken")], "what was found may have one too"


def test_a_name_that_led_while_others_were_in_the_gap_is_asked_again_beside_them(monkeypatch):
    """It won its round far ahead; beside what came later another does better."""
    first, both = model(2000.0, "stand-in"), model(ROWS, "stand-in", "later")
    alone, beside = model(900.0, "later"), model(0.9 * ROWS, "later", "true", away=0.01)
    path: list[tuple[list[Scored], Scored | None]] = [
        ([first, model(3000.0, "true", away=1.0)], first),
        ([both, model(2500.0, "stand-in", "other", away=1.0)], both),
    ]
    asked = []

    def in_its_place(regressors, fewer, effect, least, allows):
        asked.append((fewer, effect.name, least))
        return [beside]

    monkeypatch.setattr(evidence, "_in_its_place", in_its_place)
    made = standings(Selection(NONE, both, path, {}), alone, first)
    assert asked == [(alone, "stand-in", 0.5 * (900.0 - ROWS))], "beside the first all is fitted already"
    assert made["stand-in"].probability == pytest.approx(0.0, abs=1e-6)
    assert made["stand-in"].confusable == ["true"]
    assert made["stand-in"].ahead < -10.0
    assert made["later"].probability == pytest.approx(1.0)
    assert made["later"].confusable == []
    assert made["later"].ahead > 10.0


@pytest.mark.parametrize(("joints", "again"), [((0,), []), ((0, 1), ["in question"])])
def test_a_name_is_asked_again_beside_what_has_gained_a_joint_since(monkeypatch, joints, again):
    """Mass at the platform beside friction on two joints, and the third's later: a scale of all torques was behind it
    before, as it could not make up for that friction, and is as good beside all."""

    def wider(scored: Scored) -> Scored:
        for term in scored.hypothesis.terms:
            if term.effect.name == "friction":
                term.__dict__.update(joints=joints, places=joints)
        return scored

    asked = []
    monkeypatch.setattr(evidence, "in_common", lambda *_: None)
    monkeypatch.setattr(
        evidence, "_in_its_place", lambda regressors, fewer, effect, *_: asked.append(effect.name) or ()
    )
    began, taken = model(2000.0, "friction"), model(900.0, "friction", "in question")
    best = wider(model(ROWS, "friction", "in question"))
    found = Selection(NONE, best, [([began], began), ([taken], taken)], {})
    standings(found, model(2500.0, "in question"), wider(model(1500.0, "friction")))
    assert asked == ["friction", *again]


@pytest.mark.parametrize(
    ("explained", "size", "more", "taken"),
    [(True, 4, 0.0, True), (False, 4, 0.0, False), (True, 6, 0.0, False), (False, 6, -200.0, True)],
)
def test_where_noise_is_left_the_likelier_is_better_and_elsewhere_what_blocks_tell(
    monkeypatch, explained, size, more, taken
):
    """size: figures of the other, of which that in question has five: two squares each tell. more: squares that it
    leaves more, in the same blocks."""
    both, alone = model(ROWS, "in question", "later", size=5), model(900.0, "later")
    other = model(ROWS + more, "later", "other", size=size)
    monkeypatch.setattr(evidence, "_in_its_place", lambda regressors, fewer, *_: [other] if fewer is alone else [])
    made = standings(Selection(NONE, both, [], {}), alone, model(950.0, "in question"), explained=explained)
    assert (made["in question"].better is other) is taken
    assert made["later"].better is None


def exchanged(left: float) -> tuple[Selection, Scored, Scored]:
    """Two were found, and then another in place of the first of them; what was taken before leaves `left` squares more.
    The search, and what was found without either of the two that stand."""
    first, old, better = model(900.0, "old"), model(ROWS + left, "old", "later"), model(ROWS, "later", "new")
    fewer = model(900.0, "later")
    path: list[tuple[list[Scored], Scored | None]] = [([first], first), ([better, old], better)]
    return Selection(NONE, better, path, {id(first): fewer}), model(950.0, "new"), fewer


def test_what_was_taken_before_another_took_its_place_is_told_beside_that(monkeypatch):
    """It stands before what was found after it."""
    monkeypatch.setattr(evidence, "_in_its_place", lambda *_: [])
    found, *refits = exchanged(2.0)
    made = standings(found, *refits)
    assert (made["new"].probability, made["new"].confusable) == (pytest.approx(1 / (1 + np.exp(-1.0))), ["old"])
    assert (made["later"].probability, made["later"].confusable) == (pytest.approx(1.0), [])
    _, last = evidence.comparisons(found, SPLIT, ROWS)
    likely = 1 / (1 + np.exp(-1.0))
    assert [last.probability(name) for name in ("new", "old", "later")] == pytest.approx([likely, 1 - likely, 0.0])


def test_an_effect_may_be_added_again():
    """On another joint, or of another order."""
    before, later = model(ROWS, "ripple", "drag"), model(ROWS, "drag", "ripple", "ripple")
    (found,) = selection.added(later, before)
    assert found is later.hypothesis.terms[-1]


def test_all_is_told_that_a_model_has_instead(monkeypatch):
    """Also what was found before the round that it is of, and is superfluous now."""
    monkeypatch.setattr(evidence, "_in_its_place", lambda *_: [])
    first, other, right = model(900.0, "gone"), model(ROWS + 2.0, "gone", "other"), model(ROWS, "right")
    path: list[tuple[list[Scored], Scored | None]] = [([first], first), ([model(ROWS, "gone", "right"), other], first)]
    found = Selection(NONE, right, path, {})
    assert standings(found, NONE)["right"].confusable == ["gone", "other"]


@pytest.mark.parametrize(
    ("names", "takes"),
    [(("a", "b", "new"), True), (("new", "b", "a"), True), (("b", "a"), False), (("new", "b"), False),
     (("new", "other", "a", "b"), False), (("new", "other", "a"), False)],
)  # fmt: skip
def test_what_is_better_has_one_effect_in_place_of_another_in_whatever_order(monkeypatch, names, takes):
    both = model(ROWS, "a", "b", "old", away=1.0)
    other = model(0.5 * ROWS, *names)
    fewer = model(900.0, "a", "b")
    monkeypatch.setattr(evidence, "_in_its_place", lambda regressors, fewer, *_: [])
    path: list[tuple[list[Scored], Scored | None]] = [([both, other], both)]
    refits = model(950.0, "b", "old"), model(950.0, "a", "old"), fewer
    made = standings(Selection(NONE, both, path, {}), *refits)
    assert (made["old"].better is other) is takes


def test_what_fell_and_what_was_found_are_in_nobodys_place():
    kept, fell = model(ROWS, "kept"), model(ROWS, "kept", "fell")
    path: list[tuple[list[Scored], Scored | None]] = [
        ([model(ROWS, "kept"), model(ROWS, "fell"), model(1000.0, "far", away=0.1)], kept),
        ([fell], fell),
    ]
    regressors = stub(problem=stub(count=ROWS), split=SPLIT)
    found = Selection(NONE, fell, path, {})
    made = evidence.standings(regressors, found, kept, {named("kept"): NONE}, lambda *_: True, False)[named("kept")]
    assert (made.probability, made.confusable) == (pytest.approx(1.0), [])
    assert made.ahead > 100.0, "of the one that is far"


def names_in_place_of(name: str, least: float, rivals: Sequence[str]) -> list[tuple[str, ...]]:
    runs, random = [course(seed, 2.0) for seed in (1, 2)], np.random.default_rng(3)
    torques = [
        sum(reports(one, seed, 2.0) - run.torque for one in ("torque_offset", "cogging"))
        + run.torque + 0.3 * random.standard_normal(run.torque.shape)
        for seed, run in zip((1, 2), runs, strict=True)
    ]  # fmt: skip
    logs, start = problem(runs, torques), Hypothesis(BASE)
    split = Split.of(logs)
    other = {"torque_offset": "cogging", "cogging": "torque_offset"}[name]
    fewer = selection.score(fit(logs, Hypothesis(BASE, (INJECTED[other].term(other),))), split)
    regressors = Regressors(logs, split, [EFFECTS[one] for one in (name, *rivals)], start)
    whole = selection.score(fit(logs, Hypothesis(BASE, tuple(INJECTED[n].term(n) for n in (other, name)))), split)
    gain = fewer.loss - whole.loss
    found = list(evidence._in_its_place(regressors, fewer, EFFECTS[name], least * gain, lambda *_: True))
    for one in found:
        assert one.loss < fewer.loss - least * gain
        again = fit(logs, one.hypothesis)
        assert again.cost == pytest.approx(one.fitted.cost, rel=1e-3), "all are fitted beside it"
    return [one.names for one in found]


def test_what_may_be_in_its_place_is_fitted_beside_what_stays():
    """A constant torque is friction that differs by direction; drag does nothing for it."""
    rivals = ("asymmetric_friction", "air_drag")
    assert names_in_place_of("torque_offset", 0.5, rivals) == [("cogging", "asymmetric_friction")]
    assert names_in_place_of("torque_offset", 1.1, rivals) == []


def test_the_rivals_are_whole_models_of_the_round_that_is_decided_least(findings: diagnose.Findings) -> None:
    made = document.document(findings)
    assert len(made.rivals) > 1
    assert [rival.shrink for rival in made.rivals] == sorted((rival.shrink for rival in made.rivals), reverse=True)
    best = made.rivals[0]
    assert best.shrink == next(one.shrink for one in made.ranking if one.name == best.effects[-1].name)
    tried = findings.selection.path[0][0]
    scored = next(one for one in tried if one.names[-1] == best.effects[-1].name)
    term = terms_of(findings.robot.model_copy(update={"effect": best.effects}))[-1]
    np.testing.assert_allclose(term.amplitude, scored.hypothesis.terms[-1].amplitude, rtol=1e-6)
    np.testing.assert_allclose(term.nonlinear, scored.hypothesis.terms[-1].nonlinear, rtol=1e-6)
