"""Zenoh keys: `deltatwin/<robot>/<topic>` for data, `deltatwin/<robot>/@/<role>` for the liveliness token of a role."""

from __future__ import annotations

import re

from schemas.errors import RobotError
from schemas.messages import TOPICS, Role

_CHUNK = re.compile(r"^[A-Za-z0-9][A-Za-z0-9._-]*")


def check_robot_name(robot: str) -> str:
    """`robot`, if it can be one chunk of a key.

    Raises:
        RobotError: the name is empty or holds a character that keys or file names reserve.
    """
    if not _CHUNK.fullmatch(robot):
        raise RobotError(
            f"robot name {robot!r}: use letters, digits, '.', '_' and '-', starting with a letter or digit"
        )
    return robot


def topic_key(robot: str, topic: str) -> str:
    """Key of one of `schemas.messages.TOPICS`."""
    if topic not in TOPICS:
        raise KeyError(topic)
    return f"deltatwin/{check_robot_name(robot)}/{topic}"


def liveliness_key(robot: str, role: Role) -> str:
    """Key of the liveliness token that `role` holds while it runs."""
    return f"deltatwin/{check_robot_name(robot)}/@/{role.name.lower()}"
