r"""Wrong torque constant or gear ratio.

Physics: on one joint $$T_\mathrm{reported} = (1 + \varepsilon)\,T$$
Implementation: scales the whole prediction of the joint.
Limitations: the same scale on all joints is separable from a mass error only by known masses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.model.effects.base import Amplitude, Effect
from service.model.nominal import Correction
from service.model.scene import Scene


@dataclass(frozen=True)
class TorqueScale(Effect):
    epsilon: Amplitude = Amplitude("", "reported over true torque, minus one", low=-1.0)
    name = "torque_scale"
    title = "The reported torque has a wrong scale"
    means = "Check torque constant, rated torque and gear ratio of this joint in drive and column mapping."
    beyond = 0.5
    measured = True
    settles = "fast moves with a known mass at the platform"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        return scene.total[:, [joint]]

    def correct(self, correction: Correction, joint: int, amplitude: np.ndarray) -> None:
        """Scales what is reported."""
        correction.scale[joint] += amplitude[0]

    def report(self, scene: Scene, joint: int, torque: np.ndarray, amplitude: np.ndarray, nonlinear: tuple[float, ...]):
        """Scales one joint."""
        torque = torque.copy()
        torque[:, joint] *= 1.0 + amplitude[0]
        return torque

    def restore(
        self, torque: np.ndarray, period: float, joint: int, amplitude: np.ndarray, nonlinear: tuple[float, ...]
    ) -> np.ndarray:
        """Scales one joint back."""
        torque = torque.copy()
        torque[:, joint] /= 1.0 + amplitude[0]
        return torque
