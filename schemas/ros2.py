"""How ROS 2 names and tells apart the messages of `schemas.messages`.

Source: REP 2011 and the rosidl type description (type hash RIHS01); rosbag2's metadata, version 8.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from typing import Any, NamedTuple

from schemas.messages import NESTED, Message, fields_of

METADATA_VERSION = 8  # the last in which no quality of service is an empty text
_NESTED_ID, _STRING_ID, _ARRAY = 1, 17, 48
_TYPE_IDS = {"uint8": 3, "int32": 6, "uint32": 7, "int64": 8, "uint64": 9, "float64": 11, "string": _STRING_ID}


class RosType(NamedTuple):
    """A message type. text: with what it depends on, as MCAP's `ros2msg`. type_hash: RIHS01."""

    name: str
    text: str
    type_hash: str


class BagTopic(NamedTuple):
    """A topic of a recording. type: ROS 2 name of its messages. messages: how many."""

    name: str
    type: str
    type_hash: str
    messages: int


def type_hash(message: Message) -> str:
    """RIHS01 hash of `message`, by which ROS 2 tells whether two programs mean the same by it."""
    full = {name: name.replace("/", "/msg/") for name in NESTED}
    inside: dict[str, dict[str, Any]] = {}

    def described(name: str, text: str) -> dict[str, Any]:
        fields = []
        for kind, field, count in fields_of(text):
            if kind in NESTED:
                inside[full[kind]] = described(full[kind], NESTED[kind])
            number = _NESTED_ID if kind in NESTED else _TYPE_IDS[kind]
            described_type = {
                "type_id": number + (_ARRAY if count else 0),
                "capacity": count,
                "string_capacity": 0,
                "nested_type_name": full.get(kind, ""),
            }
            fields.append({"name": field, "type": described_type})
        return {"type_name": name, "fields": fields}

    description = described(message.schema_name, message.text)
    text = json.dumps(
        {"type_description": description, "referenced_type_descriptions": [inside[name] for name in sorted(inside)]}
    )
    return f"RIHS01_{hashlib.sha256(text.encode()).hexdigest()}"


def ros_type(message: Message) -> RosType:
    """`message` as ROS 2 knows it."""
    return RosType(message.schema_name, message.schema_text, type_hash(message))


def bag_metadata(file: str, topics: Iterable[BagTopic], first_ns: int, last_ns: int) -> dict[str, str]:
    """The MCAP metadata record `rosbag2`: what rosbag2 would have in metadata.yaml (JSON is YAML).

    file: name of the recording. first_ns, last_ns: log times of its first and last message.
    """
    topics = list(topics)
    count, start = sum(topic.messages for topic in topics), {"nanoseconds_since_epoch": first_ns}
    span = {"nanoseconds": last_ns - first_ns}
    listed = [
        {
            "topic_metadata": {
                "name": topic.name,
                "type": topic.type,
                "serialization_format": "cdr",
                "offered_qos_profiles": "",
                "type_description_hash": topic.type_hash,
            },
            "message_count": topic.messages,
        }
        for topic in topics
    ]
    metadata = {
        "version": METADATA_VERSION,
        "storage_identifier": "mcap",
        "duration": span,
        "starting_time": start,
        "message_count": count,
        "topics_with_message_count": listed,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file],
        "files": [{"path": file, "starting_time": start, "duration": span, "message_count": count}],
        "custom_data": {},
        "ros_distro": "",
    }
    return {"serialized_metadata": json.dumps(metadata)}
