r"""The reported torque is low-pass filtered.

Physics: a first-order filter in the drive, $$\dot y = 2 \pi f\,(u - y)$$ from the true torque $u$ to the reported
torque $y$, with the cut-off frequency $f$.
Implementation: this filter is applied to the whole predicted torque.
Limitations: above a few hundred Hz it mimics a delay of $1 / (2 \pi f)$.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.model.effects.base import Effect, Nonlinear, Readout
from service.model.scene import Scene
from service.model.signals import lagging, leading, time_constant

CUTOFFS = (1.0, 1.8, 3.0, 5.0, 8.0, 15.0, 25.0, 40.0, 70.0, 120.0)  # the lowest: a drive's filter of what it reports


@dataclass(frozen=True)
class TorqueFilter(Effect):
    cutoff: Nonlinear = Nonlinear("Hz", "cut-off frequency", CUTOFFS, 0.3, 300.0)
    name = "torque_filter"
    title = "The drive reports a smoothed torque"
    means = (
        "This is a fault of the log, not of the machine: shorten the filter of the reported torque, or log the "
        "unfiltered current."
    )
    per_joint = False
    own_joint = False
    measured = True
    settles = "fast moves with sharp reversals"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, n, 1)."""
        return (self.report(scene, joint, scene.total, np.zeros(0), nonlinear) - scene.total)[..., None]

    def read_out(self, readout: Readout, nonlinear: tuple[float, ...]) -> None:
        """A low-pass of what is reported."""
        readout.lag += time_constant(nonlinear[0])

    def report(self, scene: Scene, joint: int, torque: np.ndarray, amplitude: np.ndarray, nonlinear: tuple[float, ...]):
        """Filters all joints."""
        return lagging(torque, nonlinear[0], scene.period)

    def restore(
        self, torque: np.ndarray, period: float, joint: int, amplitude: np.ndarray, nonlinear: tuple[float, ...]
    ) -> np.ndarray:
        """The filter turned round; noise comes out stronger."""
        return leading(torque, nonlinear[0], period)
