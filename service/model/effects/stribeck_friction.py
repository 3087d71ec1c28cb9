r"""Additional breakaway friction that decays with speed.

Physics: at low speed the lubricant film does not carry the load (Stribeck; Armstrong): $$T =
f_s\,\mathrm{e}^{-(\dot\theta / v_s)^2} \operatorname{sign}\dot\theta$$
Implementation: one regressor per joint; $v_s$ is shared by the joints and refined with all other parameters.
Limitations: without motion slower than $v_s$ it mimics a lower viscous friction; without faster motion, Coulomb
friction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import Amplitude, Effect, Nonlinear, geometric
from service.model.scene import Scene


@kernel
def _online(effect, now, i):
    return effect.amplitude[i, 0] * now.direction[i] * math.exp(-((now.theta_dot[i] / effect.nonlinear[0]) ** 2))


@dataclass(frozen=True)
class StribeckFriction(Effect):
    f_s: Amplitude = Amplitude("N m", "breakaway friction above the Coulomb level", low=0.0)
    v_s: Nonlinear = Nonlinear("rad/s", "speed at which it has fallen to 37 %", geometric(0.01, 1.0, 9), 0.005, 2.0)
    name = "stribeck_friction"
    title = "More friction at low speed (sticking)"
    means = "Grease or preload of the gear: relubricate, check the seals; expect stick-slip in slow moves until then."
    dissipates = True
    directional = True
    online = staticmethod(_online)
    own_nonlinear = True
    settles = "a slow sweep with reversals, 0.005 to 1 rad/s"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        left = self.above_coulomb(scene.segment.theta_dot[:, joint], nonlinear)
        return (scene.direction[:, joint] * left)[:, None]

    def above_coulomb(self, theta_dot: np.ndarray, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N,)."""
        return np.exp(-((theta_dot / nonlinear[0]) ** 2))
