"""Text tables: separator, decimal mark, header and encoding are found from what is there.

Nothing is guessed that the next reader of the file could not check: what was found is `Table.layout`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drivers.data_frames import pl
from drivers.trace.csv_file import MISSING, date_times, load, read_cells
from drivers.trace.tables import Table
from drivers.trace.tables.codesys import FIRST_LINE as CODESYS_CSV
from drivers.trace.tables.codesys import read_csv as read_codesys
from schemas.columns import MAX_COLUMNS, Columns
from schemas.errors import TraceError
from schemas.messages import NANOSECONDS

LOOKED_AT = 400  # lines from the top in which the numbers have to begin
RUN = 8  # lines of one shape that make a table, fewer only where the file ends
SEPARATORS = ("\t", ";", ",", " ", "|")
UNIT_WORDS = frozenset({
    "s", "ms", "us", "µs", "ns", "rad", "deg", "°", "m", "mm", "nm", "n", "n m", "n*m", "a", "ma", "v", "%", "‰", "inc",
    "rev", "turns", "counts", "rad/s", "deg/s", "°/s", "m/s", "mm/s", "rpm", "1/min", "hz", "°c", "k", "w", "bar", "kg",
})  # fmt: skip


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
    columns = Columns.model_validate({**found, "position": "-", "torque": "--"})
    units = _units(head, columns)
    symbols = next((_fields(line, columns.separator) for line in head if line.startswith("SymbolName")), [])
    names, cells = read_cells(raw, columns, path)
    values: dict[str, np.ndarray] = {}
    kept_units: dict[str, str] = {}
    time_of: dict[str, str] = {}
    paths: dict[str, str] = {}
    clock, epoch_ns = "", 0
    for index, name in enumerate(names):
        name = _unique(name, values)
        array, unit, epoch_ns = numbers_of(cells[str(index)], columns.decimal, epoch_ns)
        if array is None:
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
    kind = "TwinCAT Scope export" if _twincat(head) else "table with a header" if columns.header_line else "table"
    return Table(path, kind, values, kept_units, time_of, epoch_ns, found, paths)


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
            plain = -sum("." in line and decimal == "," for line in head[start : start + RUN])
            if best is None or (numbers, plain) > best[:2]:
                best = numbers, plain, found
    if best is None:
        raise TraceError(f"{path}: no table of numbers in its first {len(head)} lines")
    return best[2]


def _numeric(line: str, separator: str, decimal: str) -> tuple[int, int]:
    """Fields of a line, and how many of them are numbers, or a date. None is text: (fields, -1)."""
    fields = _fields(line, separator)
    numbers = texts = 0
    for field in fields:
        if field in MISSING:
            continue
        try:
            float(field.replace(decimal, "."))
            numbers += 1
        except ValueError:
            texts += not _flag_or_date(field)
    return len(fields), numbers if texts <= len(fields) // 4 and numbers else -1


def _flag_or_date(field: str) -> bool:
    return field.lower() in ("true", "false") or (":" in field and field[:1].isdigit())


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


def _units(head: list[str], columns: Columns) -> dict[int, str]:
    """Units that stand on a line between names and numbers, by the index of their column."""
    for line in head[columns.header_line : columns.first_line - 1]:
        cells = [cell.strip("[]() ").lower() for cell in _fields(line, columns.separator)]
        if cells and sum(cell in UNIT_WORDS for cell in cells) > len(cells) // 2:
            return {index: cell for index, cell in enumerate(cells) if cell in UNIT_WORDS}
    return {}


def _unique(name: str, taken: Mapping[str, object]) -> str:
    return next(n for n in (name, *(f"{name} ({k})" for k in range(2, MAX_COLUMNS + 2))) if n not in taken)


def numbers_of(cells: pl.Series, decimal: str, epoch_ns: int = 0) -> tuple[np.ndarray | None, str, int]:
    """A column as float64, its unit where it is dates (`datetime`), and what those count from; None where it is text.

    epoch_ns: what dates have to count from, ns since 1970; 0: from their first.
    """
    text = cells.str.strip_chars()
    lower = text.str.to_lowercase().replace({"true": "1", "false": "0"})
    values = lower.str.replace(decimal, ".", literal=True).cast(pl.Float64, strict=False)
    filled = len(text.drop_nulls())
    if filled and values.count() >= 0.5 * filled:
        return values.to_numpy(), "", epoch_ns
    dates = pl.DataFrame({"text": text}).select(date_times(pl.col("text"))).to_series()
    if filled and dates.count() >= 0.5 * filled:
        epoch_ns = epoch_ns or int(dates.drop_nulls()[0])
        return ((dates - epoch_ns).cast(pl.Float64) / NANOSECONDS).to_numpy(), "datetime", epoch_ns
    return None, "", epoch_ns
