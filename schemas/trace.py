"""Trace: a recorded motion in memory, joint side, SI."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from schemas.messages import SAMPLE, SampleFlag, set_stamp


@dataclass(frozen=True)
class Finding:
    """Something wrong with the data: what, on which rows (0-based data rows), and one row's value as evidence."""

    flag: SampleFlag
    message: str
    rows: np.ndarray


@dataclass(frozen=True)
class Trace:
    """N samples of n joints as they were recorded, nothing repaired.

    time: (N,) s, as in the file. position, torque: (N, n) rad and N m. position_command, torque_command: (N, n) or
    None where the source has none. flags: (N,) uint32 of SampleFlag. findings: what the reader noticed.
    """

    path: Path
    time: np.ndarray
    position: np.ndarray
    torque: np.ndarray
    position_command: np.ndarray | None = None
    torque_command: np.ndarray | None = None
    flags: np.ndarray = field(default_factory=lambda: np.zeros(0, np.uint32))
    findings: tuple[Finding, ...] = ()

    def __len__(self) -> int:
        return len(self.time)

    @property
    def name(self) -> str:
        """File name without its endings."""
        return self.path.name.split(".")[0]

    @property
    def period(self) -> float:
        """Median sample time, s."""
        return float(np.median(np.diff(self.time)))

    def samples(self) -> np.ndarray:
        """The trace as (N,) records of `schemas.messages.SAMPLE`; sequence counts rows from 0."""
        records = SAMPLE.empty(len(self))
        set_stamp(records, np.rint(self.time * 1e9).astype(np.int64))
        records["sequence"] = np.arange(len(self), dtype=np.uint64)
        records["position"] = self.position
        records["torque"] = self.torque
        records["position_command"] = np.nan if self.position_command is None else self.position_command
        records["torque_command"] = np.nan if self.torque_command is None else self.torque_command
        records["flags"] = self.flags
        return records
