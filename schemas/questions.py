"""What can be asked of a machine, and the one line that says that its kind has no answer."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import NoReturn

from schemas.axes import Description, load_description
from schemas.errors import UnansweredError
from schemas.robot import Robot


class Question(Enum):
    """In words, and what to run instead."""

    ONLINE = "feed-forward torque and payload sample by sample", "on a log: deltatwin evaluate"
    FIELDBUS = "decoding and driving of EtherCAT drives", "its log from elsewhere: deltatwin import"
    CODE = "code for its controller", "for a simulator: deltatwin export --to mjcf"
    CLOSED_LOOP = "closed loop on the bus", "a simulated log: deltatwin simulate"
    COMMANDS = "rollout of position commands through drives", "of recorded torque: without --commands"
    PLATFORM = "rollout of a platform", "of its joints: deltatwin rollout"
    PICKS = "picks and releases in a log", "one load all the while: deltatwin payload without --truth and --predictions"
    LOAD = "load on a frame", "identify logs with and without the load, and compare their inertias"
    PLACE = "place of a tool", "its angles: deltatwin rollout"
    TREE = "URDF", "for a simulator: deltatwin export --to mjcf"
    MJCF = "MJCF of this kind", "its parameters: deltatwin identify --json"
    CALLBACK = "callback for MuJoCo", "its model alone: deltatwin export --to mjcf"
    RIVALS = "motion that tells rivals apart", "one that identifies best: deltatwin plan-motion --for identify"
    ROUTE = "pick-and-place, workspace or conveyor", "its motions: multisine, slow, or a file"


def refuse(description: Description, question: Question) -> NoReturn:
    """
    Raises:
        UnansweredError: always.
    """
    asked, instead = question.value
    raise UnansweredError(f"{description.name}: there is no {asked} for {description.called}; {instead}")


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
