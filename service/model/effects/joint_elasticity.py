"""Compliance between motor and link.

Physics: the link lags by torque / stiffness; what the motor measures is not where the link is.
Implementation: the link is integrated behind the recorded motor motion (spring and damper), and the rigid torque
corrected by its relative motion; base friction stays on the motor side. First order only for the search.
Limitations: linear spring; stiffness far above the analysis band is a slight shift in time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.model.effects.base import Effect, Inside, Nonlinear
from service.model.scene import Scene
from service.model.two_masses import two_masses

NATURAL_HZ = (4.0, 5.4, 7.3, 9.8, 13.0, 18.0, 24.0, 33.0, 45.0, 60.0)


@dataclass(frozen=True)
class JointElasticity(Effect):
    natural_hz: Nonlinear = Nonlinear(
        "Hz", "natural frequency of the link against a held motor", NATURAL_HZ, 2.0, 250.0
    )
    damping_ratio: Nonlinear = Nonlinear("", "damping ratio of the link", (0.07,), 0.01, 2.0, minor=True)
    motor_share: Nonlinear = Nonlinear(
        "", "share of the joint's inertia on the motor side", (0.13, 0.35), 0.02, 0.9, minor=True
    )
    name = "joint_elasticity"
    title = "The drive train yields (elastic gear or coupling)"
    means = (
        "Check clamps, coupling and belt tension; if the stiffness is by design, use smoother acceleration or "
        "take it over into the model."
    )
    own_joint = False
    rough = True
    settles = "fast moves with jumps in acceleration"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, n, 1)."""
        return two_masses(scene, joint, 0.0, nonlinear[0], nonlinear[1], nonlinear[2])[..., None]

    def starts(self, nonlinear: tuple[float, ...]) -> list[tuple[float, ...]]:
        """A lightly damped link answers sharply to its natural frequency."""
        return [(factor * nonlinear[0], *nonlinear[1:]) for factor in (0.9, 1.0, 1.1)]

    def put_inside(self, inside: Inside, joint: int, amplitude: np.ndarray, nonlinear: tuple[float, ...]) -> None:
        """A spring and a damper."""
        inside.two_masses[joint] = (0.0, *nonlinear)
