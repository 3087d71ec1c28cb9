"""Axes that share a motor, by the equations that a sheet of paper has of them."""

import tracemalloc

import numpy as np

from service.model.mechanism import Coefficient, DecoupledAxes
from service.model.scene import Base, Recording, Scene
from service.model.signals import Segment

COUPLED = DecoupledAxes(np.array([5.0, 9.0]), np.array([[1.0, 0.0], [1.0, 2.0]]), (1,))  # motor 2 turns with both


def test_the_torque_of_axes_is_that_of_their_own_parts_and_of_the_motor_they_share():
    angle, speed, change = np.random.default_rng(1).uniform(-2.0, 2.0, (3, 20, 2))
    values = {
        "inertia_1": 0.3, "inertia_2": 0.5, "offset_1": -0.7, "offset_2": 1.1,
        "gravity_sin_2": 1.3, "gravity_cos_2": -1.7, "inertia_motor_2": 1.9,
    }  # fmt: skip
    assert list(COUPLED.coefficients) == list(values)
    turned = 1.9 * (change[:, 0] + 2.0 * change[:, 1])  # of the motor: N m at its shaft
    first = 0.3 * change[:, 0] - 0.7 + turned
    second = 0.5 * change[:, 1] + 1.1 + 1.3 * np.sin(angle[:, 1]) - 1.7 * np.cos(angle[:, 1]) + 2.0 * turned
    torque = COUPLED.rigid(angle, speed, change).torque(np.array(list(values.values())))
    np.testing.assert_allclose(torque, np.stack([first, second], axis=1), atol=1e-12)


def test_what_rubs_are_the_joints_and_the_motors_of_several():
    assert COUPLED.frictions == ("1", "2", "motor_2")
    np.testing.assert_array_equal(COUPLED.rows, [[1, 0], [0, 1], [1, 2]])
    assert COUPLED.optional == [("gravity_sin_2", "gravity_cos_2")]
    alone = DecoupledAxes(np.array([5.0, 9.0]))
    assert (alone.frictions, alone.optional, len(alone.start)) == (("1", "2"), [], 4)


def test_only_inertia_has_a_least():
    units = {"inertia": Coefficient("kg m^2", 0.0), "offset": Coefficient("N m", -np.inf)}
    for name, coefficient in COUPLED.coefficients.items():
        assert coefficient == units.get(name.split("_")[0], units["offset"]), name


def _seen(axes: DecoupledAxes, motion: np.ndarray, rigid: np.ndarray) -> Scene:
    theta, theta_dot, theta_ddot = motion
    segment = Segment(
        rows=np.arange(len(theta)), time=1e-3 * np.arange(len(theta)), theta=theta, theta_dot=theta_dot,
        theta_ddot=theta_ddot, torque=np.zeros_like(theta), moving=np.ones(theta.shape, bool), period=1e-3,
    )  # fmt: skip
    none = np.zeros(len(axes.frictions))
    return Scene(Recording(segment, axes, 0, "drawn"), Base(rigid, none, none))


def test_slopes_of_axes_are_the_derivatives_on_that_sheet():
    motion = np.random.default_rng(2).uniform(-2.0, 2.0, (3, 20, 2))
    scene = _seen(COUPLED, motion, np.array([0.3, 0.5, -0.7, 1.1, 1.3, -1.7, 1.9]))
    expected = np.zeros((2, 20, 2, 3))  # joint that moves, sample, torque, by angle, speed, acceleration
    expected[1, :, 1, 0] = 1.3 * np.cos(motion[0, :, 1]) + 1.7 * np.sin(motion[0, :, 1])
    expected[0, :, 0, 2], expected[1, :, 1, 2] = 0.3 + 1.9, 0.5 + 4.0 * 1.9
    expected[0, :, 1, 2] = expected[1, :, 0, 2] = 2.0 * 1.9
    for joint in range(2):
        np.testing.assert_allclose(scene.slopes(joint), expected[joint], atol=1e-12)
    further = scene.moved(motion[0], motion[1], motion[2] + [1.0, 0.0])
    np.testing.assert_allclose(further, np.broadcast_to([0.3 + 1.9, 3.8], (20, 2)), atol=1e-12)


def test_slopes_of_six_axes_take_little_more_than_they_are():
    """Each axis has columns of its own: slopes of all columns at all axes are nearly all zero, and were 25 times as
    much memory."""
    axes = DecoupledAxes(np.ones(6), weighs=tuple(range(6)))
    scene = _seen(axes, np.random.default_rng(3).uniform(-2.0, 2.0, (3, 1000, 6)), np.ones(24))
    tracemalloc.start()
    try:
        size = sum(scene.slopes(joint).nbytes for joint in range(6))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 3 * size
