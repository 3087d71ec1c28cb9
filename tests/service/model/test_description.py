"""Effects of a description become terms; those of the user's own wherever the description is read."""

import numpy as np
import pytest

from schemas.axes import load_axes
from schemas.errors import RobotError
from service.model.description import terms_of, torque_along

AXES = """
name = "bench"
kind = "axes"
[[axis]]
[identified]
inertia = {value = [2.0]}
offset = {value = [0.0]}
viscous_friction = {value = [0.0]}
coulomb_friction = {value = [0.0]}
[[effect]]
name = "bump"
joints = [1]
parameters = {height = {value = 3.0}}
"""
OWN = """
from __future__ import annotations
from dataclasses import dataclass
from service.model.effects.base import Amplitude, Effect
@dataclass(frozen=True)
class Bump(Effect):
    height: Amplitude = Amplitude("N m", "height")
    name = "bump"
    settles = "a slow sweep"
    def regressors(self, scene, joint, shape):
        return scene.segment.theta[:, [joint]] ** 2
"""


@pytest.fixture
def files(tmp_path):
    (tmp_path / "axes.toml").write_text(AXES)
    (tmp_path / "own.py").write_text(OWN)
    return tmp_path


def test_an_effect_of_ones_own_is_in_the_torque(files):
    axes = load_axes(files / "axes.toml", files / "own.py")
    time = np.arange(2000) * 1e-3
    theta, speed, acceleration = np.sin(time)[:, None], np.cos(time)[:, None], -np.sin(time)[:, None]
    assert np.allclose(torque_along(axes, time, theta, speed, acceleration), 2.0 * acceleration + 3.0 * theta**2)
    assert terms_of(axes)[0].effect == terms_of(axes)[0].effect, "the file is run once"


def test_a_missing_effect_is_named(files):
    with pytest.raises(RobotError, match=r"robot bench: effect bump: not in the catalogue; .* --effects"):
        terms_of(load_axes(files / "axes.toml"))


def test_a_joint_that_is_none_is_named(files):
    (files / "axes.toml").write_text(AXES.replace("joints = [1]", "joints = [2]"))
    with pytest.raises(RobotError, match="effect bump: joint 2 of 1"):
        terms_of(load_axes(files / "axes.toml", files / "own.py"))
