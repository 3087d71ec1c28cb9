"""Between the true torque and the reported one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from service.diagnosis.effects.base import Amplitude, Effect, Shape
from service.diagnosis.scene import Scene


def delayed(values: np.ndarray, seconds: float, period: float) -> np.ndarray:
    """(N, ...) later by `seconds`, fractions of a sample by cubic Lagrange interpolation; the ends are held.

    Four taps round the instant: below a tenth of the sample rate the error is under 0.1 %.
    """
    samples = seconds / period
    if samples == 0.0:
        return values
    whole = int(np.floor(samples))
    u = samples - whole
    weights = (
        u * (u - 1) * (u + 1) / 6,
        -u * (u - 2) * (u + 1) / 2,
        (u - 1) * (u - 2) * (u + 1) / 2,
        -u * (u - 1) * (u - 2) / 6,
    )
    reach = abs(whole) + 2
    pad = ((reach, reach), *([(0, 0)] * (values.ndim - 1)))
    held = np.pad(values, pad, mode="edge")
    first, count = reach - whole, len(values)
    return sum(
        weight * held[first + tap : first + tap + count] for tap, weight in zip((-2, -1, 0, 1), weights, strict=True)
    )  # pyright: ignore[reportReturnType]


@dataclass(frozen=True)
class TorqueScale(Effect):
    """Torque constant or gear ratio off.

    Physics: what is reported is 1 + epsilon times the true torque of a joint.
    Implementation: scales the whole prediction of the joint.
    Limitations: on all joints alike only the known masses tell it from mass.
    """

    epsilon: Amplitude = Amplitude("", "reported over true torque, minus one")
    name = "torque_scale"
    measured = True
    settles = "fast moves with a known mass at the platform"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        return scene.total[:, [joint]]

    def report(self, scene: Scene, joint: int, torque: np.ndarray, amplitude: np.ndarray, shape: tuple[float, ...]):
        """Scales one joint."""
        torque = torque.copy()
        torque[:, joint] *= 1.0 + amplitude[0]
        return torque


@dataclass(frozen=True)
class TorqueDelay(Effect):
    """Torque and position are not sampled at the same instant.

    Physics: the two travel different ways through drive and bus.
    Implementation: the whole prediction is shifted, fractions of a sample too. A quarter of a sample
    or less is the timing within one sample, which the base model has.
    Limitations: torque sampled *before* position is the same effect with the opposite sign.
    """

    delay: Shape = Shape(
        "s", "by which torque is later than position", (-0.003, -0.0015, 0.0008, 0.0015, 0.003, 0.006), -0.02, 0.02
    )
    name = "torque_delay"
    per_joint = False
    own_joint = False
    measured = True
    settles = "fast moves with sharp reversals"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, n, 1)."""
        return (delayed(scene.total, shape[0], scene.period) - scene.total)[..., None]

    def report(self, scene: Scene, joint: int, torque: np.ndarray, amplitude: np.ndarray, shape: tuple[float, ...]):
        """Shifts all joints."""
        return delayed(torque, shape[0], scene.period)


@dataclass(frozen=True)
class TorqueFilter(Effect):
    """The reported torque is low-passed.

    Physics: a first-order filter in the drive, y' = 2 pi f (u - y).
    Implementation: the exact filter for a piecewise constant torque, on the whole prediction.
    Limitations: above a few hundred Hz it is a delay of 1 / (2 pi f).
    """

    cutoff: Shape = Shape("Hz", "cut-off frequency", (8.0, 15.0, 25.0, 40.0, 70.0, 120.0), 3.0, 300.0)
    name = "torque_filter"
    per_joint = False
    own_joint = False
    measured = True
    settles = "fast moves with sharp reversals"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, n, 1)."""
        return (self.report(scene, joint, scene.total, np.zeros(0), shape) - scene.total)[..., None]

    def report(self, scene: Scene, joint: int, torque: np.ndarray, amplitude: np.ndarray, shape: tuple[float, ...]):
        """Filters all joints."""
        keep = np.exp(-2 * np.pi * shape[0] * scene.period)
        start = keep * torque[:1]
        return lfilter([1.0 - keep], [1.0, -keep], torque, axis=0, zi=start)[0]
