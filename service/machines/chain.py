"""A serial arm, by Pinocchio."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from schemas.chain import Chain
from schemas.errors import RobotError
from service.machines.machine import Dynamics, Limits, MachineModel
from service.model.mechanism import SerialArm
from service.model.scene import Base

if TYPE_CHECKING:
    from service.machines.files import MachineFile


class ChainMachine(MachineModel):
    """See `MachineModel`."""

    def __init__(self, description: Chain):
        super().__init__(description)
        self.chain = description

    @cached_property
    def mechanism(self) -> SerialArm:
        """Kinematics and regressor."""
        return SerialArm.of(self.chain)

    @property
    def tool(self) -> str:
        """The frame that the description's payload sits on, or the last link of the URDF."""
        payload = self.chain.payload
        return self.chain.arm.links[-1] if payload is None else payload.frame

    def dynamics(self, base: Base) -> Dynamics:
        """Composite bodies and recursive Newton-Euler instead of a regressor a column."""
        mechanism = self.mechanism
        told, weights = mechanism.told(base.rigid)
        of_links = mechanism.arm.dynamics(weights)
        names = (
            *(f"rotor_{joint + 1}" for joint in range(mechanism.joints)),
            *(f"inertia_{m}" for m in mechanism.shared),
        )
        rotors = (mechanism.rows.T * [told[name] for name in names]) @ mechanism.rows
        load = np.array([told[f"offset_{joint + 1}"] for joint in range(mechanism.joints)])

        def at(theta: np.ndarray, theta_dot: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            mass, bias = of_links(theta, theta_dot)
            return mass + rotors, bias + load

        return at

    def limits(self) -> Limits:
        """Of the URDF; a speed or torque of zero there is none."""
        low, high = np.array(self.chain.arm.limits).T
        speed, effort = np.array(self.chain.arm.most).T
        return Limits(low, high, speed, np.full(self.chain.count, np.inf), effort)

    def place(self, theta: np.ndarray, frame: str | None = None) -> np.ndarray:
        """Of a link of the URDF."""
        return self.mechanism.arm.place(self.frame(frame), theta)

    def load(self, frame: str | None) -> tuple[str, np.ndarray]:
        """On a link of the URDF.

        Raises:
            RobotError: there is no such link, or it stands still.
        """
        named = self.frame(frame)
        columns = self.mechanism.arm.body_on(named)
        if not columns.any():
            raise RobotError(f"{self.chain.name}: link {named!r} stands still: a load on it shows in no torque")
        return named, columns

    def to_mjcf(self) -> MachineFile:
        """For MuJoCo."""
        from service.machines.chain_files import to_mjcf

        return to_mjcf(self.chain)

    def to_urdf(self) -> MachineFile:
        """With identified bodies."""
        from service.machines.chain_files import to_urdf

        return to_urdf(self.chain)

    def frame(self, frame: str | None) -> str:
        """
        Raises:
            RobotError: there is no such link.
        """
        links = self.chain.arm.links
        if frame is not None and frame not in links:
            raise RobotError(f"{self.chain.name}: {self.chain.urdf} has no link {frame!r}: {', '.join(links)}")
        return frame or self.tool


def split(told: dict[str, float], joints: int) -> tuple[np.ndarray, np.ndarray]:
    """(F,) kg m^2 of rotors, of the joints and of motors that turn with several; (n,) N m of constant load."""
    load = np.array([told[f"offset_{joint + 1}"] for joint in range(joints)])
    return np.array([value for name, value in told.items() if not name.startswith("offset_")]), load
