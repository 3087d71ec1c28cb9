"""A corrected robot attached to MuJoCo goes where the exported callback, called by hand before every step, takes it."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's compiled modules carry no types)

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from deltatwin.mujoco import attach, model_of
from schemas.axes_description import load_axes
from schemas.errors import DataError, UnansweredError
from service.rollout.simulator_files import to_mjcf
from tests.service.rollout.test_kernel import effect, identified

STEPS = 400
TORQUE = (4.0, -3.0, 2.0)  # N m on top of what holds it about still


def goes(model: mujoco.MjModel, apply=lambda data: None) -> np.ndarray:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for _ in range(STEPS):
        data.ctrl[:] = TORQUE
        apply(data)
        mujoco.mj_step(model, data)
    return data.qpos.copy()


def test_attached_it_goes_where_the_exported_file_takes_it() -> None:
    robot = identified(effect("stribeck_friction"), effect("cogging"), effect("presliding_friction"))
    model, scope = model_of(robot), {}
    exec(to_mjcf(robot).callback or "", scope)
    by_hand, bare = goes(model, scope["Effects"](model).apply), goes(model)
    another = model_of(identified())
    alone = goes(another)
    with attach(model, robot) as shown:
        attached = goes(model)
        other = goes(another)
    assert shown is None
    moved = np.abs(by_hand - bare).max()
    assert moved > 1e-3
    assert np.abs(attached - by_hand).max() < 0.02 * moved
    np.testing.assert_array_equal(other, alone)
    assert mujoco.get_mjcb_control() is None
    np.testing.assert_array_equal(goes(model), bare)


def test_what_cannot_be_attached_is_said(tmp_path: Path) -> None:
    robot = identified(effect("stribeck_friction"))
    model = model_of(robot)
    with attach(model, robot), pytest.raises(DataError, match="callback is already in use"), attach(model, robot):
        pass
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    with pytest.raises(DataError, match="RK4"), attach(model, robot):
        pass
    (tmp_path / "a.toml").write_text(
        'name = "a"\nkind = "axes"\n[[axis]]\n[identified]\ninertia = { value = [0.4] }\n'
        "offset = { value = [0.0] }\nviscous_friction = { value = [0.1] }\ncoulomb_friction = { value = [0.1] }\n"
    )
    axes = load_axes(tmp_path / "a.toml")
    assert model_of(axes).nu == 1
    with pytest.raises(UnansweredError, match="callback for MuJoCo is not available"), attach(model_of(axes), axes):
        pass


def test_a_delayed_torque_is_what_a_log_would_show() -> None:
    robot = identified(effect("torque_delay"))
    with attach(model_of(robot), robot) as shown:
        assert shown is not None
        assert len(shown.torque([1.0, 2.0, 3.0])) == 3
