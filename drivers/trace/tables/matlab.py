"""MATLAB files up to version 7.2: arrays and structures of arrays, `data_1`, `log.position_1`."""

from __future__ import annotations

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
    except (ValueError, TypeError, OSError, EOFError, KeyError, zlib.error, MemoryError, NotImplementedError,
            IndexError, OverflowError, AttributeError, UnicodeError) as error:  # fmt: skip
        raise TraceError(f"{path}: not a MATLAB file: {type(error).__name__}: {error}") from error
    return Table(path, "MATLAB .mat", same_length(columns, path))


def _columns(name: str, value: Any, depth: int) -> dict[str, np.ndarray]:
    if isinstance(value, dict) and depth < DEEPEST:
        found: dict[str, np.ndarray] = {}
        for key, inner in value.items():
            found |= _columns(f"{name}.{key}", inner, depth + 1)
        return found
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.ndim in (1, 2):
        return spread(name, value)
    return {}
