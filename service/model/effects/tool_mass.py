r"""Mass at the platform.

Physics: $$T = \delta m\,\mathbf{J}^\top (\ddot{\mathbf{p}} - \mathbf{g})$$ with the Jacobian $\mathbf{J}$ and the
acceleration $\ddot{\mathbf{p}}$ of the platform, and gravity $\mathbf{g}$.
Implementation: the payload term of the model.
Limitations: with the same tool in all logs, $\rho_1$ and $\rho_2$ absorb part of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import Amplitude, Inside, WholeDelta, at_platform
from service.model.scene import Scene


@kernel
def _online(effect, now, i):
    a = now.pose.acceleration
    g = now.model.gravity
    return effect.amplitude[0, 0] * at_platform(now, i, a[0] - g[0], a[1] - g[1], a[2] - g[2])


@dataclass(frozen=True)
class ToolMass(WholeDelta):
    delta_m: Amplitude = Amplitude("kg", "mass at the platform minus the described mass")
    name = "tool_mass"
    title = "The tool's mass differs from the description"
    means = "Weigh tool, gripper and everything mounted on them, then correct the mass in the description."
    online = staticmethod(_online)
    settles = "the same path with and without a known mass"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 1)."""
        motion = scene.segment
        held = scene.delta.payload(motion.theta, motion.theta_dot, motion.theta_ddot)
        return (held - scene.at_platform(scene.lean))[..., None]

    def put_inside(self, inside: Inside, joint: int, amplitude: np.ndarray, nonlinear: tuple[float, ...]) -> None:
        """Its inertia."""
        inside.tool += float(amplitude[0])
