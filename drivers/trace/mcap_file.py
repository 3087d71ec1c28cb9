"""MCAP traces: `/deltatwin/<robot>/sample` messages, CDR bytes as they are."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import IO

import numpy as np
from mcap.records import Channel, Schema

from drivers.trace.bag import BagWriter
from drivers.trace.mcap_messages import Wanted, read_messages, read_summary
from drivers.trace.quality import EXACT_SECONDS, RowNames, check
from schemas.axes_description import Description
from schemas.errors import MessageError, StorageError, TraceError
from schemas.files import opened
from schemas.messages import (
    CDR_LITTLE_ENDIAN,
    NANOSECONDS,
    OF_DELTA,
    SAMPLES,
    TOPICS,
    Message,
    dtype_of,
    stamp_ns,
)
from schemas.ros2 import ros_type
from schemas.trace import UNNAMED, Finding, Trace
from schemas.zenoh_keys import robot_key, topic_name

_SAMPLE_TOPIC = re.compile(rf"^/?deltatwin/(?P<robot>[^/]+)/({'|'.join(SAMPLES)})$")  # the slash came later
_MEASURED = {"stamp_sec", "sequence", "position", "torque", "flags"}
SHOW_EVERY = 10_000  # samples


def read_mcap(path: Path, robot: Description | None = None) -> Trace:
    """The samples of an MCAP file in the order they were written, which shows what a sort by time would hide.

    Raises:
        TraceError: not a whole MCAP file, no samples, samples of several robots and not of `robot`, foreign messages.
    """
    try:
        with opened(path, TraceError) as stream:
            samples = read_samples(stream, path, robot)
    except OSError as error:
        raise TraceError(f"{path}: {error.strerror}") from error
    trace = check(to_trace(samples, path), RowNames("message", np.arange(1, len(samples) + 1)), robot)
    return replace(trace, findings=(*_of_another(path, robot), *trace.findings))


def _of_another(path: Path, robot: Description | None) -> list[Finding]:
    """A note where the one robot of a file has another name than the description."""
    names = (robots_and_start(path) or ([], 0))[0]
    if robot is None or names == [UNNAMED] or robot_key(robot.name) in map(robot_key, names):
        return []
    return [Finding.note(f"recorded from {name}, read as {robot.name}") for name in names]


def robots_and_start(path: Path) -> tuple[list[str], int] | None:
    """Names of the robots whose samples an MCAP file has, and the log time of its first message, ns since 1970; None
    where its summary does not say, for a reason that is told by who reads it."""
    try:
        with opened(path, TraceError) as stream:
            summary = read_summary(stream, path)
    except (StorageError, TraceError, OSError):
        return None
    if summary is None:
        return None
    names = {m["robot"] for c in summary.channels.values() if (m := _SAMPLE_TOPIC.match(c.topic))}
    return sorted(names), summary.statistics.message_start_time if summary.statistics else 0


def read_samples(stream: IO[bytes], path: Path, robot: Description | None = None) -> np.ndarray:
    """(N,) records of SAMPLE, or of JOINT_SAMPLE, as they stand in the file `path`, opened as `stream`.

    Raises:
        TraceError: see `read_mcap`.
    """
    try:
        summary = read_summary(stream, path)
        if summary is None:
            raise TraceError(f"{path}: the MCAP summary is missing (its writer was killed?): {_remedy(path)}")
        topic, dtype, message = _sample_topic(summary.channels, summary.schemas, path, robot)
        ids = [channel.id for channel in summary.channels.values() if channel.topic == topic]
        ((data, _),) = read_messages(stream, path, [Wanted(topic, ids, dtype.itemsize)])
    except MessageError as error:
        raise TraceError(str(error)) from error
    except StorageError as error:
        raise TraceError(f"{error} (not a whole MCAP file); a killed writer's log: {_remedy(path)}") from error
    if len(data) == 0:
        raise TraceError(f"{path}: no messages on {topic}")
    samples = data.reshape(-1).view(dtype)
    foreign = np.flatnonzero((samples["cdr_header"] != np.frombuffer(CDR_LITTLE_ENDIAN, np.uint8)).any(axis=1))
    if len(foreign):
        header = bytes(samples["cdr_header"][foreign[0]]).hex()
        raise TraceError(f"{path}: message {foreign[0] + 1} on {topic} has CDR header {header}, expected 00010000")
    if dtype == message.dtype:
        return samples
    current = message.empty(len(samples))
    for name in dtype.names or ():
        current[name] = samples[name]
    return current


def _remedy(path: Path) -> str:
    return f"deltatwin recover {path} {path.stem}-whole.mcap"


def _sample_topic(
    channels: dict[int, Channel], schemas: dict[int, Schema], path: Path, robot: Description | None
) -> tuple[str, np.dtype, Message]:
    """The topic of the samples, the dtype that they were written with, and which message it is today."""
    found = {m["robot"]: c for c in channels.values() if (m := _SAMPLE_TOPIC.match(c.topic))}
    if not found:
        topics = ", ".join(sorted(c.topic for c in channels.values())) or "none"
        hint = "; a foreign bag: deltatwin import" if schemas else ""
        raise TraceError(f"{path}: no /deltatwin/<robot>/sample topic (topics: {topics}){hint}")
    names = [name for name in found if robot and robot_key(name) == robot_key(robot.name)]
    if len(found) > 1 and not names:
        raise TraceError(f"{path}: samples of several robots ({', '.join(sorted(found))}): give --robot")
    channel = found[names[0]] if names else next(iter(found.values()))
    schema = schemas.get(channel.schema_id)
    text = schema.data.decode("utf-8", "replace") if schema else ""
    message = TOPICS[channel.topic.rsplit("/", 1)[-1]]
    dtype = _written_with(text, message) if channel.message_encoding == "cdr" else None
    if dtype is None:
        name = schema.name if schema else "none"
        raise TraceError(
            f"{path}: {channel.topic} holds {channel.message_encoding!r} messages of schema {name}, which is not "
            f"{message.schema_name} in cdr of this version or one before"
        )
    return channel.topic, dtype, message


def _written_with(text: str, message: Message) -> np.dtype | None:
    """The dtype of a version of `message`: fields that it has today, the measured ones among them; None of others.

    Comments and constants may differ, and fields that came later may be missing.
    """
    try:
        dtype = dtype_of(text)
    except MessageError:
        return None
    fields, ours = dtype.fields or {}, message.dtype.fields or {}
    known = all(name in ours and ours[name][0] == fields[name][0] for name in fields)
    return dtype if known and fields.keys() >= _MEASURED else None


def to_trace(samples: np.ndarray, path: Path) -> Trace:
    """Records of SAMPLE or JOINT_SAMPLE as a trace with the flags they came with, unchecked.

    Raises:
        TraceError: records of several numbers of joints.
    """
    stamps, names = stamp_ns(samples), samples.dtype.names or ()
    joints = np.unique(samples["joints"]) if "joints" in names else np.array([3])
    if len(joints) > 1 or not 0 < joints[0] <= samples["position"].shape[1]:
        raise TraceError(f"{path}: samples of {', '.join(map(str, joints))} joints: the number must not change")
    of_joints = slice(int(joints[0]))
    epoch = int(stamps[0]) if np.abs(stamps).max() > EXACT_SECONDS * NANOSECONDS else 0
    commands = {}
    for name in ("position_command", "torque_command"):
        command = np.ascontiguousarray(samples[name][:, of_joints])
        commands[name] = None if np.isnan(command).all() else command
    gripper = samples["gripper"].astype(np.uint32)
    angle = np.ascontiguousarray(samples["fourth_position"]) if "fourth_position" in names else np.array(np.nan)
    return Trace(
        path=path,
        time=(stamps - epoch) / NANOSECONDS,
        position=np.ascontiguousarray(samples["position"][:, of_joints]),
        torque=np.ascontiguousarray(samples["torque"][:, of_joints]),
        fourth_position=None if np.isnan(angle).all() else angle,
        gripper=gripper if gripper.any() else None,
        flags=samples["flags"].astype(np.uint32),
        sequence=samples["sequence"].astype(np.uint64),
        epoch_ns=epoch,
        **commands,
    )


def write_samples(
    blocks: Iterable[np.ndarray],
    path: Path,
    robot: str,
    source: Path,
    show: Callable[[int], object] = lambda done: None,
    called: str = OF_DELTA.sample,
) -> int:
    """Write blocks of SAMPLE records, read from `source`, as messages of `robot`; how many. called: their topic, for
    records of JOINT_SAMPLE that of these.

    Raises:
        TraceError: stamps before zero.
        OSError: the file cannot be written.
    """
    done = 0
    with path.open("wb") as stream:
        topic = topic_name(robot, called)
        bag = BagWriter(stream, path, {topic: ros_type(TOPICS[called])})
        for samples in blocks:
            stamps = stamp_ns(samples)
            if stamps.min() < 0:
                raise TraceError(f"{source}: time {stamps.min() / NANOSECONDS} s is below zero, MCAP stamps cannot be")
            for part in range(0, len(samples), SHOW_EVERY):
                show(done + part)
                rows = slice(part, part + SHOW_EVERY)
                bag.add(topic, samples[rows], stamps[rows], stamps[rows])
            done += len(samples)
        bag.finish()
    return done
