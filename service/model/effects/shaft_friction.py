r"""Friction along the telescopic shaft of a fourth axis.

Physics: the halves of the shaft slide in each other as the platform approaches and recedes: a force along the shaft
against the rate of its length $l$, $$F = d\,\operatorname{sign}\dot l + f\,\dot l$$
Implementation: the shaft runs from the centre of the base to the centre of the platform: $\dot l = \mathbf{p} \cdot
\mathbf{v} / |\mathbf{p}|$. The dry part changes sign smoothly, over 5 mm/s.
Limitations: a shaft mounted elsewhere and friction in its universal joints are not modelled. For its mass: `tool_mass`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import Amplitude, WholeDelta, at_platform
from service.model.scene import Scene

SMOOTH = 5e-3  # m/s


@kernel
def _online(effect, now, i):
    p, v = now.pose.position, now.pose.velocity
    length = math.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2)
    rate = (p[0] * v[0] + p[1] * v[1] + p[2] * v[2]) / length
    force = (effect.amplitude[0, 0] * math.tanh(rate / SMOOTH) + effect.amplitude[0, 1] * rate) / length
    return at_platform(now, i, force * p[0], force * p[1], force * p[2])


@dataclass(frozen=True)
class ShaftFriction(WholeDelta):
    dry: Amplitude = Amplitude("N", "dry friction along the shaft", low=0.0)
    viscous: Amplitude = Amplitude("N s/m", "viscous friction along the shaft", low=0.0)
    name = "shaft_friction"
    title = "Friction along the fourth axis' shaft"
    means = (
        "Clean and grease the telescopic shaft and check that it is straight. If there is none, check what else slides "
        "between base and platform."
    )
    online = staticmethod(_online)
    settles = "straight moves up and down at several speeds"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 2)."""
        position, velocity = scene.arms.position, scene.arms.velocity
        along = position / np.linalg.norm(position, axis=1, keepdims=True)
        rate = np.sum(along * velocity, axis=1, keepdims=True)
        return np.stack([scene.at_platform(along * speed) for speed in (np.tanh(rate / SMOOTH), rate)], axis=-1)
