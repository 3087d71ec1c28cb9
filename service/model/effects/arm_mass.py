r"""Mass of one active link: inertia and gravity together.

Physics: a uniform link whose mass differs by $\delta m$ adds $$T = \tfrac{1}{3}\,\delta m\,l_1^2\,\ddot\theta -
\tfrac{1}{2}\,\delta m\,\mathbf{g} \cdot \frac{\partial \mathbf{J}'}{\partial\theta}$$ with the length $l_1$, the elbow
$\mathbf{J}'$ and gravity $\mathbf{g}$. Where the base is level, the second term is $-\tfrac{1}{2}\,\delta m\,g\,l_1
\cos\theta$.
Implementation: one regressor per joint.
Limitations: the same mass on all joints is absorbed by $\rho_1$ and $\rho_2$ of the base model and leaves no gap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import Amplitude, Effect, Inside
from service.model.scene import Scene


@kernel
def _online(effect, now, i):
    length, g = now.model.active_length[i], now.model.gravity
    weight = (now.pose.elbow[i, 0] * g[0] + now.pose.elbow[i, 1] * g[1] + now.pose.elbow[i, 2] * g[2]) / 2.0
    return effect.amplitude[i, 0] * (length * length / 3.0 * now.theta_ddot[i] - weight)


@dataclass(frozen=True)
class ArmMass(Effect):
    delta_m: Amplitude = Amplitude("kg", "mass of this active link minus that of the others")
    name = "arm_mass"
    title = "One arm is heavier or lighter than the others"
    means = (
        "Weigh this arm, or check what is mounted on it (cable, sensor, a different spare part). Then correct the "
        "description."
    )
    online = staticmethod(_online)
    kinds = frozenset({"delta"})
    settles = "fast moves and slow sweeps over a wide range of this joint's angle"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        model, motion = scene.delta.model, scene.segment
        inertia = model.active_length[joint] ** 2 / 3 * motion.theta_ddot[:, joint]
        return (inertia - scene.arms.slope[:, joint] @ (model.gravity + scene.lean) / 2)[:, None]

    def put_inside(self, inside: Inside, joint: int, amplitude: np.ndarray, nonlinear: tuple[float, ...]) -> None:
        """Its inertia."""
        inside.arm[joint] += amplitude[0]
