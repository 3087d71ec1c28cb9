"""Axes that share a motor, by the equations that a sheet of paper has of them."""

import numpy as np

from service.model.mechanism import Coefficient, DecoupledAxes

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
