"""Parameters that the data tell only in combination: over the whole catalogue, no effect carries a figure of its own
along a direction in which the torque does not change."""

from __future__ import annotations

import numpy as np
import pytest

from tests.service.axis import AXIS, SINGLE, spring_axis
from tests.service.injected import INJECTED
from tests.service.subject import (
    EFFECTS,
    Band,
    Hypothesis,
    Parameters,
    Problem,
    Recording,
    Scored,
    Split,
    Term,
    evaluate,
    selection,
    statistics,
)
from tests.service.world import BASE, course, problem

ON_AXES = sorted(name for name, effect in EFFECTS.items() if "axes" in effect.kinds)


def at_work(name: str, delta: bool) -> tuple[Problem, Scored]:
    """A fit of that effect alone, standing at figures that were given, and its problem."""
    effect, nonlinear = EFFECTS[name], tuple(one.grid[0] for one in EFFECTS[name].nonlinear.values())
    if delta:
        run = course(1, 3.0)
        logs, base = problem([run], [run.torque]), BASE
        joints = (0, 2) if effect.per_joint else ()
    else:
        segment = spring_axis(6.0, 14.0, 0.12, 0.3).scene().segment
        logs = Problem.of([Recording(segment, AXIS, 0, "run")], Band.of(segment.period), np.array([0.1]))
        base, joints = SINGLE, (0,) if effect.per_joint else ()
    known = INJECTED.get(name)
    if known is not None and known.nonlinear:
        nonlinear = known.nonlinear
    size = 1e-3 * np.arange(1, 1 + max(1, len(joints)) * len(effect.amplitudes)).reshape(max(1, len(joints)), -1)
    fitted = evaluate(logs, Hypothesis(base, (Term(effect, joints, size, nonlinear),)))
    return logs, selection.score(fitted, Split.of(logs))


def null_share(scored: Scored) -> np.ndarray:
    """(F,) how far each free parameter goes along directions in which the torque does not change, 0 to 1."""
    tangents = np.concatenate(scored.fitted.tangents)
    length = np.linalg.norm(tangents, axis=0)
    _, sizes, directions = np.linalg.svd(tangents / np.where(length > 0, length, 1.0), full_matrices=False)
    return np.linalg.norm(directions[sizes < 1e-6 * sizes[0]], axis=0)


@pytest.mark.parametrize(
    ("name", "delta"), [(name, True) for name in sorted(EFFECTS)] + [(name, False) for name in ON_AXES]
)
def test_what_only_a_combination_tells_is_no_figure_of_an_effect(name: str, delta: bool) -> None:
    logs, scored = at_work(name, delta)
    open_ones = null_share(scored) > 1e-3
    found = statistics.combined(logs, scored)
    parameters = Parameters(found.hypothesis)
    values, errors = parameters.values, statistics.standard_errors(found.fitted, Split.of(logs))
    (mine,) = parameters.terms
    amplitudes = np.zeros(len(values), bool)
    amplitudes[mine.start : mine.start + found.hypothesis.terms[0].amplitude.size] = True
    alone = amplitudes & parameters.free & (parameters.spread(open_ones.astype(float)) > 0)
    if open_ones[parameters.among_free(slice(0, parameters.transition.start))].any():  # with the base's constants
        assert not values[alone].any()
    assert np.count_nonzero(values[alone]) < max(1, np.count_nonzero(alone))
    assert not errors[alone & (values == 0)].any()
    for before, after in zip(scored.fitted.residuals, found.fitted.residuals, strict=True):
        np.testing.assert_allclose(after, before, atol=1e-6 * np.abs(before).max())


def test_the_difference_of_the_coulomb_levels_goes_to_the_constant() -> None:
    """Of an axis, which has one."""
    logs, scored = at_work("asymmetric_friction", delta=False)
    found = statistics.combined(logs, scored).hypothesis
    assert found.terms[0].amplitude[0, 0] == 0.0
    assert found.terms[0].amplitude[0, 1] == pytest.approx(2e-3)
    assert found.base.rigid[1] == pytest.approx(SINGLE.rigid[1] + 1e-3)
