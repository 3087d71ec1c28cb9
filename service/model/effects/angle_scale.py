r"""A joint's angle has a wrong scale.

Physics: $$T = \tau\bigl((1 + \varepsilon)\,\theta\bigr) - \tau(\theta)$$ The true angle is $1 + \varepsilon$ times the
measured one, because gear ratio or resolution differ from the values entered. $\tau$ is the torque of the rigid-body
model.
Implementation: the errors of angle, speed and acceleration are multiplied by the slopes of the rigid-body torque.
Limitations: first order in $\varepsilon$; over a small range of angles it mimics a wrong zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import Amplitude, Effect
from service.model.scene import Scene


@kernel
def _encoder(effect, gear_ratio, i, motion):
    for order in range(3):
        motion[order, i] *= 1.0 + effect.amplitude[i, 0]


@dataclass(frozen=True)
class AngleScale(Effect):
    epsilon: Amplitude = Amplitude("", "true over measured angle, minus one", low=-1.0)
    name = "angle_scale"
    title = "The measured angle has a wrong scale"
    means = "Check gear ratio and encoder resolution of this joint in drive, description and column mapping."
    own_joint = False
    kinds = frozenset({"delta"})
    beyond = 0.3
    beyond_together = 0.05
    encoder = staticmethod(_encoder)
    settles = "slow sweeps over the whole angle of this joint, and fast moves"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, n, 1)."""
        motion = scene.segment
        return scene.perturbed(joint, *(x[:, [joint]] for x in (motion.theta, motion.theta_dot, motion.theta_ddot)))
