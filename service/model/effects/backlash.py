r"""Lost motion between motor and link.

Physics: with $\delta = \theta_\mathrm{motor} - \theta_\mathrm{link}$ and half the lost motion $b$ the gear transmits
$$T = \begin{cases} k\,(\delta - b\,\operatorname{sign}\delta) + d\,\dot\delta & |\delta| > b \\ 0 & \text{else}
\end{cases}$$ The flanks part when the transmitted torque changes sign. The motor runs alone until they meet again, with
an impact.
Implementation: two masses with a dead zone of $\pm b$ and a stiff, damped contact are integrated along the recorded
motion of the motor; the rigid-body torque is corrected by the relative motion of the link.
While effects are searched, the contact is well damped, so that an impact is matched in its momentum; how it rings is
fitted once backlash has been found. The estimator, which does not know the instant of an impact within a sample, damps
the contact critically.
Limitations: only visible where the transmitted torque changes sign.
"""

from __future__ import annotations

from dataclasses import dataclass

from service.model.effects.base import Nonlinear
from service.model.effects.transmission import Transmission

HALVES = (0.0003, 0.00045, 0.0007, 0.001, 0.0015, 0.0023, 0.0035, 0.005)


@dataclass(frozen=True)
class Backlash(Transmission):
    half: Nonlinear = Nonlinear("rad", "half the lost motion, joint side", HALVES, 1e-4, 0.02)
    contact_hz: Nonlinear = Nonlinear(
        "Hz", "natural frequency of the link on the closed flank", (20.0, 35.0, 60.0, 120.0), 5.0, 400.0, minor=True,
        late=True,
    )  # fmt: skip
    contact_damping: Nonlinear = Nonlinear(
        "", "damping ratio of the closed flank", (0.1, 2.0), 0.02, 4.0, minor=True, late=True
    )
    motor_share: Nonlinear = Nonlinear(
        "", "share of the joint's inertia on the motor side", (0.1, 0.2, 0.35, 0.55), 0.02, 0.9, minor=True
    )
    name = "backlash"
    title = "Lost motion in the gear (backlash)"
    means = (
        "The gear is worn or has lost its preload, or a coupling or clamp is loose: check the play by hand with the "
        "drive on; readjust or replace. Until then, avoid a sign change of the torque where accuracy counts."
    )
    directional = True
    settles = "moves whose braking torque exceeds gravity, so that the transmitted torque changes sign"

    @staticmethod
    def figures(nonlinear: tuple[float, ...]) -> tuple[float, float, float, float]:
        """A gap and its two flanks."""
        half, contact_hz, contact_damping, motor_share = nonlinear
        return half, contact_hz, contact_damping, motor_share

    def starts(self, nonlinear: tuple[float, ...]) -> list[tuple[float, ...]]:
        """Impacts move in time with the gap: neighbours on the grid's scale."""
        return [(factor * nonlinear[0], *nonlinear[1:]) for factor in (0.87, 1.0, 1.15)]
