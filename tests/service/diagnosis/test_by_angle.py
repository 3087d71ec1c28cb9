"""Friction by the load is named though a description of axes leaves much; what goes by the angle is not."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from schemas.axes_description import Axes, Axis
from schemas.diagnosis import Caution, Diagnosis
from schemas.trace import Trace
from schemas.words import percent
from service.diagnosis.evidence import axis_friction
from service.diagnosis.fit.selection import Standing
from service.diagnosis.fit.wide import Wide
from service.identification import pooled
from service.model.mechanism import mechanism_of
from service.model.signals import segments_of
from tests.service.diagnosis.said import sentences
from tests.service.subject import (
    EFFECTS,
    Hypothesis,
    Problem,
    Recording,
    Regressors,
    Scored,
    Selection,
    Split,
    Term,
    diagnose,
    fit,
    selection,
)
from tests.service.subject import document as documents
from tests.service.world import BASE, PERIOD, course, direction, sines
from tests.service.world import problem as of_delta

SECONDS, SEEDS, NOISE = 6.0, (1, 2, 3, 4), 0.02  # s; N m
INERTIA, VISCOUS, DRY, WEIGHT = 0.15, 0.4, 0.3, 4.0
LOST, WANDERS = 0.3, 0.3
NAMES = ("load_dependent_friction", "position_dependent_friction", "stribeck_friction", "joint_spring", "cogging")
LOAD = EFFECTS["load_dependent_friction"]
RUBS = Term(LOAD, (0,), np.full((1, 1), 0.1), (0.0,))


def servo(seed: int, lost: float = 0.0, tight: float = 0.0, slow: float = 0.0, wanders: float = 0.0) -> Trace:
    """A weight on an axis. lost: share of the torque that carries and accelerates it, lost as friction. tight: N m of
    friction that it has more, a radian from the bottom. slow: the same at rest, which dies out with speed. wanders:
    share that the torque constant goes up and down by in 3 s."""
    time = np.arange(round(SECONDS / PERIOD)) * PERIOD
    theta, speed, acceleration = (signal[:, :1] for signal in sines(seed, 1.3)(time))
    theta = theta - 0.45
    load = INERTIA * acceleration + WEIGHT * np.sin(theta)
    rubs = DRY + lost * np.abs(load) + tight * np.abs(theta) + slow * np.exp(-((speed / 0.8) ** 2))
    torque = load + VISCOUS * speed + rubs * direction(speed)
    torque *= 1.0 + wanders * np.sin(2 * np.pi * time[:, None] / 3.0 + 2.0 * seed)
    random = np.random.default_rng([seed, 3])
    torque += NOISE * random.standard_normal(torque.shape)
    return Trace(Path(f"run_{seed}.csv"), time, theta + 1e-7 * random.standard_normal(theta.shape), torque)


def axes(count: int = 1) -> Axes:
    return Axes(name="servo", kind="axes", axis=[Axis()] * count)


@cache
def told(lost: float = 0.0, tight: float = 0.0, slow: float = 0.0, runs: int = 4) -> Diagnosis:
    """Of logs whose torque constant wanders, so that a fifth of the torque is left."""
    logs = [servo(seed, lost, tight, slow, WANDERS) for seed in SEEDS[:runs]]
    return documents.document(diagnose.diagnose(axes(), logs, [EFFECTS[name] for name in NAMES]))


def nothing_but_how_much(found: Diagnosis) -> bool:
    return not found.effects and "much_is_left" in {one.code for one in found.cannot_tell}


def test_friction_by_the_load_is_named_beside_what_leaves_much():
    """Was: nothing, as what is left is more than a tenth of the torque."""
    found = told(lost=LOST)
    assert [(effect.name, effect.joints) for effect in found.effects] == [("load_dependent_friction", [1])]
    assert found.effects[0].probability > 0.9
    assert found.effects[0].parameters["mu"].value == pytest.approx(LOST, rel=0.05)
    assert found.verdict == "partly_explained"
    (much,) = (one for one in found.cannot_tell if one.code.startswith("much"))
    assert much.code == "much_beside"
    assert much.share is not None
    assert much.share > 0.1
    assert f"The residual is {percent(much.share)} of the torque itself" in " ".join(sentences(found))


def test_it_may_take_less_than_a_quarter_of_what_is_left():
    """Which a search asks for, as much else is left."""
    found = told(lost=0.17)
    assert [effect.name for effect in found.effects] == ["load_dependent_friction"]
    assert found.effects[0].gap_share < 0.25
    assert found.effects[0].parameters["mu"].value == pytest.approx(0.17, rel=0.1)


def test_friction_by_the_angle_is_not_taken_for_it():
    """From the bottom up the weight grows with the angle: friction by either shrinks the gap of each log as well."""
    found = told(tight=4.0)
    assert (found.ranking[0].name, found.ranking[0].shrink > 0.15) == ("load_dependent_friction", True)
    assert nothing_but_how_much(found)


def test_friction_with_a_shape_of_its_own_is_not_named_where_much_is_left():
    found = told(slow=5.0)
    assert (found.ranking[0].name, found.ranking[0].shrink > 0.15) == ("stribeck_friction", True)
    assert nothing_but_how_much(found)


def test_two_logs_are_too_few():
    found = told(lost=0.5, runs=2)
    assert (found.ranking[0].name, found.ranking[0].shrink > 0.15) == ("load_dependent_friction", True)
    assert nothing_but_how_much(found)


def fitted(logs: list[Trace], count: int = 1, term: Term = RUBS) -> tuple[Problem, Scored, Scored]:
    """The base model on these logs, and with one term beside it."""
    mechanism = mechanism_of(axes(count))
    parts = [(number, part) for number, mine in enumerate(segments_of(logs)) for part in mine]
    made, _ = pooled.problem_of([Recording(part, mechanism, n, logs[n].name) for n, part in parts])
    none = fit(made, pooled.start(made))
    split = Split.of(made)
    both = fit(made, none.hypothesis.carrying((term,)))
    return made, selection.score(none, split), selection.score(both, split)


def test_it_has_to_shrink_the_gap_of_each_log():
    made, none, best = fitted([servo(seed, LOST) for seed in SEEDS])
    assert axis_friction.on_each_log(made, none, best)
    assert axis_friction.stays(made, none, best, LOAD) > 0.5
    made, none, best = fitted([servo(seed, lost) for seed, lost in zip(SEEDS, (LOST, LOST, LOST, 0.0), strict=True)])
    assert best.loss < none.loss
    assert not axis_friction.on_each_log(made, none, best)


@pytest.mark.parametrize(("ahead", "stands"), [(3.1, True), (2.9, False)])
def test_what_it_takes_beside_all_that_goes_by_the_angle_is_no_chance(monkeypatch, ahead, stands):
    made, none, best = fitted([servo(seed, LOST) for seed in SEEDS])
    monkeypatch.setattr(axis_friction, "z_score", lambda worse, better: ahead if worse.sum() > better.sum() else 0.0)
    assert (axis_friction.stays(made, none, best, LOAD) > 0.5) == stands


@pytest.mark.parametrize(
    ("probability", "confusable", "ahead", "stands"),
    [(0.9, [], 3.1, True), (0.89, [], 3.1, False), (0.9, ["cogging"], 3.1, False), (0.9, [], 2.9, False)],
)
def test_nothing_may_be_in_its_place(probability, confusable, ahead, stands):
    made, none, best = fitted([servo(seed, LOST) for seed in SEEDS])
    standing = Standing(none, probability, confusable, ahead)
    assert axis_friction.told_beside(made, best, LOAD, standing) == stands


def two(seed: int, odd: float) -> Trace:
    """Two axes; the second feels the first's weight, inertia and speed, has an inertia and a spring that go by its own
    angle and rubs at one end of its travel. odd: N m of friction on it that goes by the first's direction."""
    time = np.arange(round(SECONDS / PERIOD)) * PERIOD
    theta, speed, acceleration = (signal[:, :2] for signal in sines(seed, 0.8)(time))
    torque = INERTIA * acceleration + VISCOUS * speed + DRY * direction(speed)
    first, second = theta.T
    torque[:, 1] += 2.0 * np.sin(2.0 * first) + 3.0 * np.sin(1.5 * second + 0.6)
    torque[:, 1] += 0.2 * np.cos(second) * acceleration[:, 0] + 0.1 * second**2 * acceleration[:, 1]
    torque[:, 1] += 0.1 * np.cos(second) * speed[:, 0] ** 2 + np.exp(second) * direction(speed)[:, 1]
    torque[:, 1] += odd * direction(speed)[:, 0]
    random = np.random.default_rng([seed, 3])
    torque += NOISE * random.standard_normal(torque.shape)
    return Trace(Path(f"run_{seed}.csv"), time, theta + 1e-7 * random.standard_normal(theta.shape), torque)


@pytest.mark.parametrize(("odd", "least", "most"), [(0.0, 0.0, 0.03), (1.0, 0.1, 1.0)])
def test_what_is_left_open_is_all_that_goes_by_the_angle(odd, least, most):
    made, none, _ = fitted([two(seed, odd) for seed in SEEDS], 2)
    columns = axis_friction.by_angle(made, none.hypothesis, [1])
    left = Wide.of(none.fitted, columns, 0.0).held_out(Split.of(made, mixed=True))
    before, after = (made.rms(each, [0] * len(each))[0] for each in (none.residuals, left))
    assert least * before[1] <= after[1] < most * before[1]
    assert after[0] == pytest.approx(before[0], rel=0.1), "nothing is left open on the other joint"


def asked(made: Problem, none: Scored, best: Scored, *codes: str, taken: bool = True):
    """What stands of a search that took one effect in one step, or only came near it, where this speaks against it."""
    regressors = Regressors(made, Split.of(made), [LOAD], none.hypothesis)
    doubts = [Caution.model_validate({"code": code, "advice": "check_base"}) for code in codes]
    found = Selection(none, best, [([best], best)], {}) if taken else Selection(none, none, [([best], None)], {})
    return axis_friction.named_beside(regressors, found, doubts, [], lambda effect, joint: True, 1.25)


def test_anything_else_that_speaks_against_a_name_stands():
    made, none, best = fitted([servo(seed, LOST, wanders=WANDERS) for seed in SEEDS])
    stood = asked(made, none, best, "much_is_left")
    assert stood is not None
    kept, (said,) = stood
    assert kept.best is best
    assert said.code == "much_beside"
    assert asked(made, none, best, "runs_differ") is None
    assert asked(made, none, best, "much_is_left", "sine_of_angle") is None


@pytest.mark.parametrize("worth", [True, False])
def test_what_only_came_near_has_to_be_worth_it(monkeypatch, worth):
    made, none, best = fitted([servo(seed, LOST, wanders=WANDERS) for seed in SEEDS])
    monkeypatch.setattr(axis_friction, "worth", lambda *_: worth)
    stood = asked(made, none, best, "much_is_left", taken=False)
    assert (stood is not None) == worth
    if stood is not None:
        assert stood[0].names == ("load_dependent_friction",)


def test_a_delta_is_not_asked(monkeypatch):
    """Its description says what weighs and where, and is wrong where it leaves much."""
    runs = [course(seed, 2.0) for seed in SEEDS]
    made = of_delta(runs, [run.torque for run in runs])
    none = selection.score(fit(made, Hypothesis(BASE)), Split.of(made))
    monkeypatch.setattr(axis_friction, "earned", lambda *_: pytest.fail("was asked"))
    assert asked(made, none, none, "much_is_left") is None
