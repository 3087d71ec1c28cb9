"""A robot description packed into the arrays that the kernels read, and what effects correct of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from schemas.robot import Robot


class DeltaModel(NamedTuple):
    """Nominal rigid-body figures of one robot, SI, one entry an arm where an array of shape (3,)."""

    azimuth_cos: np.ndarray
    azimuth_sin: np.ndarray
    joint_offset: np.ndarray  # rad, true minus measured angle
    active_length: np.ndarray  # m, l1
    passive_length: np.ndarray  # m, l2
    radius: np.ndarray  # m, r = base radius - platform radius
    inertia: np.ndarray  # kg m^2, I = (m1/3 + m2) l1^2
    link_mass: float  # kg, m1/2 + m2, which weighs at the elbow
    moving_mass: float  # kg, M = m0 + 3 m2
    gravity: np.ndarray  # m/s^2, vector in the base frame


# The same as kernels take it: one type for estimator, batches and rollout, so that they share what is compiled.
MODEL = np.dtype(
    [(name, "f8") if name in ("link_mass", "moving_mass") else (name, "f8", 3) for name in DeltaModel._fields],
    align=True,
)


def record_of(model: DeltaModel) -> np.void:
    """`model` as a MODEL record."""
    return np.array([tuple(model)], MODEL)[0]


@dataclass(frozen=True)
class Correction:
    """What effects change in the model itself, true minus described, one entry an arm.

    length, forearm, radius: m, of active links, forearms, and joints from the axis. offset: rad, zeros of the joints.
    azimuth: rad. tilt: (2,) rad of the base, as in `leaning`. scale: reported over true torque.
    """

    length: np.ndarray = field(default_factory=lambda: np.zeros(3))
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    forearm: np.ndarray = field(default_factory=lambda: np.zeros(3))
    radius: np.ndarray = field(default_factory=lambda: np.zeros(3))
    azimuth: np.ndarray = field(default_factory=lambda: np.zeros(3))
    tilt: np.ndarray = field(default_factory=lambda: np.zeros(2))
    scale: np.ndarray = field(default_factory=lambda: np.ones(3))

    def geometry(self, robot: Robot) -> Robot:
        """`robot` with the geometry and the gravity that it has."""
        geometry = robot.geometry
        changed = {
            "active_link_length_error": (geometry.active_link_length_error + self.length).tolist(),
            "passive_link_length_error": (geometry.passive_link_length_error + self.forearm).tolist(),
            "base_radius_error": (geometry.base_radius_error + self.radius).tolist(),
            "arm_angles_deg": (geometry.arm_angles_deg + np.degrees(self.azimuth)).tolist(),
            "joint_offset_rad": (geometry.joint_offset_rad + self.offset).tolist(),
        }
        gravity = np.array(robot.gravity_mps2)
        update = {
            "geometry": geometry.model_copy(update=changed),
            "gravity_mps2": (gravity + leaning(gravity, self.tilt)).tolist(),
        }
        return robot.model_copy(update=update)

    def altered(self, model: DeltaModel) -> DeltaModel:
        """The same of a packed one, but for the tilt; masses stay."""
        cosine, sine = np.cos(self.azimuth), np.sin(self.azimuth)
        length = model.active_length + self.length
        return model._replace(
            azimuth_cos=model.azimuth_cos * cosine - model.azimuth_sin * sine,
            azimuth_sin=model.azimuth_sin * cosine + model.azimuth_cos * sine,
            joint_offset=model.joint_offset + self.offset,
            active_length=length,
            passive_length=model.passive_length + self.forearm,
            radius=model.radius + self.radius,
            inertia=model.inertia * (length / model.active_length) ** 2,
        )


def leaning(gravity: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """(3,) m/s^2 that `gravity` changes by in a base that is tilted by (2,) small angles, rad.

    About the base's x and y axes where it hangs level, z up; of another mounting about the two level axes that x and y
    become when the base is turned there the shortest way (about x where it stands upside down).
    """
    size = float(np.linalg.norm(gravity))
    x, y, z = gravity / size
    # the turn that takes (0, 0, -1) to the direction of gravity, on (0, 1, 0) and (1, 0, 0)
    if z > 0.999999:
        forward, side = np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    else:
        share = 1.0 / (1.0 - z)
        forward = np.array([-x * y * share, 1.0 - y * y * share, y])
        side = np.array([1.0 - x * x * share, -x * y * share, x])
    return size * (tilt[1] * side - tilt[0] * forward)


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
        passive_length=geometry.passive_link_length + np.array(geometry.passive_link_length_error),
        radius=geometry.base_radius - geometry.platform_radius + np.array(geometry.base_radius_error),
        inertia=(mass.active_link / 3 + half_forearm) * length**2,
        link_mass=mass.active_link / 2 + half_forearm,
        moving_mass=mass.platform + shaft + 3 * half_forearm,
        gravity=np.array(robot.gravity_mps2),
    )


def lengthened(rho_1: float, rho_2: float, ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """rho_1 and rho_2 (3,) of active links `ratio` (3,) as long as drawn.

    rho also stands for rotor and gear: a longer link changes its own share of inertia and gravity, not theirs.
    """
    return rho_1 + (1.0 - rho_1) * (1.0 - ratio**-2), rho_2 + (1.0 - rho_2) * (1.0 - ratio**-1)
