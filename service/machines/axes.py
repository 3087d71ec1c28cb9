"""Servo axes that feel each other through their motors at most."""

from __future__ import annotations

from typing import TYPE_CHECKING

from schemas.axes_description import Axes
from service.machines.machine import Limits, MachineModel, declared

if TYPE_CHECKING:
    from service.machines.exported import MachineFile


class AxesMachine(MachineModel):
    """See `MachineModel`: all that an axis answers follows from its regressor."""

    def __init__(self, description: Axes):
        super().__init__(description)
        self.axes = description

    def limits(self) -> Limits:
        """As declared."""
        return declared(Limits.none(self.axes.count), self.axes.limits)

    def to_mjcf(self) -> MachineFile:
        """For MuJoCo."""
        from service.machines.axes_files import to_mjcf

        return to_mjcf(self.axes)
