"""A robot description packed into the arrays that the kernels read."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from schemas.robot import Robot


class DeltaModel(NamedTuple):
    """Nominal rigid-body figures of one robot, SI, one entry an arm where an array of shape (3,)."""

    azimuth_cos: np.ndarray
    azimuth_sin: np.ndarray
    joint_offset: np.ndarray  # rad, true minus measured angle
    active_length: np.ndarray  # m, l1
    passive_length: float  # m, l2
    radius: float  # m, r = base radius - platform radius
    inertia: np.ndarray  # kg m^2, I = (m1/3 + m2) l1^2
    gravity_torque: np.ndarray  # N m, (m1/2 + m2) g l1
    moving_mass: float  # kg, M = m0 + 3 m2
    gravity: float  # m/s^2


def pack(robot: Robot) -> DeltaModel:
    """The nominal model of `robot`, with the geometry corrections it carries."""
    geometry, mass = robot.geometry, robot.mass
    azimuth = np.array(robot.arm_angles)
    length = geometry.active_link_length + np.array(geometry.active_link_length_error)
    half_forearm = mass.passive_link / 2
    shaft = robot.fourth_axis.shaft_mass_kg if robot.fourth_axis else 0.0
    return DeltaModel(
        azimuth_cos=np.cos(azimuth),
        azimuth_sin=np.sin(azimuth),
        joint_offset=np.array(geometry.joint_offset_rad),
        active_length=length,
        passive_length=geometry.passive_link_length,
        radius=geometry.base_radius - geometry.platform_radius,
        inertia=(mass.active_link / 3 + half_forearm) * length**2,
        gravity_torque=(mass.active_link / 2 + half_forearm) * robot.gravity_mps2 * length,
        moving_mass=mass.platform + shaft + 3 * half_forearm,
        gravity=robot.gravity_mps2,
    )
