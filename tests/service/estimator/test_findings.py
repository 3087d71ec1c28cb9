"""What the compiled findings say, against the same in NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from schemas.messages import HealthFlag
from service.estimator.departure import OWN, drift_share, learnt
from service.estimator.estimator import Estimator
from tests.known import PERIOD, make, robot

__all__ = ["make", "robot"]


@pytest.mark.parametrize("rubs", [0.0, 4.0])
def test_friction_is_told_as_it_was_learnt(robot, make, rubs: float) -> None:
    known = make(4.0, noise=0.25)
    known.samples["torque"][:, 1] += rubs * np.clip(known.theta_dot[:, 1] / 0.01, -1, 1)
    estimator = Estimator(robot, PERIOD)
    estimator.run(known.samples)
    flags, (told,) = estimator.findings(), estimator.friction
    found, spread = learnt(estimator.state["payload"]["departure"])
    own, deviation = found[:-1].reshape(3, OWN), spread[:-1].reshape(3, OWN)
    for part, name in enumerate(("coulomb", "viscous", "offset", "scale")):
        np.testing.assert_array_equal(told[name], own[:, part])
        np.testing.assert_array_equal(told[f"{name}_std_dev"], deviation[:, part])
    assert (told["ball_joints"], told["ball_joints_std_dev"]) == (found[-1], spread[-1])
    assert told["sequence"] == known.samples["sequence"][-1]
    identified = robot.identified
    rubbing = np.stack([identified.coulomb_friction_nm.value, identified.viscous_friction_nms.value], axis=1)
    np.testing.assert_allclose(told["drift"], drift_share(own, rubbing), rtol=1e-12)
    drifted = bool((told["drift"] > robot.limits.friction_drift).any())
    assert drifted == bool(rubs)
    assert bool(flags & HealthFlag.FRICTION_DRIFT) == drifted
    assert not flags & (HealthFlag.EFFECT_LEFT_OUT | HealthFlag.COMMAND_REFUTED)
