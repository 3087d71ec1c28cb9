"""What commands ask of a machine. A kind answers in its own file; what it does not answer is one line that says so.

Every kind has a mechanism, whose torque is linear in what is identified. That alone is enough for the forward motion;
where a kind knows a faster way, it overrides it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from schemas.axes_description import Description
from schemas.joints_description import JointLimits
from schemas.questions import Question, refuse
from service.model.mechanism import Mechanism, mechanism_of
from service.model.scene import Base

if TYPE_CHECKING:
    from service.machines.exported import MachineFile

# (W, n) angles and speeds to mass matrices (W, n, n) and the torque (W, n) that no acceleration asks for
Dynamics = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Limits:
    """What n joints may do, (n,) each: angle low and high, speed, acceleration, torque; rad or m and N m or N.

    Without end where nobody has said.
    """

    low: np.ndarray
    high: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray

    @classmethod
    def none(cls, joints: int) -> Limits:
        """Of `joints` joints of which nothing is known."""
        endless = np.full(joints, np.inf)
        return cls(-endless, endless, endless, endless, endless)


def declared(limits: Limits, own: JointLimits) -> Limits:
    """`limits` with those that a description declares."""
    told = {"torque": own.torque, "speed": own.speed}
    return replace(limits, **{key: np.array(values) for key, values in told.items() if values is not None})


class MachineModel:
    """A described machine. A kind overrides what it answers."""

    def __init__(self, description: Description):
        self.description = description

    @cached_property
    def mechanism(self) -> Mechanism:
        """Kinematics and regressor."""
        return mechanism_of(self.description)

    def dynamics(self, base: Base) -> Dynamics:
        """Mass matrix and bias without friction, of the coefficients of `base`, from the regressor alone."""
        mechanism = self.mechanism
        units = np.eye(mechanism.joints)

        def at(theta: np.ndarray, theta_dot: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            still = np.zeros_like(theta)
            bias = mechanism.rigid(theta, theta_dot, still).torque(base.rigid)
            rest = mechanism.rigid(theta, still, still).torque(base.rigid)
            columns = [mechanism.rigid(theta, still, still + unit).torque(base.rigid) - rest for unit in units]
            return np.stack(columns, axis=-1), bias

        return at

    def limits(self) -> Limits:
        """What the joints may do."""
        raise NotImplementedError

    def place(self, theta: np.ndarray, frame: str | None = None) -> np.ndarray:
        """(N, 3) m of a frame, by default the tool, at (N, n) angles, in the base frame."""
        refuse(self.description, Question.PLACE)

    def load(self, frame: str | None) -> tuple[str, np.ndarray]:
        """The frame, by default the tool, and (10 n, 10): what a body on it adds to the weights of `Arm`."""
        refuse(self.description, Question.LOAD)

    def to_mjcf(self) -> MachineFile:
        """For MuJoCo."""
        refuse(self.description, Question.MJCF)

    def to_urdf(self) -> MachineFile:
        """For everything that reads URDFs."""
        refuse(self.description, Question.TREE)
