"""Geometry that differs from the description, arm by arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.diagnosis.effects.base import Amplitude, Effect
from service.diagnosis.scene import Scene

STEP = 1e-4  # m or rad, of the central difference


def _change(scene: Scene, length_error: np.ndarray, joint_offset: np.ndarray) -> np.ndarray:
    """What altered arms add to the rigid torque (N, 3), N m."""
    motion = scene.segment
    altered = scene.delta.altered(length_error, joint_offset)
    rigid = altered.rigid(motion.theta, motion.theta_dot, motion.theta_ddot)
    plain = scene.recording.rigid
    # rho_1 and rho_2 also stand for rotor and gear: a longer link changes its own share of inertia and not theirs
    ratio = altered.model.active_length / scene.delta.model.active_length
    change = rigid.known - plain.known + (rigid.columns - plain.columns) @ scene.base.rigid
    for column, power in ((0, 2), (1, 1)):
        longer = (1.0 - scene.base.rigid[column]) * (1.0 - ratio**-power)
        change += longer * rigid.columns[..., column]
    return change


def _one(joint: int, value: float) -> np.ndarray:
    return value * np.eye(3)[joint]


@dataclass(frozen=True)
class LinkLengthError(Effect):
    """An active link's true length differs from the description.

    Physics: the platform is elsewhere, levers and inertia change: every joint feels it.
    Implementation: the whole rigid-body model is evaluated with the changed arm; first order only for the search.
    Limitations: the same on all arms hides in rho_1, rho_2 to a large part.
    """

    error: Amplitude = Amplitude("m", "true minus described length")
    name = "link_length_error"
    own_joint = False
    kinds = frozenset({"delta"})
    settles = "fast moves to all sides of the workspace"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 1)."""
        none = np.zeros(3)
        change = _change(scene, _one(joint, STEP), none) - _change(scene, _one(joint, -STEP), none)
        return (change / (2 * STEP))[..., None]

    def torque(self, scene: Scene, joint: int, amplitude: np.ndarray, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 3), exact."""
        return _change(scene, _one(joint, float(amplitude[0])), np.zeros(3))


@dataclass(frozen=True)
class JointOffset(Effect):
    """Homing error of a joint's zero.

    Physics: the true angle is the measured one plus a constant.
    Implementation: as a length error, exact; first order only for the search.
    Limitations: mostly a shift of this joint's gravity torque, and close to a spring or an offset on few angles.
    """

    error: Amplitude = Amplitude("rad", "true minus measured angle")
    name = "joint_offset"
    own_joint = False
    kinds = frozenset({"delta"})
    settles = "slow sweeps over the whole workspace and fast moves"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 1)."""
        none = np.zeros(3)
        change = _change(scene, none, _one(joint, STEP)) - _change(scene, none, _one(joint, -STEP))
        return (change / (2 * STEP))[..., None]

    def torque(self, scene: Scene, joint: int, amplitude: np.ndarray, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 3), exact."""
        return _change(scene, np.zeros(3), _one(joint, float(amplitude[0])))
