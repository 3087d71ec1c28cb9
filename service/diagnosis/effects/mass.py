"""Mass where the description has none, or another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.diagnosis.effects.base import Amplitude, Effect
from service.diagnosis.scene import Scene


@dataclass(frozen=True)
class RotorInertia(Effect):
    """Reflected rotor or gear inertia of one drive.

    Physics: T = delta_i theta_ddot, no gravity.
    Implementation: one regressor a joint.
    Limitations: the same on all joints is rho_1 of the base model and leaves no gap.
    """

    delta_i: Amplitude = Amplitude("kg m^2", "inertia of this joint above the others', joint side")
    name = "rotor_inertia"
    settles = "fast moves of this joint beside slow ones over the same angles"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        return scene.segment.theta_ddot[:, [joint]]


@dataclass(frozen=True)
class ArmMass(Effect):
    """Mass of one active link: inertia and gravity together.

    Physics: a uniform link of mass dm adds dm l1^2/3 theta_ddot - dm g l1/2 cos theta.
    Implementation: one regressor a joint.
    Limitations: the same on all joints is in rho_1 and rho_2 of the base model and leaves no gap.
    """

    delta_m: Amplitude = Amplitude("kg", "mass of this active link above the others'")
    name = "arm_mass"
    kinds = frozenset({"delta"})
    settles = "fast moves and slow sweeps over a wide range of this joint's angle"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        model, motion = scene.delta.model, scene.segment
        length = model.active_length[joint]
        angle = motion.theta[:, joint] + model.joint_offset[joint]
        inertia = length**2 / 3 * motion.theta_ddot[:, joint]
        return (inertia - model.gravity * length / 2 * np.cos(angle))[:, None]


@dataclass(frozen=True)
class ToolMass(Effect):
    """Mass at the platform.

    Physics: T = dm J' (p_ddot + g).
    Implementation: the payload term of the model.
    Limitations: with one tool all the time part of it hides in rho_1 and rho_2.
    """

    delta_m: Amplitude = Amplitude("kg", "mass at the platform beyond the description")
    name = "tool_mass"
    per_joint = False
    own_joint = False
    kinds = frozenset({"delta"})
    settles = "the same path with and without a known mass"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 1)."""
        motion = scene.segment
        return scene.delta.payload(motion.theta, motion.theta_dot, motion.theta_ddot)[..., None]


@dataclass(frozen=True)
class BaseTilt(Effect):
    """The base is not level.

    Physics: gravity leans by two small angles, on every mass.
    Implementation: torque per rad about x and about y, linear in the angles, with rho_2 on the active links.
    Limitations: small angles; a turn about z does nothing.
    """

    about_x: Amplitude = Amplitude("rad", "tilt about the base's x axis")
    about_y: Amplitude = Amplitude("rad", "tilt about the base's y axis")
    name = "base_tilt"
    per_joint = False
    own_joint = False
    kinds = frozenset({"delta"})
    settles = "slow sweeps to all sides of the workspace"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 2)."""
        model, arms = scene.delta.model, scene.arms
        # In base axes gravity is R' (0, 0, -g): tilting by (x, y) makes the upward reaction g (-y, x, 1).
        link_mass = scene.base.rigid[1] * model.gravity_torque / (model.gravity * model.active_length)
        columns = []
        for upward in (np.array([0.0, 1.0, 0.0]), np.array([-1.0, 0.0, 0.0])):
            reaction = model.gravity * upward
            columns.append(model.moving_mass * scene.at_platform(reaction) + link_mass * (arms.slope @ reaction))
        return np.stack(columns, axis=-1)
