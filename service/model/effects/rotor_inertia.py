r"""Reflected rotor or gear inertia of one drive.

Physics: $$T = \delta I\,\ddot\theta$$ without gravity.
Implementation: one regressor per joint.
Limitations: the same inertia on all joints is absorbed by $\rho_1$ of the base model and leaves no gap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import Amplitude, Effect, Inside
from service.model.scene import Scene


@kernel
def _online(effect, now, i):
    return effect.amplitude[i, 0] * now.theta_ddot[i]


@dataclass(frozen=True)
class RotorInertia(Effect):
    delta_i: Amplitude = Amplitude("kg m^2", "inertia of this joint minus that of the others, joint side", low=0.0)
    name = "rotor_inertia"
    title = "One drive has more inertia than the others"
    means = (
        "Check motor and gear type of this joint (a different spare part, an added brake or coupling) and correct the "
        "description."
    )
    online = staticmethod(_online)
    settles = "fast and slow moves of this joint over the same angles"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        return scene.segment.theta_ddot[:, [joint]]

    def put_inside(self, inside: Inside, joint: int, amplitude: np.ndarray, nonlinear: tuple[float, ...]) -> None:
        """Its inertia."""
        inside.rotor[joint] += amplitude[0]
