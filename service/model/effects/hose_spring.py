r"""A spring from a fixed point to the platform.

Physics: a hose or dress pack pulls the platform towards $\mathbf{p}_0$; against it the robot exerts the force
$$\mathbf{F} = k\,(\mathbf{p} - \mathbf{p}_0)$$ at the platform's position $\mathbf{p}$.
Implementation: linear in $k$ and in the force at the origin, $-k\,\mathbf{p}_0$.
Limitations: a hose with slack, weight or damping is not a spring.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import Amplitude, WholeDelta, at_platform
from service.model.scene import Scene


@kernel
def _online(effect, now, i):
    a, p = effect.amplitude[0], now.pose.position
    return at_platform(now, i, a[0] * p[0] + a[1], a[0] * p[1] + a[2], a[0] * p[2] + a[3])


@dataclass(frozen=True)
class HoseSpring(WholeDelta):
    k: Amplitude = Amplitude("N/m", "stiffness", low=0.0)
    force_x: Amplitude = Amplitude("N", "force along x, extrapolated to a platform at the origin")
    force_y: Amplitude = Amplitude("N", "force along y, extrapolated to a platform at the origin")
    force_z: Amplitude = Amplitude("N", "force along z, extrapolated to a platform at the origin")
    name = "hose_spring"
    title = "A hose or cable pulls at the platform"
    means = "Give the hose more slack or guide it differently; if it must stay, include it in the model."
    online = staticmethod(_online)
    settles = "slow sweeps to the edges of the workspace"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 4)."""
        columns = [scene.at_platform(scene.arms.position)]
        columns += [scene.at_platform(axis) for axis in np.eye(3)]
        return np.stack(columns, axis=-1)
