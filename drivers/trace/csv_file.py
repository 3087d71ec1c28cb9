"""CSV traces, plain or gzip: our own header, or any table that a `schemas.columns.Columns` describes."""

from __future__ import annotations

import gzip
import io
import re
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drivers.data_frames import pl
from drivers.trace.from_columns import Plan, assemble, plan
from drivers.trace.quality import EXACT_SECONDS
from drivers.trace.stated_units import contradictions
from schemas.axes_description import Description
from schemas.columns import CHANNELS, FILETIME_S, MAX_COLUMNS, TIME_UNITS, Columns
from schemas.errors import TraceError
from schemas.files import MAX_LOG_BYTES, MIB, most_unpacked, read_bytes
from schemas.messages import NANOSECONDS, Gripper
from schemas.trace import Finding, Trace
from schemas.units import is_unit

MAX_LINE_BYTES = 1 << 20  # of a header; one of a thousand signals with their paths has 100 kB
LATEST_S = 2.0**31 - 1  # year 2038: no stamp of a message is later
MISSING = ["", " ", "nan", "NaN", "NAN", "null", "NULL", "NA", "n/a"]  # cells that say there is no value
END_TAG = b"EOF"  # the last line of a TwinCAT Scope export, where that is asked for
_OWN = re.compile(r"^position_\d+_(rad|m)$")
OWN_UNITS = {True: ("rad", "nm"), False: ("m", "n")}  # endings of our own column names: angular, linear
_STAMP = pl.Decimal(38, 9)
DATE_FORMATS = (
    *(f"{day} %H:%M:%S%.f" for day in ("%Y-%m-%d", "%Y/%m/%d", "%d.%m.%Y", "%m/%d/%Y")), "%m/%d/%Y %I:%M:%S%.f %p",
)  # fmt: skip
_NO_DAY = r"^\d\d?:\d\d:\d\d"  # a time of day alone
HALF_A_DAY = 43_200 * NANOSECONDS
_ZONE = r"(?<time>:\d\d(\.\d+)?) ?(Z|(?<sign>[+-])(?<hours>\d\d):?(?<minutes>\d\d))$"
_LATIN = '; from a German or French Windows? encoding = "latin-1" in its [columns], or deltatwin import'
_FIXED_POINT_LINES = 20  # lines looked at to tell whether the last field has a fixed number of decimals


def read_csv(
    path: Path, robot: Description | None = None, columns: Columns | None = None, fallback: Columns | None = None
) -> Trace:
    """A table as a trace.

    columns: its mapping, whatever its header. fallback: its mapping where the header is not our own.

    Raises:
        TraceError: see `drivers.trace`.
    """
    raw = load(path)
    columns = columns or _mapping(raw, fallback, robot)
    names, body, between = _split(raw, columns, path)
    wanted = plan(names, columns, path)
    body, notes = _without_cut_line(body, columns)
    notes += contradictions(wanted, columns, unit_row(between, columns.separator))
    table = _parse(body, names, wanted, columns, path)
    table, epoch_ns = _from_epoch(table, body, names, wanted, columns)
    return assemble(table, wanted, columns, robot, path, notes, epoch_ns)


def read_cells(raw: bytes, columns: Columns, path: Path) -> tuple[list[str], pl.DataFrame]:
    """All cells of a table as text: the names of its columns, and the columns called by their index.

    Raises:
        TraceError: a line has more fields than the others.
    """
    names, body, _ = _split(raw, columns, path)
    width = max(len(names), _first_line(body).count(columns.separator.encode()) + 1)
    names += [str(index + 1) for index in range(len(names), width)]
    try:
        return names, _read(body, list(range(width)), width, pl.String, columns)
    except pl.exceptions.PolarsError as error:
        raise TraceError(f"{path}: {_explain(body, names, [], columns, str(error))}") from error


def write_csv(trace: Trace, path: Path) -> None:
    """Write `trace` in our own CSV, every digit that float64 needs; gzip where `path` ends in `.gz`.

    Raises:
        OSError: the file cannot be written.
    """
    text = table_of(trace).write_csv().encode()
    path.write_bytes(gzip.compress(text, compresslevel=6) if path.suffix == ".gz" else text)


def table_of(trace: Trace) -> pl.DataFrame:
    """`trace` with the columns of our own CSV."""
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
    return pl.DataFrame(data)


def load(path: Path) -> bytes:
    """The text of a table, unpacked, without a byte order mark.

    Raises:
        TraceError: it cannot be read, is empty, or no text.
    """
    raw = read_bytes(path, MAX_LOG_BYTES, TraceError)
    if raw[:2] == b"\x1f\x8b":
        raw = _unzipped(raw, path)
    if not raw[:4096].strip() and not raw.strip():
        raise TraceError(f"{path}: empty file")
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):  # "Unicode text" of Windows
        raw = raw.decode("utf-16", "replace").encode()
    zero = raw.find(b"\0", 0, 1 << 16)
    if zero >= 0:
        what = "an Excel file or an archive, save it as CSV" if raw.startswith(b"PK") else f"starts with {raw[:8]!r}"
        raise TraceError(f"{path}: not a text table: zero byte at offset {zero} ({what})")
    if not raw.isascii():
        for space in (b"\xc2\xa0", b"\xe2\x80\xaf"):  # between groups of digits, as French spreadsheets write it
            raw = raw.replace(space, b" ")
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
    return own_columns(names, robot) or fallback or Columns()


def own_columns(names: Sequence[str], robot: Description | None = None) -> Columns | None:
    """The mapping of a table whose columns are called as ours; None where they are not."""
    own = [match[1] for name in names if (match := _OWN.match(name))]
    if not own:
        return None
    if own[0] == "rad":
        of_gripper = robot is not None and robot.turns_gripper
        fourth = "position_4_rad" in names and (of_gripper or "torque_4_nm" not in names)
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


def unit_row(lines: Sequence[str], separator: str) -> dict[int, str]:
    """Units by the index of their column, from the first of the lines between names and numbers that is mostly units;
    unknown ones too."""
    for line in lines:
        cells = [cell.strip("[]() ") for cell in _fields(line, separator)]
        filled = {index: cell for index, cell in enumerate(cells) if cell.strip("-")}
        if filled and sum(map(is_unit, filled.values())) > len(cells) // 2:
            return filled
    return {}


def _split(raw: bytes, columns: Columns, path: Path) -> tuple[list[str], bytes, list[str]]:
    """Names of the columns, the rows, and the lines between them.

    Raises:
        TraceError: there are no rows, or no text in this encoding, or more than is read.
    """
    lines = raw.split(b"\n", columns.first_line - 1)
    if len(lines) < columns.first_line or not lines[-1].strip():
        raise TraceError(f"{path}: no data rows: the file ends before line {columns.first_line}")
    head, body = lines[columns.header_line - 1] if columns.header_line else b"", lines[-1]
    if len(head) > MAX_LINE_BYTES:
        raise TraceError(f"{path}: line {columns.header_line} has {len(head)} bytes, at most {MAX_LINE_BYTES} are read")
    try:
        header = head.decode(columns.encoding)
        between = [line.decode(columns.encoding) for line in lines[columns.header_line : -1]]
        if columns.encoding != "utf-8":
            body = body.decode(columns.encoding).encode()
    except UnicodeError as error:
        raise TraceError(f"{path}: not {columns.encoding} text: {error}{_LATIN}") from error
    if columns.thousands is not None:
        body = re.sub(rb"(?<=\d)%b(?=\d{3}(?!\d))" % re.escape(columns.thousands.encode()), b"", body)
    text = body.rstrip()
    last = text.rfind(b"\n") + 1
    if last and text[last:].strip().strip(b'"') == END_TAG:
        body = text[:last]
    names = _fields(header, columns.separator)
    if not columns.header_line:
        names = [str(1 + i) for i in range(_first_line(body).count(columns.separator.encode()) + 1)]
    most = max(len(names), _first_line(body).count(columns.separator.encode()) + 1)
    if most > MAX_COLUMNS:
        raise TraceError(f"{path}: {most} columns, at most {MAX_COLUMNS} are read")
    return names, body, between


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
    return body[: len(body) - len(last)], [Finding.note(message)]


def _decimals(line: bytes, separator: bytes, decimal: str) -> int:
    return len(line.rstrip(b"\r").rsplit(separator, 1)[-1].partition(decimal.encode())[2])


def _parse(body: bytes, names: list[str], wanted: Plan, columns: Columns, path: Path) -> pl.DataFrame:
    """The columns that are needed as float64, named by their index; null where a cell is empty."""
    numbers = wanted.values if columns.time.unit == "datetime" else sorted({*wanted.values, *wanted.times})
    try:
        return _read(body, numbers, len(names), pl.Float64, columns)
    except pl.exceptions.PolarsError as error:
        raise TraceError(f"{path}: {_explain(body, names, numbers, columns, str(error))}") from error


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
    table: pl.DataFrame, body: bytes, names: list[str], wanted: Plan, columns: Columns
) -> tuple[pl.DataFrame, int]:
    """Stamps since 1970 or so, counted from the first instead: as float64 seconds they would lose nanoseconds."""
    indices = wanted.times
    if not indices:
        return table, 0
    if columns.time.unit == "datetime":
        dates = [names.index(columns.time.date)] if columns.time.date in names else []
        text = _read(body, sorted({*indices, *dates}), len(names), pl.String, columns)
        if dates:
            day = pl.col(str(dates[0])).str.strip_chars() + " "
            text = text.with_columns((day + pl.col(str(i)).str.strip_chars()).alias(str(i)) for i in indices)
        return _from_dates(table, text, wanted)
    per_second = TIME_UNITS[columns.time.unit]
    before = FILETIME_S if columns.time.unit == "filetime" else 0  # s, of 1970
    possible = (pl.col(list(map(str, indices))) - before * per_second).abs() <= LATEST_S * per_second
    table = table.with_columns(pl.when(possible).then(pl.col(list(map(str, indices)))))
    largest = max(abs(stamp) if isinstance(stamp := table[str(i)].max(), float) else 0.0 for i in indices)
    if largest <= EXACT_SECONDS * per_second:
        return table, 0
    text = _read(body, indices, len(names), pl.String, columns)
    exact = text.select(
        pl.all().str.strip_chars().str.replace(columns.decimal, ".", literal=True).cast(_STAMP, strict=False)
    )
    latest = (LATEST_S + before) * per_second
    exact = exact.with_columns(pl.when(pl.all().abs() <= latest).then(pl.all()))
    base = exact[str(wanted.channels[0].time_index)].drop_nulls()
    if len(base) == 0 or any(exact[str(i)].null_count() != table[str(i)].null_count() for i in indices):
        return table, 0  # not plain decimals (an exponent, say): the float64 stands
    epoch = int(base[0] * NANOSECONDS) // int(per_second) - before * NANOSECONDS
    since = exact.select((pl.all() - base[0]).cast(pl.Float64))
    return table.with_columns(since), epoch


def _from_dates(table: pl.DataFrame, text: pl.DataFrame, wanted: Plan) -> tuple[pl.DataFrame, int]:
    """Stamps that are dates and times of day, as seconds since the first; what is none is null."""
    stamps = text.select(date_times(pl.col(str(i))) for i in wanted.times)
    known = stamps[str(wanted.channels[0].time_index)].drop_nulls()
    epoch = int(known[0]) if len(known) else 0
    return table.hstack(stamps.select((pl.all() - epoch).cast(pl.Float64) / NANOSECONDS)), epoch


def date_times(text: pl.Expr) -> pl.Expr:
    """Dates with times of day, written in any of the usual ways, as int64 ns since 1970; null where it is none.

    A zone behind the time, as Z or +02:00, is taken into account; without one the time is taken for UTC. Times of day
    alone count from midnight, on over the next one.
    """
    plain = text.str.strip_chars().str.replace(",", ".", literal=True).str.replace("T", " ", literal=True)
    zone = plain.str.extract_groups(_ZONE)
    ahead = 60 * zone.struct["hours"].cast(pl.Int64) + zone.struct["minutes"].cast(pl.Int64)
    ahead = pl.when(zone.struct["sign"] == "-").then(-ahead).otherwise(ahead).fill_null(0)
    local = plain.str.replace(_ZONE, "$time").str.replace(_NO_DAY, "1970-01-01 $0")
    parsed = (local.str.to_datetime(form, time_unit="ns", strict=False) for form in DATE_FORMATS)
    stamps = pl.coalesce(parsed).cast(pl.Int64) - ahead * 60 * NANOSECONDS
    midnights = (stamps.forward_fill().diff() < -HALF_A_DAY).fill_null(False).cum_sum().cast(pl.Int64)
    no_day = plain.str.contains(_NO_DAY).fill_null(False)
    return (stamps + pl.when(no_day).then(midnights).otherwise(0) * pl.lit(2 * HALF_A_DAY, pl.Int64)).cast(pl.Int64)


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
                float(cell.replace(columns.decimal, ".").replace("_", "x") if cell not in MISSING else 0)
            except ValueError:
                return f"line {line}, column {names[index]!r}: {cell!r} is not a number"
    fields = _first_line(body).count(columns.separator.encode()) + 1
    if fields < expected:
        return f"line {columns.first_line} has {fields} fields, the header has {expected}"
    return error.splitlines()[0]
