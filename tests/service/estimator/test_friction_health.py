"""What the compiled findings say, against the same in NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from schemas.messages import HealthFlag
from service.estimator import state
from service.estimator.departure import OWN
from service.estimator.estimator import Estimator
from service.estimator.friction_health import findings_kernel
from tests.known import PERIOD, learnt, make, robot

__all__ = ["make", "robot"]


@pytest.mark.parametrize("rubs", [0.0, 4.0])
def test_friction_is_told_as_it_was_learnt(robot, make, rubs: float) -> None:
    known = make(4.0, noise=0.25)
    known.samples["torque"][:, 1] += rubs * np.clip(known.theta_dot[:, 1] / 0.01, -1, 1)
    estimator = Estimator(robot, PERIOD)
    estimator.run(known.samples)
    flags, (told,) = estimator.findings(), estimator.friction
    found, spread = learnt(estimator)
    own, deviation = found[:-1].reshape(3, OWN), spread[:-1].reshape(3, OWN)
    for part, name in enumerate(("coulomb", "viscous", "offset", "scale")):
        np.testing.assert_array_equal(told[name], own[:, part])
        np.testing.assert_array_equal(told[f"{name}_std_dev"], deviation[:, part])
    assert (told["ball_joints"], told["ball_joints_std_dev"]) == (found[-1], spread[-1])
    assert told["sequence"] == known.samples["sequence"][-1]
    drifted = bool((told["drift"] > robot.limits.friction_drift).any())
    assert drifted == bool(rubs)
    assert bool(flags & HealthFlag.FRICTION_DRIFT) == drifted
    assert not flags & (HealthFlag.EFFECT_LEFT_OUT | HealthFlag.COMMAND_REFUTED)


def test_a_share_of_friction_is_reckoned_at_one_speed(robot) -> None:
    """Coulomb and viscous together at 1 rad/s, or an offset, over what rubs there, of which a little is always taken to
    be."""
    steps = state.fresh(state.settings(robot, PERIOD, 1))
    steps["settings"]["coulomb"], steps["settings"]["viscous"] = [2.0, 3.0, 0.0], [1.0, 2.0, 0.0]
    own = steps["state"]["payload"]["departure"]["delta"][0, :-1].reshape(3, OWN)
    own[:, :3] = [[0.4, 0.2, -0.9], [0.5, -0.5, 0.1], [0.0, 0.0, 0.3]]
    findings_kernel(steps)
    assert steps["friction"]["drift"][0] == pytest.approx([0.3, 0.02, 2.0])
