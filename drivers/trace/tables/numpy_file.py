"""NumPy arrays: .npy (columns called 1, 2, ..., or by their fields; of a single one `row`, from 0, and `value`), and
.npz (an array a name)."""

from __future__ import annotations

import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np

from drivers.trace.tables import Table, spread
from schemas.errors import TraceError
from schemas.files import MAX_LOG_BYTES, most_unpacked, opened


def read(path: Path) -> Table:
    """
    Raises:
        TraceError: not a NumPy file, pickled objects, or arrays of no equal length.
    """
    kind = f"NumPy {path.suffix}"
    try:
        with opened(path, TraceError) as stream:
            if path.suffix.lower() == ".npz":
                arrays = _archive(path)
            else:
                array = np.lib.format.open_memmap(stream.name, mode="r")  # maps what is there, whatever is claimed
                arrays = {name: array[name] for name in array.dtype.names} if array.dtype.names else {"": array}
            columns: dict[str, np.ndarray] = {}
            for name, array in arrays.items():
                if array.dtype.kind in "biuf" and array.ndim in (1, 2) and array.size <= MAX_LOG_BYTES // 8:
                    columns |= spread(name, array)
            if columns.keys() == {""}:
                columns = {"row": np.arange(len(columns[""]), dtype=np.float64), "value": columns[""]}
    except (ValueError, OSError, EOFError, KeyError, MemoryError, OverflowError, SyntaxError, NotImplementedError,
            RuntimeError, zipfile.BadZipFile, zlib.error, tokenize.TokenError) as error:  # fmt: skip
        raise TraceError(f"{path}: not a {kind} of numbers: {error}") from error
    return Table(path, kind, same_length(columns, path))


def _archive(path: Path) -> dict[str, np.ndarray]:
    with zipfile.ZipFile(path) as archive:
        unpacked = sum(entry.file_size for entry in archive.infolist())
    if unpacked > (limit := most_unpacked(path.stat().st_size)):
        raise TraceError(f"{path}: unpacks to {unpacked} bytes, at most {limit} are read")
    with np.load(path, allow_pickle=False) as arrays:
        found = {name: arrays[name] for name in arrays.files}
    return {name: array for name, array in found.items() if isinstance(array, np.ndarray)}  # bytes: no array in it


def same_length(columns: dict[str, np.ndarray], path: Path) -> dict[str, np.ndarray]:
    """The columns as long as the longest; single numbers beside them, constants and settings, are left out.

    Raises:
        TraceError: there are columns of several lengths.
    """
    columns = {name: values for name, values in columns.items() if len(values) > 1}
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{name or 'array'} has {length}" for name, length in list(lengths.items())[:8])
        raise TraceError(f"{path}: columns of different lengths: {told}")
    return columns
