"""One message of joint states, as ROS 2 or ROS 1 wrote it.

Source: the message definition of sensor_msgs/JointState; CDR as the OMG's XCDR1 has it; ROS 1 serialisation as in its
wiki: little-endian, nothing aligned, texts by their length.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
import zstandard

from schemas.messages import NANOSECONDS

TYPES = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")
UNITS = {"position": "rad", "velocity": "rad/s", "effort": "N m"}  # by the comment in the message definition
MAX_JOINTS = 64
MAX_NAME = 256  # characters
MAX_BYTES = 1 << 17  # of a message of so many joints with such names
ZSTD = b"\x28\xb5\x2f\xfd"  # rosbag2 with compression_mode MESSAGE; no CDR begins so


class JointState(NamedTuple):
    """stamp: ns. names: of the joints. values: position, velocity and effort, (n,) each or empty."""

    stamp: int
    names: list[str]
    values: list[np.ndarray]


def decode(message: bytes, encoding: str) -> JointState:
    """
    encoding: cdr, or ros1.

    Raises:
        ValueError, struct.error, UnicodeDecodeError: it is not such a message.
    """
    if message[:4] == ZSTD:
        message = _unpacked(message)
    if len(message) > MAX_BYTES:
        raise ValueError(f"{len(message)} bytes, at most {MAX_BYTES} are read")
    if encoding == "ros1":
        return _fields(message[4:], "<", ros1=True)  # behind the header's sequence number
    if len(message) < 12 or message[:2] not in (b"\x00\x00", b"\x00\x01"):
        raise ValueError("no CDR header")
    return _fields(message[4:], "<" if message[1] else ">", ros1=False)


def _unpacked(message: bytes) -> bytes:
    try:
        with zstandard.ZstdDecompressor().stream_reader(message) as reader:
            return reader.read(MAX_BYTES + 1)
    except zstandard.ZstdError as error:
        raise ValueError(f"damaged compression: {error}") from error


def _fields(body: bytes, order: str, ros1: bool) -> JointState:
    """ros1: without gaps, and without a zero behind a text."""
    at, end = 0, 0 if ros1 else 1

    def aligned(size: int) -> int:
        return at if ros1 else -(-at // size) * size

    def number() -> int:
        nonlocal at
        at = aligned(4)
        (value,) = struct.unpack_from(f"{order}I", body, at)
        at += 4
        return value

    def text() -> str:
        nonlocal at
        length = number()
        if not end <= length <= MAX_NAME or at + length > len(body):
            raise ValueError(f"a name of {length} bytes")
        found = body[at : at + length - end].decode("utf-8")
        at += length
        return found

    seconds, nanoseconds = number(), number()
    text()  # frame
    count = number()
    if count > MAX_JOINTS:
        raise ValueError(f"{count} joints, at most {MAX_JOINTS} are read")
    names = [text() for _ in range(count)]
    if len(set(names)) < count:
        raise ValueError(f"a joint is named twice: {names}")
    values = []
    for _ in UNITS:
        length = number()
        if length > MAX_JOINTS:
            raise ValueError(f"{length} values, at most {MAX_JOINTS} are read")
        if length:
            at = aligned(8)
        if at + 8 * length > len(body):
            raise ValueError(f"it ends after {len(body)} bytes")
        values.append(np.frombuffer(body, f"{order}f8", length, at).astype(np.float64))
        at += 8 * length
    return JointState(seconds * NANOSECONDS + nanoseconds, names, values)
