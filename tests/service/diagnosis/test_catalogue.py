"""Effects of the user's own, from an installed package."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from schemas.errors import RobotError
from service.model.effects import CATALOGUE, catalogue

MODULE = """
from dataclasses import dataclass
import numpy as np
from service.model.effects.base import Amplitude, Effect

@dataclass(frozen=True)
class RubberStop(Effect):
    stiffness: Amplitude = Amplitude("N m/rad", "beyond half a radian")
    name = "rubber_stop"
    settles = "a slow sweep into the stop"

    def regressors(self, scene, joint, nonlinear):
        return np.maximum(scene.segment.theta[:, joint] - 0.5, 0.0)[:, None]
"""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Puts a package with one entry point on the path, as an installer leaves it."""

    def package(entry: str) -> None:
        (tmp_path / "our_effects.py").write_text(MODULE, encoding="utf-8")
        about = tmp_path / "our_effects-1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: our-effects\nVersion: 1.0\n", encoding="utf-8")
        (about / "entry_points.txt").write_text(f"[deltatwin.effects]\nrubber_stop = {entry}\n", encoding="utf-8")
        monkeypatch.syspath_prepend(tmp_path)

    return package


def test_an_installed_package_adds_its_effect(install: Callable[[str], None]) -> None:
    install("our_effects:RubberStop")
    extra = catalogue()[len(CATALOGUE) :]
    assert [effect.name for effect in extra] == ["rubber_stop"]
    assert list(extra[0].amplitudes) == ["stiffness"]


def test_a_package_that_cannot_be_loaded_is_named(install: Callable[[str], None]) -> None:
    install("our_effects:Missing")
    with pytest.raises(RobotError, match=r"effect rubber_stop = our_effects:Missing: AttributeError"):
        catalogue()


@pytest.mark.parametrize(
    ("whole", "cut", "said"),
    [
        ('    name = "rubber_stop"\n', "", "class RubberStop has no text 'name'"),
        ("def regressors", "def other", "TypeError: .*abstract.*regressors"),
        ("stiffness: Amplitude =", "stiffness: Amplitude, other =", "SyntaxError"),
    ],
)
def test_an_effect_that_is_not_whole_is_an_error_of_its_file(tmp_path: Path, whole: str, cut: str, said: str) -> None:
    assert whole in MODULE
    (own := tmp_path / "own.py").write_text(MODULE.replace(whole, cut), encoding="utf-8")
    with pytest.raises(RobotError, match=rf"own\.py: .*{said}"):
        catalogue(own)
