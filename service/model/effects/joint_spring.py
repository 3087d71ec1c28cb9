r"""A spring on a joint.

Physics: a balancer or a stiff cable: $$T = k\,(\theta - \theta_0)$$
Implementation: $k$ and the constant $-k\,\theta_0$ are two regressors per joint.
Limitations: over a small range of angles it mimics a constant torque.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import Amplitude, Effect
from service.model.scene import Scene


@kernel
def _online(effect, now, i):
    return effect.amplitude[i, 0] * now.theta[i] + effect.amplitude[i, 1]


@dataclass(frozen=True)
class JointSpring(Effect):
    k: Amplitude = Amplitude("N m/rad", "stiffness", low=0.0)
    preload: Amplitude = Amplitude("N m", "torque at angle zero")
    name = "joint_spring"
    title = "A spring acts on the joint"
    means = "A balancing spring, a stiff cable or a rubber stop: enter it in the model, or free the cable."
    directional = True
    online = staticmethod(_online)
    settles = "a slow sweep over the whole angle of this joint alone"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 2)."""
        theta = scene.segment.theta[:, joint]
        return np.stack([theta, np.ones_like(theta)], axis=1)

    def is_weight_in_degrees(self) -> bool:
        """A pull that grows with the angle."""
        return True
