"""Trace: a recorded motion in memory, joint side, SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from schemas.errors import TraceError, printable
from schemas.messages import JOINT_SAMPLE, MOST_JOINTS, NANOSECONDS, SAMPLE, Message, SampleFlag, set_stamp

UNNAMED = "robot"  # in the topic of a log whose robot nobody named


@dataclass(frozen=True)
class Finding:
    """Something to know about the data: what, on which rows of the trace (from 0), and evidence with file lines.

    flag: the bit set on those rows; no bit where something is only to be known (a channel was interpolated).
    """

    flag: SampleFlag
    message: str
    rows: np.ndarray

    def __post_init__(self) -> None:
        object.__setattr__(self, "message", printable(self.message))

    @classmethod
    def note(cls, message: str) -> Finding:
        """Something only to be known."""
        return cls(SampleFlag(0), message, np.zeros(0, np.intp))


@dataclass(frozen=True)
class Trace:
    """N samples of n joints as they were recorded, nothing repaired.

    time: (N,) s, as in the file. position, torque: (N, n) rad and N m. position_command, torque_command: (N, n) or
    None where the source has none. fourth_position: (N,) rad, the angle of the gripper's axis, and gripper: (N,)
    of Gripper, or None. flags: (N,) uint32 of SampleFlag. findings: what the reader noticed.
    sequence: (N,) uint64 where the source counts its cycles, else None. epoch_ns: bus time of `time` 0, in ns; not
    zero only where the stamps are too large for float64 seconds to tell nanoseconds (above 1e6 s). own_time: (M,) s,
    the stamps of the channels (`torque_3`) that were brought to `time` from their own. angular: False where the axes
    are linear, in m and N.
    """

    path: Path
    time: np.ndarray
    position: np.ndarray
    torque: np.ndarray
    position_command: np.ndarray | None = None
    torque_command: np.ndarray | None = None
    fourth_position: np.ndarray | None = None
    gripper: np.ndarray | None = None
    flags: np.ndarray = field(default_factory=lambda: np.zeros(0, np.uint32))
    findings: tuple[Finding, ...] = ()
    sequence: np.ndarray | None = None
    epoch_ns: int = 0
    own_time: Mapping[str, np.ndarray] = field(default_factory=dict)
    angular: bool = True

    def __post_init__(self) -> None:
        if len(self.flags) == 0:
            object.__setattr__(self, "flags", np.zeros(len(self.time), np.uint32))

    def __len__(self) -> int:
        return len(self.time)

    @property
    def name(self) -> str:
        """File name without its ending."""
        return Path(self.path.name.removesuffix(".gz")).stem

    @property
    def period(self) -> float:
        """Median sample time, s."""
        return float(np.median(np.diff(self.time)))

    @property
    def time_ns(self) -> np.ndarray:
        """(N,) int64 bus time, ns."""
        seconds = np.floor(self.time)
        fraction = np.rint((self.time - seconds) * NANOSECONDS).astype(np.int64)
        return seconds.astype(np.int64) * NANOSECONDS + fraction + self.epoch_ns

    def samples(self, message: Message = SAMPLE) -> np.ndarray:
        """The trace as (N,) records of SAMPLE or JOINT_SAMPLE; sequence as recorded, else rows from 0.

        Raises:
            TraceError: the trace has not three joints, or more than the message holds.
        """
        joints = self.position.shape[1]
        if message is SAMPLE and joints != 3:
            raise TraceError(f"{self.path}: {joints} joints, a sample message holds 3")
        if joints > MOST_JOINTS:
            raise TraceError(f"{self.path}: {joints} joints, a sample message holds {MOST_JOINTS} at most")
        records = message.empty(len(self))
        set_stamp(records, self.time_ns)
        records["sequence"] = np.arange(len(self), dtype=np.uint64) if self.sequence is None else self.sequence
        for name in ("position", "torque", "position_command", "torque_command"):
            values = getattr(self, name)
            records[name][:, :joints] = np.nan if values is None else values
        if message is JOINT_SAMPLE:
            records["joints"] = joints
        if self.fourth_position is not None:
            records["fourth_position"] = self.fourth_position
        if self.gripper is not None:
            records["gripper"] = self.gripper
        records["flags"] = self.flags
        return records
