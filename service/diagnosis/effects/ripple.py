"""Errors periodic in the motor angle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.diagnosis.effects.base import Amplitude, Effect, Shape
from service.diagnosis.scene import Scene

COGGING_ORDERS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 18, 20, 22, 24, 30, 36)


@dataclass(frozen=True)
class Cogging(Effect):
    """Torque ripple periodic in the motor angle.

    Physics: magnets and slots, or the teeth of a gear: T = a cos(n N theta) + b sin(n N theta), N the gear ratio.
    Implementation: order n per motor turn, amplitude and phase as the two coefficients.
    Limitations: above half the sample rate it is folded; fast motion moves it above the analysis band.
    """

    cosine: Amplitude = Amplitude("N m", "cosine part of the amplitude, joint side")
    sine: Amplitude = Amplitude("N m", "sine part of the amplitude, joint side")
    order: Shape = Shape("", "periods a motor turn", COGGING_ORDERS, 0.5, 60.0)
    name = "cogging"
    settles = "a slow constant-speed sweep of this joint over several motor turns"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 2)."""
        angle = shape[0] * scene.mechanism.gear_ratio[joint] * scene.segment.theta[:, joint]
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)


@dataclass(frozen=True)
class EncoderEccentricity(Effect):
    """Position error periodic in the motor angle.

    Physics: an encoder disc off its axis: the true angle is the measured one plus a cos(n N theta) + b sin(n N theta).
    Implementation: the error and its two derivatives along the recorded motion, through the slopes of the rigid torque.
    Limitations: first order in the error; at speed its second derivative dominates, at rest nothing shows.
    """

    cosine: Amplitude = Amplitude("rad", "cosine part, true minus measured angle, joint side")
    sine: Amplitude = Amplitude("rad", "sine part, true minus measured angle, joint side")
    order: Shape = Shape("", "periods a motor turn", (1, 2, 3, 4), 0.5, 20.0)
    name = "encoder_eccentricity"
    own_joint = False
    settles = "a constant-speed sweep of this joint at medium speed"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, n, 2)."""
        motion = scene.segment
        ratio = shape[0] * scene.mechanism.gear_ratio[joint]
        angle = ratio * motion.theta[:, joint]
        speed, acceleration = ratio * motion.theta_dot[:, joint], ratio * motion.theta_ddot[:, joint]
        cosine, sine = np.cos(angle), np.sin(angle)
        return np.stack(
            [
                scene.perturbed(joint, cosine, -sine * speed, -cosine * speed**2 - sine * acceleration),
                scene.perturbed(joint, sine, cosine * speed, -sine * speed**2 + cosine * acceleration),
            ],
            axis=-1,
        )
