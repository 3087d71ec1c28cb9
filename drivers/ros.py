"""A role of ours as a node of ROS 2 on Zenoh (rmw_zenoh): its keys, liveliness tokens and attachments.

Source: rmw_zenoh's design.md, liveliness_utils.cpp and attachment_helpers.cpp, as of Jazzy.
"""

from __future__ import annotations

import hashlib
import itertools
import struct
import time
from collections.abc import Callable

import zenoh

from schemas.messages import TOPICS, Role
from schemas.ros2 import type_hash
from schemas.zenoh_keys import robot_key, topic_name

ROUTER = "tcp/127.0.0.1:7447"  # where `ros2 run rmw_zenoh_cpp rmw_zenohd` listens
NOTE = "uses ROS 2 topics on loopback: any process on this host can send as any role"
QUALITY = "::,10:,:,:,,"  # reliable, volatile, the last ten: the default of ROS 2
PUBLISHES, SUBSCRIBES = "MP", "MS"
_ATTACHMENT = struct.Struct("<qqB16s")  # sequence, ns since 1970, length of the identity, identity of the publisher


def ros_key(domain: int, robot: str, topic: str) -> str:
    """Key of one of `schemas.messages.TOPICS` in ROS domain `domain`."""
    return f"{domain}{topic_name(robot, topic)}/{_type(topic)}"


class RosNode:
    """What one role of `robot` tells the ROS 2 graph through `session`; it is told until the session closes."""

    def __init__(self, session: zenoh.Session, domain: int, robot: str, role: Role) -> None:
        self._liveliness, self._robot, self._domain = session.liveliness(), robot, domain
        self._zid = session.info.zid()
        self._place = f"%/%deltatwin%{robot_key(robot)}/{role.name.lower()}"  # enclave, namespace and name
        self._numbers = itertools.count()
        self._tokens: list[zenoh.LivelinessToken] = []
        self._declare("NN", "")

    def key(self, topic: str) -> str:
        """See `ros_key`."""
        return ros_key(self._domain, self._robot, topic)

    def subscribes(self, topic: str) -> None:
        """Declare a subscription."""
        self._declare(SUBSCRIBES, self._about(topic))

    def publishes(self, topic: str) -> Callable[[], bytes]:
        """Declare a publisher. Returns what makes the attachment of each of its messages."""
        token = self._declare(PUBLISHES, self._about(topic))
        identity = hashlib.blake2s(token.encode(), digest_size=16).digest()  # theirs is another hash; it has to be one
        count = itertools.count(1)
        return lambda: _ATTACHMENT.pack(next(count), time.time_ns(), len(identity), identity)

    def _about(self, topic: str) -> str:
        return f"/{topic_name(self._robot, topic).replace('/', '%')}/{_type(topic)}/{QUALITY}"

    def _declare(self, kind: str, about: str) -> str:
        token = f"@ros2_lv/{self._domain}/{self._zid}/0/{next(self._numbers)}/{kind}/{self._place}{about}"
        self._tokens.append(self._liveliness.declare_token(token))
        return token


def _type(topic: str) -> str:
    message = TOPICS[topic]
    return f"deltatwin_msgs::msg::dds_::{message.name}_/{type_hash(message)}"
