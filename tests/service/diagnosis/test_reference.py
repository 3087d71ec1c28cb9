"""The stored diagnosis of three logs must come out again, and is right."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.service.diagnosis.reference import NOISE, STORED, difference, kept
from tests.service.injected import INJECTED
from tests.service.subject import document


def test_the_stored_diagnosis_comes_out_again(findings):
    moved = difference(json.loads(STORED.read_text()), kept(findings))
    assert not moved, "\n".join(
        ["the diagnosis moved; if meant: uv run python -m tests.service.diagnosis.reference, and say why", *moved]
    )


def test_a_moved_value_is_named_with_its_place():
    stored = json.loads(STORED.read_text())
    changed = stored | {"gap.shrink": stored["gap.shrink"] + 0.1, "verdict": "unexplained"}
    del changed["robot"]
    assert [line.split(":")[0] for line in difference(stored, changed)] == ["gap.shrink", "robot", "verdict"]
    assert "moved by +0.1" in difference(stored, changed)[0]


def test_the_stored_diagnosis_is_right(findings):
    found = document.document(findings)
    assert found.verdict == "explained"
    assert [effect.name for effect in found.effects] == ["stribeck_friction", "cogging"]
    for effect in found.effects:
        injected = INJECTED[effect.name]
        assert effect.joints == [joint + 1 for joint in injected.joints]
        truth = [*(value for row in injected.amplitude for value in row), *injected.nonlinear]
        for estimate, value in zip(effect.parameters.values(), truth, strict=True):
            low, high = estimate.ci95
            assert low < estimate.value < high
            assert abs(value - estimate.value) < 1.6 * (high - low) / 2 + 0.01 * abs(value)
        assert effect.probability > 0.9
    floor = NOISE * findings.problem.band.white_share**0.5
    assert found.gap.noise_floor_nm == pytest.approx([floor] * 3, rel=0.05)
    assert found.gap.after_nm == pytest.approx([floor] * 3, rel=0.1)
    before, after = np.square(found.gap.before_nm).sum(), np.square(found.gap.after_nm).sum()
    assert found.gap.shrink == pytest.approx(1 - (after / before) ** 0.5, abs=0.02)
    assert found.probability_unknown < 0.5
    assert found.probability_none < 0.01
