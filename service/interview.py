"""The first description of a machine: what has to be asked, and the file that the answers make."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from schemas.axes_description import Axes
from schemas.chain_description import Chain
from schemas.errors import RobotError
from schemas.robot import Robot, Source
from schemas.toml import validate
from schemas.urdf import turning_joints

MOST_AXES = 12


@dataclass(frozen=True)
class Question:
    """One key of the description, dotted. unit: empty where it is no quantity. default: None where there is none that
    would not be a guess. text: an answer that is a text, not a number or true or false."""

    key: str
    asks: str
    unit: str = ""
    default: str | None = None
    text: bool = False

    @property
    def prompt(self) -> str:
        """How it is asked."""
        return f"{self.asks}{f', {self.unit}' if self.unit else ''}"

    @property
    def comment(self) -> str:
        """What stands behind the answer in the file."""
        return f"{self.unit}: {self.asks}" if self.unit else self.asks


DELTA = (
    Question("name", "name of the robot", default="my-robot", text=True),
    Question("geometry.active_link_length", "upper arm, from the motor's axis to the elbow", "m"),
    Question("geometry.passive_link_length", "forearm, from the elbow to its joint at the platform", "m"),
    Question("geometry.base_radius", "from the centre of the base to a motor's axis", "m"),
    Question("geometry.platform_radius", "from the centre of the platform to the joint of a forearm", "m"),
    Question("mass.active_link", "mass of one upper arm", "kg"),
    Question("mass.passive_link", "mass of one forearm (both rods)", "kg"),
    Question("mass.platform", "mass of the platform with its gripper, without a product", "kg"),
    Question("drive.gear_ratio", "motor turns per turn of the joint", default="1"),
    Question("limits.max_payload_kg", "largest payload", "kg", "6"),
)


def for_axes(count: int) -> tuple[Question, ...]:
    """What to ask of `count` servo axes that do not feel each other.

    Raises:
        RobotError: too many, or none.
    """
    if not 1 <= count <= MOST_AXES:
        raise RobotError(f"--axes {count}: 1 to {MOST_AXES}")
    asked = [Question("name", "name of the machine", default="my-axes", text=True)]
    for axis in range(count):
        key, it = f"axis.{axis + 1}", f"axis {axis + 1}"
        asked += [
            Question(f"{key}.unit", f"{it} turns (rad) or is linear (m)", default="rad", text=True),
            Question(f"{key}.gear_ratio", f"{it}: motor turns per turn of the axis", default="1"),
            Question(f"{key}.gravity", f"{it} bears a weight that changes with its angle", default="true"),
        ]
    return tuple(asked)


def for_urdf(urdf: Path) -> tuple[Question, ...]:
    """What to ask of an arm that a URDF describes.

    Raises:
        RobotError: it is no URDF, or nothing in it turns.
    """
    joints = turning_joints(urdf)
    if not joints:
        raise RobotError(f"{urdf}: no joint of it turns and has its own torque")
    return (
        Question("name", "name of the arm", default=urdf.stem.replace("_", "-"), text=True),
        Question("joints", "joints in the order of the log, separated by commas", default=",".join(joints), text=True),
        Question("gear_ratio", "motor turns per turn of a joint", default="1"),
    )


def write_up(questions: Sequence[Question], answers: Mapping[str, str], out: Path, urdf: Path | None = None) -> str:
    """The text of a description that goes to `out`, checked.

    Raises:
        RobotError: an answer that is no number, or that describes an impossible machine; names key and value.
    """
    if urdf is not None:
        text, model = _arm(questions, answers, os.path.relpath(urdf, out.parent)), Chain
    elif any(question.key.startswith("axis.") for question in questions):
        text, model = _tables(questions, answers, 'kind = "axes"\n', "[[axis]]"), Axes
    else:
        text, model = _tables(questions, answers, "", "[{}]"), Robot
    validate(model, tomllib.loads(text), out, RobotError).read_from(Source(out.parent))
    return text


def _tables(questions: Sequence[Question], answers: Mapping[str, str], head: str, heading: str) -> str:
    """A line a question, under the table that its key names."""
    lines, open_table = [head.rstrip()] if head else [], ""
    for question in questions:
        table, _, key = question.key.rpartition(".")
        if question.key.endswith(".gravity") and answers[f"{table}.unit"] == "m":
            continue  # a linear axis has a constant weight
        if table != open_table:
            lines += ["", heading.format(table)]
            open_table = table
        lines.append(f"{key} = {_value(question, answers[question.key])}  # {question.comment}")
    return "\n".join([*lines, ""])


def _arm(questions: Sequence[Question], answers: Mapping[str, str], urdf: str) -> str:
    joints = [name.strip() for name in answers["joints"].split(",")]
    ratio = next(question for question in questions if question.key == "gear_ratio")
    return (
        f"name = {json.dumps(answers['name'])}\n"
        'kind = "chain"\n'
        f"urdf = {json.dumps(urdf)}  # next to this file\n"
        f"joints = {json.dumps(joints)}  # in the order of the log\n"
        f"gear_ratio = {_value(ratio, answers['gear_ratio'])}  # {ratio.comment}; or a list, one per joint\n"
    )


def _value(question: Question, answer: str) -> str:
    """An answer as TOML has it."""
    if question.text:
        return json.dumps(answer)
    if answer in ("true", "false"):
        return answer
    try:
        return repr(float(answer))
    except ValueError:
        raise RobotError(f"{question.key}: {answer!r} is not a number ({question.prompt})") from None
