r"""Compliance between motor and link.

Physics: with $\delta = \theta_\mathrm{motor} - \theta_\mathrm{link}$ the gear transmits $$T = k\,\delta +
d\,\dot\delta$$ The link lags by the torque over the stiffness. An encoder on the motor does not measure the position of
the link.
Implementation: the link with spring and damper is integrated along the recorded motion of the motor, and the rigid-body
torque is corrected by its relative motion. The friction of the base model stays on the motor side. The search uses a
first-order approximation.
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
