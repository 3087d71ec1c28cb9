"""What an effect is: physics at work in the plant that the description does not know of."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Self

import numpy as np

if TYPE_CHECKING:
    from drivers.plant.mechanism import Design
    from drivers.plant.plant import Friction, Plant
    from drivers.plant.truth import PlantTruth

JOINTS = np.arange(3)


@dataclass
class PlantEffect:
    """One unmodelled effect: override the hooks that its physics needs. All vectors are (3,), SI, joint side.

    The hooks run in every integration step (0.25 ms or less).
    """

    @classmethod
    def draw(cls, rng: np.random.Generator, truth: PlantTruth, severity: float) -> Self:
        """A random instance; severity 1 is a fault that maintenance would want to know of."""
        raise NotImplementedError

    @property
    def joints(self) -> list[int]:
        """Joints it sits on, from 0."""
        return JOINTS.tolist()

    def shape(self, design: Design) -> Design:
        """Change what is built."""
        return design

    def start(self, plant: Plant) -> None:
        """A motion begins: forget the one before."""

    def friction(self, plant: Plant, friction: Friction) -> None:
        """Change the friction in force."""

    def joint_torque(self, plant: Plant) -> np.ndarray:
        """Extra torque on the links, N m."""
        return np.zeros(3)

    def platform_force(self, plant: Plant) -> np.ndarray:
        """Extra force on the platform, N, base frame."""
        return np.zeros(3)

    def act_on_bodies(self, plant: Plant) -> None:
        """Write forces on rods and links straight into MuJoCo's `xfrc_applied`."""

    def motor_torque(self, plant: Plant, torque: np.ndarray) -> np.ndarray:
        """Torque at the rotor when the drive means `torque`, N m."""
        return torque

    def reading(self, plant: Plant, position: np.ndarray) -> np.ndarray:
        """What the encoders make of the true `position`, rad."""
        return position

    def report(self, plant: Plant, torque: np.ndarray) -> np.ndarray:
        """What the drive reports when it means `torque`, N m. Called once a step."""
        return torque


class JointEffect(PlantEffect):
    """An effect on single joints: its first figure is a list, one a joint, zero where the joint is spared."""

    @property
    def joints(self) -> list[int]:
        """Joints, from 0, whose figure is not zero."""
        figures: list[float] = getattr(self, fields(self)[0].name)
        return [joint for joint, figure in enumerate(figures) if figure]


def on_one(rng: np.random.Generator, value: float) -> list[float]:
    """`value` on a random joint, zero on the others."""
    joint = int(rng.integers(3))
    return [value if i == joint else 0.0 for i in range(3)]


def signed(rng: np.random.Generator, low: float, high: float) -> float:
    """Uniform in [low, high], either sign."""
    return float(rng.choice((-1.0, 1.0)) * rng.uniform(low, high))


def below(
    rng: np.random.Generator, truth: PlantTruth, aside: tuple[float, float], down: tuple[float, float]
) -> list[float]:
    """A random point (3,) m under the base, `aside` of its axis and `down` by so many forearms."""
    heading, length = rng.uniform(0, 2 * math.pi), truth.passive_link_length_m[0]
    radius = rng.uniform(*aside) * length
    return [
        float(radius * math.cos(heading)),
        float(radius * math.sin(heading)),
        float(-rng.uniform(*down) * length),
    ]
