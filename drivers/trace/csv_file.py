"""CSV traces, plain or gzip: our own header, or any table that a `schemas.columns.Columns` describes."""

from __future__ import annotations

import gzip
import io
import re
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from drivers.trace.quality import EXACT_SECONDS, Rows, check
from schemas.axes import Axes, Description
from schemas.columns import CHANNELS, EXTRAS, TIME_UNITS, Columns, GripperColumn, PositionColumn, TorqueColumn
from schemas.errors import TraceError
from schemas.files import MAX_LOG_BYTES, MIB, most_unpacked, read_bytes
from schemas.messages import NANOSECONDS, Gripper, SampleFlag
from schemas.robot import Robot
from schemas.trace import Finding, Trace

MAX_LINE_BYTES = 1 << 20  # of a header; one of a thousand signals with their paths has 100 kB
MAX_COLUMNS = 4096
LATEST_S = 2.0**31 - 1  # year 2038: no stamp of a message is later
MISSING = ["", " ", "nan", "NaN", "NAN", "null", "NULL", "NA", "n/a"]  # cells that say there is no value
_OWN = re.compile(r"^position_\d+_(rad|m)$")
FOURTH = 3  # number of the joint behind the three of a Delta
OWN_UNITS = {True: ("rad", "nm"), False: ("m", "n")}  # endings of our own column names: angular, linear
_STAMP = pl.Decimal(38, 9)
_FIXED_POINT_LINES = 20  # lines looked at to tell whether the last field has a fixed number of decimals


@dataclass(frozen=True)
class _Channel:
    """One column of the file and where it goes."""

    name: str  # of CHANNELS or EXTRAS
    joint: int
    column: PositionColumn | TorqueColumn | GripperColumn
    index: int
    time_index: int

    @property
    def label(self) -> str:
        return f"{self.name}_{self.joint + 1} ({self.column.name!r})" if self.name in CHANNELS else self.column.name


def read_csv(
    path: Path, robot: Description | None = None, columns: Columns | None = None, fallback: Columns | None = None
) -> Trace:
    """A table as a trace.

    columns: its mapping, whatever its header. fallback: its mapping where the header is not our own.

    Raises:
        TraceError: see `drivers.trace`.
    """
    raw = _load(path)
    columns = columns or _mapping(raw, fallback, robot)
    names, body = _split(raw, columns, path)
    channels = _channels(names, columns, path)
    body, notes = _without_cut_line(body, columns)
    table = _parse(body, names, channels, columns, path)
    table, epoch_ns = _from_epoch(table, body, names, channels, columns)
    return _assemble(table, channels, columns, robot, path, notes, epoch_ns)


def write_csv(trace: Trace, path: Path) -> None:
    """Write `trace` in our own CSV, every digit that float64 needs; gzip where `path` ends in `.gz`.

    Raises:
        OSError: the file cannot be written.
    """
    data: dict[str, np.ndarray | pl.Series] = {"time_s": trace.time}
    if trace.epoch_ns:  # float64 seconds would lose the nanoseconds
        billion = pl.lit(NANOSECONDS).cast(_STAMP)
        data["time_s"] = pl.DataFrame({"ns": trace.time_ns}).select(pl.col("ns").cast(_STAMP) / billion).to_series()
    for name in ("position_command", "position", "torque_command", "torque"):
        values = getattr(trace, name)
        unit = OWN_UNITS[trace.angular][name.startswith("torque")]
        if values is not None:
            data.update({f"{name}_{j + 1}_{unit}": values[:, j] for j in range(values.shape[1])})
    if trace.fourth_position is not None:
        data["position_4_rad"] = trace.fourth_position
    if trace.gripper is not None:
        known = trace.gripper != Gripper.UNKNOWN
        data["gripper"] = (
            pl.DataFrame({"known": known, "closed": trace.gripper == Gripper.CLOSED})
            .select(pl.when("known").then(pl.col("closed").cast(pl.Int8)))
            .to_series()
        )
    text = pl.DataFrame(data).write_csv().encode()
    path.write_bytes(gzip.compress(text, compresslevel=6) if path.suffix == ".gz" else text)


def _load(path: Path) -> bytes:
    raw = read_bytes(path, MAX_LOG_BYTES, TraceError)
    if raw[:2] == b"\x1f\x8b":
        raw = _unzipped(raw, path)
    if not raw[:4096].strip() and not raw.strip():
        raise TraceError(f"{path}: empty file")
    zero = raw.find(b"\0", 0, 1 << 16)
    if zero >= 0:
        raise TraceError(f"{path}: not a text table: zero byte at offset {zero} (starts with {raw[:8]!r})")
    return raw.removeprefix(b"\xef\xbb\xbf")


def _unzipped(packed: bytes, path: Path) -> bytes:
    limit, parts, total = most_unpacked(len(packed)), [], 0
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(packed)) as stream:
            while part := stream.read(16 * MIB):
                parts.append(part)
                total += len(part)
                if total > limit:
                    raise TraceError(f"{path}: {len(packed)} bytes unpack to more than {limit}, at most that is read")
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise TraceError(f"{path}: broken gzip file: {error}") from error
    return b"".join(parts)


def _mapping(raw: bytes, fallback: Columns | None, robot: Description | None) -> Columns:
    names = _fields(_first_line(raw)[:MAX_LINE_BYTES].decode("utf-8", "replace"), ",")
    own = [match[1] for name in names if (match := _OWN.match(name))]
    if not own:
        return fallback or Columns()
    if own[0] == "rad":
        fourth = "position_4_rad" in names and (isinstance(robot, Robot) or "torque_4_nm" not in names)
        return Columns(joints=3) if fourth and len(own) == 4 else Columns(joints=len(own), fourth_position=None)
    linear: dict[str, Any] = {"joints": len(own)}
    for channel, ending, unit in zip(CHANNELS, ("m", "n") * 2, ("m", "N") * 2, strict=True):
        if f"{channel}_1_{ending}" in names or not channel.endswith("command"):
            linear[channel] = {"name": f"{channel}_{{joint}}_{ending}", "unit": unit}
    return Columns.model_validate(linear)


def _first_line(table: bytes) -> bytes:
    return next(io.BytesIO(table), b"")


def _fields(line: str, separator: str) -> list[str]:
    return [field.strip().strip('"') for field in line.rstrip("\r\n").split(separator)]


def _split(raw: bytes, columns: Columns, path: Path) -> tuple[list[str], bytes]:
    lines = raw.split(b"\n", columns.first_line - 1)
    if len(lines) < columns.first_line or not lines[-1].strip():
        raise TraceError(f"{path}: no data rows: the file ends before line {columns.first_line}")
    head, body = lines[columns.header_line - 1], lines[-1]
    if len(head) > MAX_LINE_BYTES:
        raise TraceError(f"{path}: line {columns.header_line} has {len(head)} bytes, at most {MAX_LINE_BYTES} are read")
    try:
        header = head.decode(columns.encoding)
        if columns.encoding != "utf-8":
            body = body.decode(columns.encoding).encode()
    except UnicodeError as error:
        raise TraceError(f"{path}: not {columns.encoding} text: {error}") from error
    names = _fields(header, columns.separator)
    most = max(len(names), _first_line(body).count(columns.separator.encode()) + 1)
    if most > MAX_COLUMNS:
        raise TraceError(f"{path}: {most} columns, at most {MAX_COLUMNS} are read")
    return names, body


def _channels(names: list[str], columns: Columns, path: Path) -> list[_Channel]:
    def find(name: str) -> int:
        count = names.count(name)
        if count != 1:
            listed = ", ".join(names[:20]) + (", ..." if len(names) > 20 else "")
            raise TraceError(
                f"{path}: column {name!r} is {'there twice' if count else 'missing'}; "
                f"line {columns.header_line} has: {listed} (other names and units: --columns)"
            )
        return names.index(name)

    def find_time(entry: PositionColumn | TorqueColumn | GripperColumn, index: int) -> int:
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
            found.append(_Channel(name, joint, entry, index, find_time(entry, index)))
    for name in EXTRAS:
        entry = columns.extra(name)
        if entry is not None and (name in columns.model_fields_set or entry.name in names):
            index = find(entry.name)
            found.append(_Channel(name, FOURTH, entry, index, find_time(entry, index)))
    return found


def _without_cut_line(body: bytes, columns: Columns) -> tuple[bytes, list[Finding]]:
    """Leave out a last line that stops in the middle: its last number may have lost digits without looking wrong."""
    if body.endswith(b"\n"):
        return body, []
    separator = columns.separator.encode()
    *before, last = body.rsplit(b"\n", _FIXED_POINT_LINES)
    before = before[1:]
    if not before:
        return body, []
    fields, expected = last.count(separator), before[-1].count(separator)
    decimals = {_decimals(line, separator, columns.decimal) for line in before}
    cut = fields < expected or (len(decimals) == 1 and _decimals(last, separator, columns.decimal) not in decimals)
    if not cut:
        return body, []
    line = columns.first_line + body.count(b"\n")
    what = f"{fields + 1} of {expected + 1} fields" if fields < expected else "its last number lacks digits"
    message = f"the last line ({line}) is cut off ({what}) and was left out: {last[-40:].decode('utf-8', 'replace')!r}"
    return body[: len(body) - len(last)], [Finding(SampleFlag(0), message, np.zeros(0, np.intp))]


def _decimals(line: bytes, separator: bytes, decimal: str) -> int:
    return len(line.rstrip(b"\r").rsplit(separator, 1)[-1].partition(decimal.encode())[2])


def _parse(body: bytes, names: list[str], channels: list[_Channel], columns: Columns, path: Path) -> pl.DataFrame:
    """The columns that are needed as float64, named by their index; null where a cell is empty."""
    used = sorted({c.index for c in channels} | {c.time_index for c in channels})
    try:
        return _read(body, used, len(names), pl.Float64, columns)
    except pl.exceptions.PolarsError as error:
        raise TraceError(f"{path}: {_explain(body, names, used, columns, str(error))}") from error


def _read(body: bytes, used: list[int], fields: int, kind: type[pl.DataType], columns: Columns) -> pl.DataFrame:
    width = max(fields, _first_line(body).count(columns.separator.encode()) + 1)
    return pl.read_csv(
        io.BytesIO(body),
        has_header=False,
        schema={str(i): kind if i in used else pl.String for i in range(width)},
        columns=used,
        separator=columns.separator,
        quote_char='"' if b'"' in body else None,
        null_values=MISSING,
        decimal_comma=columns.decimal == ",",
    )


def _from_epoch(
    table: pl.DataFrame, body: bytes, names: list[str], channels: list[_Channel], columns: Columns
) -> tuple[pl.DataFrame, int]:
    """Stamps since 1970 or so, counted from the first instead: as float64 seconds they would lose nanoseconds."""
    per_second = TIME_UNITS[columns.time.unit]
    indices = sorted({channel.time_index for channel in channels})
    possible = pl.col(list(map(str, indices))).abs() <= LATEST_S * per_second
    table = table.with_columns(pl.when(possible).then(pl.col(list(map(str, indices)))))
    largest = max(abs(stamp) if isinstance(stamp := table[str(i)].max(), float) else 0.0 for i in indices)
    if largest <= EXACT_SECONDS * per_second:
        return table, 0
    text = _read(body, indices, len(names), pl.String, columns)
    exact = text.select(
        pl.all().str.strip_chars().str.replace(columns.decimal, ".", literal=True).cast(_STAMP, strict=False)
    )
    exact = exact.with_columns(pl.when(pl.all().abs() <= LATEST_S * per_second).then(pl.all()))
    base = exact[str(channels[0].time_index)].drop_nulls()
    if len(base) == 0 or any(exact[str(i)].null_count() != table[str(i)].null_count() for i in indices):
        return table, 0  # not plain decimals (an exponent, say): the float64 stands
    epoch = int(base[0] * NANOSECONDS) // int(per_second)
    since = exact.select((pl.all() - base[0]).cast(pl.Float64))
    return table.with_columns(since), epoch


def _explain(body: bytes, names: list[str], used: list[int], columns: Columns, error: str) -> str:
    """The first cell or line that cannot be read."""
    expected = len(names)
    for line, text in enumerate(io.BytesIO(body), columns.first_line):
        fields = _fields(text.decode("utf-8", "replace"), columns.separator)
        if len(fields) > expected and "".join(fields[expected:]):
            return f"line {line} has {len(fields)} fields, the header has {expected}"
        for index in used:
            cell = fields[index] if index < len(fields) else ""
            try:
                float(cell.replace(columns.decimal, ".") if cell not in MISSING else 0)
            except ValueError:
                return f"line {line}, column {names[index]!r}: {cell!r} is not a number"
    fields = _first_line(body).count(columns.separator.encode()) + 1
    if fields < expected:
        return f"line {columns.first_line} has {fields} fields, the header has {expected}"
    return error.splitlines()[0]


def _assemble(
    table: pl.DataFrame,
    channels: list[_Channel],
    columns: Columns,
    robot: Description | None,
    path: Path,
    notes: list[Finding],
    epoch_ns: int,
) -> Trace:
    per_second = TIME_UNITS[columns.time.unit]
    stamps = {
        index: table[str(index)].to_numpy() / per_second
        for index in sorted({channel.time_index for channel in channels})
    }
    base = channels[0].time_index
    rows, left_out = _stamped(stamps[base], table, base, columns)
    notes.extend(left_out)
    if len(rows) == 0:
        raise TraceError(f"{path}: no row has a time stamp in column {columns.time.name!r}")
    joints = 1 + max(channel.joint for channel in channels if channel.name in CHANNELS)
    time = stamps[base][rows]
    arrays: dict[str, np.ndarray] = {}
    own_time: dict[str, np.ndarray] = {}
    for channel in channels:
        raw = table[str(channel.index)].to_numpy()
        own = stamps[channel.time_index]
        if channel.time_index == base or np.array_equal(own, stamps[base], equal_nan=True):
            values = raw[rows]
        else:
            values, note = _bring(time, own, raw, channel, channels[0], path)
            notes.append(note)
            own_time[f"{channel.name}_{channel.joint + 1}"] = own[np.isfinite(own)]
        if isinstance(channel.column, GripperColumn):
            closed = np.where(values == channel.column.open, Gripper.OPEN, Gripper.CLOSED)
            arrays[channel.name] = np.where(np.isfinite(values), closed, Gripper.UNKNOWN).astype(np.uint32)
            continue
        values = _to_joint(values, channel, channel.column, robot, path)
        if channel.name in EXTRAS:
            arrays[channel.name] = values
        else:
            arrays.setdefault(channel.name, np.empty((len(rows), joints)))[:, channel.joint] = values
    trace = Trace(
        path=path,
        time=time,
        position=arrays["position"],
        torque=arrays["torque"],
        position_command=arrays.get("position_command"),
        torque_command=arrays.get("torque_command"),
        fourth_position=arrays.get("fourth_position"),
        gripper=arrays.get("gripper"),
        findings=tuple(notes),
        epoch_ns=epoch_ns,
        own_time=own_time,
        angular=all(getattr(channel.column, "unit", "") not in ("m", "mm") for channel in channels),
    )
    return check(trace, Rows("line", columns.first_line + rows), robot)


def _stamped(stamps: np.ndarray, table: pl.DataFrame, base: int, columns: Columns) -> tuple[np.ndarray, list[Finding]]:
    """Rows with a stamp, and a finding for those in between that have none. Blank rows behind the last are the end."""
    finite = np.isfinite(stamps)
    rows = np.flatnonzero(finite)
    if len(rows) == 0:
        return rows, []
    bad = np.flatnonzero(~finite[: rows[-1]])
    if len(bad) == 0:
        return rows, []
    lines = Rows("line", columns.first_line + np.arange(len(stamps)))
    message = f"{len(bad)} rows without a possible time stamp were left out: {lines.name(bad)}"
    return rows, [Finding(SampleFlag(0), message, np.zeros(0, np.intp))]


def _bring(
    time: np.ndarray, own: np.ndarray, raw: np.ndarray, channel: _Channel, base: _Channel, path: Path
) -> tuple[np.ndarray, Finding]:
    """`raw`, stamped `own`, at `time`. Outside its own stamps a channel has no value: NaN, never extrapolated."""
    known = np.isfinite(own)
    own, raw = own[known], raw[known]
    if len(own) < 2 or np.any(np.diff(own) <= 0):
        raise TraceError(f"{path}: {channel.label}: its own time stamps do not rise, it cannot be brought to another's")
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
    return values, Finding(SampleFlag(0), message, np.zeros(0, np.intp))


def _gear_ratio(robot: Description | None, joint: int) -> float | None:
    if robot is None:
        return None
    if isinstance(robot, Axes):
        return robot.axis[joint].gear_ratio if joint < len(robot.axis) else None
    if joint == FOURTH:
        return None  # `drive` is of the arms
    own = robot.drive.joint[joint].gear_ratio if robot.drive.joint else None
    return own or robot.drive.gear_ratio


def _to_joint(
    values: np.ndarray,
    channel: _Channel,
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
