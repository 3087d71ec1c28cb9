"""What does a machine of this kind answer?"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from schemas.axes_description import Axes, Description, load_description
from schemas.chain_description import Chain
from schemas.robot import Robot
from service.machines.axes import AxesMachine
from service.machines.chain import ChainMachine
from service.machines.delta import DeltaMachine
from service.machines.machine import MachineModel

KINDS: dict[type, Any] = {  # a line a kind
    Robot: DeltaMachine,
    Axes: AxesMachine,
    Chain: ChainMachine,
}


def machine_of(description: Description) -> MachineModel:
    """The machine of a description."""
    return KINDS[type(description)](description)


def load_machine(path: str | Path, effects: Path | None = None) -> MachineModel:
    """Read a description of any kind.

    Raises:
        RobotError: naming file, key and value of the first thing that is wrong.
    """
    return machine_of(load_description(path, effects))
