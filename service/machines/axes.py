"""Servo axes that feel each other through their motors at most."""

from __future__ import annotations

from schemas.axes import Axes
from service.machines.machine import MachineModel


class AxesMachine(MachineModel):
    """See `MachineModel`: all that an axis answers follows from its regressor."""

    def __init__(self, description: Axes):
        super().__init__(description)
        self.axes = description
