"""Each model's torque along a log, against the sums of which the log was made."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from schemas.robot import Robot
from service.model.dynamics import FOREARM, GRAVITY, INERTIA, PLATFORM, torque_terms
from service.model.nominal import pack
from service.model.prediction import predict
from tests.known import Known, make, robot, trace_of

LEFT = 0.15  # N m: accelerations of an encoder's counts are off by some rad/s^2

__all__ = ["make", "robot"]  # fixtures


def test_each_model_is_the_one_before_and_its_own_part(robot: Robot, make: Callable[..., Known]) -> None:
    known, identified = make(2.0), robot.identified
    assert identified is not None
    found = predict(robot, trace_of(known))
    assert list(found) == ["M_KH", "M_Id", "M_Id+F", "full"]
    terms = torque_terms(pack(robot), known.theta, known.theta_dot, known.theta_ddot)
    inertia, gravity, platform = (terms[:, part] for part in (INERTIA, GRAVITY, PLATFORM))
    friction = identified.viscous_friction_nms.value * known.theta_dot + identified.coulomb_friction_nm.value * np.sign(
        known.theta_dot
    )
    scaled = identified.rho_1.value * inertia + identified.rho_2.value * gravity + platform
    forearm = identified.forearm_inertia_kg.value * terms[:, FOREARM]
    expected = {
        "M_KH": inertia + gravity + platform,
        "M_Id": scaled,
        "M_Id+F": scaled + friction,
        "full": scaled + friction + forearm,
    }
    sliding = np.abs(known.theta_dot) > 0.1
    sliding[:100] = sliding[-100:] = False
    for name, torque in expected.items():
        np.testing.assert_allclose(found[name][sliding], torque[sliding], atol=LEFT, err_msg=name)
