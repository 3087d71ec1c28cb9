"""Description of n servo axes that do not feel each other but through their gears: a TOML file with `kind = "axes"`,
for logs of real drives that are no Delta.

name = "emps"
kind = "axes"
columns = "emps"            # a column mapping: a file, or one that comes along, by name
coupling = [[1, 0], [1, 1]] # row i: how far motor i, behind its gear, turns for a turn of each joint; default: its own
[[axis]]
unit = "m"                  # of the position: m, or rad; torque is then a force in N, or N m
gravity = false             # turns about a vertical axis, or is balanced; default: a turning axis bears a weight
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tomlkit
from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, model_validator

from schemas.columns import MAX_JOINTS
from schemas.errors import RobotError
from schemas.files import write_text
from schemas.robot import (
    Effect,
    JointParameter,
    NotNegative,
    Positive,
    Robot,
    RobotName,
    check_joints,
    load_robot,
    toml_item,
)
from schemas.toml import read_toml, validate

MOST_COUPLED = 1e6  # condition of a coupling matrix


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Axis(_Section):
    """One axis. gear_ratio: motor turns an axis turn, for ripple orders. gravity: whether its weight changes with its
    angle; what does not change is its constant load."""

    unit: Literal["m", "rad"] = "rad"
    gear_ratio: Positive = 1.0
    gravity: bool | None = None

    @model_validator(mode="after")
    def _weight(self) -> Axis:
        if self.unit == "m" and self.gravity:
            raise ValueError("gravity: a linear axis has a constant weight, which is its constant load")
        return self

    @property
    def weighs(self) -> bool:
        """Whether gravity may turn with the axis."""
        return self.unit == "rad" and self.gravity is not False


class AxesIdentified(_Section):
    """torque = inertia x_ddot + viscous x_dot + coulomb sign x_dot + offset + sin sin x + cos cos x, SI, a number an
    axis; and inertia and friction of each motor that turns with several axes. friction_transition: one for all, or one
    an axis and then one such motor."""

    inertia: JointParameter
    offset: JointParameter
    gravity_sin: JointParameter | None = None
    gravity_cos: JointParameter | None = None
    viscous_friction: JointParameter
    coulomb_friction: JointParameter
    motor_inertia: JointParameter | None = None
    motor_viscous_friction: JointParameter | None = None
    motor_coulomb_friction: JointParameter | None = None
    friction_transition: NotNegative | list[Positive] = 0.0
    torque_timing_s: float = 0.0


class Axes(_Section):
    """n decoupled axes."""

    name: RobotName
    kind: Literal["axes"]
    axis: Annotated[list[Axis], Field(min_length=1, max_length=MAX_JOINTS)]
    columns: str | None = None
    coupling: list[list[float]] | None = None
    identified: AxesIdentified | None = None
    effect: list[Effect] = []
    _folder: Path = PrivateAttr(Path())
    _effects_file: Path | None = PrivateAttr(None)

    @property
    def effects_file(self) -> Path | None:
        """Python file with effects of the user's own that `effect` may name."""
        return self._effects_file

    @model_validator(mode="after")
    def _for_each_axis(self) -> Axes:
        count = len(self.axis)
        check_joints(self.identified, self.effect, count)
        if self.coupling is not None:
            if [len(row) for row in self.coupling] != [count] * count:
                raise ValueError(f"coupling: {count} rows of {count} numbers are needed, a motor each")
            if np.linalg.cond(self.motors) > MOST_COUPLED:
                raise ValueError(f"coupling: {self.coupling}: the motors do not tell where every joint is")
        return self

    @property
    def motors(self) -> np.ndarray:
        """(n, n): row i, how far motor i turns, behind its gear, for a turn of each joint."""
        return np.eye(len(self.axis)) if self.coupling is None else np.array(self.coupling, float)

    @property
    def shared_motors(self) -> list[int]:
        """Motors, from 0, that turn with several joints."""
        return [int(i) for i in np.flatnonzero(np.count_nonzero(self.motors, axis=1) > 1)]

    @property
    def mapping(self) -> str | None:
        """`columns`, a file as found from here."""
        beside = self._folder / self.columns if self.columns else None
        return str(beside) if beside is not None and beside.is_file() else self.columns

    @property
    def linear(self) -> bool:
        """Metres and newtons, on all axes."""
        return all(axis.unit == "m" for axis in self.axis)

    @property
    def angular(self) -> bool:
        """Radians and newton metres, on all axes."""
        return all(axis.unit == "rad" for axis in self.axis)


Description = Robot | Axes


def load_description(path: str | Path, effects: Path | None = None) -> Description:
    """Read a description of a Delta robot or of axes, as its `kind` says. effects: Python file with effects of the
    user's own.

    Raises:
        RobotError: naming file, key and value of the first thing that is wrong.
    """
    return load_axes(path, effects) if is_axes(path) else load_robot(path, effects)


def no_axes(robot: Description | None, what: str) -> Robot | None:
    """`robot`, where it is a Delta or none.

    Raises:
        RobotError: it describes axes; `what` says what for that is no use.
    """
    if isinstance(robot, Axes):
        raise RobotError(f"{what}: {robot.name} describes axes, a Delta robot is needed")
    return robot


def is_axes(path: str | Path) -> bool:
    """Whether the description at `path` says `kind = "axes"`.

    Raises:
        RobotError: it cannot be read.
    """
    return Path(path).suffix == ".toml" and read_toml(Path(path), RobotError).get("kind") == "axes"


def load_axes(path: str | Path, effects: Path | None = None) -> Axes:
    """Read a description of axes.

    Raises:
        RobotError: naming file, key and value of the first thing that is wrong.
    """
    axes = validate(Axes, read_toml(Path(path), RobotError), Path(path), RobotError)
    axes._folder, axes._effects_file = Path(path).parent, effects
    return axes


def save_axes(axes: Axes, path: Path) -> None:
    """Write a description of axes; a mapping file that it names is named as seen from `path`.

    Raises:
        StorageError: the file cannot be written.
    """
    document: Any = tomlkit.document()
    values = axes.model_dump(exclude_none=True, exclude_defaults=True)
    if axes.mapping != axes.columns:
        values["columns"] = os.path.relpath(str(axes.mapping), path.parent)
    for key, value in values.items():
        document[key] = toml_item(value)
    write_text(path, tomlkit.dumps(document))
