"""Messages: the `.msg` text is the definition; the NumPy dtypes, and so the wire and log bytes, are made from it.

A fixed-size ROS 2 message in little-endian CDR is a C struct behind the four bytes 00 01 00 00, every field aligned to
its own size counted from behind them. One structured dtype a message therefore serves as Zenoh payload, MCAP message
and array in memory. The one text in it, `frame_id` of the header, is empty: no joint has a frame.
"""

from __future__ import annotations

import enum
import re
from dataclasses import dataclass
from importlib import resources
from typing import NamedTuple

import numpy as np

from schemas.errors import MessageError

CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
NANOSECONDS = 1_000_000_000
SEQUENCE_BYTES = slice(20, 28)  # of every message, behind CDR and message header
NO_FRAME = b"\x01\x00\x00\x00\x00\x00\x00\x00"  # the empty text in CDR, and what aligns the sequence behind it

# What most sources do not have, and what a recording of an earlier version does not.
OPTIONAL = {"fourth_position", "random_std_dev", "common_std_dev", "position_offset"}
FARTHEST_AHEAD = 0.1  # rad, of any `position_offset`: gears that yield further are broken

_TIME, _HEADER = "builtin_interfaces/Time", "std_msgs/Header"
NESTED = {_HEADER: f"{_TIME} stamp\nstring frame_id\n", _TIME: "int32 sec\nuint32 nanosec\n"}
_PRIMITIVES = {
    "uint8": "u1", "int32": "<i4", "uint32": "<u4", "int64": "<i8", "uint64": "<u8", "float64": "<f8",
}  # fmt: skip
_FIELD = re.compile(r"^(?P<type>[\w/]+)(?:\[(?P<count>\d{1,6})\])?\s+(?P<name>[a-z]\w*)$")
_CONSTANT = re.compile(r"^\w+\s+[A-Z]\w*\s*=")


class SampleFlag(enum.IntFlag):
    """What is known to be wrong with a sample; set by drivers, carried through to every result."""

    NOT_A_NUMBER = 1  # a position or torque is missing or not finite
    OUT_OF_RANGE = 2  # a position no Delta joint can take (degrees for radians?) or no pose of this robot
    GAP_BEFORE = 4  # cycles are missing between this sample and the one before
    REPEATED = 8  # the stamp or the whole row is that of the sample before
    TIME_BACKWARDS = 16  # the stamp is below that of the sample before
    JUMP = 32  # the position moved further in one cycle than the joint can
    BUS_FAULT = 64  # working counter wrong or drive not in operation
    NO_COMMAND = 128  # no command came with the sample
    COMMAND_OUT_OF_RANGE = 256  # a commanded position outside the joint range or not finite: not followed
    COMMAND_JUMP = 512  # the command moved further in one cycle than the joint can: not differentiated
    LIMITED = 1024  # of a feed-forward: the torque or its slope was limited to its bound
    FADING = 2048  # of a feed-forward: no usable motion, the last torque fades to zero
    FRICTION_HELD = 4096  # of a feed-forward: the learnt friction in it is limited to its bound
    LOADED = 8192  # an unknown payload is carried: the torque is not the robot's own
    STATE_NEW = 16384  # of a result: the states of effects (gears, bristles) were reset and are uncertain for a while


class Gripper(enum.IntEnum):
    """State of the gripper in a sample."""

    UNKNOWN = 0  # no gripper signal
    OPEN = 1  # it holds nothing
    CLOSED = 2  # it may hold something


class FeedforwardSource(enum.IntEnum):
    """Where the motion behind a feed-forward torque came from."""

    ESTIMATE = 0  # measured position, Kalman filter
    COMMAND = 1  # commanded position in the sample
    REFERENCE = 2  # planned motion, one or more cycles ahead
    NONE = 3  # no usable motion: the torque is zero


class PayloadEvent(enum.IntEnum):
    """What happened to the payload at this sample."""

    NONE = 0
    PICK = 1
    RELEASE = 2


class Role(enum.IntEnum):
    """The sender of a message. There is one process of each role per robot."""

    PLAYER = 0
    ESTIMATOR = 1
    MONITOR = 2
    ROBOT = 3
    TAP = 4
    MASTER = 5
    OBSERVER = 6
    WATCH = 7

    @property
    def noun(self) -> str:
        """What a sentence calls its process."""
        return {Role.ROBOT: "simulated robot", Role.OBSERVER: "`view` or `top`"}.get(self, self.name.lower())


class WatchState(enum.IntEnum):
    """State of the watch."""

    LEARNING = 0  # the level is not known yet
    WATCHING = 1  # the gap is at its level
    RAISED = 2  # the gap is higher
    DIAGNOSING = 3  # the gap is higher, and a diagnosis is running
    NEW_MOTION = 4  # most of the motion is of a kind whose level is not known
    IDLE = 5  # too little motion


class FindingVerdict(enum.IntEnum):
    """Result of a diagnosis after the gap has risen."""

    EXPLAINED = 0  # the named effects explain the gap
    PARTLY_EXPLAINED = 1  # the named effects explain part of it
    UNEXPLAINED = 2  # no effect of the catalogue explains it, or the data cannot separate them
    WITHIN_NOISE = 3  # the gap is within the noise
    FAILED = 4  # the diagnosis failed


class HealthFlag(enum.IntFlag):
    """Present conditions of a role."""

    NO_REALTIME = 1  # SCHED_FIFO or memory locking was refused
    DISK_ERROR = 2  # the log cannot be written
    STALE_INPUT = 4  # no input for some cycles
    BUS_FAULT = 8  # working counter, lost cycles or drive state
    DUPLICATE_SOURCE = 16  # two senders on one key
    WRONG_DECLARATION = 32  # drives contradict the robot description
    STALE_FEEDFORWARD = 64  # the drives get no new feed-forward: it fades to zero or is zero
    FRICTION_DRIFT = 256  # friction has drifted from the identified value by more than the robot description allows
    COMMAND_REFUTED = 512  # the drives do not follow torque_command as identified: masses are estimated without it
    SCALE_DRIFT = 1024  # a torque constant has drifted by more than the robot description allows
    EFFECT_LEFT_OUT = 2048  # the description names an effect that the online model leaves out
    STOPPED = 128  # the last message of this role; `reason` says why it ended


class StopReason(enum.IntEnum):
    """Why a role ended, in its last health message."""

    RUNNING = 0  # the role has not ended
    DONE = 1  # its work is done
    INTERRUPTED = 2  # by Ctrl-C or SIGTERM
    BUS_FAULT = 3  # drives, working counter or link
    DISK_ERROR = 4
    ERROR = 5  # anything else, as its stderr says


@dataclass(frozen=True)
class Message:
    """One message type: its ROS 2 name, its text and the dtype of its CDR bytes (header included, as `cdr_header`)."""

    name: str
    text: str
    dtype: np.dtype

    @property
    def schema_name(self) -> str:
        return f"deltatwin_msgs/msg/{self.name}"

    @property
    def schema_text(self) -> str:
        """The text with the definitions it depends on, as an MCAP `ros2msg` schema holds it."""
        return self.text + "".join(f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in NESTED.items())

    def empty(self, count: int = 1) -> np.ndarray:
        """`count` records of zeros with the CDR header and no frame; `OPTIONAL` fields are NaN."""
        records = np.zeros(count, self.dtype)
        for name in OPTIONAL.intersection(self.dtype.names or ()):
            records[name] = np.nan
        records["cdr_header"] = np.frombuffer(CDR_LITTLE_ENDIAN, np.uint8)
        records["frame_id"] = np.frombuffer(NO_FRAME, np.uint8)
        return records

    def decode(self, payload: bytes | bytearray | memoryview) -> np.void:
        """One record viewing `payload`.

        Raises:
            MessageError: the size or the CDR header is not this message's.
        """
        if len(payload) != self.dtype.itemsize:
            raise MessageError(f"{self.name}: {len(payload)} bytes, expected {self.dtype.itemsize}")
        record = np.frombuffer(payload, self.dtype)[0]
        if bytes(record["cdr_header"]) != CDR_LITTLE_ENDIAN:
            raise MessageError(f"{self.name}: CDR header {bytes(record['cdr_header']).hex()}, expected 00010000")
        return record


class Field(NamedTuple):
    """A field of a message text. length: of a fixed array, 0 where it is none."""

    type: str
    name: str
    length: int


def fields_of(text: str) -> list[Field]:
    """The fields of a message text, without what it depends on; constants and comments are passed over.

    Raises:
        MessageError: a line that is neither.
    """
    fields = []
    for line in text.split("=" * 80, 1)[0].splitlines():
        declaration = line.split("#", 1)[0].strip()
        if not declaration or _CONSTANT.match(declaration):
            continue
        match = _FIELD.match(declaration)
        if match is None:
            raise MessageError(f"cannot read {declaration!r}")
        fields.append(Field(match["type"], match["name"], int(match["count"] or 0)))
    return fields


def dtype_of(text: str) -> np.dtype:
    """The dtype of the CDR bytes of a message text, header included, as `cdr_header`.

    Raises:
        MessageError: a line or a type that cannot be read.
    """
    names, formats, offsets = ["cdr_header"], ["(4,)u1"], [0]
    offset = 0  # CDR aligns from behind the header
    for kind, name, count in fields_of(text):
        if kind in NESTED:
            parts = [("stamp_sec", "<i4", 4, 4), ("stamp_nanosec", "<u4", 4, 4)]
            if kind == _HEADER:
                parts.append(("frame_id", "(8,)u1", 4, len(NO_FRAME)))
        elif kind not in _PRIMITIVES:
            raise MessageError(f"cannot read {kind!r}")
        else:
            code = _PRIMITIVES[kind]
            size = int(code[-1])
            parts = [(name, f"({count},){code}" if count else code, size, size * max(count, 1))]
        for field, code, alignment, size in parts:
            offset += -offset % alignment
            names.append(field)
            formats.append(code)
            offsets.append(4 + offset)
            offset += size
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": 4 + offset})


def _load(name: str) -> Message:
    text = (resources.files(__package__ or "schemas") / "msg" / f"{name}.msg").read_text(encoding="utf-8")
    return Message(name, text, dtype_of(text))


SAMPLE = _load("Sample")
REFERENCE = _load("Reference")
FEEDFORWARD = _load("Feedforward")
PAYLOAD = _load("Payload")
MODEL_ERROR = _load("ModelError")
FRICTION = _load("Friction")
HEALTH = _load("Health")
GAP = _load("Gap")
FINDING = _load("Finding")
JOINT_SAMPLE = _load("JointSample")
JOINT_REFERENCE = _load("JointReference")
JOINT_FEEDFORWARD = _load("JointFeedforward")
JOINT_ERROR = _load("JointError")
LOAD = _load("Load")
JOINT_GAP = _load("JointGap")
JOINT_FINDING = _load("JointFinding")
MOST_JOINTS: int = JOINT_SAMPLE.dtype["position"].shape[0]  # of an arm or of axes on the bus

TOPICS = {
    "sample": SAMPLE,
    "reference": REFERENCE,
    "feedforward": FEEDFORWARD,
    "payload": PAYLOAD,
    "error": MODEL_ERROR,
    "friction": FRICTION,
    "health": HEALTH,
    "gap": GAP,
    "finding": FINDING,
    "joint_sample": JOINT_SAMPLE,
    "joint_reference": JOINT_REFERENCE,
    "joint_feedforward": JOINT_FEEDFORWARD,
    "load": LOAD,
    "joint_error": JOINT_ERROR,
    "joint_gap": JOINT_GAP,
    "joint_finding": JOINT_FINDING,
}


class Topics(NamedTuple):
    """Names in TOPICS of what a robot's roles say of its joints; which they are depends on the kind of machine."""

    sample: str
    reference: str
    feedforward: str
    payload: str
    error: str
    gap: str
    finding: str


OF_DELTA = Topics("sample", "reference", "feedforward", "payload", "error", "gap", "finding")
OF_JOINTS = Topics(
    "joint_sample", "joint_reference", "joint_feedforward", "load", "joint_error", "joint_gap", "joint_finding"
)  # fmt: skip
SAMPLES = tuple(topics.sample for topics in (OF_DELTA, OF_JOINTS))


def topics_of(own: Topics) -> dict[str, Message]:
    """TOPICS of a robot whose kind of machine has `own`."""
    other = {topic for topics in (OF_DELTA, OF_JOINTS) if topics != own for topic in topics}
    return {topic: message for topic, message in TOPICS.items() if topic not in other}


def stamp_ns(records: np.ndarray | np.void) -> np.ndarray:
    """Bus time of `records` in nanoseconds, int64, shape of `records`."""
    return np.asarray(records["stamp_sec"], np.int64) * NANOSECONDS + np.asarray(records["stamp_nanosec"], np.int64)


def set_stamp(records: np.ndarray | np.void, time_ns: np.ndarray | int) -> None:
    """Write bus time, given in nanoseconds since the epoch of the bus."""
    records["stamp_sec"], records["stamp_nanosec"] = np.divmod(np.asarray(time_ns, np.int64), NANOSECONDS)
