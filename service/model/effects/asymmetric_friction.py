r"""Coulomb and viscous friction differ between the two directions.

Physics: one flank of a gear or one side of a screw has more friction: $$T = \delta_c + \delta_v\,|\dot\theta|$$ in
addition to the symmetric part.
Implementation: two regressors per joint. The friction is the symmetric part plus $\delta$ forward, and minus $\delta$
backward.
Limitations: $\delta_c$ alone is an alias of a constant torque offset; no motion separates the two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import Amplitude, Effect
from service.model.scene import Scene


@kernel
def _online(effect, now, i):
    return effect.amplitude[i, 0] + effect.amplitude[i, 1] * abs(now.theta_dot[i])


@dataclass(frozen=True)
class AsymmetricFriction(Effect):
    delta_c: Amplitude = Amplitude("N m", "half the difference of the Coulomb levels, forward minus backward")
    delta_v: Amplitude = Amplitude("N m s/rad", "half the difference of the viscous levels, forward minus backward")
    name = "asymmetric_friction"
    title = "Friction differs between the two directions"
    means = (
        "Check the preload and the seal of this joint's gear, and whether a brake drags. A constant offset of the "
        "torque sensor or drive looks the same: compare at rest with the brake closed."
    )
    same = frozenset({"torque_offset"})
    directional = True
    dissipates = True
    online = staticmethod(_online)
    settles = "the same path at three speeds in both directions"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 2)."""
        speed = np.abs(scene.segment.theta_dot[:, joint])
        return np.stack([np.ones_like(speed), speed], axis=1)
