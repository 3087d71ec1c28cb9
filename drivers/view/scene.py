"""The robot in three dimensions, from its description and joint angles."""

from __future__ import annotations

import numpy as np

from schemas.robot import Robot
from service.model.kinematics import forward
from service.model.nominal import pack


def skeleton(robot: Robot, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Arms (3, 4, 3) m, hip, elbow, wrist and platform centre of each, and the platform's rim (4, 3) m, closed.

    theta: (3,) rad. Base frame, z up.

    Raises:
        PoseError: no pose of the robot.
    """
    platform = forward(pack(robot), theta[None])[0]
    arms = np.empty((3, 4, 3))
    for joint, azimuth in enumerate(robot.arm_angles):
        out = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        angle = theta[joint] + robot.geometry.joint_offset_rad[joint]
        length = robot.geometry.active_link_length + robot.geometry.active_link_length_error[joint]
        hip = robot.geometry.base_radius * out
        elbow = hip + length * (np.cos(angle) * out - np.sin(angle) * np.array([0.0, 0.0, 1.0]))
        arms[joint] = hip, elbow, platform + robot.geometry.platform_radius * out, platform
    return arms, np.concatenate([arms[:, 2], arms[:1, 2]])
