"""Zenoh keys: `deltatwin/<robot>/<topic>` for data, `deltatwin/<robot>/@/<role>` for the liveliness token of a role.

`<robot>` is its name as ROS 2 allows it in a topic, so that key, ROS 2 topic and topic of a recording are one name.
"""

from __future__ import annotations

import re

from schemas.errors import RobotError
from schemas.messages import TOPICS, Role

_CHUNK = re.compile(r"^[A-Za-z0-9][A-Za-z0-9._-]*")
_NOT_ROS = re.compile(r"[^A-Za-z0-9]+")  # nor underscores in a row, nor a digit in front (design.ros2.org, names)


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


def robot_key(robot: str) -> str:
    """`robot` as one chunk of a key: d3_1200 for d3-1200.

    Raises:
        RobotError: see `check_robot_name`.
    """
    chunk = _NOT_ROS.sub("_", check_robot_name(robot)).rstrip("_")
    return f"robot_{chunk}" if chunk[0].isdigit() else chunk


def topic_key(robot: str, topic: str) -> str:
    """Key of one of `schemas.messages.TOPICS`."""
    if topic not in TOPICS:
        raise KeyError(topic)
    return f"deltatwin/{robot_key(robot)}/{topic}"


def topic_name(robot: str, topic: str) -> str:
    """The same as a topic of ROS 2, in recordings and viewers."""
    return f"/{topic_key(robot, topic)}"


def liveliness_key(robot: str, role: Role) -> str:
    """Key of the liveliness token that `role` holds while it runs."""
    return f"deltatwin/{robot_key(robot)}/@/{role.name.lower()}"
