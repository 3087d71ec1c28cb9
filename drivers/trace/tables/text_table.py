"""Text tables: separator, decimal mark, header and encoding are found from what is there.

Nothing is guessed that the next reader of the file could not check: what was found is `Table.layout`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drivers.data_frames import pl
from drivers.trace.csv_file import MISSING, date_times, load, read_cells, unit_row
from drivers.trace.tables import Table
from drivers.trace.tables.codesys import FIRST_LINE as CODESYS_CSV
from drivers.trace.tables.codesys import read_csv as read_codesys
from schemas.columns import MAX_COLUMNS, Columns
from schemas.errors import TraceError
from schemas.messages import NANOSECONDS

DAY = r"^(\d{4}[-/]\d\d?[-/]\d\d?|\d\d?[./]\d\d?[./]\d{4})$"
TIME_OF_DAY = r"^\d\d?:\d\d:\d\d([.,]\d+)?$"
_JOINT_NAME = re.compile(r"(?i)(?<![a-z])names?\D{0,2}(\d+)\]?$")
_LAST_NUMBER = re.compile(r"(\d+)\D*$")
_WORD = re.compile(r"^[A-Za-z]\w*$")
LOOKED_AT = 400  # lines from the top in which the numbers have to begin
RUN = 8  # lines of one shape that make a table, fewer only where the file ends
THOUSANDS = (".", ",", "'", " ")  # marks between groups of three digits
SEPARATORS = ("\t", ";", ",", " ", "|")


def read(path: Path, layout: Mapping[str, object] | None = None) -> Table:
    """
    Raises:
        TraceError: no text, or no table of numbers in it.
    """
    raw = load(path)
    encoding = str((layout or {}).get("encoding", _encoding(raw)))
    head = [line.decode(encoding, "replace").rstrip("\r") for line in raw[: 1 << 20].split(b"\n", LOOKED_AT)]
    head = head[:LOOKED_AT]
    if head[0].strip() == CODESYS_CSV:
        return read_codesys(path, raw.decode(encoding, "replace"))
    found = dict(layout) if layout else _layout(head, path) | ({"encoding": encoding} if encoding != "utf-8" else {})
    if not layout and "thousands" not in found and (mark := _later_thousands(raw, found)):
        found["thousands"] = mark
    columns = Columns.model_validate(
        {key: value for key, value in found.items() if key != "date"} | {"position": "-", "torque": "--"}
    )
    units = unit_row(head[columns.header_line : columns.first_line - 1], columns.separator)
    symbols = next((_fields(line, columns.separator) for line in head if line.startswith("SymbolName")), [])
    names, cells = read_cells(raw, columns, path)
    values: dict[str, np.ndarray] = {}
    kept_units: dict[str, str] = {}
    time_of: dict[str, str] = {}
    paths: dict[str, str] = {}
    texts: dict[str, pl.Series] = {}
    clock, epoch_ns = "", 0
    plain = _plain_numbers(cells, columns.decimal)
    for index, name in enumerate(names):
        name = _unique(name, values)
        array, unit = plain.get(str(index)), ""
        if array is None:
            array, unit, epoch_ns = numbers_of(cells[str(index)], columns.decimal, epoch_ns)
        if array is None:
            texts[name] = cells[str(index)]
            continue
        values[name] = array
        if index < len(symbols):
            paths[name] = symbols[index]
        if unit or units.get(index):
            kept_units[name] = unit or units[index]
        if _twincat(head) and name.startswith("Name"):
            clock, kept_units[name] = name, "ms"
        elif clock:
            time_of[name] = clock
    epoch_ns = _days(names, cells, values, kept_units, epoch_ns, found)
    paths |= _named_in_cells(list(values), texts, path)
    kind = "TwinCAT Scope export" if _twincat(head) else "table with a header" if columns.header_line else "table"
    return Table(path, kind, values, kept_units, time_of, epoch_ns, found, paths)


def _days(
    names: list[str], cells: pl.DataFrame, values: dict[str, np.ndarray], units: dict[str, str], epoch_ns: int,
    found: dict[str, Any],
) -> int:  # fmt: skip
    """Put a column of days and one of times of day together, called after the latter, and say so in the layout."""
    texts = {
        name: cells[str(k)].str.strip_chars()
        for k, name in enumerate(names)
        if name not in values or units.get(name) == "datetime"
    }
    day, clock = (
        next((name for name, text in texts.items() if text.len() and text.str.contains(form).all()), None)
        for form in (DAY, TIME_OF_DAY)
    )
    if day is None or clock is None:
        return epoch_ns
    if not any(unit == "datetime" for name, unit in units.items() if name != clock):
        epoch_ns = 0  # not from the midnight of the times of day alone
    array, unit, epoch_ns = numbers_of(texts[day] + " " + texts[clock], ".", epoch_ns)
    if array is not None and unit:
        first = {clock: array} | {name: column for name, column in values.items() if name != clock}
        values.clear()
        values.update(first)
        units[clock], found["date"] = unit, day
    return epoch_ns


def _named_in_cells(columns: list[str], texts: Mapping[str, pl.Series], path: Path) -> dict[str, str]:
    """Joints by column, where columns of text name them: `field.name0` that of `field.position0` (`rostopic echo -p`).

    Raises:
        TraceError: one of them names several joints.
    """
    found = {}
    numbered: dict[str, list[str]] = {}
    for column in columns:
        if number := _LAST_NUMBER.search(column):
            numbered.setdefault(number[1], []).append(column)
    for name, cells in texts.items():
        if (which := _JOINT_NAME.search(name)) is None:
            continue
        joints = cells.str.strip_chars().drop_nulls().unique().to_list()
        if len(joints) > 1:
            raise TraceError(
                f"{path}: {name!r} names several joints, {joints[0]!r}, {joints[1]!r}: only one per column is read"
            )
        found |= {column: joint for joint in joints for column in numbered.get(which[1], [])}
    return found


def _encoding(raw: bytes) -> str:
    try:
        raw.decode("utf-8")
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"


def _twincat(head: list[str]) -> bool:
    return any(line.startswith("SampleTime[") for line in head)


def _layout(head: list[str], path: Path) -> dict[str, Any]:
    """Separator, decimal mark, header line and first line of numbers: the reading with most columns of numbers."""
    best: tuple[int, int, dict[str, Any]] | None = None
    for separator in SEPARATORS:
        for decimal in (".", ","):
            if decimal == separator:
                continue
            shape = [_numeric(line, separator, decimal) for line in head]
            start = _start(shape)
            if start is None:
                continue
            fields, numbers = shape[start][0], sum(count for _, count in shape[start:] if count > 0)
            if fields > MAX_COLUMNS:
                raise TraceError(f"{path}: {fields} columns, at most {MAX_COLUMNS} are read")
            found = {"separator": separator, "decimal": decimal, **_header(head, separator, decimal, start, fields)}
            if mark := _thousands(head[start:], separator, decimal):
                found["thousands"] = mark
            plain = -sum("." in line and decimal == "," for line in head[start : start + RUN])
            if best is None or (numbers, plain) > best[:2]:
                best = numbers, plain, found
    if best is None:
        raise TraceError(f"{path}: no table of numbers in its first {len(head)} lines")
    return best[2]


def _numeric(line: str, separator: str, decimal: str) -> tuple[int, int]:
    """Fields of a line, and how many of them are numbers, or a date. None is text: (fields, -1)."""
    fields = _fields(line, separator)
    numbers = texts = words = 0
    for field in fields:
        if field in MISSING:
            continue
        try:
            float(_plain(field, separator, decimal).replace(decimal, "."))
            numbers += 1
        except ValueError:
            texts += not _flag_or_date(field)
            words += _WORD.match(field) is not None
    most = len(fields) // (3 if words == texts else 4)  # joints may be named in each row
    return len(fields), numbers if texts <= most and numbers else -1


def _plain(field: str, separator: str, decimal: str) -> str:
    """A number without the marks between its groups of three digits, where it has some beside a decimal mark, or
    several; anything else as it is."""
    for mark in THOUSANDS:
        if mark not in (separator, decimal) and mark in field:
            whole, _, part = field.lstrip("+-").partition(decimal)
            groups = whole.split(mark)
            grouped = 1 <= len(groups[0]) <= 3 and all(len(group) == 3 for group in groups[1:])
            if grouped and (part or len(groups) > 2) and "".join([*groups, part]).isdigit():
                return field.replace(mark, "")
    return field


def _thousands(lines: list[str], separator: str, decimal: str) -> str | None:
    """The mark between groups of three digits in a table's lines; None where there is none."""
    fields = [field for line in lines for field in _fields(line, separator)]
    marked = [field for field in fields if _plain(field, separator, decimal) != field]
    marks = [mark for mark in THOUSANDS if mark not in (separator, decimal)]
    return next((mark for mark in marks if any(mark in field for field in marked)), None)


def _later_thousands(raw: bytes, found: Mapping[str, Any]) -> str | None:
    """The mark between groups of three digits, where the first number that has one stands further down."""
    point, begin = re.escape(found["decimal"].encode()), 0
    for _ in range(found.get("data_line", found["header_line"] + 1) - 1):
        begin = raw.find(b"\n", begin) + 1
    for mark in THOUSANDS:
        first = raw.find(mark.encode(), begin)
        if mark not in (found["separator"], found["decimal"]) and first >= 0:
            form = rb"(?<![\d.,' ])\d{1,3}(?:%b\d{3})+%b\d" % (re.escape(mark.encode()), point)
            if re.compile(form).search(raw, max(first - 3, begin)):
                return mark
    return None


def _flag_or_date(field: str) -> bool:
    days = re.match(DAY, field) is not None
    return days or field.lower() in ("true", "false") or (":" in field and field[:1].isdigit())


def _fields(line: str, separator: str) -> list[str]:
    fields = [field.strip().strip('"') for field in line.split(separator)]
    while len(fields) > 1 and fields[-1] == "":  # a separator behind the last field
        fields.pop()
    return fields


def _start(shape: list[tuple[int, int]]) -> int | None:
    """Index of the first line of numbers that goes on as long as a table does."""
    for start, (fields, numbers) in enumerate(shape):
        run = [s for s in shape[start : start + RUN] if s[1] > 0]
        if numbers > 0 and len(run) >= min(RUN, max(2, len(shape) - start - 1)):
            if fields == 1 and numbers == 1 and any(f > 1 for f, _ in run):
                continue
            return start
    return None


def _header(head: list[str], separator: str, decimal: str, start: int, fields: int) -> dict[str, int]:
    """Line of the names, from 1 (0: none), and of the first numbers: names stand on the first line of as many fields
    in the block above the numbers, blank lines aside."""
    named = 0
    if _twincat(head):  # comments of which most are empty stand between names and numbers
        named = max((k for k, line in enumerate(head[:start], 1) if line.startswith("Name")), default=0)
        return {"header_line": named, "data_line": start + 1}
    for index in range(start - 1, -1, -1):
        if not head[index].strip():
            if named:
                break
            continue
        count = len(_fields(head[index], separator))
        if count < max(2, fields - 1) and fields > 1:
            break
        named = index + 1
    found = {"header_line": named}
    if start + 1 != named + 1:
        found["data_line"] = start + 1
    return found


def _unique(name: str, taken: Mapping[str, object]) -> str:
    if name not in taken:
        return name
    return next(n for k in range(2, MAX_COLUMNS + 2) if (n := f"{name} ({k})") not in taken)


def _plain_numbers(cells: pl.DataFrame, decimal: str) -> dict[str, np.ndarray]:
    """The columns that are numbers, all at once: a table may have thousands."""
    values = cells.select(_as_number(pl.all(), decimal))
    filled, known = (frame.select(pl.all().count()).row(0) for frame in (cells, values))
    return {
        name: values[name].to_numpy()
        for name, all_, numbers in zip(cells.columns, filled, known, strict=True)
        if all_ and numbers >= 0.5 * all_
    }


def _as_number(text: pl.Expr, decimal: str) -> pl.Expr:
    lower = text.str.strip_chars().str.to_lowercase().replace({"true": "1", "false": "0"})
    return lower.str.replace(decimal, ".", literal=True).cast(pl.Float64, strict=False)


def numbers_of(cells: pl.Series, decimal: str, epoch_ns: int = 0) -> tuple[np.ndarray | None, str, int]:
    """A column as float64, its unit where it is dates (`datetime`), and what those count from; None where it is text.

    epoch_ns: what dates have to count from, ns since 1970; 0: from their first.
    """
    table = pl.DataFrame({"text": cells.str.strip_chars()})
    values = table.select(_as_number(pl.col("text"), decimal)).to_series()
    filled = len(table) - table["text"].null_count()
    if filled and values.count() >= 0.5 * filled:
        return values.to_numpy(), "", epoch_ns
    if table["text"].str.contains(":", literal=True).sum() < 0.5 * filled or not filled:  # a time of day has them
        return None, "", epoch_ns
    dates = table.select(date_times(pl.col("text"))).to_series()
    if dates.count() >= 0.5 * filled:
        epoch_ns = epoch_ns or int(dates.drop_nulls()[0])
        return ((dates - epoch_ns).cast(pl.Float64) / NANOSECONDS).to_numpy(), "datetime", epoch_ns
    return None, "", epoch_ns
