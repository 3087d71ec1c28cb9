r"""A constant torque error of a joint.

Physics: the zero of a current sensor or an analogue offset: $$T_\mathrm{reported} = T + T_0$$
Implementation: one constant per joint.
Limitations: not separable from Coulomb friction that differs between the directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import Amplitude, Effect
from service.model.scene import Scene


@kernel
def _online(effect, now, i):
    return effect.amplitude[i, 0]


@dataclass(frozen=True)
class TorqueOffset(Effect):
    offset: Amplitude = Amplitude("N m", "reported minus true torque")
    name = "torque_offset"
    title = "The reported torque has a constant offset"
    means = (
        "Zero the drive's current measurement. Friction that differs between directions looks the same: "
        "compare at rest with the brake closed."
    )
    same = frozenset({"asymmetric_friction"})
    directional = True
    online = staticmethod(_online)
    settles = "a rest with the brake closed and the drive on (no motion separates the two)"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        return np.ones((len(scene.time), 1))
