"""Column mapping: how a foreign table's columns and units become joint-side SI.

It stands as `[columns]` in a robot description or in a TOML file of its own (`--columns FILE`, same keys, with or
without the `[columns]` heading). `Columns()` itself describes our own CSV. A channel is one table a joint, or one for
all joints with `{joint}` (1, 2, ...) in its name; a bare string is a name with every other key at its default:

    header_line = 1
    separator = ";"
    decimal = ","
    time = { name = "Zeit", unit = "ms" }
    position = { name = "A{joint} Ist", unit = "counts", counts_per_rev = 1048576, side = "motor", gear_ratio = 55 }
    torque = { name = "A{joint} M", unit = "permille", rated = 2.39, side = "motor", sign = -1, gear_ratio = 55 }
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from schemas.errors import TraceError
from schemas.toml import Positive, TomlTable, read_toml, validate
from schemas.units import CONSTANTS, LINEAR, POSITION_SCALES, SHARES, TIME_UNITS, TORQUE_SCALES

MAX_LINE = 10_000  # of the header; what exports put above it are some dozens
MAX_JOINTS = 64
MAX_COLUMNS = 4096  # of a table
_LISTED = Field(max_length=MAX_JOINTS)

FILETIME_S = 11_644_473_600  # from 1601, where Windows counts from, to 1970
RATES_HZ = 5.0, 2e5  # of logs that hold dynamics: below, a fast joint has moved on by a radian; above none is known


def implausible_rate(period: float) -> str | None:
    """What to say of a log whose rows are `period` s apart by its stamps; None where that is a log's rate."""
    if RATES_HZ[0] <= 1 / period <= RATES_HZ[1]:
        return None
    units = {unit: per_second / period for unit, per_second in TIME_UNITS.items() if unit in ("ms", "us", "ns")}
    fits = [f"{unit} ({rate:.6g} Hz)" for unit, rate in units.items() if RATES_HZ[0] <= rate <= RATES_HZ[1]]
    meant = f"; are they in {' or '.join(fits)}? Use deltatwin import, or set time.unit in its columns" if fits else ""
    return f"{1 / period:.6g} samples per second by its time stamps, read as s{meant}"


class TimeColumn(TomlTable):
    """The stamps. Where the name occurs several times, each channel has the nearest one to its left (TwinCAT Scope)."""

    name: str = "time_s"  # of the column
    # datetime: text such as 2026-11-22 09:30:00.125; filetime: 100 ns since 1601, as Windows and TwinCAT count
    unit: Literal["s", "ms", "us", "ns", "datetime", "filetime"] = "s"
    date: str | None = None  # column with the day, if `name` has the time of day only
    rate_hz: Positive | None = None  # of a table without stamps: its rows are 1/rate_hz s apart
    backwards: bool = False  # of such a table: its last row was the first

    @model_validator(mode="after")
    def _counted(self) -> TimeColumn:
        if self.backwards and self.rate_hz is None:
            raise ValueError(
                "backwards is only for a table without time stamps, with rate_hz: stamps give the order themselves"
            )
        if self.date is not None and self.unit != "datetime":
            raise ValueError(f"date {self.date!r} with unit {self.unit!r}: give it with 'datetime' only")
        return self


class _Channel(TomlTable):
    name: str  # of the column
    time: str | None = None  # name of this channel's own time column, same unit as `Columns.time`


class _JointChannel(_Channel):
    side: Literal["joint", "motor"] = "joint"  # motor: before the gear
    gear_ratio: Positive | None = None  # motor turns per joint turn; absent: `drive.gear_ratio` of the robot
    sign: Literal[1, -1] = 1  # -1: positive turns the active link up
    zero: float = 0.0  # reading, in the column's unit, where the joint's angle (or torque) is zero
    bits: Literal[8, 16, 32] | None = None  # width of a signed value that was recorded as unsigned
    times: str | None = None  # column by which the values are multiplied, such as a voltage for a duty cycle
    between: Literal["linear", "hold"] = "linear"  # value between two samples, if another channel gives the stamps


class PositionColumn(_JointChannel):
    """A joint position."""

    unit: Literal["rad", "mrad", "deg", "turns", "counts", "m", "cm", "mm", "um"] = "rad"  # of the column
    counts_per_rev: Positive | None = None  # encoder increments per turn of its shaft,
    counts_per_m: Positive | None = None  # or per metre of a linear axis

    @model_validator(mode="after")
    def _complete(self) -> PositionColumn:
        given = sum(count is not None for count in (self.counts_per_rev, self.counts_per_m))
        if given != (self.unit == "counts"):
            raise ValueError(
                f"unit {self.unit!r} with counts_per_rev {self.counts_per_rev}, counts_per_m {self.counts_per_m}: give "
                "one of them, with 'counts' only"
            )
        return self

    @property
    def linear(self) -> bool:
        """Whether it goes along a line."""
        return self.unit in LINEAR or self.counts_per_m is not None

    @property
    def scale(self) -> float:
        """Radians (or metres) per unit of the column, before the gear."""
        if self.counts_per_rev is not None:
            return POSITION_SCALES["turns"] / self.counts_per_rev
        if self.counts_per_m is not None:
            return 1 / self.counts_per_m
        return POSITION_SCALES[self.unit]


class TorqueColumn(_JointChannel):
    """A joint torque, or the force of a linear axis."""

    # of the column
    unit: Literal[
        "N m", "mN m", "N cm", "kN m", "lbf in", "lbf ft", "N", "mN", "kN", "permille", "percent", "V", "A", "mA"
    ] = "N m"
    rated: Positive | None = None  # permille, percent: rated torque of the drive, N m (or rated force, N)
    constant: Positive | None = None  # V, A: N m (or N) per volt or ampere

    @model_validator(mode="after")
    def _complete(self) -> TorqueColumn:
        if (self.unit in SHARES) != (self.rated is not None):
            raise ValueError(f"unit {self.unit!r} with rated {self.rated}: give it with 'permille' or 'percent' only")
        if (self.unit in CONSTANTS) != (self.constant is not None):
            raise ValueError(f"unit {self.unit!r} with constant {self.constant}: give it with 'V', 'A' or 'mA' only")
        return self

    @property
    def scale(self) -> float:
        """N m (or N) per unit of the column, before the gear."""
        if self.rated is not None:
            return self.rated / SHARES[self.unit]
        return TORQUE_SCALES[self.unit] * (self.constant or 1.0)


class RowFilter(TomlTable):
    """Rows to use: those with the value `equals` in the column `name`, or with any value except `unlike` if that is
    given. The other rows are left out, and their number is reported."""

    name: str  # of the column
    equals: float = 1.0  # value of rows to use
    unlike: float | None = None  # value of rows to leave out

    @model_validator(mode="after")
    def _one(self) -> RowFilter:
        if self.unlike is not None and "equals" in self.model_fields_set:
            raise ValueError(f"equals {self.equals:g} and unlike {self.unlike:g}: give one of them")
        return self

    @property
    def left_out(self) -> str:
        """What is said of rows that do not count."""
        return f"do not have {self.equals:g}" if self.unlike is None else f"have {self.unlike:g}"

    def counts(self, values: np.ndarray) -> np.ndarray:
        """Which rows of the column, (N,), count."""
        return values == self.equals if self.unlike is None else values != self.unlike


class GripperColumn(_Channel):
    """The state of the gripper: `open` where it holds nothing, any other number where it is closed."""

    open: float = 0.0  # value when it is open
    between: Literal["hold"] = "hold"  # value between two samples


def _table(value: Any) -> Any:
    return {"name": value} if isinstance(value, str) else value


def _tables(value: Any) -> Any:
    return [_table(v) for v in value] if isinstance(value, list) else [_table(value)]


_Position = Annotated[list[PositionColumn], _LISTED, BeforeValidator(_tables)]
_Torque = Annotated[list[TorqueColumn], _LISTED, BeforeValidator(_tables)]


def _text_encoding(name: str) -> str:
    """Raises ValueError: Python knows no such encoding of text."""
    try:
        b"".decode(name)
    except (LookupError, UnicodeError) as error:
        raise ValueError(str(error)) from error
    return name


class Columns(TomlTable):
    """A table's layout and the meaning of its columns. Defaults: our own CSV. Lines count from 1, as editors do."""

    # between two columns
    separator: Annotated[str, Field(pattern=r"^[\t !#$%&*,/:;<=>?@^_|~]$")] = ","
    decimal: Literal[".", ","] = "."  # mark in numbers
    thousands: Literal[".", ",", " ", "'"] | None = None  # mark between groups of three digits
    encoding: Annotated[str, AfterValidator(_text_encoding)] = "utf-8"  # of the text
    header_line: Annotated[int, Field(ge=0, le=MAX_LINE)] = 1  # 0: no header, columns are called 1, 2, ...
    data_line: Annotated[int, Field(ge=1, le=MAX_LINE)] | None = (
        None  # first line of numbers; absent: the one after the header
    )
    beside: Annotated[list[str], _LISTED] = []  # files in the same folder whose columns continue the rows
    topic: str | None = None  # topic of the joint states, for a bag with several
    where: Annotated[RowFilter | None, BeforeValidator(_table)] = None
    joints: Annotated[int, Field(ge=1, le=MAX_JOINTS)] = 3  # number of joints for `{joint}`
    time: Annotated[TimeColumn, BeforeValidator(_table)] = TimeColumn()
    position: _Position = [PositionColumn(name="position_{joint}_rad")]
    torque: _Torque = [TorqueColumn(name="torque_{joint}_nm")]
    position_command: _Position = [PositionColumn(name="position_command_{joint}_rad")]
    torque_command: _Torque = [TorqueColumn(name="torque_command_{joint}_nm")]
    fourth_position: Annotated[PositionColumn | None, BeforeValidator(_table)] = PositionColumn(name="position_4_rad")
    gripper: Annotated[GripperColumn | None, BeforeValidator(_table)] = GripperColumn(name="gripper")

    @model_validator(mode="after")
    def _consistent(self) -> Columns:
        if self.decimal == self.separator:
            raise ValueError(f"decimal {self.decimal!r} is also the separator")
        if self.thousands in (self.decimal, self.separator):
            raise ValueError(f"thousands {self.thousands!r} is also the decimal mark or the separator")
        if self.data_line is not None and self.data_line <= self.header_line:
            raise ValueError(f"data_line {self.data_line} is not behind header_line {self.header_line}")
        places: dict[str, str] = {}
        for role in CHANNELS:
            for joint, entry in enumerate(self.channel(role), start=1):
                place = f"{role} of joint {joint}"
                if entry.name in places:
                    raise ValueError(f"column {entry.name!r} is named twice: {places[entry.name]} and {place}")
                places[entry.name] = place
        counts = {name: len(self.channel(name)) for name in CHANNELS if self.channel(name)}
        if len({*counts.values()}) > 1 or not (self.position and self.torque):
            raise ValueError(f"as many position as torque columns are needed, commands as many or none: {counts}")
        return self

    @property
    def first_line(self) -> int:
        """Line of the first row of numbers."""
        return self.data_line or self.header_line + 1

    def channel(self, name: str) -> list[PositionColumn] | list[TorqueColumn]:
        """The columns of one of `CHANNELS`, one a joint; empty where the mapping has none."""
        if name.endswith("command") and self._is_foreign(name):
            return []
        entries = getattr(self, name)
        if len(entries) != 1 or "{joint}" not in entries[0].name:
            return entries
        return [
            entries[0].model_copy(update={"name": entries[0].name.replace("{joint}", str(j + 1))})
            for j in range(self.joints)
        ]

    def extra(self, name: str) -> PositionColumn | GripperColumn | None:
        """The column of one of `EXTRAS`; None where the mapping has none."""
        return None if self._is_foreign(name) else getattr(self, name)

    def _is_foreign(self, name: str) -> bool:
        """Whether an optional channel is not meant: a foreign table has those that it says it has."""
        return name not in self.model_fields_set and "position" in self.model_fields_set


CHANNELS = ("position", "torque", "position_command", "torque_command")
EXTRAS = ("fourth_position", "gripper")  # of the robot, not of a joint


def load_columns(path: str | Path) -> Columns:
    """Read a mapping file.

    Raises:
        TraceError: naming file, key and value of the first thing that is wrong.
    """
    path = Path(path)
    values = read_toml(path, TraceError)
    return validate(Columns, values.get("columns", values), path, TraceError)
