"""The first description of a machine: what has to be asked, and the file that the answers make."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from schemas.axes_description import Axes
from schemas.chain_description import Chain
from schemas.drive_list import ListedDrive
from schemas.errors import RobotError
from schemas.robot import Described, Robot, Source
from schemas.toml import explain_one, validate
from schemas.urdf import moving_joints, read_urdf, turning_joints

MOST_AXES = 12
DELTA_JOINTS = 3
# What of a list of drives scales a bus -> what scales a log alike.
IMPORTED = {
    "counts_per_turn": "`import --counts-per-rev`", "sign": "`sign` in the mapping that `import` writes",
    "zero_counts": "`zero` in the mapping that `import` writes",
    **dict.fromkeys(("rated_torque_nm", "rated_current_a", "torque_constant_nmpa"), "`import --torque-unit`"),
}  # fmt: skip


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
        Question(
            "joints",
            "joints of the log in its order, separated by commas; others are at rest",
            default=",".join(joints),
            text=True,
        ),
        Question("gear_ratio", "motor turns per turn of a joint", default="1"),
    )


def count_of(questions: Sequence[Question]) -> int:
    """How many joints are asked for: by their names in an arm, by the axes, or three."""
    for question in questions:
        if question.key == "joints":
            return len((question.default or "").split(","))
    axes = {question.key.split(".")[1] for question in questions if question.key.startswith("axis.")}
    return len(axes) or DELTA_JOINTS


def gears(questions: Sequence[Question], drives: Sequence[ListedDrive], path: Path) -> dict[str, str]:
    """The answers that a list of drives gives, by their keys. path: of the list.

    Raises:
        RobotError: it scales the bus of what is no Delta robot, or leaves out what that needs.
    """
    scaled = [(drive.joint, key) for drive in drives for key in drive.scaling]
    if questions is DELTA:
        if scaled and not drives[0].on_bus:
            joint, key = scaled[0]
            value = getattr(drives[joint - 1], key)
            raise RobotError(
                f"{path}: joint {joint}: {key} {value:g}: counts_per_turn is missing (encoder counts per motor "
                f"turn); if the drives are not on a bus, leave {key} out and use {IMPORTED[key]}"
            )
        return {"drive.gear_ratio": str(drives[0].gear_ratio)}
    if scaled:
        key = scaled[0][1]
        raise RobotError(f"{path}: {key}: only for a Delta robot; for others use {IMPORTED[key]}")
    if any(question.key == "joints" for question in questions):
        return {"gear_ratio": ",".join(str(drive.gear_ratio) for drive in drives)}
    return {f"axis.{drive.joint}.gear_ratio": str(drive.gear_ratio) for drive in drives}


def _on_bus(drives: Sequence[ListedDrive]) -> str:
    """Tables of the drives, where the list scales their messages."""
    text = ""
    for drive in drives if all(drive.on_bus for drive in drives) else ():
        torque = (
            f'reference = "rated_torque", rated_torque_nm = {drive.rated_torque_nm!r}'
            if drive.rated_torque_nm is not None
            else f'reference = "rated_current", rated_current_a = {drive.rated_current_a!r}, '
            f'rated_current_form = "rms", torque_constant_nmpa = {drive.torque_constant_nmpa!r}, '
            'torque_constant_form = "rms"'
        )
        text += (
            f"\n[[drive.joint]]  # joint {drive.joint}\n"
            f"counts_per_turn = {drive.counts_per_turn!r}  # encoder counts per motor turn\n"
            f"gear_ratio = {drive.gear_ratio!r}  # motor turns per turn of the joint\n"
            f"sign = {drive.sign}  # -1: the drive counts up while the active link rises\n"
            f"zero_counts = {drive.zero_counts}  # at joint angle 0\n"
            f"torque = {{ {torque} }}\n"
        )
    return text


def write_up(
    questions: Sequence[Question], answers: Mapping[str, str], out: Path, urdf: Path | None = None,
    drives: Sequence[ListedDrive] = (),
) -> str:  # fmt: skip
    """The text of a description that goes to `out`, checked.

    Raises:
        RobotError: an answer that is no number, or that describes an impossible machine; names key and value.
    """
    text, model = _written(questions, answers, out, urdf)
    text += _on_bus(drives)
    validate(model, tomllib.loads(text), out, RobotError).read_from(Source(out.parent))
    return text


def fault(
    questions: Sequence[Question], answers: Mapping[str, str], out: Path, urdf: Path | None = None
) -> tuple[str, str] | None:
    """What is wrong with the answers so far: the key, or the table where it takes several, and a sentence."""
    answered = [question for question in questions if question.key in answers]
    for question in answered:
        try:
            for part in answers[question.key].split(",") if question.key == "gear_ratio" else [answers[question.key]]:
                _value(question, part)
        except RobotError as error:
            return question.key, str(error)
    text, model = _written(answered, answers, out, urdf)
    values = tomllib.loads(text)
    try:
        if urdf is not None and "joints" in answers:
            read_urdf(urdf, values["joints"], values.get("held", []))
        model.model_validate(values, strict=True)
    except RobotError as error:
        return "joints", str(error)
    except ValidationError as error:
        for one in error.errors():
            if one["type"] != "missing":  # it is not asked yet
                return ".".join(str(part + 1 if isinstance(part, int) else part) for part in one["loc"]), explain_one(
                    one
                )
    return None


def _written(
    questions: Sequence[Question], answers: Mapping[str, str], out: Path, urdf: Path | None
) -> tuple[str, type[Described]]:
    """The text of a description with the answers to `questions`, and the kind that it is of."""
    if urdf is not None:
        return _arm(questions, answers, urdf, out.parent), Chain
    if any(question.key.startswith("axis.") for question in questions):
        return _tables(questions, answers, 'kind = "axes"\n', "[[axis]]"), Axes
    return _tables(questions, answers, "", "[{}]"), Robot


def _tables(questions: Sequence[Question], answers: Mapping[str, str], head: str, heading: str) -> str:
    """A line a question, under the table that its key names."""
    lines, open_table = [head.rstrip()] if head else [], ""
    for question in questions:
        table, _, key = question.key.rpartition(".")
        if question.key.endswith(".gravity") and answers.get(f"{table}.unit") == "m":
            continue  # a linear axis has a constant weight
        if table != open_table:
            lines += ["", heading.format(table)]
            open_table = table
        lines.append(f"{key} = {_value(question, answers[question.key])}  # {question.comment}")
    return "\n".join([*lines, ""])


def _arm(questions: Sequence[Question], answers: Mapping[str, str], urdf: Path, folder: Path) -> str:
    lines = ['kind = "chain"', f"urdf = {json.dumps(os.path.relpath(urdf, folder))}  # as seen from this file"]
    for question in questions:
        answer = answers[question.key]
        if question.key == "joints":
            joints = [name.strip() for name in answer.split(",")]
            rest = [name for name in moving_joints(urdf) if name not in joints]
            lines.append(f"joints = {json.dumps(joints)}  # in the order of the log")
            lines += [f"held = {json.dumps(rest)}  # not in the log: at rest at zero"] if rest else []
        elif question.key == "gear_ratio":
            ratios = [_value(question, part) for part in answer.split(",")]
            said = ratios[0] if len(ratios) == 1 else f"[{', '.join(ratios)}]"
            lines.append(f"gear_ratio = {said}  # {question.comment}; or a list, one per joint")
        else:
            lines.insert(0, f"{question.key} = {_value(question, answer)}")
    return "\n".join([*lines, ""])


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
