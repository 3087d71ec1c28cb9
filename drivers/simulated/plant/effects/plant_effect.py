"""What an effect is: physics at work in the plant that the description does not know of."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, Literal, NamedTuple, Self, get_type_hints

import numpy as np

from drivers.simulated.plant.mujoco_delta import Design
from drivers.simulated.plant.seen import Friction, Seen
from drivers.simulated.plant.truth import PlantTruth

JOINTS = np.arange(3)


class Size(NamedTuple):
    """A figure of a fault that maintenance would want to know of: between `low` and `high`, of either sign if `either`,
    on one random joint, on each, or of the robot. grows: times the severity (1), over it (-1), or neither (0)."""

    low: float
    high: float
    on: Literal["robot", "one", "each"] = "robot"
    grows: Literal[1, 0, -1] = 1
    either: bool = False

    def draw(self, rng: np.random.Generator, severity: float) -> float | list[float]:
        """A random one."""
        if self.either:
            value = signed(rng, self.low, self.high)
        else:
            value = rng.uniform(self.low, self.high, 3 if self.on == "each" else None)
        value = value * severity if self.grows > 0 else value / severity if self.grows else value
        return on_one(rng, float(value)) if self.on == "one" else np.asarray(value).tolist()


class Among(NamedTuple):
    """A figure that is one of `values`."""

    values: tuple[float, ...]

    def draw(self, rng: np.random.Generator, severity: float) -> float:
        """A random one."""
        return float(rng.choice(self.values))


@dataclass
class PlantEffect:
    """One unmodelled effect: override the hooks that its physics needs. All vectors are (3,), SI, joint side.

    Fields are its figures, annotated with their `Size`. The hooks run in every integration step (0.25 ms or less).
    """

    @classmethod
    def draw(cls, rng: np.random.Generator, truth: PlantTruth, severity: float) -> Self:
        """A random instance, figure by figure as annotated; severity 1 is a fault that maintenance would want to know
        of."""
        hints = get_type_hints(cls, include_extras=True)
        figures = [field.name for field in fields(cls) if field.init]
        return cls(*(hints[name].__metadata__[0].draw(rng, severity) for name in figures))

    @property
    def figures(self) -> dict[str, Any]:
        """By name, the first one its size."""
        return {field.name: getattr(self, field.name) for field in fields(self) if field.init}

    @property
    def in_words(self) -> str:
        """Its figures by name, `0/1000/0` where they are one a joint."""
        return ", ".join(f"{name} {_shown(value)}" for name, value in self.figures.items())

    @property
    def joints(self) -> list[int]:
        """Joints it sits on, from 0."""
        return JOINTS.tolist()

    def shape(self, design: Design) -> Design:
        """Change what is built."""
        return design

    def start(self, plant: Seen) -> None:
        """A motion begins: forget the one before."""

    def friction(self, plant: Seen, friction: Friction) -> None:
        """Change the friction in force."""

    def joint_torque(self, plant: Seen) -> np.ndarray:
        """Extra torque on the links, N m."""
        return np.zeros(3)

    def platform_force(self, plant: Seen) -> np.ndarray:
        """Extra force on the platform, N, base frame."""
        return np.zeros(3)

    def act_on_bodies(self, plant: Seen) -> None:
        """Write forces on rods and links straight into MuJoCo's `xfrc_applied`."""

    def motor_torque(self, plant: Seen, torque: np.ndarray) -> np.ndarray:
        """Torque at the rotor when the drive means `torque`, N m."""
        return torque

    def reading(self, plant: Seen, position: np.ndarray) -> np.ndarray:
        """What the encoders make of the true `position`, rad."""
        return position

    def report(self, plant: Seen, torque: np.ndarray) -> np.ndarray:
        """What the drive reports when it means `torque`, N m. Called once a step."""
        return torque


class JointEffect(PlantEffect):
    """An effect on single joints: its first figure is a list, one a joint, zero where the joint is spared."""

    @property
    def joints(self) -> list[int]:
        """Joints, from 0, whose figure is not zero."""
        return [joint for joint, figure in enumerate(next(iter(self.figures.values()))) if figure]


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


def _shown(value: float | list[float]) -> str:
    return f"{value:.4g}" if not isinstance(value, list) else "/".join(f"{one:.4g}" for one in value)
