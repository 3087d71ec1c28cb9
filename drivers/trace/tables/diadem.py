"""KUKA traces: a DIAdem header (.dat) that names the channels, and binary files (.r64) beside it that hold them.

Source: National Instruments, DIAdem header file format (keys 200 to 241); KUKA writes EXPLIZIT channels of REAL64 in
blocks, and the time as an IMPLIZIT one, by its step.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from drivers.trace.tables import Table, padded
from schemas.errors import TraceError
from schemas.files import MAX_LOG_BYTES, MIB, read_bytes

NAME, UNIT, KIND, FILE, METHOD, TYPE, COUNT, PLACE, START, STEP = (
    "200", "202", "210", "211", "213", "214", "220", "221", "240", "241",
)  # fmt: skip
TYPES = {"REAL64": "<f8", "REAL32": "<f4", "INT32": "<i4", "INT16": "<i2", "WORD16": "<u2"}
MAX_HEADER_BYTES = 4 * MIB
BEGIN, END = "#BEGINCHANNELHEADER", "#ENDCHANNELHEADER"


def read(path: Path) -> Table:
    """
    Raises:
        TraceError: not such a header, or a file it names is missing or too short.
    """
    text = read_bytes(path, MAX_HEADER_BYTES, TraceError).decode("latin-1")  # what KUKA writes; every byte is a letter
    headers = _headers(text)
    if not headers:
        raise TraceError(f"{path}: no DIAdem header of a KUKA trace ({BEGIN})")
    widths: dict[str, int] = {}
    for header in headers:
        if header.get(KIND, "").upper().startswith("EX") and header.get(METHOD) == "BLOCK":
            widths[header.get(FILE, "")] = widths.get(header.get(FILE, ""), 0) + 1
    columns: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    for header in headers:
        name = header.get(NAME, "")
        try:
            columns[name] = _values(header, widths, path)
        except (ValueError, KeyError, OverflowError) as error:
            raise TraceError(f"{path}: channel {name!r}: {type(error).__name__} {error}") from error
        if header.get(UNIT):
            units[name] = header[UNIT].strip("[] ")
    return Table(path, "KUKA trace", padded(columns), units)


def _headers(text: str) -> list[dict[str, str]]:
    found: list[dict[str, str]] = []
    inside = False
    for line in text.splitlines():
        if line.strip() == BEGIN:
            found.append({})
            inside = True
        elif line.strip() == END:
            inside = False
        elif inside:
            key, _, value = line.partition(",")
            found[-1][key.strip()] = value.strip()
    return found


def _values(header: dict[str, str], widths: dict[str, int], path: Path) -> np.ndarray:
    start, step = float(header.get(START) or 0.0), float(header.get(STEP) or 1.0)
    count = int(header[COUNT])
    if not 0 < count <= MAX_LOG_BYTES // 8:
        raise ValueError(f"{count} values")
    if header[KIND].upper().startswith("IM"):
        return start + step * np.arange(count)
    name = Path(header[FILE].replace("\\", "/")).name  # beside the header, whatever folder it was written in
    source = next((p for p in path.parent.iterdir() if p.name.lower() == name.lower()), path.with_name(name))
    values = np.frombuffer(read_bytes(source, MAX_LOG_BYTES, TraceError), TYPES[header[TYPE]])
    place = int(header.get(PLACE) or 1) - 1
    width = widths[header[FILE]] if header.get(METHOD) == "BLOCK" else 1
    taken = values[place::width] if width > 1 else values[place : place + count]
    if len(taken) < count or place < 0:
        raise ValueError(f"{name} holds {len(taken)} of its {count} values")
    return taken[:count].astype(np.float64) * step + start
