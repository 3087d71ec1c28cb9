"""An active link's true length differs from the description.

Physics: the platform is elsewhere, levers and inertia change: every joint feels it.
Implementation: the whole rigid-body model is evaluated with the changed arm; first order only for the search.
Limitations: the same on all arms hides in rho_1, rho_2 to a large part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.model.effects.base import Amplitude, Effect
from service.model.scene import Scene

STEP = 1e-4  # m or rad, of the central difference


@dataclass(frozen=True)
class LinkLengthError(Effect):
    error: Amplitude = Amplitude("m", "true minus described length")
    name = "link_length_error"
    own_joint = False
    kinds = frozenset({"delta"})
    settles = "fast moves to all sides of the workspace"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 1)."""
        none, step = np.zeros(3), STEP * np.eye(3)[joint]
        change = scene.altered(step, none) - scene.altered(-step, none)
        return (change / (2 * STEP))[..., None]

    def torque(self, scene: Scene, joint: int, amplitude: np.ndarray, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 3), exact."""
        return scene.altered(amplitude[0] * np.eye(3)[joint], np.zeros(3))
