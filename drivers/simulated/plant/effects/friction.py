"""Effects in the friction of the gears and of the forearms' joints."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Self

import numpy as np

from drivers.simulated.plant.effects.plant_effect import Among, JointEffect, PlantEffect, Size, on_one, signed
from drivers.simulated.plant.seen import Friction, Seen
from drivers.simulated.plant.truth import PlantTruth


@dataclass
class StribeckFriction(PlantEffect):
    """Extra breakaway friction that dies out with speed as the lubricant film builds up: f_s exp(-(v/v_s)^2)."""

    breakaway_nm: Annotated[list[float], Size(1.2, 2.5, "each")]
    stribeck_speed_radps: Annotated[float, Size(0.08, 0.35, grows=0)]

    def friction(self, plant: Seen, friction: Friction) -> None:
        extra = np.asarray(self.breakaway_nm) * np.exp(-((plant.motor_dot / self.stribeck_speed_radps) ** 2))
        friction.forward += extra
        friction.backward += extra


@dataclass
class AsymmetricFriction(JointEffect):
    """Gear teeth are loaded on other flanks in the other direction: Coulomb and viscous levels differ between the two.

    The figures are forward minus backward.
    """

    coulomb_nm: list[float]
    viscous_nms: list[float]

    @classmethod
    def draw(cls, rng: np.random.Generator, truth: PlantTruth, severity: float) -> Self:
        coulomb = on_one(rng, severity * signed(rng, 0.8, 2.0))
        share = float(rng.uniform(0.0, 0.2))
        return cls(coulomb, [share * value for value in coulomb])

    def friction(self, plant: Seen, friction: Friction) -> None:
        half = np.asarray(self.coulomb_nm) / 2
        friction.forward += half
        friction.backward -= half
        friction.viscous += np.sign(plant.motor_dot) * np.asarray(self.viscous_nms) / 2
        np.maximum(friction.forward, 0.0, out=friction.forward)
        np.maximum(friction.backward, 0.0, out=friction.backward)


@dataclass
class LoadDependentFriction(PlantEffect):
    """Tooth friction grows with the torque through the gear: mu times its magnitude."""

    mu: Annotated[list[float], Size(0.035, 0.08, "each")]

    def friction(self, plant: Seen, friction: Friction) -> None:
        extra = np.asarray(self.mu) * np.abs(plant.load)
        friction.forward += extra
        friction.backward += extra


@dataclass
class NonlinearViscousFriction(PlantEffect):
    """Churning (positive) or shear-thinning (negative) lubricant: c v |v| beside the viscous friction."""

    quadratic_nms2: Annotated[list[float], Size(0.06, 0.15, "each")]

    def friction(self, plant: Seen, friction: Friction) -> None:
        friction.viscous += np.asarray(self.quadratic_nms2) * np.abs(plant.motor_dot)


@dataclass
class PositionDependentFriction(JointEffect):
    """A bearing or gear wheel that runs out of true: the Coulomb level varies with the joint angle."""

    amplitude_nm: Annotated[list[float], Size(0.8, 1.8, "one")]
    order: Annotated[float, Among((2.0, 3.0, 4.0, 5.0, 6.0))]
    phase_rad: Annotated[float, Size(0.0, 2 * math.pi, grows=0)]

    def friction(self, plant: Seen, friction: Friction) -> None:
        extra = np.asarray(self.amplitude_nm) * np.sin(self.order * plant.motor + self.phase_rad)
        friction.forward += extra
        friction.backward += extra
        np.maximum(friction.forward, 0.0, out=friction.forward)
        np.maximum(friction.backward, 0.0, out=friction.backward)


@dataclass
class WarmupFriction(PlantEffect):
    """Cold grease: viscous friction is (1 + gain) times its warm value at power-on and decays with a time constant."""

    gain: Annotated[list[float], Size(0.5, 1.2, "each")]
    time_constant_s: Annotated[float, Size(10.0, 40.0, grows=0)]

    def friction(self, plant: Seen, friction: Friction) -> None:
        friction.viscous *= 1.0 + np.asarray(self.gain) * math.exp(-plant.time / self.time_constant_s)


@dataclass
class PreslidingFriction(PlantEffect):
    """Contacts bend before they slide: Coulomb friction builds up over a small displacement (Dahl's law).

    dz/dt = v - |v| z sigma_0 / f_c, torque sigma_0 z: after a reversal it changes sides along exp(-x sigma_0 / f_c).
    """

    stiffness_nmprad: Annotated[list[float], Size(60.0, 200.0, "each", grows=-1)]
    bristle: np.ndarray = field(default_factory=lambda: np.zeros(3), init=False, repr=False, compare=False)

    def start(self, plant: Seen) -> None:
        self.bristle = np.zeros(3)

    def friction(self, plant: Seen, friction: Friction) -> None:
        stiffness = np.asarray(self.stiffness_nmprad)
        level = np.maximum((friction.forward + friction.backward) / 2, 1e-3)
        limit = level / stiffness
        travel = plant.motor_dot * plant.step
        # exact over one step at constant speed and level
        side = np.sign(travel)
        self.bristle = side * limit + (self.bristle - side * limit) * np.exp(-np.abs(travel) / limit)
        friction.torque -= stiffness * self.bristle
        friction.forward[:] = 0.0
        friction.backward[:] = 0.0


@dataclass
class PassiveJointFriction(PlantEffect):
    """Friction in the twelve ball joints of the forearms: dry and viscous torque against the relative rotation."""

    dry_nm: Annotated[float, Size(0.10, 0.25)]
    viscous_nms: Annotated[float, Size(0.0, 0.03)]
    _rods: list[int] = field(default_factory=list, init=False, repr=False, compare=False)
    _arms: list[int] = field(default_factory=list, init=False, repr=False, compare=False)

    # relative speed below which the dry torque fades, rad/s: a ball seat is compliant
    SOFT = 0.05

    def start(self, plant: Seen) -> None:
        model = plant.mechanism.model
        self._rods = [model.body(f"rod{i}{rod}").id for i in range(3) for rod in range(2)]
        self._arms = [model.body(f"arm{i}").id for i in range(3) for _ in range(2)]

    def act_on_bodies(self, plant: Seen) -> None:
        data = plant.data
        # cvel is the spatial velocity, rotation first, of the state that MuJoCo evaluated last: one step old
        spin = data.cvel[:, :3]
        rods, arms = spin[self._rods], spin[self._arms]
        at_elbow, at_platform = self._torque(rods - arms), self._torque(rods)
        data.xfrc_applied[self._rods, 3:] = at_elbow + at_platform
        data.xfrc_applied[self._arms[::2], 3:] = -(at_elbow[::2] + at_elbow[1::2])

    def _torque(self, spin: np.ndarray) -> np.ndarray:
        speed = np.linalg.norm(spin, axis=1, keepdims=True)
        return -(self.viscous_nms + self.dry_nm * np.tanh(speed / self.SOFT) / np.maximum(speed, 1e-9)) * spin


@dataclass
class ShaftFriction(PlantEffect):
    """The halves of a telescopic shaft from the middle of the base to the platform rub along each other."""

    dry_n: Annotated[float, Size(3.0, 7.0)]
    viscous_nspm: Annotated[float, Size(0.5, 3.0)]

    # speed below which the dry force fades, m/s: seals are compliant
    SOFT = 0.005

    def platform_force(self, plant: Seen) -> np.ndarray:
        length = math.sqrt(plant.platform @ plant.platform)
        rate = float(plant.platform @ plant.platform_dot) / length
        return -(self.dry_n * math.tanh(rate / self.SOFT) + self.viscous_nspm * rate) / length * plant.platform
