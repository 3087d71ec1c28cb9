"""Effects in masses, geometry, springs and forces."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np

from drivers.simulated.plant.effects.plant_effect import JointEffect, PlantEffect, Size, below
from drivers.simulated.plant.mujoco_delta import Design
from drivers.simulated.plant.seen import Seen
from drivers.simulated.plant.truth import PlantTruth


def _plus(values: list[float], change: list[float]) -> list[float]:
    return [value + extra for value, extra in zip(values, change, strict=True)]


@dataclass
class RotorInertia(JointEffect):
    """Another motor or gear on one joint: more (or less) inertia reflected to it."""

    inertia_kgm2: Annotated[list[float], Size(0.012, 0.035, "one")]

    def shape(self, design: Design) -> Design:
        return design.change(rotor_inertia_kgm2=_plus(design.truth.rotor_inertia_kgm2, self.inertia_kgm2))


@dataclass
class ArmMass(JointEffect):
    """A cable, valve or repair on one active link: mass spread along it, so inertia and gravity change together."""

    mass_kg: Annotated[list[float], Size(0.2, 0.5, "one")]

    def shape(self, design: Design) -> Design:
        truth = design.truth
        length = truth.active_link_length_m
        mass = _plus(truth.active_link_kg, self.mass_kg)
        moment = [
            m * c + extra * l1 / 2
            for m, c, extra, l1 in zip(
                truth.active_link_kg, truth.active_link_centre_m, self.mass_kg, length, strict=True
            )
        ]
        return design.change(
            active_link_kg=mass,
            active_link_centre_m=[a / b for a, b in zip(moment, mass, strict=True)],
            active_link_inertia_kgm2=_plus(
                truth.active_link_inertia_kgm2,
                [extra * l1**2 / 3 for extra, l1 in zip(self.mass_kg, length, strict=True)],
            ),
        )


@dataclass
class ToolMass(PlantEffect):
    """A gripper that the description does not know: mass at the platform."""

    mass_kg: Annotated[float, Size(0.10, 0.30)]

    def shape(self, design: Design) -> Design:
        return design.change(platform_kg=design.truth.platform_kg + self.mass_kg)


@dataclass
class BaseTilt(PlantEffect):
    """The base is not level: gravity leans by two angles, rotations about the base's x and y axes."""

    about_x_rad: float
    about_y_rad: float

    @classmethod
    def draw(cls, rng: np.random.Generator, truth: PlantTruth, severity: float) -> Self:
        angle, heading = severity * math.radians(rng.uniform(1.5, 4.0)), rng.uniform(0, 2 * math.pi)
        return cls(float(angle * math.cos(heading)), float(angle * math.sin(heading)))

    def shape(self, design: Design) -> Design:
        x, y, z = design.truth.gravity_mps2
        a, b = self.about_x_rad, self.about_y_rad
        # gravity seen from a base turned about x by a, then about y by b
        y, z = math.cos(a) * y + math.sin(a) * z, math.cos(a) * z - math.sin(a) * y
        return design.change(gravity_mps2=[math.cos(b) * x - math.sin(b) * z, y, math.sin(b) * x + math.cos(b) * z])


@dataclass
class LinkLengthError(JointEffect):
    """An active link was machined longer or shorter than drawn: its mass centre and inertia go with it."""

    length_m: Annotated[list[float], Size(0.006, 0.012, "one", either=True)]

    def shape(self, design: Design) -> Design:
        truth = design.truth
        length = _plus(truth.active_link_length_m, self.length_m)
        ratio = np.divide(length, truth.active_link_length_m)
        return design.change(
            active_link_length_m=length,
            active_link_centre_m=(ratio * truth.active_link_centre_m).tolist(),
            active_link_inertia_kgm2=(ratio**2 * truth.active_link_inertia_kgm2).tolist(),
        )


@dataclass
class ForearmLengthError(JointEffect):
    """A forearm's rods are longer or shorter than drawn, of the same mass."""

    length_m: Annotated[list[float], Size(0.004, 0.008, "one", either=True)]

    def shape(self, design: Design) -> Design:
        return design.change(passive_link_length_m=_plus(design.truth.passive_link_length_m, self.length_m))


@dataclass
class BaseRadiusError(JointEffect):
    """A joint's axis is farther from the base's centre than drawn, or nearer."""

    radius_m: Annotated[list[float], Size(0.004, 0.008, "one", either=True)]

    def shape(self, design: Design) -> Design:
        return design.change(base_radius_m=_plus(design.truth.base_radius_m, self.radius_m))


@dataclass
class AzimuthError(JointEffect):
    """An arm is mounted at another angle round the base than drawn, and its feet on the platform with it."""

    azimuth_rad: Annotated[list[float], Size(0.008, 0.02, "one", either=True)]

    def shape(self, design: Design) -> Design:
        turned = [math.degrees(angle) for angle in self.azimuth_rad]
        return design.change(arm_angles_deg=_plus(design.truth.arm_angles_deg, turned))


@dataclass
class JointOffset(JointEffect):
    """Homing error: the encoder's zero is not where the link is horizontal. Figures are true minus measured angle."""

    offset_rad: Annotated[list[float], Size(0.02, 0.045, "one", either=True)]

    def shape(self, design: Design) -> Design:
        return design.change(joint_offset_rad=_plus(design.truth.joint_offset_rad, self.offset_rad))


@dataclass
class JointSpring(JointEffect):
    """A counterbalance spring or a stiff cable bundle on a joint: -k (theta - theta_0)."""

    stiffness_nmprad: Annotated[list[float], Size(1.5, 4.0, "one")]
    zero_rad: Annotated[list[float], Size(-0.3, 0.6, "each", grows=0)]

    def joint_torque(self, plant: Seen) -> np.ndarray:
        return -np.asarray(self.stiffness_nmprad) * (plant.theta - np.asarray(self.zero_rad))


@dataclass
class HoseSpring(PlantEffect):
    """A vacuum hose pulls the platform towards the point where it is clamped."""

    stiffness_npm: float
    point_m: list[float]

    @classmethod
    def draw(cls, rng: np.random.Generator, truth: PlantTruth, severity: float) -> Self:
        point = below(rng, truth, (0.2, 0.35), (0.3, 0.5))
        return cls(float(severity * rng.uniform(10.0, 22.0)), point)

    def platform_force(self, plant: Seen) -> np.ndarray:
        return self.stiffness_npm * (np.asarray(self.point_m) - plant.platform)


@dataclass
class AirDrag(PlantEffect):
    """Air against a flat gripper or product: c v |v| against the platform's motion."""

    drag_ns2pm2: Annotated[float, Size(0.5, 1.2)]

    def platform_force(self, plant: Seen) -> np.ndarray:
        return -self.drag_ns2pm2 * math.sqrt(plant.platform_dot @ plant.platform_dot) * plant.platform_dot
