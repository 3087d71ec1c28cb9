"""The packed model by hand, what effects correct of it, and friction's direction against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from schemas.robot import FourthAxis
from service.model.coulomb_viscous import direction, mean_direction
from service.model.nominal import Correction, leaning, pack
from tests.service import world


def test_the_model_is_the_description_in_si(robot):
    model = pack(robot.model_copy(update={"fourth_axis": FourthAxis(shaft_mass_kg=0.4)}))
    angles = np.radians([5.0, 118.0, 247.0])
    expected = {
        "azimuth_cos": np.cos(angles), "azimuth_sin": np.sin(angles), "joint_offset": [0.01, 0.0, -0.02],
        "active_length": [0.36, 0.364, 0.354], "passive_length": [0.853, 0.845, 0.85], "radius": [0.136, 0.14, 0.146],
        "inertia": (0.9 + 0.275) * np.array([0.36, 0.364, 0.354]) ** 2, "link_mass": 1.35 + 0.275,
        "moving_mass": 1.3 + 0.4 + 0.825, "gravity": [0.0, 0.0, -9.81],
    }  # fmt: skip
    assert expected.keys() == set(model._fields)
    for name, value in expected.items():
        np.testing.assert_allclose(getattr(model, name), value, err_msg=name)
    assert pack(robot).moving_mass == pytest.approx(1.3 + 0.825), "no fourth axis, no shaft"


def test_a_corrected_description_is_a_corrected_model(robot):
    values = np.random.default_rng(2).uniform(-0.01, 0.01, (5, 3))
    correction = Correction(*values)
    corrected = pack(correction.geometry(robot))
    altered = correction.altered(pack(robot))
    for name in corrected._fields:
        np.testing.assert_allclose(getattr(corrected, name), getattr(altered, name), atol=1e-12, err_msg=name)
    np.testing.assert_allclose(corrected.active_length - pack(robot).active_length, values[0])
    np.testing.assert_allclose(corrected.joint_offset - pack(robot).joint_offset, values[1])
    np.testing.assert_allclose(corrected.passive_length - pack(robot).passive_length, values[2])
    np.testing.assert_allclose(corrected.radius - pack(robot).radius, values[3])
    was, now = (np.arctan2(model.azimuth_sin, model.azimuth_cos) for model in (pack(robot), corrected))
    np.testing.assert_allclose(now - was, values[4], atol=1e-12)


@pytest.mark.parametrize(
    ("gravity", "about"),
    [
        ([0.0, 0.0, -9.81], ([1, 0, 0], [0, 1, 0])),
        ([0.0, 0.0, 9.81], ([1, 0, 0], [0, -1, 0])),  # turned half round about x
        ([-9.81, 0.0, 0.0], ([0, 0, -1], [0, 1, 0])),
        ([0.0, 6.0, -8.0], ([1, 0, 0], [0, 0.8, 0.6])),
    ],
)
def test_a_tilt_turns_gravity_in_the_base(robot, gravity, about):
    size = 1e-5
    for axis, way in zip(about, np.eye(2), strict=True):
        leaned = Rotation.from_rotvec(-size * np.array(axis, float)).apply(gravity)
        np.testing.assert_allclose(leaning(np.array(gravity), size * way), leaned - gravity, atol=1e-8)
        tilted = Correction(tilt=size * way).geometry(robot.model_copy(update={"gravity_mps2": gravity}))
        np.testing.assert_allclose(tilted.gravity_mps2, leaned, atol=1e-8)


@pytest.mark.parametrize("gravity", [[3.0, -4.0, -8.0], [-1.0, 2.0, 9.0], [6.0, 5.0, 0.0]])
def test_a_tilt_is_about_the_axes_that_level_ones_become_when_the_base_is_turned_there(gravity):
    """The shortest way: about the normal of down and gravity."""
    gravity, down = np.array(gravity), np.array([0.0, 0.0, -1.0])
    normal = np.cross(down, gravity)
    angle = np.arctan2(np.linalg.norm(normal), down @ gravity)
    turned = Rotation.from_rotvec(angle * normal / np.linalg.norm(normal))
    np.testing.assert_allclose(turned.apply(down), gravity / np.linalg.norm(gravity), atol=1e-12)
    for axis, way in zip(turned.apply(np.eye(3)[:2]), np.eye(2), strict=True):
        np.testing.assert_allclose(leaning(gravity, way), -np.cross(axis, gravity), atol=1e-9)


def test_direction_is_a_mean_over_each_sample():
    speed = 0.03 * np.cos(np.linspace(0.0, 9.0, 200))[:, None] * [1.0, 5.0]
    speed[90:95] = speed[90]  # nothing changes: the mean is the value
    own = np.array([0.004, 0.02])
    expected = np.stack([world.direction(speed, each)[:, joint] for joint, each in enumerate(own)], axis=1)
    np.testing.assert_allclose(mean_direction(speed, own), expected, atol=2e-3)
    np.testing.assert_allclose(mean_direction(speed, 0.004), world.direction(speed, 0.004), atol=2e-3)
    np.testing.assert_allclose(mean_direction(speed, own)[92], np.tanh(speed[92] / own))
    np.testing.assert_array_equal(mean_direction(speed, 0.0), np.sign(speed))


def test_direction_of_a_sample_turns_within_its_transition_or_the_rest_speed():
    assert direction(0.003, 0.004) == pytest.approx(np.tanh(0.75))
    assert [direction(speed, 0.0) for speed in (-1.0, -0.005, 0.0, 0.0025, 0.5)] == [-1.0, -0.5, 0.0, 0.25, 1.0]
