"""What has changed: the catalogue, at work only from a moment on.

The motion before that moment holds the base model and the effects that the description carries already, so that a
production motion, which alone would leave the base model open, is enough to tell what came on top of them.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, cast

import numpy as np

from service.model.effects.base import Amplitude, Effect
from service.model.mechanism import SerialArm
from service.model.scene import Scene


@dataclass(frozen=True)
class FrictionLevel(Effect):
    """Dry or viscous friction other than it was. As a property of the robot it is the base model's; as a change it is
    the commonest of all."""

    coulomb: Amplitude = Amplitude("N m", "dry friction, now minus before")
    viscous: Amplitude = Amplitude("N m s/rad", "viscous friction, now minus before")
    name = "friction_level"
    title = "Dry or viscous friction has changed"
    means = (
        "Lubrication, temperature, a seal or a preload: check the gear of this joint; identify again if the change "
        "persists."
    )
    dissipates = True
    settles = "the same path at three speeds"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 2)."""
        return np.stack([scene.direction[:, joint], scene.segment.theta_dot[:, joint]], axis=1)


@dataclass(frozen=True)
class ToolLoad(Effect):
    """A load on the tool of an arm other than it was: a tool that was changed, a part that was not set down."""

    mass: Amplitude = Amplitude("kg", "mass on the tool, now minus before")
    moment_x: Amplitude = Amplitude("kg m", "mass times its x coordinate in the tool's frame, now minus before")
    moment_y: Amplitude = Amplitude("kg m", "mass times its y coordinate in the tool's frame, now minus before")
    moment_z: Amplitude = Amplitude("kg m", "mass times its z coordinate in the tool's frame, now minus before")
    name = "tool_load"
    title = "The load on the tool has changed"
    means = "Check tool, gripper and what they hold; if the change is meant, put it into the description as payload."
    per_joint = False
    own_joint = False
    kinds = frozenset({"chain"})
    settles = "the same path with and without the tool"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, n, 4)."""
        arm, motion = cast(SerialArm, scene.mechanism).arm, scene.segment
        return arm.columns(motion.theta, motion.theta_dot, motion.theta_ddot) @ arm.body_on(arm.tool)[:, :4]


def changes(effects: Sequence[Effect], first: int) -> tuple[Effect, ...]:
    """`effects`, and changes of friction and load, at work in recordings of trace number `first` and later."""
    return tuple(_coming_on(effect, first) for effect in (FrictionLevel(), ToolLoad(), *effects))


def _coming_on(effect: Effect, first: int) -> Effect:
    late = copy.copy(effect)
    object.__setattr__(late, "__class__", _kind(type(effect), first))  # frozen, and of the user's own making
    return late


@cache
def _kind(kind: type[Effect], first: int) -> type[Effect]:
    """`kind` without any effect on recordings of earlier traces."""

    def before(scene: Scene) -> bool:
        return scene.recording.trace < first

    def regressors(self: Effect, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        if not before(scene):
            return kind.regressors(self, scene, joint, nonlinear)
        each = () if self.own_joint else (scene.joints,)
        return np.zeros((len(scene.time), *each, max(1, len(self.amplitudes))))

    def torque(
        self: Effect, scene: Scene, joint: int, amplitude: np.ndarray, nonlinear: tuple[float, ...]
    ) -> np.ndarray:
        if before(scene):
            return np.zeros((len(scene.time), scene.joints))
        return kind.torque(self, scene, joint, amplitude, nonlinear)

    def report(
        self: Effect, scene: Scene, joint: int, torque: np.ndarray, amplitude: np.ndarray, nonlinear: tuple[float, ...]
    ) -> Any:
        return torque if before(scene) else kind.report(self, scene, joint, torque, amplitude, nonlinear)

    members: dict[str, Any] = {"regressors": regressors, "report": report}
    if kind.torque is not Effect.torque:  # else it is made of the regressors
        members["torque"] = torque
    return type(kind.__name__, (kind,), members)
