"""An active link's true length differs from the description.

Physics: the platform is elsewhere, levers and inertia change: every joint feels it.
Implementation: the whole rigid-body model is evaluated with the changed arm; first order only for the search.
Limitations: the same on all arms hides in rho_1, rho_2 to a large part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.model.effects.base import Amplitude, Correction, Effect
from service.model.mechanism import Delta, Mechanism
from service.model.scene import Scene

STEP = 1e-4  # m or rad, of the central difference


@dataclass(frozen=True)
class LinkLengthError(Effect):
    error: Amplitude = Amplitude("m", "true minus described length")
    name = "link_length_error"
    title = "An arm's length differs from the description"
    means = "Measure this arm between its axes and correct the description."
    beyond_together = 0.05
    beyond = 0.2
    own_joint = False
    kinds = frozenset({"delta"})
    settles = "fast moves to all sides of the workspace"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 1)."""
        none, step = np.zeros(3), STEP * np.eye(3)[joint]
        change = scene.altered(step, none) - scene.altered(-step, none)
        return (change / (2 * STEP))[..., None]

    def size(self, mechanism: Mechanism, amplitude: np.ndarray) -> float:
        """Share of the link's length."""
        assert isinstance(mechanism, Delta)
        return float(np.abs(amplitude).max(initial=0.0) / mechanism.model.active_length[0])

    def correct(self, correction: Correction, joint: int, amplitude: np.ndarray) -> None:
        """A longer link."""
        correction.length[joint] += amplitude[0]

    def torque(self, scene: Scene, joint: int, amplitude: np.ndarray, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 3), exact."""
        return scene.altered(amplitude[0] * np.eye(3)[joint], np.zeros(3))
