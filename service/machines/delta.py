"""A Delta robot. What it alone answers, `schemas.questions.as_delta` hands out."""

from __future__ import annotations

import numpy as np

from schemas.robot import Robot
from service.machines.machine import Limits, MachineModel
from service.model import kinematics
from service.model.mechanism import Delta


class DeltaMachine(MachineModel):
    """See `MachineModel`."""

    def __init__(self, description: Robot):
        super().__init__(description)
        self.robot = description

    def limits(self) -> Limits:
        """As described; torque without end where [limits] has no peak."""
        limits, (low, high) = self.robot.limits, self.robot.geometry.joint_range_rad
        values = (low, high, limits.joint_speed_radps, limits.joint_acceleration_radps2, limits.peak_torque_nm)
        return Limits(*(np.full(3, np.inf if value is None else value) for value in values))

    def place(self, theta: np.ndarray, frame: str | None = None) -> np.ndarray:
        """Of the platform."""
        return kinematics.forward(Delta.of(self.robot).model, theta)
