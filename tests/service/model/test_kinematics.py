"""Kinematics against the constraint itself, finite differences and its own inverse."""

import numpy as np
import pytest

from schemas.errors import PoseError
from service.model import kinematics
from service.model.mechanism import Delta


def elbows(model, theta):
    """J'_i of the frame's definition, (N, 3 arms, 3 axes)."""
    angle = theta + model.joint_offset
    reach = model.radius + model.active_length * np.cos(angle)
    return np.stack(
        [reach * model.azimuth_cos, reach * model.azimuth_sin, -model.active_length * np.sin(angle)], axis=-1
    )


def test_forward_puts_the_platform_one_forearm_from_every_elbow(model, poses):
    platform = kinematics.forward(model, poses)
    length = np.linalg.norm(platform[:, None] - elbows(model, poses), axis=-1)
    assert np.abs(length - model.passive_length).max() < 1e-12
    assert (platform[:, 2] < elbows(model, poses)[..., 2].min(axis=1)).all(), "the platform hangs below the elbows"


def test_arms_may_be_numbered_either_way_round(model, poses):
    way = [0, 2, 1]
    other = model._replace(
        **{name: getattr(model, name)[way] for name in model._fields if np.shape(getattr(model, name)) == (3,)}
    )._replace(gravity=model.gravity)
    np.testing.assert_allclose(kinematics.forward(other, poses[:, way]), kinematics.forward(model, poses), atol=1e-12)


def test_inverse_undoes_forward_over_the_workspace(model, poses):
    assert np.abs(kinematics.inverse(model, kinematics.forward(model, poses)) - poses).max() < 1e-12


def test_jacobian_is_the_slope_of_forward(model, poses):
    step = 1e-6
    slope = np.stack(
        [
            (kinematics.forward(model, poses + step * axis) - kinematics.forward(model, poses - step * axis))
            / (2 * step)
            for axis in np.eye(3)
        ],
        axis=2,
    )
    assert np.abs(kinematics.jacobian(model, poses) - slope).max() < 1e-8


def test_motion_is_the_derivative_of_position_along_a_path(model, poses):
    random = np.random.default_rng(2)
    theta_dot, theta_ddot = random.normal(0, 5, poses.shape), random.normal(0, 100, poses.shape)
    platform = kinematics.motion(model, poses, theta_dot, theta_ddot)

    def at(time):
        return kinematics.forward(model, poses + theta_dot * time + theta_ddot * time**2 / 2)

    step = 2e-4
    velocity = (8 * (at(step) - at(-step)) - (at(2 * step) - at(-2 * step))) / (12 * step)
    acceleration = (16 * (at(step) + at(-step)) - (at(2 * step) + at(-2 * step)) - 30 * at(0)) / (12 * step**2)
    assert np.abs(platform.velocity - velocity).max() < 1e-6
    assert np.abs(platform.acceleration - acceleration).max() < 1e-3
    # J_dot theta_dot is what the joint accelerations leave
    j_dot = (
        kinematics.jacobian(model, poses + step * theta_dot) - kinematics.jacobian(model, poses - step * theta_dot)
    ) / (2 * step)
    rest = kinematics.motion(model, poses, theta_dot, np.zeros_like(poses)).acceleration
    assert np.abs(np.einsum("nai,ni->na", j_dot, theta_dot) - rest).max() < 1e-3


@pytest.mark.parametrize("size", [1.0, 0.01])
def test_inverse_motion_undoes_motion(model, poses, size):
    model = model._replace(
        **{name: getattr(model, name) * size for name in ("active_length", "passive_length", "radius")}
    )
    random = np.random.default_rng(3)
    theta_dot, theta_ddot = random.normal(0, 5, poses.shape), random.normal(0, 100, poses.shape)
    platform = kinematics.motion(model, poses, theta_dot, theta_ddot)
    back = kinematics.inverse_motion(model, platform)
    for found, given in zip(back, (poses, theta_dot, theta_ddot), strict=True):
        np.testing.assert_allclose(found, given, rtol=0, atol=1e-9)


def test_one_sample_and_the_batch_give_the_same_bits(model, poses):
    batch = kinematics.forward(model, poses)
    assert all((kinematics.forward(model, pose) == row).all() for pose, row in zip(poses[:50], batch[:50], strict=True))


def test_of_no_pose_there_is_nothing_and_no_error(model):
    none = np.zeros((0, 3))
    assert kinematics.forward(model, none).shape == (0, 3)
    assert kinematics.inverse(model, none).shape == (0, 3)
    assert kinematics.jacobian(model, none).shape == (0, 3, 3)


def test_unreachable_and_singular_poses_are_errors_with_the_pose(model):
    with pytest.raises(PoseError, match=r"unreachable pose \(3, 0, 0.5\) rad in row 1"):
        kinematics.forward(model, np.array([[0.1, 0.1, 0.1], [3.0, 0.0, 0.5]]))
    with pytest.raises(PoseError, match=r"unreachable pose \(0, 0, -5\) m"):
        kinematics.inverse(model, np.array([0.0, 0.0, -5.0]))
    with pytest.raises(PoseError, match="nan"):
        kinematics.forward(model, np.array([np.nan, 0.0, 0.0]))
    with pytest.raises(PoseError, match="nan"):
        kinematics.inverse(model, np.array([np.nan, 0.0, -0.8]))


def test_forearms_in_one_plane_are_singular(model):
    flat = model._replace(passive_length=np.ones(3), active_length=np.full(3, 0.9), joint_offset=np.zeros(3))
    azimuth = np.radians([0.0, 120.0, 240.0])
    flat = flat._replace(azimuth_cos=np.cos(azimuth), azimuth_sin=np.sin(azimuth), radius=np.full(3, 0.1))
    with pytest.raises(PoseError, match="singular pose"):
        kinematics.forward(flat, np.zeros(3))  # elbows exactly one forearm from the axis


def test_a_stretched_arm_has_no_joint_velocity(model):
    straight = model._replace(joint_offset=np.zeros(3))
    reach = straight.active_length[0] + straight.passive_length[0]
    # base pivot of arm 1 plus a straight arm at 1 rad
    position = np.array(
        [
            (straight.radius[0] + reach * np.cos(1.0)) * straight.azimuth_cos[0],
            (straight.radius[0] + reach * np.cos(1.0)) * straight.azimuth_sin[0],
            -reach * np.sin(1.0) + 1e-9,
        ]
    )
    still = kinematics.PlatformMotion(position, np.ones(3), np.zeros(3))
    with pytest.raises(PoseError, match="pose"):
        kinematics.inverse_motion(straight, still)


def test_arms_are_rods_from_elbow_to_platform_that_turn_about_their_axles(model, poses):
    theta_dot = np.random.default_rng(4).normal(0, 5, poses.shape)
    arms = Delta(model, np.ones(3)).arms(poses, theta_dot, np.zeros_like(poses))
    platform = kinematics.forward(model, poses)
    np.testing.assert_allclose(arms.forearm, platform[:, None] - elbows(model, poses), atol=1e-12)
    step = 1e-6
    after, before = (kinematics.forward(model, poses + way * step * theta_dot) for way in (1, -1))
    rod = [p[:, None] - elbows(model, poses + w * step * theta_dot) for p, w in ((after, 1), (before, -1))]
    np.testing.assert_allclose(arms.swing, (rod[0] - rod[1]) / (2 * step), atol=1e-6)
    slope = (elbows(model, poses + step) - elbows(model, poses - step)) / (2 * step)
    np.testing.assert_allclose(arms.slope, slope, atol=1e-8)
    azimuth = np.stack([model.azimuth_cos, model.azimuth_sin, np.zeros(3)], axis=1)
    pivot = model.radius[:, None] * azimuth
    np.testing.assert_allclose(np.cross(arms.axle, elbows(model, poses) - pivot), slope, atol=1e-8)
