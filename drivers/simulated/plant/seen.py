"""What effects see of the plant that they act on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from drivers.simulated.plant.mujoco_delta import CompiledMechanism
from drivers.simulated.plant.truth import PlantTruth


@dataclass
class Friction:
    """Friction of the three joints in force at one instant; effects change it."""

    forward: np.ndarray  # (3,) N m, Coulomb level while the joint turns positive
    backward: np.ndarray  # (3,) N m, while it turns negative
    viscous: np.ndarray  # (3,) N m s/rad
    torque: np.ndarray  # (3,) N m, anything else that acts like friction, signed as it acts on the joint


class Seen(Protocol):
    """The plant at one instant. All follows the physics: copy what has to last.

    time: s since power-on. step: s of integration. theta: (3,) rad, links. motor, motor_dot: (3,) rad and rad/s.
    platform, platform_dot: (3,) m and m/s. load: (3,) N m, torque last passed through the gears, beyond the friction
    before them. truth: with what effects have built in. mechanism, data: MuJoCo's.
    """

    time: float
    step: float
    theta: np.ndarray
    motor: np.ndarray
    motor_dot: np.ndarray
    platform: np.ndarray
    platform_dot: np.ndarray
    load: np.ndarray
    rng: np.random.Generator
    truth: PlantTruth
    mechanism: CompiledMechanism
    data: Any
