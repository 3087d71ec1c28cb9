"""Columns of a table, whatever file they stood in, as a trace: what `schemas.columns` says of them is done here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.data_frames import pl
from drivers.trace.quality import RowNames, check
from schemas.axes_description import Description
from schemas.columns import CHANNELS, EXTRAS, TIME_UNITS, Columns, GripperColumn, PositionColumn, TorqueColumn
from schemas.errors import TraceError
from schemas.messages import Gripper
from schemas.trace import Finding, Trace
from schemas.words import counted

COUNTED = -1  # index of the stamps where the table has none and `time.rate_hz` says how far apart its rows are
STAYS = 3  # rows that a reading is off by its width until it is taken for wrapped, not for a glitch
ON_ONE_ROW = 0.1  # of the rows of two columns, on which both hold values: fewer, and they are of two topics
FOURTH = 3  # number of the joint behind the three of a Delta
MOST_NAMED = 20  # columns of a file listed in a message


@dataclass(frozen=True)
class Channel:
    """One column of the table and where it goes. times_index: of the column it is multiplied with."""

    name: str  # of CHANNELS or EXTRAS
    joint: int
    column: PositionColumn | TorqueColumn | GripperColumn
    index: int
    time_index: int
    times_index: int | None = None

    @property
    def label(self) -> str:
        """As messages call it."""
        return f"{self.name}_{self.joint + 1} ({self.column.name!r})" if self.name in CHANNELS else self.column.name


@dataclass(frozen=True)
class Plan:
    """Which columns of a table are needed. where: index of the column that says which rows count, if there is one."""

    channels: tuple[Channel, ...]
    where: int | None

    @property
    def times(self) -> list[int]:
        """Indices of the columns of stamps."""
        return sorted({channel.time_index for channel in self.channels} - {COUNTED})

    @property
    def values(self) -> list[int]:
        """Indices of the columns of numbers that are no stamps."""
        wanted = {c.index for c in self.channels} | {c.times_index for c in self.channels} | {self.where}
        return sorted({index for index in wanted if index is not None} - set(self.times))


def plan(names: Sequence[str], columns: Columns, path: Path) -> Plan:
    """What of a table with columns `names` is needed for `columns`.

    Raises:
        TraceError: a column is missing, or there twice.
    """

    def find(name: str) -> int:
        count = names.count(name)
        if count != 1:
            listed = ", ".join(names[:MOST_NAMED]) + (", ..." if len(names) > MOST_NAMED else "")
            line = f"line {columns.header_line}" if columns.header_line else "the file"
            raise TraceError(
                f"{path}: column {name!r} is {'there twice' if count else 'missing'}; {line} has: {listed} "
                f"(for other names and units: deltatwin import, or --columns)"
            )
        return names.index(name)

    def find_time(entry: PositionColumn | TorqueColumn | GripperColumn, index: int) -> int:
        if columns.time.rate_hz is not None:
            return COUNTED
        name = entry.time or columns.time.name
        places = [i for i, n in enumerate(names) if n == name]
        if len(places) <= 1:
            return find(name)
        return max((i for i in places if i < index), default=places[0])

    found = []
    for name in CHANNELS:
        entries = columns.channel(name)
        optional = name.endswith("command") and name not in columns.model_fields_set
        if optional and not any(entry.name in names for entry in entries):
            continue
        for joint, entry in enumerate(entries):
            index = find(entry.name)
            times = None if entry.times is None else find(entry.times)
            found.append(Channel(name, joint, entry, index, find_time(entry, index), times))
    for name in EXTRAS:
        entry = columns.extra(name)
        if entry is not None and (name in columns.model_fields_set or entry.name in names):
            index = find(entry.name)
            found.append(Channel(name, FOURTH, entry, index, find_time(entry, index)))
    return Plan(tuple(found), None if columns.where is None else find(columns.where.name))


def assemble(
    table: pl.DataFrame,
    wanted: Plan,
    columns: Columns,
    robot: Description | None,
    path: Path,
    notes: list[Finding],
    epoch_ns: int,
    word: str = "line",
) -> Trace:
    """The trace that `columns` makes of `table`, checked.

    table: float64 columns called by their index. notes: what was found while reading. epoch_ns: what the stamps count
    from. word: how messages call a row of the file.

    Raises:
        TraceError: see `drivers.trace`.
    """
    per_second = TIME_UNITS.get(columns.time.unit, 1.0)
    first = columns.first_line if word == "line" else 1
    numbers = first + np.arange(len(table))
    if columns.time.backwards:
        table, numbers = table.reverse(), numbers[::-1]
    if columns.time.rate_hz is not None:
        table = table.with_columns(pl.Series(str(COUNTED), np.arange(len(table)) / columns.time.rate_hz * per_second))
    channels = wanted.channels
    base = channels[0].time_index
    stamps = {i: table[str(i)].to_numpy() / per_second for i in sorted({c.time_index for c in channels})}
    lines = RowNames(word, numbers)
    rows = _counted(table, stamps[base], columns, wanted, lines, notes, path)
    apart = _rows_of_their_own(table, channels)
    if apart:
        rows = rows[np.isfinite(table[str(channels[0].index)].to_numpy()[rows])]
    arrays, own_time = _arrays(table, channels, stamps, (rows, apart), robot, lines, notes, path)
    if robot is not None and robot.coupled and arrays["position"].shape[1] == robot.count:
        for name in CHANNELS:
            own = [c.column for c in channels if c.name == name and not isinstance(c.column, GripperColumn)]
            if own:
                _uncouple(arrays, name, {column.side for column in own}, robot, path)
    trace = Trace(
        path=path,
        time=stamps[base][rows],
        position=arrays["position"],
        torque=arrays["torque"],
        position_command=arrays.get("position_command"),
        torque_command=arrays.get("torque_command"),
        fourth_position=arrays.get("fourth_position"),
        gripper=arrays.get("gripper"),
        findings=tuple(notes),
        epoch_ns=epoch_ns,
        own_time=own_time,
        angular=not any(isinstance(c.column, PositionColumn) and c.column.linear for c in channels),
    )
    return check(trace, RowNames(word, lines.numbers[rows]), robot)


def _arrays(
    table: pl.DataFrame, channels: Sequence[Channel], stamps: Mapping[int, np.ndarray],
    taken: tuple[np.ndarray, set[int]], robot: Description | None, lines: RowNames, notes: list[Finding],
    path: Path,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:  # fmt: skip
    """Values of all channels in SI of the joint, by name, and the stamps of those that were brought to others'.

    stamps: s, of each column of stamps. taken: rows of the trace, and columns that stand on rows of their own.
    """
    rows, apart = taken
    base = channels[0].time_index
    joints = 1 + max(channel.joint for channel in channels if channel.name in CHANNELS)
    arrays: dict[str, np.ndarray] = {}
    own_time: dict[str, np.ndarray] = {}
    for channel in channels:
        column, raw = channel.column, table[str(channel.index)].to_numpy()
        if not isinstance(column, GripperColumn):
            raw = signed(raw, column.bits)
            _refuse_wraps(raw, channel, lines, path)
        if channel.times_index is not None:
            raw = raw * table[str(channel.times_index)].to_numpy()
        own = stamps[channel.time_index]
        if channel.index in apart:
            own = np.where(np.isfinite(raw), own, np.nan)
        elif channel.time_index != base and np.array_equal(own, stamps[base], equal_nan=True):
            own = stamps[base]
        if own is stamps[base]:
            values = raw[rows]
        else:
            values, note = _bring(stamps[base][rows], own, raw, channel, channels[0], path)
            notes.append(note)
            own_time[f"{channel.name}_{channel.joint + 1}"] = own[np.isfinite(own)]
        if isinstance(column, GripperColumn):
            closed = np.where(values == column.open, Gripper.OPEN, Gripper.CLOSED)
            arrays[channel.name] = np.where(np.isfinite(values), closed, Gripper.UNKNOWN).astype(np.uint32)
            continue
        values = _to_joint(values, channel, column, robot, path)
        if channel.name in EXTRAS:
            arrays[channel.name] = values
        else:
            arrays.setdefault(channel.name, np.empty((len(rows), joints)))[:, channel.joint] = values
    return arrays, own_time


def _counted(
    table: pl.DataFrame, stamps: np.ndarray, columns: Columns, wanted: Plan, lines: RowNames, notes: list[Finding],
    path: Path,
) -> np.ndarray:  # fmt: skip
    """Rows that have a stamp and count; what is left out is added to `notes`.

    Raises:
        TraceError: there are none.
    """
    rows, left_out = stamped(stamps, lines)
    notes.extend(left_out)
    if len(rows) == 0:
        raise TraceError(f"{path}: no row has a time stamp in column {columns.time.name!r}")
    if columns.where is None:
        return rows
    counts = columns.where.counts(table[str(wanted.where)].to_numpy()[rows])
    why = f"{columns.where.left_out} in column {columns.where.name!r}"
    if not counts.any():
        raise TraceError(f"{path}: all rows {why}")
    if not counts.all():
        notes.append(Finding.note(f"{np.count_nonzero(~counts)} of {len(rows)} rows {why} and were left out"))
    return rows[counts]


def _rows_of_their_own(table: pl.DataFrame, channels: Sequence[Channel]) -> set[int]:
    """Indices of the columns that hold values on other rows than the first one: of another topic, on one column of
    stamps."""
    known = {c.index: np.isfinite(table[str(c.index)].to_numpy()) for c in channels if c.name in CHANNELS}
    first = known[channels[0].index]
    return {index for index, mine in known.items() if on_other_rows(mine, first)}


def on_other_rows(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two columns, (N,) bool where they hold values, hardly ever do so on the same row."""
    least = min(np.count_nonzero(one), np.count_nonzero(other))
    return bool(least > 1 and np.count_nonzero(one & other) < ON_ONE_ROW * least)


def stamped(stamps: np.ndarray, lines: RowNames) -> tuple[np.ndarray, list[Finding]]:
    """Rows with a stamp, and a finding for those in between that have none. Blank rows behind the last are the end."""
    finite = np.isfinite(stamps)
    rows = np.flatnonzero(finite)
    if len(rows) == 0:
        return rows, []
    bad = np.flatnonzero(~finite[: rows[-1]])
    if len(bad) == 0:
        return rows, []
    message = f"left out {counted(len(bad), 'row')} without a possible time stamp: {lines.name(bad)}"
    return rows, [Finding.note(message)]


def _bring(
    time: np.ndarray, own: np.ndarray, raw: np.ndarray, channel: Channel, base: Channel, path: Path
) -> tuple[np.ndarray, Finding]:
    """`raw`, stamped `own`, at `time`. Outside its own stamps a channel has no value: NaN, never extrapolated."""
    known = np.isfinite(own)
    own, raw = own[known], raw[known]
    if len(own) < 2 or np.any(np.diff(own) <= 0):
        raise TraceError(f"{path}: {channel.label}: its own time stamps do not rise, so it cannot be resampled")
    if channel.column.between == "hold":
        values = raw[np.clip(np.searchsorted(own, time, side="right") - 1, 0, None)]
    else:
        values = np.interp(time, own, raw)
    outside = np.flatnonzero((time < own[0]) | (time > own[-1]))
    values[outside] = np.nan
    how = "held" if channel.column.between == "hold" else "interpolated linearly"
    message = (
        f"{channel.label} is sampled every {np.median(np.diff(own)) * 1e3:.6g} ms, {how} at the "
        f"{np.median(np.diff(time)) * 1e3:.6g} ms stamps of {base.label}; {len(outside)} of {len(time)} rows outside"
    )
    return values, Finding.note(message)


def signed(values: np.ndarray, bits: int | None) -> np.ndarray:
    """Readings of so many bits with the sign that they were written without; as they are where bits is None."""
    if bits is None:
        return values
    return np.where(values >= 2.0 ** (bits - 1), values - 2.0**bits, values)


def _refuse_wraps(raw: np.ndarray, channel: Channel, lines: RowNames, path: Path) -> None:
    """
    Raises:
        TraceError: whole numbers that step by 2^16 or 2^32 and stay there.
    """
    known = np.flatnonzero(np.isfinite(raw))
    values = raw[known]
    if len(values) < STAYS + 2 or np.ptp(values) < 0.9 * 2.0**16 or np.any(values != np.round(values)):
        return
    from scipy.ndimage import median_filter

    step = np.diff(values)
    beside = step - median_filter(step, size=5, mode="nearest")
    for bits in (16, 32):
        wraps = np.abs(np.abs(beside) - 2.0**bits) < 0.05 * 2.0**bits
        away = np.concatenate([[0], np.cumsum(np.where(wraps, np.sign(beside), 0.0))])
        usual = np.median(away)
        stays = np.convolve(away != usual, np.ones(STAYS), "valid") == STAYS
        if stays.any():
            at = np.flatnonzero(wraps) + 1
            remedy = f"bits = {bits}" if isinstance(channel.column, TorqueColumn) else "unwrap it first"
            raise TraceError(
                f"{path}: {channel.label} steps by 2^{bits} {counted(len(at), 'time')} ({lines.name(known[at])}): "
                f"a reading of {bits} bits that wraps: {remedy}"
            )


def _gear_ratio(robot: Description | None, joint: int) -> float | None:
    """Of a joint of `robot`; the fourth behind a Delta's three has none."""
    return None if robot is None or joint >= robot.count else robot.gear_ratios[joint]


def _uncouple(arrays: dict[str, np.ndarray], name: str, sides: set[str], machine: Description, path: Path) -> None:
    """Bring a channel of all motors to the joints, in place; one that is the joints' already stays."""
    if len(sides) > 1:
        reason = f"{machine.name} has a coupling, give it for all"
        raise TraceError(f"{path}: {name}: side is motor for some joints; {reason}")
    if sides == {"motor"}:
        turn = machine.motors if "torque" in name else np.linalg.inv(machine.motors).T
        arrays[name] = arrays[name] @ turn


def _to_joint(
    values: np.ndarray,
    channel: Channel,
    column: PositionColumn | TorqueColumn,
    robot: Description | None,
    path: Path,
) -> np.ndarray:
    gear: float | None = 1.0
    if column.side == "motor":
        gear = column.gear_ratio or _gear_ratio(robot, channel.joint)
        if gear is None:
            raise TraceError(f"{path}: {channel.label} is motor side: give its gear_ratio or a robot with [drive]")
    scale = column.sign * column.scale
    return (values - column.zero) * (scale / gear if isinstance(column, PositionColumn) else scale * gear)
