"""Tables of foreign files: named columns, before anybody has said what they mean. One file a format.

A reader says what the file itself says: names, units where they stand in it, which column stamps which.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from schemas.columns import MAX_COLUMNS
from schemas.errors import TraceError
from schemas.messages import NANOSECONDS
from schemas.units import said_unit, unit_texts, unknown_unit

READERS = {
    ".npy": "numpy_file",
    ".npz": "numpy_file",
    ".mat": "matlab",
    ".json": "records",
    ".jsonl": "records",
    ".ndjson": "records",
    ".db3": "rosbag",
    ".mcap": "rosbag",
    ".bag": "rosbag",
    ".zstd": "rosbag",
    "metadata.yaml": "rosbag",
    ".dat": "diadem",
    ".trace": "codesys",
    ".xml": "codesys",
}  # the file of this folder that reads what ends so; text that is none of these is `text`'s


@dataclass(frozen=True)
class Table:
    """Columns of a file.

    kind: what it is, in words. columns: (N,) float64 by name, in the file's order; NaN where a cell is empty.
    units: what the file says of a column's unit. time_of: the column that stamps a column, where the file says so.
    epoch_ns: what the stamps count from, ns since 1970; 0 where they are as in the file. layout: keys of
    `schemas.columns.Columns` that reading the file again takes. paths: of the controller's variable that a column was.
    """

    path: Path
    kind: str
    columns: Mapping[str, np.ndarray]
    units: Mapping[str, str] = field(default_factory=dict)
    time_of: Mapping[str, str] = field(default_factory=dict)
    epoch_ns: int = 0
    layout: Mapping[str, object] = field(default_factory=dict)
    paths: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.columns:
            raise TraceError(f"{self.path}: {self.kind} without a column of numbers")
        if len(self.columns) > MAX_COLUMNS:
            raise TraceError(f"{self.path}: {len(self.columns)} columns, at most {MAX_COLUMNS} are read")

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def said_unit(self, name: str, known: Mapping[str, str]) -> str | None:
        """The unit of `known` that the file, or the name of the column, gives."""
        return said_unit(name, self.units.get(name, ""), known)

    def unit_texts(self, name: str) -> list[str]:
        """What of the file, or of the name of the column, may be its unit."""
        return unit_texts(name, self.units.get(name, ""))

    def unknown_unit(self, name: str) -> str | None:
        """What the file or the name of the column gives as a unit, and is the unit of nothing that is known."""
        return unknown_unit(name, self.units.get(name, ""))


def read_table(path: Path, layout: Mapping[str, Any] | None = None) -> Table:
    """The columns of a file, or of a folder that is a rosbag2.

    layout: how a text is laid out, and the topic of a bag (`Table.layout`); without it, that is found out.

    Raises:
        TraceError: it cannot be read, is damaged, or no table is in it.
    """
    ending = ".db3" if path.is_dir() else path.name if path.name in READERS else path.suffix.lower()
    if READERS.get(ending) == "rosbag":
        from drivers.trace.tables.rosbag import read as read_bag

        return read_bag(path, (layout or {}).get("topic"))
    if ending in READERS:
        read: Callable[[Path], Table] = import_module(f"{__name__}.{READERS[ending]}").read
        return read(path)
    from drivers.trace.tables.text_table import read

    return read(path, {key: value for key, value in (layout or {}).items() if key != "topic"} or None)


def joined(tables: Sequence[Table], clocks: Sequence[str | None] = ()) -> Table:
    """Files side by side as one: the first one's columns, then those of the others called `file:column`.

    clocks: the column that stamps each file, None where its rows are those of the first.

    Raises:
        TraceError: a file without stamps of its own has not as many rows as the first.
    """
    first, *others = tables
    columns = dict(first.columns)
    units, time_of, paths = dict(first.units), dict(first.time_of), dict(first.paths)
    for number, other in enumerate(others, 1):
        stem = other.path.name.split(".")[0]
        clock = clocks[number] if clocks else None
        if len(other) != len(first) and clock is None:
            raise TraceError(f"{other.path}: {len(other)} rows, but {first.path.name} has {len(first)}")
        later_s = (other.epoch_ns - first.epoch_ns) / NANOSECONDS if first.epoch_ns else 0.0
        for name, values in other.columns.items():
            unit, time = other.units.get(name), other.time_of.get(name, clock)
            columns[f"{stem}:{name}"] = values + later_s if unit == "datetime" else values
            if unit:
                units[f"{stem}:{name}"] = unit
            if name in other.paths:
                paths[f"{stem}:{name}"] = other.paths[name]
            if time and time != name:
                time_of[f"{stem}:{name}"] = f"{stem}:{time}"
    layout = dict(first.layout)
    if others:
        layout["beside"] = [other.path.name for other in others]
    return Table(first.path, first.kind, padded(columns), units, time_of, first.epoch_ns, layout, paths)


def padded(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns of different lengths as columns of the longest one's, NaN behind their ends."""
    longest = max((len(values) for values in columns.values()), default=0)
    return {name: np.concatenate([values, np.full(longest - len(values), np.nan)]) for name, values in columns.items()}


def spread(name: str, values: np.ndarray) -> dict[str, np.ndarray]:
    """An array of one or two dimensions as columns: the longer side is time; `name_1`, `name_2`, ... if several."""
    values = np.asarray(values, np.float64)
    if values.ndim == 1:
        return {name: values}
    rows = values if values.shape[0] >= values.shape[1] else values.T
    if rows.shape[1] == 1:
        return {name: rows[:, 0]}
    prefix = f"{name}_" if name else ""
    return {f"{prefix}{k + 1}": np.ascontiguousarray(rows[:, k]) for k in range(rows.shape[1])}
