"""Description of n decoupled servo axes: a TOML file with `kind = "axes"`, for logs of real drives that are no Delta.

name = "emps"
kind = "axes"
columns = "emps"            # a column mapping: a file, or one that comes along, by name
[[axis]]
unit = "m"                  # of the position: m, or rad; torque is then a force in N, or N m
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import tomlkit
from pydantic import BaseModel, ConfigDict, Field

from schemas.errors import RobotError
from schemas.robot import Effect, JointParameter, Positive, RobotName, toml_item
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
    axis: Annotated[list[Axis], Field(min_length=1)]
    columns: str | None = None
    identified: AxesIdentified | None = None
    effect: list[Effect] = []


def is_axes(path: str | Path) -> bool:
    """Whether the description at `path` says `kind = "axes"`.

    Raises:
        RobotError: it cannot be read.
    """
    return Path(path).suffix == ".toml" and read_toml(Path(path), RobotError).get("kind") == "axes"


def load_axes(path: str | Path) -> Axes:
    """Read a description of axes.

    Raises:
        RobotError: naming file, key and value of the first thing that is wrong.
    """
    return validate(Axes, read_toml(Path(path), RobotError), Path(path), RobotError)


def save_axes(axes: Axes, path: Path) -> None:
    """Write a description of axes."""
    document: Any = tomlkit.document()
    for key, value in axes.model_dump(exclude_none=True, exclude_defaults=True).items():
        document[key] = toml_item(value)
    partial = path.with_name(path.name + ".part")
    partial.write_text(tomlkit.dumps(document), encoding="utf-8")
    partial.replace(path)
