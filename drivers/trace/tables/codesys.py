"""CODESYS traces as its editor saves them: .trace and .xml, .csv (a block a variable), .txt (a table).

Each variable has stamps of its own, counted from the start of the trace in ms, or in µs where the trace says so.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree.ElementTree import ParseError

import numpy as np
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from drivers.trace.tables import Table, padded
from schemas.errors import TraceError
from schemas.files import MIB, read_bytes

MAX_BYTES = 1024 * MIB
MICROSECONDS = 32  # bit of `Flags` in the CSV
FIRST_LINE = "[key]; [value]"  # of the CSV
_FLAGS = re.compile(r"[0-9]{0,20}")
_VARIABLE = re.compile(r"^\d+\.Variable;\s*(.*)$")


def read(path: Path) -> Table:
    """A .trace or .xml.

    Raises:
        TraceError: not XML, not a trace, or without recorded values.
    """
    raw = read_bytes(path, MAX_BYTES, TraceError)
    try:
        root = fromstring(raw)
    except (ParseError, DefusedXmlException, ValueError, LookupError) as error:
        raise TraceError(f"{path}: not XML: {error}") from error
    micro = any(
        node.get("Name") == "MicroSeconds" and (node.text or "").strip().lower() == "true" for node in root.iter()
    )
    blocks = {}
    for node in root.iter("TraceVariable"):
        values, stamps = (_numbers((node.findtext(tag) or "").split(","), path) for tag in ("Values", "Timestamps"))
        if len(values) != len(stamps):
            raise TraceError(f"{path}: {node.get('VarName')}: {len(values)} values with {len(stamps)} stamps")
        if len(values):
            blocks[node.get("VarName") or str(len(blocks) + 1)] = stamps, values
    return _table(path, blocks, micro)


def read_csv(path: Path, text: str) -> Table:
    """The CSV.

    Raises:
        TraceError: without recorded values.
    """
    blocks: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    micro, name, rows = False, "", []

    def close() -> None:
        if name and rows:
            stamps, values = zip(*rows, strict=True)
            blocks[name] = _numbers(stamps, path), _numbers(values, path)

    for line in text.splitlines():
        if line.startswith(";"):
            parts = [part.strip() for part in line[1:].split(";")]
            if len(parts) >= 2:
                rows.append((parts[0], parts[1]))
        elif match := _VARIABLE.match(line):
            close()
            name, rows = match[1].strip(), []
        elif line.startswith("Flags;"):
            flags = line.partition(";")[2].strip()
            if not _FLAGS.fullmatch(flags):  # they say the unit of the stamps
                raise TraceError(f"{path}: Flags is not a number: {flags[:20]!r}")
            micro = bool(int(flags or 0) & MICROSECONDS)
    close()
    return _table(path, blocks, micro)


def _numbers(texts: list[str] | tuple[str, ...], path: Path) -> np.ndarray:
    words = {"true": "1", "false": "0"}
    try:
        return np.array([float(words.get(t.strip().lower(), t)) for t in texts if t.strip()], np.float64)
    except ValueError as error:
        raise TraceError(f"{path}: {error}") from error


def _table(path: Path, blocks: dict[str, tuple[np.ndarray, np.ndarray]], micro: bool) -> Table:
    unit = "us" if micro else "ms"
    if not blocks:
        raise TraceError(f"{path}: a CODESYS trace without recorded values; save it after the recording")
    first = next(iter(blocks.values()))[0]
    columns: dict[str, np.ndarray] = {"time": first}
    units, time_of = {"time": unit}, {}
    for name, (stamps, values) in blocks.items():
        clock = "time"
        if not np.array_equal(stamps, first):
            clock = f"{name} time"
            columns[clock], units[clock] = stamps, unit
        columns[name], time_of[name] = values, clock
    return Table(path, "CODESYS trace", padded(columns), units, time_of)
