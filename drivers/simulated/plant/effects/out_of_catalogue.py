"""Effects that no catalogue lists: what a diagnosis must call unexplained."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Annotated, Self

import numpy as np

from drivers.simulated.plant.effects.plant_effect import JointEffect, PlantEffect, Size, below, on_one, signed
from drivers.simulated.plant.mujoco_delta import BaseMode, Design
from drivers.simulated.plant.seen import Friction, Seen
from drivers.simulated.plant.truth import PlantTruth


@dataclass
class ContactRail(JointEffect):
    """A cable carrier rubs over an edge in one place: the link has to climb a bell of energy there."""

    torque_nm: Annotated[list[float], Size(2.0, 4.0, "one")]  # largest
    centre_rad: Annotated[float, Size(0.1, 0.4, grows=0)]
    width_rad: Annotated[float, Size(0.03, 0.07, grows=0)]

    def joint_torque(self, plant: Seen) -> np.ndarray:
        x = (plant.theta - self.centre_rad) / self.width_rad
        return np.asarray(self.torque_nm) * math.exp(0.5) * x * np.exp(-(x**2) / 2)


@dataclass
class StickEvents(JointEffect):
    """Dirt passes through a gear: at random moments its friction is higher for a while."""

    level_nm: Annotated[list[float], Size(2.5, 5.0, "one")]
    rate_hz: Annotated[float, Size(1.0, 2.5, grows=0)]
    length_s: Annotated[float, Size(0.04, 0.12, grows=0)]
    _until: float = field(default=-1.0, init=False, repr=False, compare=False)

    def friction(self, plant: Seen, friction: Friction) -> None:
        if plant.time > self._until and plant.rng.random() < self.rate_hz * plant.step:
            self._until = plant.time + self.length_s
        if plant.time < self._until:
            friction.forward += np.asarray(self.level_nm)
            friction.backward += np.asarray(self.level_nm)


@dataclass
class BaseResonance(PlantEffect):
    """The frame that carries the robot swings on its feet when the platform is thrown about."""

    frame_kg: Annotated[float, Size(20.0, 40.0, grows=-1)]
    frequency_hz: Annotated[float, Size(6.0, 14.0, grows=0)]
    damping_ratio: Annotated[float, Size(0.01, 0.03, grows=0)]
    azimuth_rad: Annotated[float, Size(0.0, math.pi, grows=0)]

    def shape(self, design: Design) -> Design:
        mode = BaseMode(self.frame_kg, self.frequency_hz, self.damping_ratio, self.azimuth_rad)
        return replace(design, base_mode=mode)


@dataclass
class TorqueDropouts(JointEffect):
    """A loose connector: at random moments a motor gets only part of its current for some milliseconds."""

    lost: list[float]  # share
    rate_hz: float
    length_s: float
    _until: float = field(default=-1.0, init=False, repr=False, compare=False)

    @classmethod
    def draw(cls, rng: np.random.Generator, truth: PlantTruth, severity: float) -> Self:
        return cls(
            on_one(rng, min(1.0, severity * rng.uniform(0.3, 0.6))),
            float(rng.uniform(1.0, 3.0)),
            float(rng.uniform(0.01, 0.03)),
        )

    def motor_torque(self, plant: Seen, torque: np.ndarray) -> np.ndarray:
        if plant.time > self._until and plant.rng.random() < self.rate_hz * plant.step:
            self._until = plant.time + self.length_s
        return torque * (1.0 - np.asarray(self.lost)) if plant.time < self._until else torque


@dataclass
class TorqueConstantDrift(PlantEffect):
    """Magnets weaken as the motor heats: the torque constant falls with a winding temperature that the losses drive."""

    loss: list[float]  # share of the torque constant that is lost when the motor runs at `hot_nm` rms for long
    hot_nm: float
    time_constant_s: float
    _heat: np.ndarray = field(default_factory=lambda: np.zeros(3), init=False, repr=False, compare=False)

    @classmethod
    def draw(cls, rng: np.random.Generator, truth: PlantTruth, severity: float) -> Self:
        return cls((severity * rng.uniform(0.06, 0.15, 3)).tolist(), 30.0, float(rng.uniform(3.0, 8.0)))

    def motor_torque(self, plant: Seen, torque: np.ndarray) -> np.ndarray:
        self._heat += ((torque / self.hot_nm) ** 2 - self._heat) * (plant.step / self.time_constant_s)
        return torque / (1.0 + np.asarray(self.loss) * self._heat)


@dataclass
class HoseJerk(PlantEffect):
    """A vacuum hose that is too short: slack near its clamp, and a hard jerk where the slack is used up."""

    stiffness_npm: float
    slack_m: float
    point_m: list[float]

    @classmethod
    def draw(cls, rng: np.random.Generator, truth: PlantTruth, severity: float) -> Self:
        heading, depth = rng.uniform(0, 2 * math.pi), truth.passive_link_length_m[0]
        radius = 0.25 * depth
        point = [float(radius * math.cos(heading)), float(radius * math.sin(heading)), -0.4 * depth]
        return cls(float(severity * rng.uniform(30.0, 80.0)), float(rng.uniform(0.42, 0.50) * depth), point)

    def platform_force(self, plant: Seen) -> np.ndarray:
        line = np.asarray(self.point_m) - plant.platform
        length = math.sqrt(line @ line)
        return line * (self.stiffness_npm * max(length - self.slack_m, 0.0) / length)


@dataclass
class BeltTooth(PlantEffect):
    """The platform drags a toothed belt along the base's y axis: a force with the pitch of its teeth."""

    force_n: Annotated[float, Size(3.0, 6.0)]
    pitch_m: Annotated[float, Size(0.03, 0.08, grows=0)]
    phase_rad: Annotated[float, Size(0.0, 2 * math.pi, grows=0)]

    def platform_force(self, plant: Seen) -> np.ndarray:
        return np.array(
            [0.0, self.force_n * math.sin(2 * math.pi * plant.platform[1] / self.pitch_m + self.phase_rad), 0.0]
        )


@dataclass
class CableMemory(JointEffect):
    """A cable bundle creeps: a spring in series with a damper on a joint, which forgets where it was."""

    stiffness_nmprad: Annotated[list[float], Size(2.0, 5.0, "one")]
    relaxation_s: Annotated[float, Size(0.2, 0.6, grows=0)]
    _rest: np.ndarray = field(default_factory=lambda: np.zeros(3), init=False, repr=False, compare=False)

    def start(self, plant: Seen) -> None:
        self._rest = plant.theta.copy()

    def joint_torque(self, plant: Seen) -> np.ndarray:
        stretch = plant.theta - self._rest
        self._rest += stretch * (plant.step / self.relaxation_s)
        return -np.asarray(self.stiffness_nmprad) * stretch


@dataclass
class Magnet(PlantEffect):
    """A magnetic fixture beside the conveyor pulls a steel gripper when it comes near."""

    force_n: float  # at the point
    reach_m: float
    point_m: list[float]

    @classmethod
    def draw(cls, rng: np.random.Generator, truth: PlantTruth, severity: float) -> Self:
        point = below(rng, truth, (0.1, 0.25), (0.85, 0.95))
        return cls(float(severity * signed(rng, 6.0, 12.0)), float(rng.uniform(0.05, 0.09)), point)

    def platform_force(self, plant: Seen) -> np.ndarray:
        line = np.asarray(self.point_m) - plant.platform
        x2 = (line @ line) / self.reach_m**2
        return line * (self.force_n / self.reach_m * math.exp(-x2 / 2))
