r"""Position error periodic in the motor angle.

Physics: the disc of the encoder is off its axis. The true angle is the measured one plus $$e = a \cos(n N \theta) + b
\sin(n N \theta)$$ with the gear ratio $N$ and the order $n$.
Implementation: the error and its two derivatives along the recorded motion are multiplied by the slopes of the
rigid-body torque.
Limitations: first order in the error. At speed its second derivative dominates; at rest nothing shows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import Amplitude, Effect, Nonlinear
from service.model.scene import Scene


@kernel
def _encoder(effect, gear_ratio, i, motion):
    ratio = effect.nonlinear[0] * gear_ratio
    cosine, sine = math.cos(ratio * motion[0, i]), math.sin(ratio * motion[0, i])
    wave = effect.amplitude[i, 0] * cosine + effect.amplitude[i, 1] * sine
    slope = ratio * (effect.amplitude[i, 1] * cosine - effect.amplitude[i, 0] * sine)
    speed = motion[1, i]
    motion[0, i] += wave
    motion[1, i] += slope * speed
    motion[2, i] += slope * motion[2, i] - ratio * ratio * wave * speed * speed


@dataclass(frozen=True)
class EncoderEccentricity(Effect):
    cosine: Amplitude = Amplitude("rad", "cosine part, true minus measured angle, joint side")
    sine: Amplitude = Amplitude("rad", "sine part, true minus measured angle, joint side")
    order: Nonlinear = Nonlinear("", "periods per motor turn", (1, 2, 3, 4), 0.5, 20.0)
    name = "encoder_eccentricity"
    title = "The encoder is mounted off-centre"
    means = (
        "The measured angle has a periodic error over a turn: check how the encoder disc or magnet is seated; "
        "recalibrate or replace it."
    )
    beyond = 0.03  # rad: a magnet half a millimetre off a ring of 17 mm
    own_joint = False
    of_motor_turns = True
    encoder = staticmethod(_encoder)
    settles = "a constant-speed sweep of this joint at medium speed"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, n, 2)."""
        motion = scene.segment
        ratio = nonlinear[0] * scene.mechanism.gear_ratio[joint]
        angle, speed, acceleration = (
            ratio * signal[:, joint, None] for signal in (motion.theta, motion.theta_dot, motion.theta_ddot)
        )
        wave = np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
        slope = np.concatenate([-np.sin(angle), np.cos(angle)], axis=1)
        return scene.perturbed(joint, wave, slope * speed, -wave * speed**2 + slope * acceleration)
