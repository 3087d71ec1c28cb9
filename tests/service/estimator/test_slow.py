"""Motion below 0.05 rad/s, where a gear rubs as it likes: gravity tells the mass, or it is said that it does not."""

import numpy as np
import pytest

from schemas.messages import Gripper, PayloadEvent, stamp_ns
from tests.service.estimator.test_friction import rubbed
from tests.service.estimator.test_trust import covered, weigh

PACE = 0.0085  # 0.039 rad/s at most
ON, OFF = 8.0, 20.0  # s


def slowly(robot, make, level=(0.0, 0.0, 0.0), mass=2.0):
    """30 s of slow motion with `mass` kg from ON to OFF, friction more by `level` of itself."""
    known = make(30.0, payload=lambda t: mass * ((t >= ON) & (t < OFF)), noise=0.25, pace=PACE)
    known.samples["torque"] += np.array(level) * rubbed(robot, known)
    return known.samples


def truth_of(time, mass=2.0):
    return mass * ((time >= ON) & (time < OFF))


@pytest.mark.parametrize(
    "level", [(0.0, 0.0, 0.0), (0.2, 0.2, 0.2), (0.2, -0.1, 0.25)], ids=["as identified", "more", "of each its own"]
)
def test_a_load_is_seen_and_weighed(robot, make, level):
    payload, time = weigh(robot, slowly(robot, make, level))
    inside, _ = covered(payload, time, truth_of(time), after=0.6)
    assert inside >= 0.95
    seen = payload["event"] != 0
    assert payload["event"][seen].tolist() == [PayloadEvent.PICK, PayloadEvent.RELEASE]
    assert (np.abs(time[seen] - [ON, OFF]) < 0.6).all()
    held = (time > ON + 2.0) & (time < OFF)
    assert np.abs(payload["mass"] - 2.0)[held].max() < 0.3


def test_what_friction_may_be_is_in_the_error(robot, make):
    """A load that hangs from the start, and friction that has departed as far as a gear does, another way on each
    joint: nothing but the way the weight changes with the pose tells the two apart."""
    known = make(10.0, payload=lambda t: 2.0 * np.ones_like(t), noise=0.25, pace=PACE)
    known.samples["torque"] += np.array([0.3, -0.3, 0.3]) * rubbed(robot, known)
    payload, time = weigh(robot, known.samples)
    inside, _ = covered(payload, time, 2.0 * np.ones_like(time))
    assert inside >= 0.95


def test_a_gripper_that_says_so_starts_a_mass_anew(robot, make):
    samples = slowly(robot, make)
    time = stamp_ns(samples) * 1e-9
    samples["gripper"] = np.where((time >= ON) & (time < OFF), Gripper.CLOSED, Gripper.OPEN)
    payload, time = weigh(robot, samples)
    kinds, at = payload["event"][payload["event"] != 0], time[payload["event"] != 0]
    assert kinds.tolist() == [PayloadEvent.PICK, PayloadEvent.RELEASE]
    assert (np.abs(at - [ON, OFF]) < [0.6, 0.02]).all()
    assert (payload["mass"][(time > OFF + 0.02)] == 0).all()


def test_nothing_is_seen_where_nothing_hangs(robot, make):
    payload, time = weigh(robot, slowly(robot, make, (0.2, -0.1, 0.25), mass=0.0))
    assert not payload["event"].any()
    inside, _ = covered(payload, time, np.zeros_like(time))
    assert inside >= 0.95
