r"""Torque and position are not sampled at the same instant.

Physics: the two take different paths through drive and bus: $$T_\mathrm{reported}(t) = T(t - t_\mathrm{d})$$ with the
delay $t_\mathrm{d}$.
Implementation: the whole prediction is shifted, also by fractions of a sample. A quarter of a sample or less is the
timing within one sample, which is part of the base model.
Limitations: torque sampled before position is the same effect with the opposite sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.model.effects.base import Effect, Nonlinear, Readout
from service.model.scene import Scene
from service.model.signals import delayed


@dataclass(frozen=True)
class TorqueDelay(Effect):
    delay: Nonlinear = Nonlinear(
        "s", "time by which torque is later than position", (-0.003, -0.0015, 0.0008, 0.0015, 0.003, 0.006), -0.02, 0.02
    )
    name = "torque_delay"
    title = "Torque and position are not sampled at the same time"
    means = (
        "This is a fault of the log, not of the machine: correct the delay of the torque channel in drive or recorder. "
        "If torque comes first, it is the command: log the measured current."
    )
    takes_timing = True
    per_joint = False
    own_joint = False
    measured = True
    settles = "fast moves with sharp reversals"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, n, 1)."""
        return (delayed(scene.total, nonlinear[0], scene.period) - scene.total)[..., None]

    def read_out(self, readout: Readout, nonlinear: tuple[float, ...]) -> None:
        """A shift."""
        readout.late += nonlinear[0]

    def report(self, scene: Scene, joint: int, torque: np.ndarray, amplitude: np.ndarray, nonlinear: tuple[float, ...]):
        """Shifts all joints."""
        return delayed(torque, nonlinear[0], scene.period)

    def restore(
        self, torque: np.ndarray, period: float, joint: int, amplitude: np.ndarray, nonlinear: tuple[float, ...]
    ) -> np.ndarray:
        """Shifts all joints back."""
        return delayed(torque, -nonlinear[0], period)
