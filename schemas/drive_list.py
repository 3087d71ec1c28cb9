"""A list of drives as a table: one row per joint, of gear, encoder and torque, as data sheets give them."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError, model_validator

from schemas.errors import RobotError
from schemas.files import read_bytes
from schemas.toml import Positive, TomlTable, explain

MAX_BYTES = 64 << 10  # a dozen drives have 1 kB


class ListedDrive(TomlTable):
    """One row."""

    joint: Annotated[int, Field(ge=1)]  # from 1
    gear_ratio: Positive  # motor turns per turn of the joint
    counts_per_turn: Positive | None = None  # encoder counts per motor turn, 0x608F
    sign: Literal[1, -1] = 1  # -1: the drive counts up while the joint turns back
    zero_counts: int = 0  # 0x6064 at joint angle 0
    rated_torque_nm: Positive | None = None  # of the motor, 0x6076; what 1000 per mille stand for, or:
    rated_current_a: Positive | None = None  # of the motor, rms
    torque_constant_nmpa: Positive | None = None  # N m per ampere rms, of the motor

    @model_validator(mode="after")
    def _torque(self) -> ListedDrive:
        by_current = [self.rated_current_a is not None, self.torque_constant_nmpa is not None]
        if any(by_current) and not all(by_current):
            raise ValueError("rated_current_a and torque_constant_nmpa must be given together")
        if self.rated_torque_nm is not None and any(by_current):
            raise ValueError("rated_torque_nm, or rated_current_a and torque_constant_nmpa: give one of the two")
        if self.on_bus and self.rated_torque_nm is None and not any(by_current):
            raise ValueError("counts_per_turn is given: rated_torque_nm or rated_current_a is missing")
        return self

    @property
    def scaling(self) -> list[str]:
        """Keys that are given and scale messages of a bus."""
        standard = type(self).model_fields
        return [key for key, value in self if key not in ("joint", "gear_ratio") and value != standard[key].default]

    @property
    def on_bus(self) -> bool:
        """Whether the scaling of its messages is given."""
        return self.counts_per_turn is not None


def read_drives(path: Path, count: int) -> list[ListedDrive]:
    """The drives of `count` joints, joint 1 first, from a CSV whose columns are the keys of `ListedDrive`.

    Raises:
        RobotError: naming file, row and key.
    """
    try:
        text = read_bytes(path, MAX_BYTES, RobotError).decode("utf-8-sig")
        reader = csv.DictReader(io.StringIO(text, newline=""))
        rows = [(reader.line_num, row) for row in reader]
    except (UnicodeDecodeError, csv.Error) as error:
        raise RobotError(f"{path}: not a text table: {error}") from error
    drives = {}
    for line, row in rows:
        drive = _drive(row, f"{path}: row {line}")
        if drive.joint in drives:
            raise RobotError(f"{path}: row {line}: joint: {drive.joint} has a row already")
        drives[drive.joint] = drive
    if sorted(drives) != list(range(1, count + 1)):
        there = ", ".join(map(str, sorted(drives))) or "none"
        raise RobotError(f"{path}: joint: rows for {there}; one row for each of 1 to {count} is needed")
    if len({drive.on_bus for drive in drives.values()}) > 1:
        raise RobotError(f"{path}: counts_per_turn: give it for all drives, or for none")
    return [drives[joint] for joint in sorted(drives)]


def _drive(row: dict[str | None, str], where: str) -> ListedDrive:
    if None in row:
        raise RobotError(f"{where}: more cells than the header has columns")
    given = {str(key).strip(): text.strip() for key, text in row.items() if text is not None and text.strip()}
    try:
        return ListedDrive.model_validate({key: _value(text) for key, text in given.items()}, strict=True)
    except ValidationError as error:
        raise RobotError(f"{where}: {explain(error)}") from error


def _value(text: str) -> int | float | str:
    """A cell as a number, where it is one."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
