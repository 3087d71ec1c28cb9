r"""Viscous friction that is not linear in speed.

Physics: shear thinning, churning and turbulence cause $$T = f\,|\dot\theta|^p \operatorname{sign}\dot\theta$$ in
addition to the linear part.
Implementation: the exponent $p$ is shared by the joints and refined; $p = 1$ is the base model and is not searched.
Limitations: a small range of speeds does not determine $p$.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import Amplitude, Effect, Nonlinear
from service.model.scene import Scene


@kernel
def _online(effect, now, i):
    return effect.amplitude[i, 0] * now.direction[i] * abs(now.theta_dot[i]) ** effect.nonlinear[0]


@dataclass(frozen=True)
class NonlinearViscousFriction(Effect):
    f: Amplitude = Amplitude("N m (s/rad)^p", "friction at 1 rad/s", low=0.0)
    p: Nonlinear = Nonlinear("", "exponent of speed", (0.35, 0.6, 1.5, 2.0, 3.0), 0.2, 4.0)
    name = "nonlinear_viscous_friction"
    title = "Friction is not proportional to speed"
    means = "Mostly grease or seals: check the kind and amount of grease; include it in the model."
    dissipates = True
    directional = True
    online = staticmethod(_online)
    own_nonlinear = True
    settles = "runs of one path at 10, 30, 60 and 100 % speed"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        return (scene.direction[:, joint] * np.abs(scene.segment.theta_dot[:, joint]) ** nonlinear[0])[:, None]
