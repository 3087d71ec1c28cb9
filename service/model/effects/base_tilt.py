"""The base is not level.

Physics: gravity leans by two small angles, on every mass.
Implementation: torque per rad about x and about y, linear in the angles, with rho_2 on the active links.
Limitations: small angles; a turn about z does nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from service.model.effects.base import Amplitude, Effect, at_platform
from service.model.scene import Scene


@njit(cache=True)
def _online(effect, now, i):
    # gravity leans by two small angles: its reaction is g (-y, x, 1)
    gx, gy = -effect.amplitude[0, 1] * now.model.gravity, effect.amplitude[0, 0] * now.model.gravity
    link = now.rho_2 * now.model.gravity_torque[i] / (now.model.gravity * now.model.active_length[i])
    platform = now.model.moving_mass * at_platform(now, i, gx, gy, 0.0)
    return platform + link * (now.elbow[i, 0] * gx + now.elbow[i, 1] * gy)


@dataclass(frozen=True)
class BaseTilt(Effect):
    about_x: Amplitude = Amplitude("rad", "tilt about the base's x axis")
    about_y: Amplitude = Amplitude("rad", "tilt about the base's y axis")
    name = "base_tilt"
    title = "The base is not level"
    means = "Put a level on the base frame and shim it, or enter the tilt in the description."
    beyond = 0.35
    online = staticmethod(_online)
    per_joint = False
    own_joint = False
    kinds = frozenset({"delta"})
    settles = "slow sweeps to all sides of the workspace"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 2)."""
        model, arms = scene.delta.model, scene.arms
        # In base axes gravity is R' (0, 0, -g): tilting by (x, y) makes the upward reaction g (-y, x, 1).
        link_mass = scene.base.rigid[1] * model.gravity_torque / (model.gravity * model.active_length)
        columns = []
        for upward in (np.array([0.0, 1.0, 0.0]), np.array([-1.0, 0.0, 0.0])):
            reaction = model.gravity * upward
            columns.append(model.moving_mass * scene.at_platform(reaction) + link_mass * (arms.slope @ reaction))
        return np.stack(columns, axis=-1)
