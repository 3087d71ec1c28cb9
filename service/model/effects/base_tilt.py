r"""The base is not level.

Physics: $$T = \tau(\mathbf{R}\,\mathbf{g}) - \tau(\mathbf{g})$$ $\mathbf{R}$ is a rotation by two small angles about x
and y: gravity $\mathbf{g}$ is tilted for every mass. $\tau$ is the torque of the rigid-body model.
Implementation: torque per rad, linear in the angles, with $\rho_2$ on the active links; its product with masses that
other effects add is taken at the operating point.
Limitations: small angles; a rotation about the direction of gravity has no effect.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.model.effects.base import Amplitude, WholeDelta
from service.model.nominal import Correction, leaning
from service.model.scene import Scene


@dataclass(frozen=True)
class BaseTilt(WholeDelta):
    about_x: Amplitude = Amplitude("rad", "tilt about the base's x axis")
    about_y: Amplitude = Amplitude("rad", "tilt about the base's y axis")
    name = "base_tilt"
    title = "The base is not level"
    means = "Put a level on the base frame and shim it, or enter the tilt in the description."
    beyond = 0.35
    settles = "slow sweeps to all sides of the workspace"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 2)."""
        model = scene.delta.model
        link_mass = scene.base.rigid[1] * model.link_mass
        columns = []
        for tilt in np.eye(2):
            lean = leaning(model.gravity, tilt)
            columns.append(-model.moving_mass * scene.at_platform(lean) - link_mass * (scene.arms.slope @ lean))
        return np.stack(columns, axis=-1)

    def correct(self, correction: Correction, joint: int, amplitude: np.ndarray) -> None:
        """Another gravity."""
        correction.tilt[:] += amplitude
