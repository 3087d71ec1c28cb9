"""Description of n servo axes that do not feel each other but through their gears: a TOML file with `kind = "axes"`,
for logs of real drives that are no Delta.

name = "emps"
kind = "axes"
columns = "emps"            # a column mapping: a file, or the name of a bundled one
coupling = [[1, 0], [1, 1]] # row i: how far motor i, behind its gear, turns for a turn of each joint; default: its own
[[axis]]
unit = "m"                  # of the position: m, or rad; torque is then a force in N, or N m
gravity = false             # vertical axis of rotation, or balanced; default: a rotary axis bears a weight
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from schemas.chain_description import Chain
from schemas.columns import MAX_JOINTS
from schemas.errors import RobotError
from schemas.fitted import Figures, Fitted, JointParameter, per_joint
from schemas.joints_description import JointFriction, Machine
from schemas.questions import Question, as_delta
from schemas.robot import Robot, Source, load_robot
from schemas.toml import Positive, TomlTable, read_toml, validate
from schemas.urdf import turning_joints


class Axis(TomlTable):
    """One axis. gear_ratio: for the orders of ripple. gravity: whether its weight torque changes with its angle; the
    part that does not change is its constant load."""

    unit: Literal["m", "rad"] = "rad"  # of the position
    gear_ratio: Positive = 1.0  # motor turns per turn of the axis
    gravity: bool | None = None  # default: a rotary axis bears a weight

    @model_validator(mode="after")
    def _weight(self) -> Axis:
        if self.unit == "m" and self.gravity:
            raise ValueError("gravity: the weight of a linear axis is constant, and is part of its constant load")
        return self

    @property
    def weighs(self) -> bool:
        """Whether gravity may turn with the axis."""
        return self.unit == "rad" and self.gravity is not False


class AxesIdentified(JointFriction):
    """torque = inertia x_ddot + friction + offset + gravity_sin sin x + gravity_cos cos x, SI, one value per axis; and
    the inertia of each motor that turns with several axes."""

    inertia: JointParameter
    offset: JointParameter
    gravity_sin: JointParameter | None = None
    gravity_cos: JointParameter | None = None
    motor_inertia: JointParameter | None = None

    @classmethod
    def of(cls, fitted: Fitted) -> Self:
        """The section with a fitted base model."""
        return cls.model_validate({key: fitted.joints(name) for key, name in _RIGID.items()} | cls._frictions(fitted))

    @property
    def figures(self) -> Figures:
        found = super().figures
        for key, name in _RIGID.items():
            found |= per_joint(name, getattr(self, key))
        return found


_RIGID = {"motor_inertia": "inertia_motor_{}"} | {
    name: f"{name}_{{}}" for name in ("inertia", "offset", "gravity_sin", "gravity_cos")
}


class Axes(Machine):
    """One or more servo axes that do not influence each other."""

    kind: Literal["axes"]  # of the machine
    called: ClassVar[str] = "servo axes"
    axis: Annotated[list[Axis], Field(min_length=1, max_length=MAX_JOINTS)]
    identified: AxesIdentified | None = None

    @model_validator(mode="after")
    def _for_each_axis(self) -> Axes:
        self._check(self.identified)
        return self

    @property
    def count(self) -> int:
        return len(self.axis)

    @property
    def gear_ratios(self) -> list[float]:
        return [axis.gear_ratio for axis in self.axis]

    @property
    def known(self) -> AxesIdentified | None:
        """`identified`."""
        return self.identified

    @property
    def separate(self) -> Axes | None:
        """Itself: one of its axes may be on a rig of its own, where it moves a body that is known."""
        return self

    @property
    def bears_load(self) -> bool:
        return False

    @property
    def predicts(self) -> bool:
        return self.identified is not None

    def identified_as(self, fitted: Fitted) -> AxesIdentified:
        return AxesIdentified.of(fitted)

    @property
    def linear(self) -> bool:
        return all(axis.unit == "m" for axis in self.axis)

    def joint_linear(self, joint: int) -> bool:
        return self.axis[joint].unit == "m"

    @property
    def angular(self) -> bool:
        return all(axis.unit == "rad" for axis in self.axis)


KINDS = {"axes": Axes, "chain": Chain}
Description = Robot | Axes | Chain


def load_description(path: str | Path, effects: Path | None = None) -> Description:
    """Read a description of a Delta robot, of axes or of an arm, as its `kind` says. effects: Python file with effects
    of the user's own.

    Raises:
        RobotError: naming file, key and value of the first thing that is wrong.
    """
    path = Path(path)
    kind = read_toml(path, RobotError).get("kind") if path.suffix == ".toml" else None
    return load_axes(path, effects) if str(kind) in KINDS else load_robot(path, effects)


def load_delta(path: str | Path, question: Question, effects: Path | None = None) -> Robot:
    """Read the description of a Delta robot, which alone answers `question`.

    Raises:
        RobotError: naming file, key and value of the first thing that is wrong.
        UnansweredError: it describes another machine.
    """
    return as_delta(load_description(path, effects), question)


def load_axes(path: str | Path, effects: Path | None = None) -> Axes | Chain:
    """Read a description of axes, or of an arm and its URDF.

    Raises:
        RobotError: naming file, key and value of the first thing that is wrong.
    """
    path = Path(path)
    values = read_toml(path, RobotError)
    kind = KINDS.get(str(values.get("kind")), Axes)
    if kind is Chain and isinstance(urdf := values.get("urdf"), str):
        _ask_joints(path, urdf, values)
    return validate(kind, values, path, RobotError).read_from(Source(path.parent, effects, path))


def _ask_joints(path: Path, urdf: str, values: Mapping[str, object]) -> None:
    """
    Raises:
        RobotError: an arm without its joints, naming those that it may have. Or its URDF is none.
    """
    if "joints" not in values:
        turning = ", ".join(turning_joints(path.parent / urdf)) or "none"
        raise RobotError(f"{path}: joints: missing key; joints of {urdf} that turn: {turning}")


def save_description(description: Description, path: Path, template: Path | None = None) -> None:
    """Write a description; files that it names are named as seen from `path`. template: of a Delta, see `save_robot`.

    Raises:
        StorageError: the file cannot be written.
    """
    description.save(path, template)
