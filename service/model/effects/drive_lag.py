r"""The true torque lags the reported one: the log contains the torque command.

Physics: a current loop or amplifier of first order, $$\dot y = 2 \pi f\,(u - y)$$ The command $u$ is reported, and the
torque $y$ moves the robot. $f$ is the cut-off frequency.
Implementation: the inverse of this filter is applied to the whole predicted torque.
Limitations: above a few hundred Hz it mimics a torque that is reported $1 / (2 \pi f)$ too early.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.model.effects.base import Nonlinear, Readout
from service.model.effects.torque_filter import TorqueFilter
from service.model.scene import Scene
from service.model.signals import lagging, time_constant

CUTOFFS = (3.0, 5.0, 8.0, 15.0, 25.0, 40.0, 70.0, 120.0)  # a robot is hardly held through less


@dataclass(frozen=True)
class DriveLag(TorqueFilter):
    cutoff: Nonlinear = Nonlinear("Hz", "cut-off frequency of the drive", CUTOFFS, 1.0, 300.0)
    name = "drive_lag"
    title = "The drive follows its torque command late"
    means = (
        "The log contains the torque command, not the actual torque: log the measured current. If that lags, too, the "
        "current loop is tuned too softly, or the cut-off of a command filter is too low."
    )

    def read_out(self, readout: Readout, nonlinear: tuple[float, ...]) -> None:
        """A low-pass of what acts."""
        readout.follows += time_constant(nonlinear[0])

    def report(self, scene: Scene, joint: int, torque: np.ndarray, amplitude: np.ndarray, nonlinear: tuple[float, ...]):
        """What all joints have to be asked for."""
        return super().restore(torque, scene.period, joint, amplitude, nonlinear)

    def restore(
        self, torque: np.ndarray, period: float, joint: int, amplitude: np.ndarray, nonlinear: tuple[float, ...]
    ) -> np.ndarray:
        """What acts."""
        return lagging(torque, nonlinear[0], period)
