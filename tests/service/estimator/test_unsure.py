"""What is not known of an effect is not known of a mass."""

import numpy as np
import pytest

from schemas.robot import EffectEntry, EffectParameter
from service.estimator.estimator import Estimator
from service.estimator.unsure import mass_error
from tests.known import PERIOD


def described(robot, name, **parameters):
    """parameters: value and standard error."""
    given = {key: EffectParameter(value=value, std_error=error) for key, (value, error) in parameters.items()}
    return robot.model_copy(update={"effect": [EffectEntry(name=name, joints=[], parameters=given)]})


def test_a_tool_of_unknown_mass_is_a_load_of_unknown_mass(robot):
    """By as much, for it hangs where the load does."""
    assert mass_error(described(robot, "tool_mass", delta_m=(0.3, 0.05))) == pytest.approx(0.05, rel=0.02)


def test_parameters_without_an_error_and_robots_without_effects_are_sure(robot):
    assert mass_error(robot) == 0.0
    assert mass_error(described(robot, "tool_mass", delta_m=(0.3, 0.0))) == 0.0


def test_all_masses_of_a_robot_have_that_error_in_common(robot, make):
    samples = make(2.0, noise=0.25).samples
    known, unsure = (
        Estimator(described(robot, "tool_mass", delta_m=(0.0, error)), PERIOD).run(samples).payload[-1]
        for error in (0.0, 0.05)
    )
    assert unsure["mass"] == pytest.approx(known["mass"], abs=1e-3)
    assert unsure["random_std_dev"] == pytest.approx(known["random_std_dev"], rel=0.05)
    grown = np.sqrt(unsure["common_std_dev"] ** 2 - known["common_std_dev"] ** 2)
    assert grown == pytest.approx(0.05, rel=0.02)
    assert unsure["std_dev"] > known["std_dev"]
