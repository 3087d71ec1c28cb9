"""Springs, drag and constant torque."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.diagnosis.effects.base import Amplitude, Effect
from service.diagnosis.scene import Scene


@dataclass(frozen=True)
class JointSpring(Effect):
    """A spring on a joint.

    Physics: T = k (theta - theta_0): a balancer, a stiff cable.
    Implementation: k and the constant -k theta_0 as two regressors a joint.
    Limitations: over a small range of angles it is a constant.
    """

    k: Amplitude = Amplitude("N m/rad", "stiffness")
    preload: Amplitude = Amplitude("N m", "torque at angle zero, -k theta_0")
    name = "joint_spring"
    settles = "a slow sweep over the whole angle of this joint alone"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 2)."""
        theta = scene.segment.theta[:, joint]
        return np.stack([theta, np.ones_like(theta)], axis=1)


@dataclass(frozen=True)
class HoseSpring(Effect):
    """A spring from a fixed point to the platform.

    Physics: a hose or dress pack pulls the platform with k (p - p_0).
    Implementation: linear in k and in the force at the origin, -k p_0.
    Limitations: a hose with slack, weight or damping is not a spring.
    """

    k: Amplitude = Amplitude("N/m", "stiffness")
    force_x: Amplitude = Amplitude("N", "-k x_0")
    force_y: Amplitude = Amplitude("N", "-k y_0")
    force_z: Amplitude = Amplitude("N", "-k z_0")
    name = "hose_spring"
    per_joint = False
    own_joint = False
    kinds = frozenset({"delta"})
    settles = "slow sweeps to the edges of the workspace"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 4)."""
        columns = [scene.at_platform(scene.arms.position)]
        columns += [scene.at_platform(axis) for axis in np.eye(3)]
        return np.stack(columns, axis=-1)


@dataclass(frozen=True)
class AirDrag(Effect):
    """Force on the platform against v |v|.

    Physics: drag of a large tool or a suction cup's sheet: F = c v |v|.
    Implementation: one regressor.
    Limitations: grows with speed squared; slow motion says nothing about it.
    """

    c: Amplitude = Amplitude("N s^2/m^2", "drag force at 1 m/s")
    name = "air_drag"
    per_joint = False
    own_joint = False
    kinds = frozenset({"delta"})
    settles = "long straight moves at full speed"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 1)."""
        velocity = scene.arms.velocity
        return scene.at_platform(velocity * np.linalg.norm(velocity, axis=1, keepdims=True))[..., None]


@dataclass(frozen=True)
class TorqueOffset(Effect):
    """A constant torque error of a joint.

    Physics: a current sensor's zero, an analogue offset.
    Implementation: one constant a joint.
    Limitations: not told apart from Coulomb friction that differs between the directions.
    """

    offset: Amplitude = Amplitude("N m", "reported minus true torque")
    name = "torque_offset"
    settles = "nothing while the joint moves: compare with the brake closed and the drive on"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        return np.ones((len(scene.time), 1))
