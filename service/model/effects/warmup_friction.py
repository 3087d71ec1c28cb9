r"""Viscous friction decreases as the gear warms up.

Physics: oil thins with temperature: $$T = f\,\mathrm{e}^{-t / t_\mathrm{w}}\,\dot\theta$$ in addition to the level of
the warm gear, with the time constant $t_\mathrm{w}$ of the warm-up.
Implementation: $t$ is the clock of the log, assumed to be the time since power-on; the time constant is shared by the
joints.
Limitations: logs that all start warm, or that have separate clocks, do not show it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import Amplitude, Effect, Nonlinear
from service.model.scene import Scene


@kernel
def _online(effect, now, i):
    return effect.amplitude[i, 0] * math.exp(-now.seconds / effect.nonlinear[0]) * now.theta_dot[i]


@dataclass(frozen=True)
class WarmupFriction(Effect):
    f: Amplitude = Amplitude("N m s/rad", "viscous friction of the cold gear minus that of the warm gear", low=0.0)
    tau: Nonlinear = Nonlinear("s", "time constant of the warm-up", (3.0, 8.0, 20.0, 50.0, 150.0, 600.0), 1.0, 3600.0)
    name = "warmup_friction"
    title = "Friction falls while the gear warms up"
    means = "Cold grease: warm the machine up before accurate work, or use a grease for lower temperatures."
    dissipates = True
    online = staticmethod(_online)
    settles = "the same path, cold and after half an hour of running, with continuous time stamps"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        return (np.exp(-scene.time / nonlinear[0]) * scene.segment.theta_dot[:, joint])[:, None]
