"""An effect is accepted given the discrepancy that explains a disturbance, however large that is."""

from __future__ import annotations

import numpy as np
import pytest

from service.diagnosis.discrepancies.discrepancy import Discrepancy, Process, Seen, alike
from service.diagnosis.evidence import opened
from service.diagnosis.evidence.accepted import own
from service.diagnosis.fit.null import OWN
from service.diagnosis.fit.selection import score
from tests.service.diagnosis.test_null import SPRING, logs, on
from tests.service.subject import Hypothesis, Split, fit
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


@pytest.mark.parametrize("size", [0.5, 2.0])
def test_a_spring_is_accepted_however_large_the_lines_on_its_joint(size, monkeypatch):
    """size: N m, standard deviation of the six weights; the residual is 23 and 92 times the noise."""
    weights = size * np.random.default_rng(2).standard_normal(6)
    made = logs("joint_spring", lambda run, seed: on(0, lines(len(run.torque)) @ weights))
    split = Split.of(made)
    fewer, best = (score(fit(made, Hypothesis(BASE, terms)), split) for terms in ((), (SPRING,)))
    monkeypatch.setattr(opened, "DISCREPANCIES", [Lines()])
    pool = opened.Pool(made, split, best.hypothesis)
    beside = opened.Opened.beside(pool, best)
    assert own(pool, fewer, best, SPRING.effect, beside) > OWN
