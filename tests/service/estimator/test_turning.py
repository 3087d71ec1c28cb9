"""What a load off the fourth axis does to the joints, against the second derivative of its place in closed form."""

import numpy as np
import pytest

from service.estimator.state import SETTINGS, STATE
from service.estimator.turning import swing_kernel, turn_kernel

CYCLE, LAG = 1e-3, 5


@pytest.fixture
def turning():
    """Settings and state of an estimator at some pose, and what it says of an angle, cycle after cycle."""
    random, settings, state = np.random.default_rng(0), np.zeros(1, SETTINGS)[0], np.zeros(1, STATE)[0]
    settings["period"], settings["motion"]["lag"], settings["scale"] = CYCLE, LAG, [1.0, 1.05, 0.9]
    state["pose"]["column"], state["pose"]["lever"] = random.standard_normal((3, 3)), random.standard_normal(3)

    def say(angle, gap=1):
        loads = np.full((3, 3), 7.0)
        turn_kernel(state, angle, gap)
        swing_kernel(settings, state, loads)
        assert (loads[:, 0] == 7.0).all(), "the mass's own column is another's"
        return loads[:, 1:]

    jacobian = settings["scale"][:, None] * (state["pose"]["column"] * state["pose"]["lever"][:, None])[:, :2]
    return say, jacobian


def test_the_swing_of_a_turning_load_is_the_acceleration_of_its_place(turning):
    """Some turns at a speed that changes, as drives tell it: within one turn."""
    say, jacobian = turning
    time = np.arange(200) * CYCLE
    speed, change = 70.0, 900.0  # rad/s, rad/s^2
    angle = 2.0 + speed * time + 0.5 * change * time**2
    for n, read in enumerate(np.mod(angle, 2 * np.pi)):
        found = say(read)
        if n < 2 * LAG:
            assert not found.any(), "not known all around"
            continue
        rate = speed + change * time[n - LAG]
        place = np.exp(1j * angle[n - LAG]) * np.array([1.0, 1j])  # of a load ahead of the axis, and of one beside it
        pushed = (1j * change - rate**2) * place
        np.testing.assert_allclose(found, jacobian @ np.stack([pushed.real, pushed.imag]), rtol=1e-6, atol=1e-3)


@pytest.mark.parametrize("how", ["not known", "a cycle left out"])
def test_an_angle_that_was_gone_is_looked_at_anew(turning, how):
    say, _ = turning
    for n in range(50):
        assert say(0.05 * n).any() == (n >= 2 * LAG)
    assert not (say(np.nan) if how == "not known" else say(9.0, gap=2)).any()
    known = 0 if how == "not known" else 1
    for n in range(known, 30):
        assert say(1.0 + 0.05 * n).any() == (n >= 2 * LAG)
