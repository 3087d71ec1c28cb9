"""What can be asked of a machine, and the one line that says that its kind has no answer."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import NoReturn

from schemas.axes_description import Description, load_description
from schemas.errors import UnansweredError
from schemas.robot import Robot


class Question(Enum):
    """A question that only some kinds of machine answer: its words, and what to run instead."""

    VIEW = "view in a browser", "on a terminal: deltatwin top"
    LEARNING = "learning of friction online", "without --keep"
    FIELDBUS = "decoding and driving of EtherCAT drives", "for a log from elsewhere: deltatwin import"
    CODE = "code for a controller", "for a simulator: deltatwin export --to mjcf"
    CLOSED_LOOP = "closed loop on the bus", "for a simulated log: deltatwin simulate"
    COMMANDS = "rollout of position commands through drives", "for recorded torque: without --commands"
    PICKS = (
        "detection of picks and releases",
        "for one load throughout: deltatwin payload without --truth and --predictions",
    )
    LOAD = "load on a frame", "identify logs with and without the load, and compare the inertias"
    PLACE = "position of a tool", "for its angles: deltatwin rollout"
    TREE = "URDF", "for a simulator: deltatwin export --to mjcf"
    MJCF = "MJCF export of this kind", "for its parameters: deltatwin identify --json"
    CALLBACK = "callback for MuJoCo", "for the model alone: deltatwin export --to mjcf"
    RIVALS = (
        "motion that separates alternative models",
        "for the best identification: deltatwin plan-motion --for identify",
    )
    ROUTE = "pick-and-place, workspace or conveyor", "possible motions: multisine, slow, or a file"


def refuse(description: Description, question: Question) -> NoReturn:
    """
    Raises:
        UnansweredError: always.
    """
    asked, instead = question.value
    raise UnansweredError(f"{description.name}: {asked} is not available for {description.called}; {instead}")


def as_delta(description: Description, question: Question) -> Robot:
    """`description`, where it is a Delta robot, which alone answers `question`.

    Raises:
        UnansweredError: it is none.
    """
    if not isinstance(description, Robot):
        refuse(description, question)
    return description


def load_delta(path: str | Path, question: Question, effects: Path | None = None) -> Robot:
    """Read the description of a Delta robot, which alone answers `question`.

    Raises:
        RobotError: naming file, key and value of the first thing that is wrong.
        UnansweredError: it describes another machine.
    """
    return as_delta(load_description(path, effects), question)
