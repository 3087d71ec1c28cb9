"""Description of n decoupled servo axes: a TOML file with `kind = "axes"`, for logs of real drives that are no Delta.

name = "emps"
kind = "axes"
columns = "emps"            # a column mapping: a file, or one that comes along, by name
[[axis]]
unit = "m"                  # of the position: m, or rad; torque is then a force in N, or N m
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any, Literal

import tomlkit
from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, model_validator

from schemas.columns import MAX_JOINTS
from schemas.errors import RobotError
from schemas.files import write_text
from schemas.robot import Effect, JointParameter, Positive, Robot, RobotName, check_joints, load_robot, toml_item
from schemas.toml import read_toml, validate


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Axis(_Section):
    """One axis. gear_ratio: motor turns an axis turn, for ripple orders."""

    unit: Literal["m", "rad"] = "rad"
    gear_ratio: Positive = 1.0


class AxesIdentified(_Section):
    """torque = inertia x_ddot + viscous x_dot + coulomb sign x_dot + offset, one number an axis, SI."""

    inertia: JointParameter
    offset: JointParameter
    viscous_friction: JointParameter
    coulomb_friction: JointParameter
    friction_transition: float = 0.0
    torque_timing_s: float = 0.0


class Axes(_Section):
    """n decoupled axes."""

    name: RobotName
    kind: Literal["axes"]
    axis: Annotated[list[Axis], Field(min_length=1, max_length=MAX_JOINTS)]
    columns: str | None = None
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
        check_joints(self.identified, self.effect, len(self.axis))
        return self

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
