"""One message of joint states in protobuf (`foxglove.JointStates`) or JSON (that, or `sensor_msgs/JointState`).

Source: Foxglove's message schemas; protobuf's wire format, of which a message like this takes three kinds of fields.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from drivers.trace.tables.joint_state import MAX_BYTES, MAX_JOINTS, MAX_NAME, UNITS, JointState
from schemas.messages import NANOSECONDS

TYPE = "foxglove.JointStates"
NUMBERED = {2: "position", 3: "velocity", 5: "effort"}  # fields of a joint; 1 is its name, 4 its acceleration
VARINT, EIGHT, BYTES, FOUR = 0, 1, 2, 5  # kinds of fields
LONGEST = 10  # bytes of a whole number


def decode(message: bytes, encoding: str) -> JointState:
    """
    encoding: protobuf, or json.

    Raises:
        ValueError, struct.error, UnicodeDecodeError: it is not such a message.
    """
    if len(message) > MAX_BYTES:
        raise ValueError(f"{len(message)} bytes, at most {MAX_BYTES} are read")
    return _of_json(message) if encoding == "json" else _of_protobuf(message)


def _state(stamp: int, joints: list[dict[str, Any]]) -> JointState:
    """Of joints by name, position, velocity and effort; a field that none has is empty, as ROS leaves it."""
    names = [joint.get("name", "") for joint in joints]
    if len(names) > MAX_JOINTS or any(not isinstance(name, str) or len(name) > MAX_NAME for name in names):
        raise ValueError(f"{len(names)} joints, at most {MAX_JOINTS} are read, with names of {MAX_NAME} characters")
    if len(set(names)) < len(names):
        raise ValueError(f"a joint is named twice: {names}")
    values = []
    for field in UNITS:
        known = [joint.get(field) for joint in joints]
        numbers = [math.nan if value is None else float(value) for value in known]
        values.append(np.array(numbers if any(value is not None for value in known) else [], np.float64))
    return JointState(stamp, names, values)


def _of_json(message: bytes) -> JointState:
    try:
        document = json.loads(message)
        stamp = document.get("timestamp") or document.get("header", {}).get("stamp") or {}
        seconds = stamp.get("sec", stamp.get("secs", 0))
        rest = next((stamp[key] for key in ("nsec", "nanosec", "nsecs") if key in stamp), 0)
        joints = document.get("joints")
        if joints is None:  # as ROS has it: a list a field
            names = document["name"]
            fields = {field: document.get(field) or [None] * len(names) for field in UNITS}
            joints = [
                {"name": name} | {field: values[k] for field, values in fields.items()} for k, name in enumerate(names)
            ]
        return _state(int(seconds) * NANOSECONDS + int(rest), joints)
    except (AttributeError, KeyError, IndexError, TypeError, OverflowError, RecursionError) as error:
        raise ValueError(f"no joint states in it: {type(error).__name__} {error}") from error


def _of_protobuf(message: bytes) -> JointState:
    stamp, joints = 0, []
    for number, value in _fields(message):
        if number == 1 and isinstance(value, bytes):
            clock = {part: number for part, number in _fields(value) if isinstance(number, int)}
            stamp = clock.get(1, 0) * NANOSECONDS + clock.get(2, 0)
        elif number == 2 and isinstance(value, bytes):
            joint: dict[str, Any] = {}
            for part, inner in _fields(value):
                if part == 1 and isinstance(inner, bytes):
                    joint["name"] = inner.decode("utf-8")
                elif part in NUMBERED and isinstance(inner, float):
                    joint[NUMBERED[part]] = inner
            joints.append(joint)
            if len(joints) > MAX_JOINTS:
                raise ValueError(f"more than {MAX_JOINTS} joints")
    return _state(stamp, joints)


def _fields(message: bytes) -> Iterator[tuple[int, int | float | bytes]]:
    """Number and value of each field: a whole number, a float64, or bytes; one of four bytes is passed over."""
    at = 0

    def whole() -> int:
        nonlocal at
        value = 0
        for k in range(LONGEST):
            if at >= len(message):
                break
            value |= (message[at] & 0x7F) << 7 * k
            at += 1
            if message[at - 1] < 0x80:
                return value
        raise ValueError(f"it ends after {len(message)} bytes")

    while at < len(message):
        key = whole()
        kind = key & 7
        if kind == VARINT:
            yield key >> 3, whole()
        elif kind == EIGHT:
            yield key >> 3, struct.unpack_from("<d", message, at)[0]
            at += 8
        elif kind == BYTES:
            length = whole()
            if at + length > len(message):
                raise ValueError(f"a field of {length} bytes in {len(message)}")
            yield key >> 3, message[at : at + length]
            at += length
        elif kind == FOUR:
            at += 4
        else:
            raise ValueError(f"a field of kind {kind}")
