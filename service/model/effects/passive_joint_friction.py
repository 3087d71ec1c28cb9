r"""Friction in the forearms' ball joints.

Physics: each forearm turns against the active link at its elbow and against the platform, which loses the power $$P =
T_\mathrm{dry}\,|\boldsymbol{\omega}| + d\,|\boldsymbol{\omega}|^2$$
Implementation: the angular velocity of a forearm is $\boldsymbol{\omega} = \mathbf{s} \times \dot{\mathbf{s}} / l_2^2$
(no spin about itself). Joint torques follow by virtual power, with the same coefficients for all forearms, per pair of
ball joints. Dry friction fades below 0.05 rad/s, as the seat of the ball is compliant.
Limitations: friction about the rod's own axis and differences between the joints are not modelled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.coulomb_viscous import SOFT
from service.model.effects.base import Amplitude, WholeDelta
from service.model.scene import Scene


@kernel
def _level(dry, viscous, x, y, z):
    """Friction torque over the speed of a ball joint that turns at x, y, z rad/s."""
    speed = math.sqrt(x * x + y * y + z * z)
    return dry * math.tanh(speed / SOFT) / max(speed, 1e-12) + viscous


@kernel
def _online(effect, now, i):
    model, pose, torque = now.model, now.pose, 0.0
    forearm, elbow, velocity, amplitude = pose.forearm, pose.elbow, pose.velocity, effect.amplitude[0]
    column, lever = pose.column, pose.lever[i]
    slope_x, slope_y, slope_z = column[i, 0] * lever, column[i, 1] * lever, column[i, 2] * lever
    for arm in range(3):
        axle_x, axle_y, rate = -model.azimuth_sin[arm], model.azimuth_cos[arm], now.theta_dot[arm]
        over = 1.0 / model.passive_length[arm] ** 2
        x, y, z = forearm[arm, 0] * over, forearm[arm, 1] * over, forearm[arm, 2] * over
        own = 1.0 if arm == i else 0.0
        u, v = velocity[0] - elbow[arm, 0] * rate, velocity[1] - elbow[arm, 1] * rate
        w = velocity[2] - elbow[arm, 2] * rate
        turn_x, turn_y, turn_z = y * w - z * v, z * u - x * w, x * v - y * u
        u, v, w = slope_x - own * elbow[arm, 0], slope_y - own * elbow[arm, 1], slope_z - own * elbow[arm, 2]
        per_x, per_y, per_z = y * w - z * v, z * u - x * w, x * v - y * u
        level = _level(amplitude[1], amplitude[3], turn_x, turn_y, turn_z)
        torque += level * (turn_x * per_x + turn_y * per_y + turn_z * per_z)
        bend_x, bend_y = turn_x - axle_x * rate, turn_y - axle_y * rate
        level = _level(amplitude[0], amplitude[2], bend_x, bend_y, turn_z)
        torque += level * (bend_x * (per_x - own * axle_x) + bend_y * (per_y - own * axle_y) + turn_z * per_z)
    return torque


@dataclass(frozen=True)
class PassiveJointFriction(WholeDelta):
    dry_elbow: Amplitude = Amplitude("N m", "dry friction of one forearm's ball joints at the elbow", low=0.0)
    dry_platform: Amplitude = Amplitude("N m", "dry friction of one forearm's ball joints at the platform", low=0.0)
    viscous_elbow: Amplitude = Amplitude("N m s/rad", "viscous friction at the elbow", low=0.0)
    viscous_platform: Amplitude = Amplitude("N m s/rad", "viscous friction at the platform", low=0.0)
    name = "passive_joint_friction"
    title = "Friction in the forearms' ball joints"
    means = "Clean or replace the ball joints' shells and check the tension of their springs."
    online = staticmethod(_online)
    settles = "long moves of the platform at several speeds, where a forearm swings while its own joint rests"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 4)."""
        arms, theta_dot = scene.arms, scene.segment.theta_dot
        length2 = scene.delta.model.passive_length[:, None] ** 2
        swing_per_joint = np.repeat(arms.jacobian[:, None], 3, axis=1)  # (N, arm, axis, joint)
        for arm in range(3):
            swing_per_joint[:, arm, :, arm] -= arms.slope[:, arm]
        turn = np.cross(arms.forearm, arms.swing) / length2
        turn_per_joint = (
            np.cross(arms.forearm[..., None], swing_per_joint, axisa=2, axisb=2, axisc=2) / length2[..., None]
        )
        bend = turn - arms.axle * theta_dot[..., None]
        bend_per_joint = turn_per_joint.copy()
        for arm in range(3):
            bend_per_joint[:, arm, :, arm] -= arms.axle[arm]
        columns = []
        for rate, per_joint in ((bend, bend_per_joint), (turn, turn_per_joint)):
            speed = np.sqrt(np.sum(rate**2, axis=-1, keepdims=True))
            unit = rate * np.tanh(speed / SOFT) / np.maximum(speed, 1e-12)
            columns.append((unit, per_joint))
        for rate, per_joint in ((bend, bend_per_joint), (turn, turn_per_joint)):
            columns.append((rate, per_joint))
        return np.stack([np.einsum("nax,naxj->nj", rate, per) for rate, per in columns], axis=-1)
