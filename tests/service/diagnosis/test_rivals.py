"""What a diagnosis hands on to the planning of a run."""

from __future__ import annotations

import numpy as np

from tests.service.subject import diagnose, document, terms_of


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
