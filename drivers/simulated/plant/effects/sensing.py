"""Effects between what happens and what the bus says of it, and ripple of the motors."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Annotated, Self

import numpy as np

from drivers.simulated.plant.effects.plant_effect import Among, JointEffect, PlantEffect, Size, on_one
from drivers.simulated.plant.seen import Seen
from drivers.simulated.plant.truth import PlantTruth


@dataclass
class TorqueScale(JointEffect):
    """Torque constant or gear ratio off: the drive reports (1 + error) times the torque that acts."""

    error: Annotated[list[float], Size(0.04, 0.08, "one", either=True)]

    def motor_torque(self, plant: Seen, torque: np.ndarray) -> np.ndarray:
        return torque / (1.0 + np.asarray(self.error))


@dataclass
class TorqueOffset(JointEffect):
    """A current sensor with an offset: the drive reports, and regulates, a constant too much."""

    offset_nm: Annotated[list[float], Size(0.5, 1.2, "one", either=True)]

    def motor_torque(self, plant: Seen, torque: np.ndarray) -> np.ndarray:
        return torque - np.asarray(self.offset_nm)


@dataclass
class TorqueDelay(PlantEffect):
    """The drive reports the torque of a while ago beside the position of now; fractions of a sample too."""

    delay_s: Annotated[float, Size(0.001, 0.003)]
    _past: deque[np.ndarray] = field(default_factory=deque, init=False, repr=False, compare=False)

    def start(self, plant: Seen) -> None:
        self._past = deque([plant.load.copy()], maxlen=math.floor(self.delay_s / plant.step) + 2)

    def report(self, plant: Seen, torque: np.ndarray) -> np.ndarray:
        self._past.appendleft(torque)
        whole, share = divmod(self.delay_s / plant.step, 1.0)
        newer = min(int(whole), len(self._past) - 1)
        older = min(newer + 1, len(self._past) - 1)
        return (1.0 - share) * self._past[newer] + share * self._past[older]


@dataclass
class _LowPass(PlantEffect):
    """A torque behind a first-order low-pass."""

    cutoff_hz: float
    _value: np.ndarray = field(default_factory=lambda: np.zeros(3), init=False, repr=False, compare=False)

    def start(self, plant: Seen) -> None:
        self._value = plant.load.copy()

    def passed(self, plant: Seen, torque: np.ndarray) -> np.ndarray:
        """What comes out of it one step after `torque` went in."""
        self._value = torque + (self._value - torque) * math.exp(-2 * math.pi * self.cutoff_hz * plant.step)
        return self._value


@dataclass
class TorqueFilter(_LowPass):
    """The reported torque went through a first-order low-pass in the drive."""

    cutoff_hz: Annotated[float, Size(30.0, 80.0, grows=-1)]

    def report(self, plant: Seen, torque: np.ndarray) -> np.ndarray:
        return self.passed(plant, torque)


@dataclass
class DriveLag(_LowPass):
    """The motor's torque lags the command, which is what the drive reports."""

    cutoff_hz: Annotated[float, Size(40.0, 100.0, grows=-1)]

    def motor_torque(self, plant: Seen, torque: np.ndarray) -> np.ndarray:
        return self.passed(plant, torque)


@dataclass
class Cogging(JointEffect):
    """Torque ripple of the motor, periodic in its angle; the drive does not see it in its current."""

    amplitude_nm: Annotated[list[float], Size(0.5, 1.4, "one")]
    order: Annotated[float, Among((1.0, 2.0, 4.0))]  # periods a motor turn
    phase_rad: Annotated[float, Size(0.0, 2 * math.pi, grows=0)]

    def motor_torque(self, plant: Seen, torque: np.ndarray) -> np.ndarray:
        angle = self.order * plant.truth.gear_ratio * plant.motor + self.phase_rad
        return torque + np.asarray(self.amplitude_nm) * np.sin(angle)


@dataclass
class EncoderEccentricity(JointEffect):
    """The encoder disc sits off its axis: the reading errs periodically with the motor angle."""

    amplitude_rad: list[float]  # joint side
    order: float  # periods a motor turn
    phase_rad: float

    @classmethod
    def draw(cls, rng: np.random.Generator, truth: PlantTruth, severity: float) -> Self:
        order = float(rng.choice((1.0, 2.0)))
        # the second derivative goes with the square of the periods a joint turn
        amplitude = rng.uniform(0.6, 1.2) / (order * truth.gear_ratio) ** 2
        return cls(on_one(rng, float(severity * amplitude)), order, float(rng.uniform(0, 2 * math.pi)))

    def reading(self, plant: Seen, position: np.ndarray) -> np.ndarray:
        angle = self.order * plant.truth.gear_ratio * plant.motor + self.phase_rad
        return position + np.asarray(self.amplitude_rad) * np.sin(angle)


@dataclass
class AngleScale(JointEffect):
    """Another gear ratio or encoder resolution than was entered: the true angle is (1 + error) times what is read."""

    error: Annotated[list[float], Size(0.01, 0.03, "one", either=True)]

    def reading(self, plant: Seen, position: np.ndarray) -> np.ndarray:
        return position / (1.0 + np.asarray(self.error))
