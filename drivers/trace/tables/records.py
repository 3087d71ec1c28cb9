"""JSON: a list of records, one such list inside an object, an object of lists, or a record a line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from drivers.data_frames import pl
from drivers.trace.tables import Table
from drivers.trace.tables.numpy_file import same_length
from drivers.trace.tables.text_table import numbers_of
from schemas.columns import MAX_COLUMNS
from schemas.errors import TraceError
from schemas.files import MIB, read_bytes
from schemas.messages import NANOSECONDS

MAX_BYTES = 512 * MIB  # twenty times that in memory
LATE = 1 << 33  # s of a stamp beyond which it is none; ns of its rest are fewer
MAX_DEPTH = 12  # lists and objects in each other; records have three
EMPTY = (
    16  # cells of the table for one with a value in it, beyond a million: records that have next to no key in common
)


def read(path: Path) -> Table:
    """
    Raises:
        TraceError: not JSON, or no records of numbers in it.
    """
    raw = read_bytes(path, MAX_BYTES, TraceError)
    try:
        text = raw.decode("utf-8-sig")
        if path.suffix.lower() == ".json":
            document = json.loads(text)
        else:
            document = [json.loads(line) for line in text.splitlines() if line.strip()]
    except UnicodeDecodeError as error:
        raise TraceError(f"{path}: not a text file (byte {error.start} is not UTF-8)") from error
    except (ValueError, RecursionError) as error:
        raise TraceError(f"{path}: not JSON: {error}") from error
    if _deeper_than(MAX_DEPTH, document):
        raise TraceError(f"{path}: lists or objects nested more than {MAX_DEPTH} deep")
    lists = _lists(document)
    if not lists:
        raise TraceError(f"{path}: no list of records, and no lists of numbers, in this JSON")
    records = max(lists, key=len)
    columns, units, epoch_ns = _columns(records, path)
    return Table(path, "JSON records", same_length(columns, path), units, epoch_ns=epoch_ns)


def _deeper_than(most: int, document: Any) -> bool:
    level = [document]
    for _ in range(most + 1):
        level = (
            [
                inner
                for outer in level
                for inner in (outer.values() if isinstance(outer, dict) else outer)
                if isinstance(inner, (dict, list))
            ]
            if isinstance(level[0], (dict, list))
            else []
        )
        if not level:
            return False
    return True


def _lists(document: Any) -> list[list[dict[str, Any]]]:
    """The lists of records in a document, an object of lists of numbers as one."""
    if isinstance(document, list):
        return [document] if document and all(isinstance(entry, dict) for entry in document) else []
    if not isinstance(document, dict):
        return []
    found = [entry for value in document.values() for entry in _lists(value)]
    series = {key: value for key, value in document.items() if isinstance(value, list) and _numbers(value)}
    if series and not found:
        longest = max(map(len, series.values()))
        found = [[{key: value[k] for key, value in series.items() if k < len(value)} for k in range(longest)]]
    return found


def _numbers(values: list[Any]) -> bool:
    return len(values) > 1 and all(value is None or isinstance(value, (int, float, str, list)) for value in values)


def _columns(records: list[dict[str, Any]], path: Path) -> tuple[dict[str, np.ndarray], dict[str, str], int]:
    """Columns, units and the epoch of dates, as of `Table`.

    Raises:
        TraceError: more columns than are read, or hardly a cell of them with a value.
    """
    cells: dict[str, list[Any]] = {}
    filled = 0
    for k, record in enumerate(records):
        for name, value in _flat("", record):
            filled += 1
            if name not in cells:
                if len(cells) == MAX_COLUMNS or len(cells) * len(records) > EMPTY * filled + 1_000_000:
                    raise TraceError(f"{path}: {len(cells)} keys in {k + 1} of {len(records)} records: no table")
                cells[name] = [None] * len(records)
            cells[name][k] = value
    found: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    epoch_ns = 0
    for name, values in cells.items():
        if all(isinstance(value, _Stamp) for value in values):
            epoch_ns = epoch_ns or values[0]
            found[name], units[name] = np.array([(value - epoch_ns) / NANOSECONDS for value in values]), "s"
            continue
        if not any(isinstance(value, str) for value in values):
            found[name] = np.array(values, np.float64)
            continue
        text = pl.Series([None if value is None else str(value) for value in values], dtype=pl.String)
        array, unit, epoch_ns = numbers_of(text, ".", epoch_ns)
        if array is not None:
            found[name], units[name] = array, unit
    return found, units, epoch_ns


def _flat(name: str, value: Any) -> list[tuple[str, float | str]]:
    """A record's numbers and texts by name: `motor.position_1` for the first of a list inside an object; what names
    itself, or is named by a list beside it, goes by that: `joints.elbow.position`."""
    prefix = f"{name}." if name else ""
    if isinstance(value, dict) and (stamp := _stamp(value)) is not None:
        return [(name or "time", stamp)]
    if isinstance(value, dict):
        called = _called(value)
        if called is None:
            return [pair for key, inner in value.items() for pair in _flat(f"{prefix}{key}", inner)]
        return [
            pair
            for key, inner in value.items()
            if key not in ("name", "names")
            for pair in (
                [p for joint, one in zip(called, inner, strict=True) for p in _flat(f"{prefix}{joint}.{key}", one)]
                if isinstance(inner, list) and len(inner) == len(called)
                else _flat(f"{prefix}{key}", inner)
            )
        ]
    if isinstance(value, list):
        own = [inner.get("name") if isinstance(inner, dict) else None for inner in value]
        named = len(value) > 0 and all(isinstance(one, str) for one in own) and len(set(own)) == len(own)
        labels = [f"{prefix}{one}" for one in own] if named else [f"{name}_{k + 1}" for k in range(len(value))]
        return [pair for label, inner in zip(labels, value, strict=True) for pair in _flat(label, inner)]
    if isinstance(value, str):
        return [(name, value)]
    if isinstance(value, (bool, int, float)) and abs(value) < 1e300:
        return [(name, float(value))]
    return []


class _Stamp(int):
    """ns; float64 would lose the last hundreds of them."""


def _stamp(record: dict[str, Any]) -> _Stamp | None:
    """A record that is whole seconds and the rest, as ROS and Foxglove write stamps."""
    for whole, rest in (("sec", "nsec"), ("sec", "nanosec"), ("secs", "nsecs"), ("seconds", "nanos")):
        seconds, nanoseconds = record.get(whole), record.get(rest)
        if (
            len(record) == 2
            and type(seconds) is int
            and type(nanoseconds) is int
            and abs(seconds) + abs(nanoseconds) < LATE
        ):
            return _Stamp(seconds * NANOSECONDS + nanoseconds)
    return None


def _called(record: dict[str, Any]) -> list[str] | None:
    """Names that a record has for the numbers of its lists, as joint states of ROS do."""
    names = next((record[key] for key in ("name", "names") if isinstance(record.get(key), list)), [])
    called = [one for one in names if isinstance(one, str)]
    return called if len(called) == len(names) == len(set(called)) > 0 else None
