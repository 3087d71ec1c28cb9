r"""Gear friction that grows with the torque through it.

Physics: the friction of the teeth is proportional to the force on them: $$T =
\mu\,|\tau|\,\operatorname{sign}\dot\theta$$ The torque that accelerates the rotor does not pass through the teeth. With
a high gear ratio, mainly the weight loads them.
Implementation: $\tau$ is the rigid-body torque of the base model at the operating point; for single axes and arms,
whose rotors are not described, minus a share of the acceleration torque.
Limitations: at a nearly constant load (gravity only) it mimics Coulomb friction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import Amplitude, Effect, Nonlinear
from service.model.scene import Scene


@kernel
def _online(effect, now, i):
    return effect.amplitude[i, 0] * abs(now.load[i]) * now.direction[i]


@dataclass(frozen=True)
class LoadDependentFriction(Effect):
    # at 1 a gear locks itself
    mu: Amplitude = Amplitude("", "friction torque per transmitted torque", low=0.0, high=1.0)
    motor_share: Nonlinear = Nonlinear(
        "", "share of the acceleration torque on the motor side of the gear", (0.0, 0.25, 0.5, 0.75, 1.0), 0.0, 1.0,
        fixed=True,
    )  # fmt: skip
    name = "load_dependent_friction"
    title = "Gear friction grows with load"
    means = (
        "The gear loses part of the torque that it transmits: check its oil and efficiency class; include the friction "
        "in the model."
    )
    dissipates = True
    directional = True
    online = staticmethod(_online)
    by_load = True
    settles = "fast and slow runs of one path, or the same path with a payload"

    def grid(self, scene: Scene) -> list[tuple[float, ...]]:
        """Of a Delta's load nothing is taken off, as its online form takes nothing off."""
        return [(0.0,)] if scene.mechanism.closed else super().grid(scene)

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        load, share = scene.load[:, joint], nonlinear[0]
        if share:
            load = load - share * (load - scene.weight[:, joint])
        return (np.abs(load) * scene.direction[:, joint])[:, None]
