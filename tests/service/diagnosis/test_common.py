"""One figure for all joints against a fit that has but one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from service.diagnosis.fit.common import in_common
from tests.service.injected import INJECTED, reports
from tests.service.subject import (
    EFFECTS,
    Amplitude,
    Effect,
    Hypothesis,
    Problem,
    Regressors,
    Scene,
    Selection,
    Split,
    Term,
    evidence,
    fit,
    selection,
)
from tests.service.world import BASE, course, problem, stub

OFFSET = Amplitude("N m", "of all joints")
DRAG = Amplitude("N m s^2/rad^2", "at 1 rad/s", low=0.0)
OFFSETS = np.array([0.65, 0.60, 0.62])  # N m


class OneFigure(Effect):
    """One column for all joints."""

    per_joint = False
    own_joint = False
    settles = ""


@dataclass(frozen=True)
class OneOffset(OneFigure):
    """The same constant torque on every joint."""

    offset: Amplitude = OFFSET
    name = "one_offset"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        return np.ones((len(scene.time), scene.joints, 1))


@dataclass(frozen=True)
class OwnDrag(Effect):
    """Friction by speed squared of each joint."""

    drag: Amplitude = DRAG
    name = "own_drag"
    settles = ""

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        speed = scene.segment.theta_dot[:, [joint]]
        return speed * np.abs(speed)


@dataclass(frozen=True)
class OneDrag(OneFigure):
    """The same with one figure for all joints."""

    drag: Amplitude = DRAG
    name = "one_drag"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        speed = scene.segment.theta_dot
        return (speed * np.abs(speed))[..., None]


@pytest.fixture(scope="module")
def logs():
    runs, random = [course(seed, 3.0) for seed in (1, 2, 3)], np.random.default_rng(4)
    made = problem(runs, [run.torque + OFFSETS + 0.3 * random.standard_normal(run.torque.shape) for run in runs])
    return made, Split.of(made)


def test_one_figure_for_all_joints_is_that_of_a_fit_which_has_one(logs):
    made, split = logs
    each = Term(EFFECTS["torque_offset"], (0, 1, 2), np.zeros((3, 1)), ())
    apart = selection.score(fit(made, Hypothesis(BASE, (each,))), split)
    one = selection.score(fit(made, Hypothesis(BASE, (Term.blank(OneOffset(), (), ()),))), split)
    shared = in_common(apart, 0, split)
    assert shared is not None
    assert shared.fitted.cost == pytest.approx(one.fitted.cost, rel=1e-4)
    assert shared.loss == pytest.approx(one.loss, rel=1e-4)
    assert shared.fitted.cost > 1.001 * apart.fitted.cost, "they are told apart"
    assert shared.fitted.tangents[0].shape[1] == one.fitted.tangents[0].shape[1]
    np.testing.assert_allclose(shared.blocks, one.blocks, rtol=2e-3)


def test_it_is_asked_of_what_sits_on_all_joints_with_one_figure_each(logs):
    made, split = logs
    for name, joints, amplitudes, nonlinear in (
        ("torque_offset", (0, 1), 1, ()), ("torque_offset", (2,), 1, ()), ("joint_spring", (0, 1, 2), 2, ()),
        ("presliding_friction", (0, 1, 2), 1, (0.01,)), ("tool_mass", (), 1, ()),
    ):  # fmt: skip
        term = Term(EFFECTS[name], joints, np.zeros((max(len(joints), 1), amplitudes)), nonlinear)
        assert in_common(selection.score(fit(made, Hypothesis(BASE, (term,)), 1), split), 0, split) is None, name
    alone = Term(EFFECTS["torque_offset"], (0,), np.zeros((1, 1)), ())
    one_axis = stub(fitted=None, hypothesis=stub(terms=(alone,), base=stub(viscous=np.ones(1))))
    assert in_common(one_axis, 0, split) is None  # pyright: ignore[reportArgumentType]


def two_at_work(seed: int, scale: float = 1.0, offset: float | np.ndarray = 0.0) -> Problem:
    """Cogging and drag, torque that is reported `scale` times as large and `offset` N m higher. seed: of the noise."""
    random, torques = np.random.default_rng(seed), []
    for run in (1, 2, 3):
        plain = course(run, 3.0).torque
        torque = plain + sum(reports(name, run, 3.0) - plain for name in ("cogging", "air_drag"))
        torques.append(scale * torque + offset + 0.3 * random.standard_normal(plain.shape))
    return problem([course(run, 3.0) for run in (1, 2, 3)], torques)


OTHERS = tuple(INJECTED[name].term(name) for name in ("cogging", "air_drag"))


@pytest.mark.parametrize("number", [0, 1, 2])
def test_it_may_be_any_effect_of_the_model(number):
    made = two_at_work(4, offset=OFFSETS)
    split = Split.of(made)
    each = Term(EFFECTS["torque_offset"], (0, 1, 2), np.zeros((3, 1)), ())
    terms, same = ((*OTHERS[:number], one, *OTHERS[number:]) for one in (each, Term.blank(OneOffset(), (), ())))
    shared = in_common(selection.score(fit(made, Hypothesis(BASE, terms)), split), number, split)
    one = selection.score(fit(made, Hypothesis(BASE, same)), split)
    assert shared is not None
    assert shared.loss == pytest.approx(one.loss, rel=5e-4)


@pytest.mark.parametrize("off", [0.5, -0.2])
def test_the_figure_stays_where_that_of_a_joint_may_be(off):
    """Friction by speed squared of three joints, that of the first below nothing, or the mean of all. off: that mean,
    N m at 1 rad/s."""
    runs, random, made = [course(seed, 3.0) for seed in (1, 2, 3)], np.random.default_rng(4), []
    for run in runs:
        speed = run.motion[1]
        torque = run.torque + (off + np.array([-0.6, 0.2, 0.4])) * speed * np.abs(speed)
        made.append(torque + 0.3 * random.standard_normal(torque.shape))
    logs = problem(runs, made)
    split, blank = Split.of(logs), Term.blank(OwnDrag(), (0, 1, 2), ())
    apart = selection.score(fit(logs, Hypothesis(BASE, (blank,))), split)
    assert apart.hypothesis.terms[0].amplitude[0] == 0.0
    one = selection.score(fit(logs, Hypothesis(BASE, (Term.blank(OneDrag(), (), ()),))), split)
    assert (one.hypothesis.terms[0].amplitude[0] > 0) == (off > 0)
    shared = in_common(apart, 0, split)
    assert shared is not None
    assert shared.fitted.cost == pytest.approx(one.fitted.cost, rel=1e-3)
    assert shared.loss == pytest.approx(one.loss, rel=1e-3)


@pytest.mark.parametrize("first", [0, 1, 2])
def test_a_mass_is_even_beside_a_torque_constant_off_on_all_joints_whatever_order_they_were_found_in(
    monkeypatch, first
):
    """A mass at the platform and two other effects, and 5 % more torque of every joint: one figure explains as well.
    first: of how many of the others the scale was found behind."""
    made, mass, scale = two_at_work(10, scale=1.05), EFFECTS["tool_mass"], EFFECTS["torque_scale"]
    split, scales = Split.of(made), Term.blank(scale, (0, 1, 2), ())
    none, fewer, best, rival = (
        selection.score(fit(made, Hypothesis(BASE, terms)), split)
        for terms in ((), OTHERS, (*OTHERS, Term.blank(mass, (), ())), (*OTHERS[:first], scales, *OTHERS[first:]))
    )
    monkeypatch.setattr(evidence, "_in_its_place", lambda *_: [])
    regressors = Regressors(made, split, [], Hypothesis(BASE))
    found = Selection(none, best, [([best, rival], best)], {})
    standing = evidence.standings(regressors, found, best, {mass: fewer}, lambda effect, joint: True, True)[mass]
    assert 0.4 < standing.probability < 0.6
    assert standing.confusable == ["torque_scale"]
