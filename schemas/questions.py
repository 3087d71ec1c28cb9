"""What can be asked of a machine, and the one line that says that its kind has no answer."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, NoReturn

from schemas.errors import UnansweredError

if TYPE_CHECKING:
    from schemas.robot import Described, Robot


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


def refuse(description: Described, question: Question) -> NoReturn:
    """
    Raises:
        UnansweredError: always.
    """
    asked, instead = question.value
    raise UnansweredError(f"{description.name}: {asked} is not available for {description.called}; {instead}")


def as_delta(description: Described, question: Question) -> Robot:
    """`description`, where it answers `question`, as a Delta robot alone does.

    Raises:
        UnansweredError: it does not.
    """
    found = description.answering(question)
    if found is None:
        refuse(description, question)
    return found
