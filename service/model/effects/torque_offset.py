"""A constant torque error of a joint.

Physics: a current sensor's zero, an analogue offset.
Implementation: one constant a joint.
Limitations: not told apart from Coulomb friction that differs between the directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.model.effects.base import Amplitude, Effect
from service.model.scene import Scene


@dataclass(frozen=True)
class TorqueOffset(Effect):
    offset: Amplitude = Amplitude("N m", "reported minus true torque")
    name = "torque_offset"
    settles = "nothing while the joint moves: compare with the brake closed and the drive on"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        return np.ones((len(scene.time), 1))
