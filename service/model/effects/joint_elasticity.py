"""Compliance between motor and link.

Physics: with delta = theta_motor - theta_link the gear transmits k delta + d delta_dot: the link lags by torque /
stiffness. The encoder on the motor does not measure the position of the link.
Implementation: the link is integrated behind the recorded motor motion (spring and damper), and the rigid torque
corrected by its relative motion; base friction stays on the motor side. First order only for the search.
Limitations: linear spring; a natural frequency far above the analysis band mimics a small shift in time.
"""

from __future__ import annotations

from dataclasses import dataclass

from service.model.effects.base import Nonlinear
from service.model.effects.transmission import Transmission

NATURAL_HZ = (4.0, 5.4, 7.3, 9.8, 13.0, 18.0, 24.0, 33.0, 45.0, 60.0)


@dataclass(frozen=True)
class JointElasticity(Transmission):
    natural_hz: Nonlinear = Nonlinear(
        "Hz", "natural frequency of the link against a held motor", NATURAL_HZ, 2.0, 250.0
    )
    damping_ratio: Nonlinear = Nonlinear("", "damping ratio of the link", (0.07,), 0.01, 2.0, minor=True)
    motor_share: Nonlinear = Nonlinear(
        "", "share of the joint's inertia on the motor side", (0.13, 0.35), 0.02, 0.9, minor=True
    )
    name = "joint_elasticity"
    title = "The drive train is elastic (gear, belt or coupling)"
    means = (
        "Check clamps, coupling and belt tension. If the stiffness is by design, use smoother acceleration or include "
        "it in the model."
    )
    settles = "fast moves with jumps in acceleration"

    @staticmethod
    def figures(nonlinear: tuple[float, ...]) -> tuple[float, float, float, float]:
        """A spring and a damper."""
        natural_hz, damping_ratio, motor_share = nonlinear
        return 0.0, natural_hz, damping_ratio, motor_share

    def starts(self, nonlinear: tuple[float, ...]) -> list[tuple[float, ...]]:
        """A lightly damped link answers sharply to its natural frequency."""
        return [(factor * nonlinear[0], *nonlinear[1:]) for factor in (0.9, 1.0, 1.1)]
