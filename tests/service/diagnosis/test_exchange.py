"""Effects in place of others: two for one, one for two."""

from __future__ import annotations

import numpy as np
import pytest

from service.diagnosis.evidence.earned import earned
from service.diagnosis.fit.exchange import exchanged
from tests.service.injected import INJECTED, reports
from tests.service.subject import CATALOGUE, EFFECTS, Hypothesis, Split, candidates, selection
from tests.service.world import BASE, course, problem

SECONDS, NOISE, SCALE = 3.0, 0.2, 1.04
LIMIT = 1.06  # rms in units of the noise


@pytest.fixture(scope="module")
def wrong_gear() -> tuple[candidates.Regressors, selection.Selection]:
    """Another gear ratio than was entered on joint 2: its angle and its torque are scaled."""
    runs, random = [course(seed, SECONDS) for seed in (1, 2, 3)], np.random.default_rng(7)
    torques = [reports("angle_scale", seed, SECONDS).copy() for seed in (1, 2, 3)]
    for torque in torques:
        torque[:, 1] *= SCALE
        torque += NOISE * random.standard_normal(torque.shape)
    logs = problem(runs, torques, NOISE)
    rivals = [effect for effect in CATALOGUE if not effect.rough]
    regressors = candidates.Regressors(logs, Split.of(logs), rivals, Hypothesis(BASE))
    return regressors, selection.search(regressors, lambda _: None)


def told(wrong_gear: tuple[candidates.Regressors, selection.Selection], limit: float) -> selection.Selection:
    return exchanged(*wrong_gear, limit, lambda effect, joint: True, lambda _: None)


def test_what_explains_all_goes_before_what_stood_in_for_it(wrong_gear):
    """A link's length and a base's radius stood in for them, with the scale of the torque."""
    assert "angle_scale" not in wrong_gear[1].names
    found = told(wrong_gear, LIMIT)
    assert set(found.names) == {"angle_scale", "torque_scale"}
    figures = {term.effect.name: term for term in found.best.hypothesis.terms}
    assert all(term.joints == (1,) for term in figures.values())
    (injected,) = INJECTED["angle_scale"].amplitude
    assert figures["angle_scale"].amplitude.item() == pytest.approx(injected[0], rel=0.05)
    assert figures["torque_scale"].amplitude.item() == pytest.approx(SCALE - 1.0, rel=0.05)
    assert found.best.loss <= LIMIT**2 * wrong_gear[0].problem.count


def test_what_was_exchanged_stands_against_what_may_be_in_its_place(wrong_gear):
    regressors, found = wrong_gear[0], told(wrong_gear, LIMIT)
    kept, fallen = earned(regressors, found, [], lambda effect, joint: True, LIMIT, lambda _: None)
    assert fallen == []
    assert {effect.name for effect in kept.standings} == set(found.names)
    for one in kept.standings.values():
        assert one.probability > 0.9
        assert one.without.loss > found.best.loss


@pytest.mark.parametrize(("share", "taken"), [(1.01, True), (0.99, False)])
def test_two_at_once_are_taken_where_what_they_leave_is_noise_and_not_where_it_is_more(wrong_gear, share, taken):
    """share: the limit, of what they leave."""
    regressors, found = wrong_gear[0], told(wrong_gear, LIMIT)
    left = (found.best.loss / regressors.problem.count) ** 0.5
    nothing = selection.Selection(found.none, found.none, [], {})
    both = told((regressors, nothing), share * left)
    assert set(both.names) == ({"angle_scale", "torque_scale"} if taken else set())


def test_what_cannot_be_looked_for_is_in_no_couple(wrong_gear):
    """And who waits is told what is done."""
    said: list[str] = []
    search, asked = wrong_gear
    found = exchanged(search, asked, LIMIT, lambda effect, joint: effect is not EFFECTS["angle_scale"], said.append)
    assert said[0] == "comparing alternatives to the effects found"
    assert "angle_scale" not in found.names
