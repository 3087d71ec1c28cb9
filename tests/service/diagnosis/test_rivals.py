"""What a diagnosis hands on to the planning of a run."""

from __future__ import annotations

import numpy as np

from tests.service.subject import Selection, diagnose, document, evidence, terms_of
from tests.service.world import stub


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


def test_rivals_are_weighed_as_their_search_weighed_them():
    """Not by all that is left, most of which may be a stranger's."""

    def of(name, weighed, loss):
        away = np.tile([0.5, -0.5], 20)
        return stub(names=(name,) * bool(name), blocks=weighed / 40 + away * (name == "near"), loss=loss)

    none, taken = of("", 400.0, 5000.0), of("taken", 80.0, 4000.0)
    near, far = of("near", 100.0, 4990.0), of("far", 300.0, 4000.0)
    found = Selection(none, taken, [([taken, near, far], taken)], {})  # pyright: ignore[reportArgumentType]
    assert evidence.confusable(found, "taken") == []
    near.blocks = near.blocks - 0.3
    assert evidence.confusable(found, "taken") == ["near"]


def test_a_name_is_as_likely_as_in_the_round_that_speaks_for_it_most():
    def tried(*names: str):
        return stub(names=("given", *names))

    rounds = [
        evidence.ModelComparison(tried(), [(tried("first"), 0.3), (tried("second"), 0.6)], 0.1),
        evidence.ModelComparison(tried("second"), [(tried("second", "first"), 0.8)], 0.2),
    ]
    assert [evidence.probability_of(rounds, name) for name in ("first", "second", "other")] == [0.8, 0.6, 0.0]
    assert evidence.probability_of([], "first") == 0.0
