"""MATLAB files up to version 7.2: arrays and structures of arrays, `data_1`, `log.position_1`."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

from drivers.trace.tables import Table, spread
from drivers.trace.tables.numpy_file import same_length
from schemas.errors import TraceError
from schemas.files import MAX_LOG_BYTES, most_unpacked, read_bytes

DEEPEST = 4  # structures in each other
# Data elements of a level 5 MAT-file, of MathWorks' "MAT-File Format"
MATRIX, COMPRESSED = 14, 15
VALUES = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18}
HOLDS_MATRICES = {1, 2, 3}  # array classes: cell, structure, object
PARTS = {4: 4, 5: 6} | dict.fromkeys(range(6, 16), 4)  # of a text, a sparse array, numbers: flags, size, name, values
IS_COMPLEX = 0x800  # in the flags: one part more
DEEPEST_ELEMENT = 40
MOST_ARRAYS = 20_000  # in a file, each a kilobyte in memory however small: a log has an array a signal


def read(path: Path) -> Table:
    """
    Raises:
        TraceError: not such a file, or no arrays of one length in it.
    """
    raw = read_bytes(path, MAX_LOG_BYTES, TraceError)
    if raw[:8] == b"\x89HDF\r\n\x1a\n" or b"MATLAB 7.3" in raw[:128]:
        raise TraceError(f"{path}: a MATLAB 7.3 file (HDF5); in MATLAB: save('{path.stem}.mat', ..., '-v7')")
    limit = most_unpacked(len(raw))
    try:
        if order := {b"IM": "<", b"MI": ">"}.get(raw[126:128]):
            _check_elements(raw, 128, order, {MATRIX, COMPRESSED}, limit, 0, [MOST_ARRAYS])
        claimed = sum(8 * int(np.prod(shape, dtype=float)) for _, shape, _ in scipy.io.whosmat(path))
        if claimed > limit:
            raise TraceError(f"{path}: {claimed} bytes of arrays in it, at most {limit} are read")
        found = scipy.io.loadmat(path, simplify_cells=True)
        columns: dict[str, np.ndarray] = {}
        for name, value in found.items():
            if not name.startswith("__"):
                columns |= _columns(name, value, 0)
    except TraceError:
        raise
    except Exception as error:  # SciPy raises whatever comes of damaged bytes, an UnboundLocalError too
        raise TraceError(f"{path}: not a MATLAB file: {type(error).__name__}: {ascii(str(error))[:200]}") from error
    return Table(path, "MATLAB .mat", same_length(columns, path))


def _check_elements(
    raw: bytes, at: int, order: str, allowed: set[int], limit: int, depth: int, arrays: list[int]
) -> int:
    """How many there are. SciPy crashes the process on data of an unknown type, and takes what follows an array that
    lacks a part for that part. arrays: one number, how many more the file may have.

    Raises:
        ValueError: an element of no type that can stand there, longer than what holds it, or without all its parts.
    """
    if depth > DEEPEST_ELEMENT:
        raise ValueError("elements are nested too deeply")
    count = 0
    while at + 8 <= len(raw):
        kind, size = struct.unpack_from(f"{order}II", raw, at)
        begin = at + 8
        if kind >> 16:  # a small element: size, type and up to four bytes
            kind, size, begin = kind & 0xFFFF, kind >> 16, at + 4
        if kind not in allowed or begin + size > len(raw) or (begin == at + 4 and size > 4):
            raise ValueError(f"element of type {kind} and {size} bytes at byte {at}")
        if kind == COMPRESSED:
            inner = zlib.decompressobj().decompress(raw[begin : begin + size], limit)
            _check_elements(inner, 0, order, {MATRIX}, limit, depth + 1, arrays)
        elif kind == MATRIX and size:
            arrays[0] -= 1
            if arrays[0] < 0:
                raise ValueError(f"more than {MOST_ARRAYS} arrays: cells are not signals")
            inner = raw[begin : begin + size]
            (flags,) = struct.unpack_from(f"{order}I", inner.ljust(12, b"\0"), 8)
            held = VALUES | {MATRIX} if flags & 0xFF in HOLDS_MATRICES else VALUES
            parts = _check_elements(inner, 0, order, held, limit, depth + 1, arrays)
            if parts < PARTS.get(flags & 0xFF, 0) + bool(flags & IS_COMPLEX):
                raise ValueError(f"array of {parts} parts at byte {at}, some are missing")
        count += 1
        at = at + 8 if begin == at + 4 else begin + size + (-size % 8 if kind != COMPRESSED else 0)
    return count


def _columns(name: str, value: Any, depth: int) -> dict[str, np.ndarray]:
    if isinstance(value, dict) and depth < DEEPEST:
        found: dict[str, np.ndarray] = {}
        for key, inner in value.items():
            found |= _columns(f"{name}.{key}", inner, depth + 1)
        return found
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.ndim in (1, 2):
        return spread(name, value)
    return {}
