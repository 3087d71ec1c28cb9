r"""Torque ripple periodic in the motor angle.

Physics: magnets and slots, or the teeth of a gear, cause $$T = a \cos(n N \theta) + b \sin(n N \theta)$$ with the gear
ratio $N$ and the order $n$.
Implementation: order $n$ per motor turn; amplitude and phase are given by the two coefficients $a$ (cosine) and $b$
(sine).
Limitations: above half the sample rate it is aliased. Fast motion moves it above the analysis band; the band is
extended where the ripple exceeds the residual of the model.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import PERIODS, Amplitude, Effect, Nonlinear
from service.model.ripple import MOST_ORDER, standing_out
from service.model.scene import Scene

COGGING_ORDERS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 18, 20, 22, 24, 30, 36)
MOST_PEAKS = 4  # a joint and run
ONCE = 0.1  # periods a joint turn: so near to one it is a weight


@kernel
def _online(effect, now, i):
    angle = effect.nonlinear[0] * now.gear_ratio * now.theta[i]
    return effect.amplitude[i, 0] * math.cos(angle) + effect.amplitude[i, 1] * math.sin(angle)


@dataclass(frozen=True)
class Cogging(Effect):
    cosine: Amplitude = Amplitude("N m", "cosine part of the amplitude, joint side")
    sine: Amplitude = Amplitude("N m", "sine part of the amplitude, joint side")
    order: Nonlinear = Nonlinear("", "periods per motor turn", COGGING_ORDERS, 0.5, MOST_ORDER, most_step=0.05)
    name = "cogging"
    title = "Torque ripple over the motor turn (cogging)"
    means = (
        "Pole or slot ripple of the motor, or a current sensor out of adjustment: repeat the drive's current "
        "calibration, or let the drive compensate these orders."
    )
    repeats = True
    of_motor_turns = True
    online = staticmethod(_online)
    settles = "a slow constant-speed sweep of this joint over several motor turns"

    def grid(self, scene: Scene) -> list[tuple[float, ...]]:
        """The usual orders, and those that stand out of what the base model leaves."""
        left, turns = scene.segment.torque - scene.total, scene.mechanism.gear_ratio * scene.segment.theta / (2 * np.pi)
        orders: set[int] = set(COGGING_ORDERS)
        for joint, moving in enumerate(scene.segment.moving.T):
            orders.update(standing_out(turns[moving, joint], left[moving, joint])[:MOST_PEAKS])
        return [(float(order),) for order in sorted(orders)]

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 2)."""
        angle = nonlinear[0] * scene.mechanism.gear_ratio[joint] * scene.segment.theta[:, joint]
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def is_weight(self, gear_ratio: float, travel: float, nonlinear: tuple[float, ...]) -> bool:
        """Once a turn of the joint; or so seldom that nothing comes round again: a counterbalance, another ratio."""
        order = nonlinear[0] * gear_ratio
        return abs(order - 1.0) < ONCE or order * travel < 2 * np.pi * PERIODS
