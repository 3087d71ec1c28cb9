"""Homing error of a joint's zero.

Physics: the true angle is the measured one plus a constant.
Implementation: as a length error, exact; first order only for the search.
Limitations: mostly a shift of this joint's gravity torque, and close to a spring or an offset on few angles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.model.effects.base import Amplitude, Correction, Effect
from service.model.scene import Scene

STEP = 1e-4  # m or rad, of the central difference


@dataclass(frozen=True)
class JointOffset(Effect):
    error: Amplitude = Amplitude("rad", "true minus measured angle")
    name = "joint_offset"
    title = "The joint's zero is off"
    means = "Home this joint again against its mark or gauge and enter the new zero."
    beyond_together = 0.05
    beyond = 0.3
    own_joint = False
    kinds = frozenset({"delta"})
    settles = "slow sweeps over the whole workspace and fast moves"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 1)."""
        none, step = np.zeros(3), STEP * np.eye(3)[joint]
        change = scene.altered(none, step) - scene.altered(none, -step)
        return (change / (2 * STEP))[..., None]

    def correct(self, correction: Correction, joint: int, amplitude: np.ndarray) -> None:
        """Another zero."""
        correction.offset[joint] += amplitude[0]

    def torque(self, scene: Scene, joint: int, amplitude: np.ndarray, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 3), exact."""
        return scene.altered(np.zeros(3), amplitude[0] * np.eye(3)[joint])
