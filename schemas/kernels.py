"""How a kernel is compiled: `@kernel` before it, `@kernel(nogil=True)`, or `@part`; and how it is kept.

A kept kernel that is not whole is made anew, and one that cannot be kept is made for this process alone: either is said
once. Each carries a checksum, since what is loaded is machine code.
"""

import hashlib
import os
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from schemas.kernel_cache import kept_in  # noqa: F401 - before Numba, which reads the place then

from numba import njit  # isort: skip
from numba.core.caching import IndexDataCacheFile  # isort: skip

_SUM = hashlib.sha256().digest_size
_said: set[str] = set()


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Numba's `njit`, cached, and without what would let C call it, which takes a tenth of the time to compile."""
    flags: dict[str, Any] = {"cache": True, "no_cfunc_wrapper": True} | options
    if function is None:
        return lambda given: kernel(given, **options)
    compiled = njit(**flags)(function)
    kept = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if isinstance(kept, IndexDataCacheFile):
        kept.__class__ = _Kept
    return compiled


def part(function: Callable[..., Any]) -> Any:
    """A kernel that only passes on to others, for one caller: it is compiled as a part of that. The machine code of a
    kernel holds all that it calls, which would be compiled once more for each of these that lies in between."""
    return kernel(function, inline="always")


class _Kept(IndexDataCacheFile):
    """Numba's files of one kernel, with a checksum behind each machine code."""

    def load(self, key: Any) -> Any:
        try:
            return super().load(key)
        except Exception as error:  # whatever a damaged file does to pickle
            for path in (self._index_path, *self._codes()):
                with suppress(OSError):
                    os.unlink(path)
            why = error or type(error).__name__
            _say(f"{self._cache_path}: compiled kernels are damaged ({why}): they are compiled again")
            return None

    def save(self, key: Any, data: Any) -> None:
        try:
            super().save(key, data)
        except OSError as error:
            _say(
                f"{self._cache_path}: compiled kernels cannot be stored ({error.strerror}): they are compiled for this "
                "run only"
            )

    def _load_data(self, name: str) -> Any:
        with open(self._data_path(name), "rb") as file:
            content = file.read()
        if hashlib.sha256(content[:-_SUM]).digest() != content[-_SUM:]:
            raise ValueError("checksum of " + name)
        return pickle.loads(content[:-_SUM])

    def _save_data(self, name: str, data: Any) -> None:
        content = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(content + hashlib.sha256(content).digest())

    def _codes(self) -> list[str]:
        stem = self._data_name_pattern.split("{")[0]
        names = os.listdir(self._cache_path) if os.path.isdir(self._cache_path) else []
        return [os.path.join(self._cache_path, name) for name in names if name.startswith(stem) and ".nbc" in name]


def _say(line: str) -> None:
    """Once a process, of each kind."""
    kind = line.rpartition("): ")[2]
    if kind not in _said:
        _said.add(kind)
        print(line, file=sys.stderr)
