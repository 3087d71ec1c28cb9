"""One figure for all joints against a fit that has but one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from service.diagnosis.fit.common import in_common
from tests.service.subject import EFFECTS, Amplitude, Effect, Hypothesis, Scene, Split, Term, fit, selection
from tests.service.world import BASE, course, problem, stub

OFFSET = Amplitude("N m", "of all joints")
OFFSETS = np.array([0.65, 0.60, 0.62])  # N m


@dataclass(frozen=True)
class OneOffset(Effect):
    """The same constant torque on every joint: one column."""

    offset: Amplitude = OFFSET
    name = "one_offset"
    per_joint = False
    own_joint = False
    settles = ""

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        return np.ones((len(scene.time), scene.joints, 1))


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
    shared = in_common(apart, split)
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
        assert in_common(selection.score(fit(made, Hypothesis(BASE, (term,)), 1), split), split) is None, name
    alone = Term(EFFECTS["torque_offset"], (0,), np.zeros((1, 1)), ())
    one_axis = stub(fitted=None, hypothesis=stub(terms=(alone,), base=stub(viscous=np.ones(1))))
    assert in_common(one_axis, split) is None  # pyright: ignore[reportArgumentType]
