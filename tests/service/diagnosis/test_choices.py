"""What a search decides, on fits made up for it: each rule just inside and just outside of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from service.identification.correlated import WHITE
from tests.service.subject import EFFECTS, Hypothesis, Regressors, Split, Term, candidates, selection
from tests.service.world import BASE, course, stub
from tests.service.world import problem as logged

BLOCKS = 50


def made(loss: float, size: int = 1, noise: float = 0.0, term: object = None, name: str = ""):
    """A fit of `size` parameters; noise: of its blocks, about their mean."""
    away = np.random.default_rng(1).standard_normal(BLOCKS)
    away = noise * (away - away.mean()) / away.std()
    result = stub(
        name=name, loss=loss, blocks=loss / BLOCKS + away, fitted=stub(free=np.ones(size, bool)),
        hypothesis=stub(terms=[term]), light=lambda problem: result, whole=lambda: result,
    )  # fmt: skip
    return result


@pytest.mark.parametrize(
    ("loss", "noise", "size", "leads"),
    [
        (1009.9, 2.0, 1, "small"),  # 2 % of what is gained, and not told apart
        (1010.1, 2.0, 1, "large"),
        (1009.9, 0.74, 1, "small"),
        (1009.9, 0.66, 1, "large"),  # told apart by two standard errors, 9.9 / (0.66 sqrt(50))
        (1009.9, 2.0, 3, "large"),
    ],
)
def test_the_one_with_fewer_parameters_leads_where_it_does_as_well(loss, noise, size, leads):
    small, large = made(loss, size, noise, name="small"), made(1000.0, 3, name="large")
    third = made(1200.0, 1, name="third")
    order: list[Any] = selection.simplest_first([third, small, large], made(1500.0))
    assert order[0].name == leads
    assert order[2] is third


@pytest.mark.parametrize(("loss", "leads"), [(103.9, "small"), (104.1, "large")])
def test_of_two_that_are_told_apart_a_parameter_is_worth_two_rows(loss, leads):
    small, large = made(loss, 1, name="small"), made(100.0, 3, name="large")
    order: list[Any] = selection.simplest_first([small, large], made(110.0))
    assert order[0].name == leads


@pytest.mark.parametrize(("scatter", "worth"), [(4.04, True), (5.66, False)])
def test_an_addition_stands_out_of_three_standard_errors(scatter, worth):
    """A tenth of the noise gained in 1000 rows, 2 a block; 3.5 and 2.5 of them."""
    without = 22.0 + np.tile([scatter, -scatter], BLOCKS // 2)
    assert selection.worth(np.full(BLOCKS, 20.0), without, without, 1000) is worth


@pytest.mark.parametrize(
    ("rough", "lacks", "single"), [(False, 0.049, True), (False, 0.051, False), (True, 0.29, True), (True, 0.31, False)]
)
def test_an_effect_on_all_joints_has_to_gain_by_the_others(rough, lacks, single):
    """A twentieth of what it gains, and a third where the grid only comes near."""
    effect = stub(rough=rough)
    every, one, other = (stub(joints=joints, effect=effect) for joints in ((0, 1), (1,), (0,)))
    scored = [(50.0, every), (50.0 + lacks * 50.0, one), (99.0, other)]
    assert candidates._prefer_single(scored, 100.0)[1] is (one if single else every)


@pytest.mark.parametrize(
    ("low", "truth", "dead"),
    [
        ((0.0, 0.0), ((1.0,), (-1.0,)), True),  # friction that would drive
        ((0.0, 0.0), ((1.0,), (2.0,)), False),
        ((-np.inf, -np.inf), ((1.0,), (-1.0,)), False),
        ((0.0, -np.inf, 0.0, -np.inf), ((1.0, -1.0), (-1.0, 2.0)), True),
        ((0.0, 0.0, 0.0, 0.0), ((1.0, -1.0), (2.0, 1.0)), False),  # something of it is left
    ],
)
def test_an_effect_is_dead_on_a_joint_that_would_want_less_than_none_of_it(low, truth, dead):
    random, size = np.random.default_rng(0), len(truth[0])
    folds = []
    for _ in range(2):
        columns = random.standard_normal((40, 2 * size))
        gram, moment = columns.T @ columns, columns.T @ (columns @ np.concatenate(truth))
        folds.append(stub(left_out=lambda rows, g=gram, m=moment: (g[rows[:, :, None], rows[:, None]], m[rows])))
    index = {("effect", joint, ()): np.arange(joint * size, (joint + 1) * size) for joint in (0, 1)}
    dictionary = stub(folds=folds, index=index, low=np.array(low))
    dictionary._left_out = lambda chosen: candidates.Dictionary._left_out(dictionary, chosen)
    dictionary._columns = lambda *asked: candidates.Dictionary._columns(dictionary, *asked)
    assert candidates.Dictionary._dead(dictionary, stub(effect="effect", joints=(0, 1), nonlinear=())) is dead


@pytest.mark.parametrize(("dead", "joints"), [((), (0, 1)), ((0, 1), (1,))])
def test_an_effect_that_is_dead_on_a_joint_is_offered_on_the_one_joint_that_wants_it_most(dead, joints):
    """And those that gain more by more joints come first."""

    def effect(*options: tuple[float, tuple[int, ...]]):
        owner = stub(rough=False)
        return [(loss, stub(joints=places, effect=owner)) for loss, places in options]

    spread = effect((90.0, (0,)), (20.0, (0, 1)), (80.0, (1,)), (75.0, ()))
    other = effect((50.0, (0,)))
    dictionary = stub(
        nothing=100.0, _options=lambda *asked: {"other": other, "spread": spread},
        _dead=lambda candidate: candidate.joints == dead,
    )  # fmt: skip
    found = candidates.Dictionary.ranking(dictionary, (), 2, lambda *asked: True)
    assert [candidate.joints for _, candidate in found] == ([(0,), joints] if dead else [joints, (0,)])


@pytest.mark.parametrize("name", ["drive_lag", "torque_delay", "presliding_friction"])
def test_of_points_that_do_as_well_as_each_other_the_first_of_the_grid_is_taken(name):
    effect = EFFECTS[name]
    grid = [(value,) for value in next(iter(effect.nonlinear.values())).grid]
    for points in (grid, grid[::-1], sorted(grid)):
        index = {(effect, joint, point): None for joint in range(3) for point in points}
        dictionary = stub(index=index, effects=[effect], losses=lambda several: np.zeros(len(several)))
        dictionary._columns = lambda candidate: []
        for _, candidate in candidates.Dictionary._options(dictionary, (), 3, lambda *asked: True)[effect]:
            assert candidate.nonlinear == points[0]


def apart(joints: tuple[int, ...], dissipates: bool = False, nonlinear: tuple[str, ...] = ()):
    return stub(joints=joints, effect=stub(dissipates=dissipates, nonlinear=nonlinear))


@pytest.mark.parametrize(
    ("term", "loss", "lacks", "leads"),
    [
        (apart((0, 1)), 410.0, 0.049, "platform"),  # of 100 rows; it lacks so much of what is gained
        (apart((0, 1)), 410.0, 0.051, "springs"),
        (apart((0, 1)), 390.0, 0.01, "springs"),  # what is left is not twice the noise
        (apart((0,)), 410.0, 0.01, "springs"),
        (apart((0, 1), dissipates=True), 410.0, 0.01, "springs"),
        (apart((0, 1), nonlinear=("width",)), 410.0, 0.01, "springs"),
    ],
)
def test_one_force_on_the_platform_goes_before_what_each_arm_would_have(term, loss, lacks, leads):
    platform = loss + lacks * (1000.0 - loss)
    springs, other = made(loss, term=term, name="springs"), made(loss, term=apart((2,)), name="other")
    one = made(platform, term=apart(()), name="platform")
    order: list[Any] = selection.one_cause_first([springs, other, one], made(1000.0), 100)
    assert [scored.name for scored in order] == (
        ["platform", "springs", "other"] if leads == "platform" else ["springs", "other", "platform"]
    )


FAULT = stub(code="a fault")


@pytest.mark.parametrize(
    ("losses", "faulty", "order", "fault"),
    [
        ((100.0, 150.0), (), (0, 1), None),
        ((100.0, 150.0), (1,), (0,), None),
        ((100.0, 103.9, 104.5), (0,), (1, 2), None),  # 5 % of a gain of 80
        ((100.0, 150.0, 103.9), (0,), (2, 1), None),
        ((100.0, 104.1, 150.0), (0,), (1, 2), FAULT),
        ((100.0, 104.1), (0, 1), (0, 1), FAULT),
        ((178.0, 179.9), (0,), (1,), None),  # not worth it: no fault either
    ],
)
def test_what_cannot_be_is_out_and_its_fault_where_it_leads_alone(monkeypatch, losses, faulty, order, fault):
    tried = [made(loss, noise=0.001 * (loss > 100.0)) for loss in losses]
    wrong = {id(tried[k].hypothesis) for k in faulty}
    monkeypatch.setattr(selection, "fault_of", lambda _, hypothesis, given: FAULT if id(hypothesis) in wrong else None)
    found, told = selection._sound_first(
        stub(count=80, most=1.0), list(tried), made(180.0, noise=0.01), made(180.0, noise=0.01), 0, list
    )
    assert [tried.index(scored) for scored in found] == list(order)
    assert told is fault


def test_of_what_can_be_the_simplest_leads_though_it_stood_behind_what_cannot(monkeypatch):
    """A constant torque before a spring with one, behind a hose at the end of its stiffness: the spring's stiffness is
    nothing once more is found."""
    hose, spring, offset = made(100.0, 4), made(120.0, 2), made(120.5, 1, noise=1.0)
    monkeypatch.setattr(
        selection, "fault_of", lambda _, hypothesis, given: FAULT if hypothesis is hose.hypothesis else None
    )
    without = made(180.0, noise=0.01)
    order = selection._sound_first(
        stub(count=80, most=1.0), [hose, spring, offset], without, made(180.0), 0,
        lambda tried: selection.simplest_first(tried, without),
    )  # fmt: skip
    assert order == ([offset, spring], FAULT)


def test_what_blocks_do_not_tell_apart_is_as_good(monkeypatch):
    lead, near = made(100.0, noise=0.0), made(110.0, noise=2.0)
    monkeypatch.setattr(
        selection, "fault_of", lambda _, hypothesis, given: FAULT if hypothesis is lead.hypothesis else None
    )
    assert selection._sound_first(stub(count=80, most=1.0), [lead, near], made(1800.0), made(1800.0), 0, list) == (
        [near],
        None,
    )


@pytest.mark.parametrize(
    ("loss", "errors", "gain", "kept"),
    [
        (9000.0, 2.9, 39.0, False),
        (9000.0, 3.1, 39.0, True),
        (19000.0, 3.1, 99.0, False),
        (19000.0, 3.1, 101.0, True),
    ],
)  # fmt: skip
def test_widths_of_their_own_are_a_hundredth_of_what_is_left_and_not_chance(monkeypatch, loss, errors, gain, kept):
    """Of 9000 rows. errors: standard ones over blocks, of which the gain is so many."""
    term = Term(EFFECTS["stribeck_friction"], (0, 2), np.array([[1.0], [2.0]]), (0.2,))
    away = np.tile([1.0, -1.0], BLOCKS // 2) * gain / (errors * BLOCKS**0.5)
    best = stub(hypothesis=Hypothesis(BASE, (term,)), loss=loss, blocks=np.full(BLOCKS, loss / BLOCKS))
    monkeypatch.setattr(selection, "fit", lambda problem, hypothesis: hypothesis)
    monkeypatch.setattr(selection, "score", lambda fitted, split: stub(
        hypothesis=fitted, loss=loss - gain, blocks=best.blocks - gain / BLOCKS + away))  # fmt: skip
    found = selection.spread(stub(count=9000), stub(), best)
    assert (found is not best) == kept
    if kept:
        assert [(t.joints, t.amplitude.tolist()) for t in found.hypothesis.terms] == [((0,), [[1.0]]), ((2,), [[2.0]])]


@pytest.mark.parametrize("beside", [0.0, 1e6])
@pytest.mark.parametrize(
    ("errors", "lost", "joints"),
    [(2.9, 40.0, (0, 1)), (3.1, 40.0, (0, 1, 2)), (9.0, 19.9, (0, 1)), (9.0, 20.1, (0, 1, 2))],
)
def test_a_joint_goes_that_is_worth_no_more_than_chance_or_a_fiftieth(monkeypatch, beside, errors, lost, joints):
    """Of 1000 squares that the effect gains on all joints. lost: without joint 3, so many standard errors over blocks;
    the others are needed. beside: what another effect gains, which is nothing to it: drives of other scales beside warm
    gears lost one of their joints by it, and a mass at the platform made up for that."""
    gain, way = 1000.0, np.tile([1.0, -1.0], 4)
    away = way * lost / (errors * 8**0.5)
    offset = Term(EFFECTS["torque_offset"], (0, 1, 2), np.array([[1.0], [2.0], [3.0]]), ())
    drag = Term.blank(EFFECTS["air_drag"], (), ())
    terms = (drag, offset) if beside else (offset,)

    def scored(fitted, split):
        sits = {joint for term in fitted.terms if term.effect is offset.effect for joint in term.joints}
        needed, drags = len({0, 1} - sits), drag.effect in [term.effect for term in fitted.terms]
        loss = 100.0 + lost * (2 not in sits) + 500.0 * needed if sits else 100.0 + gain
        return stub(
            hypothesis=fitted,
            loss=loss + beside * (not drags),
            blocks=loss / 8 + (way if needed else away * (2 not in sits)),
        )

    monkeypatch.setattr(selection, "fit", lambda problem, hypothesis, iterations=6: hypothesis)
    monkeypatch.setattr(selection, "score", scored)
    monkeypatch.setattr(selection, "worth", lambda *_: True)
    best, none = stub(hypothesis=Hypothesis(BASE, terms), loss=100.0, blocks=np.full(8, 12.5)), 100.0 + gain + beside
    plain = stub(hypothesis=Hypothesis(BASE), loss=none, blocks=np.full(8, none / 8))
    left = selection.pruned(stub(most=1.0), stub(), best, plain, 80, 0)
    *_, term = left.hypothesis.terms
    assert term.joints == joints
    assert term.amplitude.tolist() == [[1.0], [2.0], [3.0]][: len(joints)]


def test_a_rough_effect_is_searched_where_it_promises_something(monkeypatch):
    """Play is tried at three widths; one that takes less than 30 % of the squares off is left there, another refined by
    steps of 12 % and less, each kept that helps."""
    term = Term(
        EFFECTS["backlash"], (1,), np.zeros((1, 0)), (1e-3, *([0.1] * (len(EFFECTS["backlash"].nonlinear) - 1)))
    )
    asked, without = [], stub(hypothesis=Hypothesis(BASE), residuals=[np.full(1, 10.0)])

    def valley(bottom: float, best: float):
        def fit(problem, hypothesis, iterations=6, noise=WHITE):
            asked.append(iterations)
            off = np.log(hypothesis.terms[-1].nonlinear[0] / best) ** 2
            return stub(hypothesis=hypothesis, residuals=[np.full(1, (bottom + 100.0 * off) ** 0.5)])

        return fit

    monkeypatch.setattr(selection, "fit", valley(75.0, 1.4e-3))
    found = selection.fit_added(stub(), without, term)
    assert found.hypothesis.terms[-1].nonlinear[0] == pytest.approx(1.15e-3)
    assert asked == [1, 1, 1]
    monkeypatch.setattr(selection, "fit", valley(10.0, 1.4e-3))
    found = selection.fit_added(stub(), without, term)
    assert found.hypothesis.terms[-1].nonlinear[0] == pytest.approx(1.15e-3 * 1.13 * 1.06 * 1.03, rel=1e-9)
    assert found.hypothesis.terms[-1].nonlinear[1:] == term.nonlinear[1:]
    monkeypatch.setattr(selection, "fit", valley(10.0, 0.7e-3))
    found = selection.fit_added(stub(), without, term)
    assert found.hypothesis.terms[-1].nonlinear[0] == pytest.approx(0.87e-3 * 0.88 * 0.94 * 0.97, rel=1e-9)
    plain = Term(EFFECTS["torque_offset"], (1,), np.zeros((1, 1)), ())
    monkeypatch.setattr(
        selection, "fit", lambda problem, hypothesis, iterations=6, noise=WHITE: (hypothesis, iterations)
    )
    assert selection.fit_added(stub(), without, plain) == (Hypothesis(BASE, (plain,)), 6)


def searched(
    monkeypatch,
    *rounds: list[float],
    none: float = 200.0,
    promise: float = 50.0,
    fault: object = None,
    closed: bool = True,
    begun: selection.Selection | None = None,
):
    """A search of 100 rows from `none`; rounds: the losses of what is tried. promise: that all of them are ranked at.
    fault: found in the second round, or where a search goes on at once. closed: of the mechanism; those of a closed
    chain are put in order once more, here backwards. begun: to go on with."""
    effect, asked, said = stub(name="an_effect", amplitudes={"size": 0}), [], []

    class Dictionary:
        nothing = 100.0

        def __init__(self, regressors: object, fitted: object) -> None:
            asked.append(fitted)

        def ranking(self, taken: object, joints: int, allows: object):
            losses = rounds[len(asked) - 1]
            return [(promise, stub(effect=effect, term=lambda loss=loss: loss)) for loss in losses]

    def sound(problem, tried, best, none, given, order):
        return order(tried), fault if len(asked) == (2 if begun is None else 1) else None

    parts = {
        "Dictionary": Dictionary, "_sound_first": sound,
        "fit": lambda problem, start, iterations=6: none,
        "fit_added": lambda problem, without, term: term,
        "score": lambda loss, split: made(loss, noise=1e-4 * loss, term=stub(effect=effect)),
        "spread": lambda problem, split, best: best, "pruned": lambda problem, split, best, none, rows, given: best,
        "one_cause_first": lambda ordered, best, rows: ordered[::-1],
    }  # fmt: skip
    for name, part in parts.items():
        monkeypatch.setattr(selection, name, part)
    problem = stub(count=100, most=1.0, weights=None, recordings=[stub(mechanism=stub(closed=closed, joints=3))])
    start = Hypothesis(BASE, timed=False)
    found = selection.search(
        stub(problem=problem, split=stub(), start=start, effects=[effect]), said.append, begun=begun
    )
    path = [([scored.loss for scored in tried], taken and taken.loss) for tried, taken in found.path]
    tried = sum(len(losses) for losses, _ in path[0 if begun is None else len(begun.path) - 1 :])
    assert said.count("comparing the effects of the catalogue") == len(asked)
    assert said.count("fitting an effect") == len(said) - len(asked) == tried
    return found, path


@pytest.mark.parametrize(
    ("rounds", "path"),
    [
        (([190.0, 150.0], [148.0, 149.0]), [([150.0, 190.0], 150.0), ([148.0, 149.0], None)]),  # 2 of 100 rows
        (([150.0], [103.1], [101.0]), [([150.0], 150.0), ([103.1], 103.1), ([101.0], None)]),
        (([150.0], [102.9]), [([150.0], 150.0), ([102.9], 102.9)]),  # three rows above the noise: done
        (([600.0], [400.0], [300.0], [220.0], [160.0]), [([600.0], 600.0), ([400.0], 400.0), ([300.0], 300.0),
                                                        ([220.0], 220.0)]),
        (([151.0, 152.0, 153.0, 154.0, 155.0, 150.0], [151.0]), [([151.0, 152.0, 153.0, 154.0, 155.0], 151.0),
                                                                ([151.0], None)]),
    ],
)  # fmt: skip
def test_a_search_goes_on_while_something_is_gained(monkeypatch, rounds, path):
    """Five candidates a round, four rounds; what was tried last and not taken is kept too."""
    none = 900.0 if len(rounds) == 5 else 200.0
    found, told = searched(monkeypatch, *rounds, none=none, closed=False)
    assert told == path
    assert found.none.loss == pytest.approx(none)
    assert found.best.loss == [taken for _, taken in path if taken is not None][-1]
    assert found.fault is None


def test_a_search_ends_at_a_fault_and_where_nothing_promises_anything(monkeypatch):
    found, path = searched(monkeypatch, [150.0, 160.0], [110.0], fault=FAULT)
    assert path == [([160.0, 150.0], 160.0), ([110.0], None)]
    assert found.fault is FAULT
    assert searched(monkeypatch, [150.0], promise=99.5)[1] == []


@pytest.mark.parametrize("possible", [True, False])
def test_a_search_that_ended_at_a_fault_goes_on_with_what_can_be(monkeypatch, possible):
    """What was tried at the fault is tried again; where that cannot be either it ends there. Four effects in all."""
    ended, _ = searched(monkeypatch, [150.0], [110.0], fault=FAULT)
    monkeypatch.setattr(selection, "fault_of", lambda problem, hypothesis, given: None if possible else FAULT)
    rounds = [130.0], [115.0], [104.0], [101.0]
    found, path = searched(monkeypatch, *rounds, fault=FAULT, begun=ended)
    assert ended.best.loss == 150.0
    if possible:
        assert path == [([150.0], 150.0), ([130.0], 130.0), ([115.0], 115.0), ([104.0], 104.0)]
        assert (found.best.loss, found.fault) == (104.0, None)
        assert found.trimmed.items() >= ended.trimmed.items()
    else:
        assert path == [([150.0], 150.0), ([130.0], None)]
        assert (found.best, found.fault) == (ended.best, FAULT)


@pytest.mark.parametrize(("loss", "large"), [(749.0, True), (751.0, False)])
def test_a_quarter_of_what_is_left_above_the_noise_is_a_large_share(loss, large):
    candidate, without = stub(loss=100.0 + loss), stub(loss=1100.0)
    assert selection._a_large_share(stub(most=1.0, count=100), candidate, without) is large


def test_a_search_ends_at_what_takes_little(monkeypatch):
    """Noise, and a constant torque: it takes nearly all, and would if it were asked."""
    made = logged(
        [course(seed, 1.0) for seed in (1, 2, 3)], [course(seed, 1.0).torque + [2.0, 0, 0] for seed in (1, 2, 3)]
    )
    regressors = Regressors(made, Split.of(made), [EFFECTS["torque_offset"]], Hypothesis(BASE))
    for own, names in ((True, ("torque_offset",)), (False, ())):
        monkeypatch.setattr(selection, "_a_large_share", lambda *_, own=own: own)
        assert selection.search(regressors, lambda _: None).names == names
