"""A serial arm, by Pinocchio."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from schemas.chain_description import Chain
from schemas.errors import RobotError
from service.machines.bodies import IdentifiedBodies, identified_bodies
from service.machines.machine import Dynamics, Limits, MachineModel, declared
from service.model.mechanism import SerialArm
from service.model.scene import Base

if TYPE_CHECKING:
    from service.machines.exported import MachineFile


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
        """The frame that the description's payload sits on, or the last link of the URDF that moves with all joints."""
        payload = self.chain.payload
        return self.mechanism.arm.tool if payload is None else payload.frame

    @cached_property
    def _bodies(self) -> IdentifiedBodies:
        return identified_bodies(self.chain)

    def dynamics(self, base: Base) -> Dynamics:
        """Of bodies that can be: parameters of a short log may have inertias that no motion could start from."""
        mechanism, bodies = self.mechanism, self._bodies
        of_links = mechanism.arm.dynamics(bodies.weights)
        rotors = (mechanism.rows.T * bodies.found.rotors) @ mechanism.rows

        def at(theta: np.ndarray, theta_dot: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            mass, bias = of_links(theta, theta_dot)
            return mass + rotors, bias + bodies.load

        return at

    def limits(self) -> Limits:
        """Of the URDF, where a speed or torque of zero is none; those of the description go before them."""
        low, high = np.array(self.chain.arm.limits).T
        speed, effort = np.array(self.chain.arm.most).T
        return declared(Limits(low, high, speed, np.full(self.chain.count, np.inf), effort), self.chain.limits)

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
            raise RobotError(f"{self.chain.name}: link {named!r} does not move: no torque shows a load on it")
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
