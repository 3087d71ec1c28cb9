"""Effects are found, accepted and confirmed given the discrepancy that explains a disturbance, however large it is."""

from __future__ import annotations

import numpy as np
import pytest

from service.diagnosis.discrepancies.discrepancy import Discrepancy, Process, Seen, alike
from service.diagnosis.evidence import accepted, earned, opened
from service.diagnosis.fit.null import OWN
from service.diagnosis.fit.selection import Scored, Selection, fit_added, score
from service.identification.correlated import WHITE
from tests.service.diagnosis.test_null import SPRING, logs, on
from tests.service.subject import EFFECTS, Hypothesis, Problem, Split, fit
from tests.service.world import BASE, PERIOD, stub

HERTZ = (1.3, 2.1, 3.7)


def lines(rows: int) -> np.ndarray:
    """(rows, 6) sines and cosines of three lines, over the time of a log."""
    turns = 2.0 * np.pi * np.arange(rows)[:, None] * PERIOD * HERTZ
    return np.hstack([np.sin(turns), np.cos(turns)])


class Lines(Discrepancy):
    """N m over time, alike in every log."""

    def process(self, seen: Seen, joint: int) -> Process:
        parts = [lines(len(torque)) for torque in seen.torque]
        return self.on(seen, joint, alike(parts, float(seen.size[joint])))


def spring_beside_lines(size: float, monkeypatch) -> tuple[Problem, Scored, Scored, opened.Pool, opened.Opened]:
    """Logs, models without the spring and with it, and what is open. size: N m, of the lines on its joint."""
    weights = size * np.random.default_rng(2).standard_normal(6)
    made = logs("joint_spring", lambda run, seed: on(0, lines(len(run.torque)) @ weights))
    split = Split.of(made)
    fewer, best = (score(fit(made, Hypothesis(BASE, terms)), split) for terms in ((), (SPRING,)))
    monkeypatch.setattr(opened, "DISCREPANCIES", [Lines()])
    pool = opened.Pool(made, split, best.hypothesis)
    return made, fewer, best, pool, opened.Opened.beside(pool, best)


@pytest.mark.parametrize("size", [0.5, 2.0])
def test_a_spring_is_accepted_however_large_the_lines_on_its_joint(size, monkeypatch):
    """The residual is 23 and 92 times the noise."""
    _, fewer, best, pool, beside = spring_beside_lines(size, monkeypatch)
    assert accepted.own(pool, fewer, best, SPRING.effect, beside) > OWN


def test_a_candidate_is_fitted_given_the_discrepancies(monkeypatch):
    made, fewer, _, _, beside = spring_beside_lines(2.0, monkeypatch)
    clean = fit(logs("joint_spring"), Hypothesis(BASE, (SPRING,))).hypothesis.terms[0].amplitude
    given, alone = (
        fit_added(made, fewer.fitted, SPRING, noise).hypothesis.terms[0].amplitude for noise in (beside.noise, WHITE)
    )
    np.testing.assert_allclose(given, clean, rtol=0.05)
    assert np.abs(alone / clean - 1.0).max() > 0.2


def test_names_are_confirmed_given_the_discrepancies(monkeypatch):
    """Their values, and that together they shrink the gap: beside lines of ten times the spring none is seen."""
    made, fewer, _, _, beside = spring_beside_lines(2.0, monkeypatch)
    split = Split.of(made)
    best = score(fit_added(made, fewer.fitted, SPRING, beside.noise), split)
    for noise, stands in ((beside.noise, True), (WHITE, False)):
        found = Selection(fewer, best, [([best], best)], {}, noise=noise)
        kept, _ = earned.together(made, split, found, [best] * split.folds, 0, vague=False)
        assert (kept is found) == stands
        assert (earned._open(best, split, SPRING.effect, noise) is None) == stands


@pytest.mark.parametrize(
    ("ratios", "gone", "promised", "found"),
    [
        ({"hose_spring": 101.0, "air_drag": 101.0, "torque_offset": 99.0}, set(), 199.0, ("hose_spring", "air_drag")),
        ({"hose_spring": 101.0, "air_drag": 99.0, "torque_offset": 99.0}, set(), 199.0, None),
        (
            {"hose_spring": 101.0, "air_drag": 101.0, "torque_offset": 101.0},
            set(),
            199.0,
            ("hose_spring", "torque_offset"),
        ),
        ({"hose_spring": 101.0, "air_drag": 101.0, "torque_offset": np.inf}, set(), 199.0, ("hose_spring", "air_drag")),
        ({"hose_spring": 101.0, "air_drag": 101.0, "torque_offset": 101.0}, set(), 201.0, ("hose_spring", "air_drag")),
        (
            {"hose_spring": 101.0, "air_drag": 101.0, "torque_offset": 101.0},
            {"torque_offset"},
            199.0,
            ("hose_spring", "air_drag"),
        ),
    ],
)
def test_two_effects_are_added_where_each_is_accepted_given_the_other(ratios, gone, promised, found, monkeypatch):
    """Of such pairs, the one that explains most given the discrepancies; none with an effect that was rejected,
    nor one that promises less than half of what is left above the noise, 200 squares."""
    pairs = {("hose_spring", "torque_offset"): 10.0, ("hose_spring", "air_drag"): 20.0}
    candidates = [tuple(stub(effect=EFFECTS[name]) for name in pair) for pair in pairs]
    hypothesis = stub(terms=())
    problem = stub(count=100, recordings=[stub(mechanism=stub(joints=3))])
    monkeypatch.setattr(accepted, "_seen", lambda problem, model, *_: stub(loss=model.loss))
    monkeypatch.setattr(accepted, "fault_of", lambda *_: None)
    monkeypatch.setattr(accepted, "without", lambda problem, split, none, model, effect: model)
    monkeypatch.setattr(accepted, "own", lambda pool, fewer, model, effect, opened: ratios[effect.name])
    monkeypatch.setattr(
        accepted,
        "with_several",
        lambda regressors, best, several, noise: stub(
            names=tuple(one.effect.name for one in several),
            loss=pairs[tuple(one.effect.name for one in several)],
            hypothesis=hypothesis,
        ),
    )
    dictionary = stub(nothing=300.0, couples=lambda *_: [(199.0, candidates[1]), (promised, candidates[0])])
    start = stub(loss=90.0, hypothesis=hypothesis)
    models = accepted._couple(
        stub(problem=problem, split=None), dictionary, stub(), start, start, stub(noise=WHITE, found=[]),
        {EFFECTS[name] for name in gone}, lambda *_: True,
    )  # fmt: skip
    assert (models[0].names if models else None) == found
