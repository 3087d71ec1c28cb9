r"""Air resistance of the platform: a force that grows with the square of its speed.

Physics: the air resists a large tool or the sheet of a suction cup with the force $$\mathbf{F} =
c\,|\mathbf{v}|\,\mathbf{v}$$ against the velocity $\mathbf{v}$ of the platform.
Implementation: one regressor for the whole robot.
Limitations: slow motion does not show it, as it grows with the square of the speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import Amplitude, WholeDelta, at_platform
from service.model.scene import Scene


@kernel
def _online(effect, now, i):
    v = now.pose.velocity
    speed = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    return effect.amplitude[0, 0] * speed * at_platform(now, i, v[0], v[1], v[2])


@dataclass(frozen=True)
class AirDrag(WholeDelta):
    c: Amplitude = Amplitude("N s^2/m^2", "drag force at 1 m/s", low=0.0)
    name = "air_drag"
    title = "Air drag of the platform"
    means = (
        "The air resists fast moves. This is a property of the machine: include it in the model; check for covers "
        "or hoses that catch air."
    )
    online = staticmethod(_online)
    settles = "long straight moves at full speed"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 1)."""
        velocity = scene.arms.velocity
        return scene.at_platform(velocity * np.linalg.norm(velocity, axis=1, keepdims=True))[..., None]
