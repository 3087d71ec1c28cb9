r"""Coulomb friction varies with the joint angle.

Physics: a bent shaft or a worn tooth causes $$T = \bigl(a \cos n\theta + b \sin n\theta\bigr)
\operatorname{sign}\dot\theta$$
Implementation: order $n$ per turn of the joint; amplitude and phase are given by the two coefficients $a$ (cosine) and
$b$ (sine).
Limitations: one sine only; a narrow rough spot is not modelled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import PERIODS, Amplitude, Effect, Nonlinear
from service.model.scene import Scene


@kernel
def _online(effect, now, i):
    angle = effect.nonlinear[0] * now.theta[i]
    return (effect.amplitude[i, 0] * math.cos(angle) + effect.amplitude[i, 1] * math.sin(angle)) * now.direction[i]


@dataclass(frozen=True)
class PositionDependentFriction(Effect):
    cosine: Amplitude = Amplitude("N m", "cosine part of the amplitude")
    sine: Amplitude = Amplitude("N m", "sine part of the amplitude")
    order: Nonlinear = Nonlinear("", "periods per turn of the joint", (1, 2, 3, 4, 5, 6, 8, 10, 12), 0.5, 40.0)
    name = "position_dependent_friction"
    title = "Friction varies over the joint's angle"
    means = "A tight spot: check for a bent shaft, a misaligned or worn gear, or a cable that rubs at these angles."
    dissipates = True
    directional = True
    online = staticmethod(_online)
    settles = "a slow sweep over the whole angle in both directions"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 2)."""
        angle, sign = nonlinear[0] * scene.segment.theta[:, joint], scene.direction[:, joint]
        return np.stack([np.cos(angle) * sign, np.sin(angle) * sign], axis=1)

    def goes_by_load(self, travel: float, nonlinear: tuple[float, ...]) -> bool:
        """So little of it that nothing comes round again."""
        return nonlinear[0] * travel < 2 * np.pi * PERIODS
