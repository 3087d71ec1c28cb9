"""The base is not level.

Physics: gravity leans by two small angles, on every mass.
Implementation: torque per rad about x and about y, linear in the angles, with rho_2 on the active links.
Limitations: small angles; a turn about z does nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.model.effects.base import Amplitude, Effect
from service.model.scene import Scene


@dataclass(frozen=True)
class BaseTilt(Effect):
    about_x: Amplitude = Amplitude("rad", "tilt about the base's x axis")
    about_y: Amplitude = Amplitude("rad", "tilt about the base's y axis")
    name = "base_tilt"
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
