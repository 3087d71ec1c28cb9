"""Gear friction that grows with the torque through it.

Physics: tooth friction is proportional to the tooth force; T = mu |load| sign v.
Implementation: load is the rigid-body torque of the base model at the operating point.
Limitations: at a nearly constant load (gravity only) it is Coulomb friction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import Amplitude, Effect
from service.model.scene import Scene


@kernel
def _online(effect, now, i):
    return effect.amplitude[i, 0] * abs(now.load[i]) * now.direction[i]


@dataclass(frozen=True)
class LoadDependentFriction(Effect):
    mu: Amplitude = Amplitude("", "friction torque per torque through the gear", low=0.0)
    name = "load_dependent_friction"
    title = "Gear friction grows with load"
    means = (
        "The gear loses part of the torque that it carries: check its oil and efficiency class; take it over "
        "into the model."
    )
    dissipates = True
    directional = True
    online = staticmethod(_online)
    settles = "fast and slow runs of one path, or the same path with a payload"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        return (np.abs(scene.load[:, joint]) * scene.direction[:, joint])[:, None]
