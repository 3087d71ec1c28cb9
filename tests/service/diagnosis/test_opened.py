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
from tests.service.subject import Hypothesis, Problem, Split, fit
from tests.service.world import BASE, PERIOD

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
