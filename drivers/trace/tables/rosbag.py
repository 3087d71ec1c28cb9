"""rosbag2, SQLite or MCAP: the joints of `sensor_msgs/JointState`, called `<joint>.position` and `<joint>.effort`.

Source: the ROS 2 message definition of sensor_msgs/msg/JointState; CDR as the OMG's XCDR1 has it.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from mcap.records import Message

from drivers.trace.mcap_messages import read_records, read_summary
from drivers.trace.tables import Table
from schemas.errors import StorageError, TraceError
from schemas.files import opened
from schemas.messages import NANOSECONDS, SAMPLE

JOINT_STATE = "sensor_msgs/msg/JointState"
UNITS = {"position": "rad", "velocity": "rad/s", "effort": "N m"}  # by the comment in the message definition
MAX_JOINTS = 64
MAX_NAME = 256  # characters


def parts_of(folder: Path) -> list[Path]:
    """The files of a rosbag2, in their order.

    Raises:
        TraceError: there are none.
    """
    parts = sorted([*folder.glob("*.db3"), *folder.glob("*.mcap")])
    if not parts:
        raise TraceError(f"{folder}: a folder without .db3 or .mcap, no rosbag2: name the logs in it")
    return parts


def read(path: Path) -> Table:
    """
    Raises:
        TraceError: not a rosbag2, none or several topics of joint states in it, or a message that is not whole.
    """
    parts = parts_of(path) if path.is_dir() else [path]
    stamps: list[int] = []
    rows: list[list[np.ndarray]] = []
    names: list[str] = []
    for part in parts:
        for number, message in enumerate(_messages(part), 1):
            try:
                stamp, names_here, values = _joint_state(message)
            except (struct.error, ValueError, UnicodeDecodeError) as error:
                raise TraceError(f"{part}: joint state {number} is not whole: {error}") from error
            names = names or names_here
            if names_here != names:
                raise TraceError(f"{part}: joint state {number} has joints {names_here}, the first has {names}")
            stamps.append(stamp)
            rows.append(values)
    if not stamps:
        raise TraceError(f"{path}: no message on its topic of joint states")
    kind = "rosbag2 of joint states"
    columns = {"time": (np.array(stamps, np.int64) - stamps[0]) / NANOSECONDS}
    units = {"time": "s"}
    for k, (field, unit) in enumerate(UNITS.items()):
        lengths = {len(row[k]) for row in rows}
        if lengths != {len(names)}:
            continue  # a field that is empty is not published
        block = np.array([row[k] for row in rows])
        for joint, name in enumerate(names):
            columns[f"{name}.{field}"] = np.ascontiguousarray(block[:, joint])
            units[f"{name}.{field}"] = unit
    return Table(path, kind, columns, units, epoch_ns=stamps[0])


def _messages(path: Path) -> Iterable[bytes]:
    return _from_mcap(path) if path.suffix == ".mcap" else _from_sqlite(path)


def _from_sqlite(path: Path) -> list[bytes]:
    opened(path, TraceError).close()
    address = f"{path.resolve().as_uri()}?mode=ro&immutable=1"
    try:
        with sqlite3.connect(address, uri=True) as bag:
            topics = bag.execute("SELECT id, name, type FROM topics").fetchall()
            topic = _one({name: kind for _, name, kind in topics}, path)
            (number,) = (number for number, name, _ in topics if name == topic)
            query = "SELECT data FROM messages WHERE topic_id = ? ORDER BY id"
            return [bytes(data) for (data,) in bag.execute(query, (number,))]
    except (sqlite3.Error, ValueError, TypeError) as error:
        raise TraceError(f"{path}: not a rosbag2 database: {error}") from error


def _from_mcap(path: Path) -> list[bytes]:
    try:
        with opened(path, TraceError) as stream:
            summary = read_summary(stream, path)
            if summary is None:
                raise TraceError(f"{path}: the MCAP summary is missing (its writer was killed?)")
            kinds = {
                channel.topic: summary.schemas[channel.schema_id].name
                for channel in summary.channels.values()
                if channel.schema_id in summary.schemas
            }
            if SAMPLE.schema_name in kinds.values():  # its joint states are for viewers, a few of many samples
                raise TraceError(f"{path}: a log of deltatwin already; every command reads it as it is")
            topic = _one(kinds, path)
            channels = {channel.id for channel in summary.channels.values() if channel.topic == topic}
            stream.seek(0)
            return [
                record.data
                for record in read_records(stream, path)
                if isinstance(record, Message) and record.channel_id in channels
            ]
    except StorageError as error:
        raise TraceError(str(error)) from error


def _one(kinds: dict[str, str], path: Path) -> str:
    """The one topic of joint states."""
    found = [topic for topic, kind in kinds.items() if kind in (JOINT_STATE, "sensor_msgs/JointState")]
    if len(found) == 1:
        return found[0]
    if found:
        raise TraceError(f"{path}: {len(found)} topics of {JOINT_STATE}: {', '.join(sorted(found))}; keep one")
    topics = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(kinds.items())) or "none"
    raise TraceError(f"{path}: no topic of {JOINT_STATE}; topics: {topics}")


def _joint_state(message: bytes) -> tuple[int, list[str], list[np.ndarray]]:
    """Stamp in ns, joint names, and position, velocity and effort of one message.

    Raises:
        ValueError, struct.error, UnicodeDecodeError: it is not such a message.
    """
    if len(message) < 12 or message[:2] not in (b"\x00\x00", b"\x00\x01"):
        raise ValueError("no CDR header")
    order = "<" if message[1] else ">"
    body, at = message[4:], 0

    def number() -> int:
        nonlocal at
        at = -(-at // 4) * 4
        (value,) = struct.unpack_from(f"{order}I", body, at)
        at += 4
        return value

    def text() -> str:
        nonlocal at
        length = number()
        if not 1 <= length <= MAX_NAME or at + length > len(body):
            raise ValueError(f"a name of {length} bytes")
        found = body[at : at + length - 1].decode("utf-8")
        at += length
        return found

    seconds, nanoseconds = number(), number()
    text()  # frame
    count = number()
    if count > MAX_JOINTS:
        raise ValueError(f"{count} joints, at most {MAX_JOINTS} are read")
    names = [text() for _ in range(count)]
    values = []
    for _ in UNITS:
        length = number()
        if length > MAX_JOINTS:
            raise ValueError(f"{length} values, at most {MAX_JOINTS} are read")
        if length:
            at = -(-at // 8) * 8
        if at + 8 * length > len(body):
            raise ValueError(f"it ends after {len(message)} bytes")
        values.append(np.frombuffer(body, f"{order}f8", length, at).astype(np.float64))
        at += 8 * length
    return seconds * NANOSECONDS + nanoseconds, names, values
