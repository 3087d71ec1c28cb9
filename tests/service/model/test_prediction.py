"""Each model's torque along a log, against the sums of which the log was made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from schemas.axes_description import load_axes
from schemas.errors import DataError
from schemas.robot import Robot
from schemas.trace import Trace
from service.model.dynamics import FOREARM, GRAVITY, INERTIA, PLATFORM, torque_terms
from service.model.nominal import pack
from service.model.prediction import Motion, error_in_band, motion, predict_along
from service.model.signals import UNUSABLE
from tests.known import Known, make, robot, trace_of
from tests.service import arm

LEFT = 0.15  # N m: accelerations of an encoder's counts are off by some rad/s^2

__all__ = ["make", "robot"]  # fixtures


def test_each_model_is_the_one_before_and_its_own_part(robot: Robot, make: Callable[..., Known]) -> None:
    known, identified = make(2.0), robot.identified
    assert identified is not None
    trace = trace_of(known)
    found = predict_along(robot, trace, motion(trace))
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


def test_faulty_rows_are_bridged_by_row(robot: Robot, make: Callable[..., Known]) -> None:
    """The motion of a row that was not measured goes straight from the one before it to the one after."""
    trace = trace_of(make(2.0))
    trace = replace(trace, flags=np.zeros(len(trace), np.uint32))
    trace.flags[700:705] = UNUSABLE
    along = motion(trace)
    assert np.flatnonzero(~along.measured).tolist() == list(range(700, 705))
    assert not along.moving[700:705].any()
    share = np.arange(1, 6)[:, None] / 6
    for signal in (along.theta, along.theta_dot, along.theta_ddot):
        np.testing.assert_allclose(signal[700:705], signal[699] * (1 - share) + signal[705] * share)
    # what is left of a torque that is right but for 2 N m is those, where joints move and rows were measured
    full = predict_along(robot, trace, along)["full"]
    left = error_in_band(trace, along, full - 2.0)
    assert np.isnan(left[~along.moving]).all()
    assert np.isfinite(left[along.moving]).all()
    assert along.moving.mean() > 0.5
    assert abs(np.nanmedian(left) - 2.0) < 0.1
    both = left - error_in_band(trace, along, full)
    np.testing.assert_allclose(both[along.moving], 2.0, atol=1e-6)


def test_axes_without_figures_have_no_prediction(tmp_path: Path, make: Callable[..., Known]) -> None:
    path = tmp_path / "axes.toml"
    path.write_text('name = "bench"\nkind = "axes"\n' + 3 * "[[axis]]\n")
    trace = trace_of(make(2.0))
    with pytest.raises(DataError, match=r"robot bench: no \[identified\] parameters"):
        predict_along(load_axes(path), trace, motion(trace))


def test_an_arm_is_predicted_by_its_urdf_too(tmp_path: Path) -> None:
    pytest.importorskip("pinocchio")
    _, signals = arm.motion(1)
    theta, theta_dot, theta_ddot = (values[:50] for values in signals)
    along = Motion(theta, theta_dot, theta_ddot, np.ones((50, 3), bool), np.ones(50, bool), ())
    trace = Trace(Path("arm.csv"), np.arange(50) * arm.PERIOD, theta, np.zeros((50, 3)))
    found = predict_along(load_axes(arm.write(tmp_path)), trace, along)
    assert list(found) == ["URDF"]
    np.testing.assert_allclose(found["URDF"], arm.torque(theta, theta_dot, theta_ddot), atol=1e-4)
