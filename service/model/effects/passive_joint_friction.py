"""Friction in the forearms' ball joints.

Physics: each forearm turns against the active link at its elbow and against the platform; dry friction loses
T |omega|, viscous friction d omega^2.
Implementation: omega of a forearm is s x s_dot / l2^2 (no spin about itself); joint torques by virtual power, both
ends of all forearms with the same coefficients, per ball joint pair. Dry friction fades below `SOFT` as the seat gives.
Limitations: friction about the rod's own axis and unequal joints are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.model.effects.base import Amplitude, Inside, WholeDelta
from service.model.friction import SOFT
from service.model.scene import Scene


@dataclass(frozen=True)
class PassiveJointFriction(WholeDelta):
    dry_elbow: Amplitude = Amplitude("N m", "dry friction of one forearm's ball joints at the elbow", low=0.0)
    dry_platform: Amplitude = Amplitude("N m", "dry friction of one forearm's ball joints at the platform", low=0.0)
    viscous_elbow: Amplitude = Amplitude("N m s/rad", "viscous friction at the elbow", low=0.0)
    viscous_platform: Amplitude = Amplitude("N m s/rad", "viscous friction at the platform", low=0.0)
    name = "passive_joint_friction"
    title = "Friction in the forearms' ball joints"
    means = "Clean or replace the ball joints' shells and check the tension of their springs."
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

    def put_inside(self, inside: Inside, joint: int, amplitude: np.ndarray, nonlinear: tuple[float, ...]) -> None:
        """In the ball joints."""
        inside.ball_joints[:] += amplitude
