"""How a kernel is compiled: `@kernel` before it, `@kernel(nogil=True)`, or `@part`; and how it is kept.

What other kernels call is compiled without what would let Python call it, a fifth of the time; where Python calls the
same kernel, it is compiled a second time.

A kept kernel that is not whole is made anew, and one that cannot be kept is made for this process alone: either is said
once. Each carries a checksum, since what is loaded is machine code.
"""

import gc
import hashlib
import os
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from schemas.kernel_cache import KERNEL_ROOMS, NAME, kept_in  # before Numba, which reads the place then

from numba import njit  # isort: skip
from numba.core import event, types  # isort: skip
from numba.core.caching import IndexDataCacheFile  # isort: skip
from numba.core.registry import CPUDispatcher  # isort: skip

_ROOT = Path(__file__).parents[1]
# What the digest that names our own folder is of; nothing where kernels are kept in somebody else's.
_BY_CONTENT = tuple(f"{_ROOT / room}{os.sep}" for room in KERNEL_ROOMS) if kept_in().name == NAME else ()
_SUM = hashlib.sha256().digest_size
_said: set[str] = set()


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Numba's `njit`, cached, and without what would let C call it, which takes a tenth of the time to compile.

    A record does not keep the array that it is in: `np.empty(1, TYPE)[0]` in a kernel is memory that is free again. A
    kernel that needs a record of its own takes it from the array wherever it is used.
    """
    if function is None:
        return lambda given: kernel(given, **options)
    compiled = _compiled(function, options)
    if isinstance(compiled, CPUDispatcher):  # not where Numba is told to compile nothing
        compiled.__class__ = _Kernel
    return compiled


def _compiled(function: Callable[..., Any], options: dict[str, Any], ending: str = "") -> Any:
    """ending: of the name under which it is kept."""
    flags: dict[str, Any] = {"cache": True, "no_cfunc_wrapper": True} | options
    compiled = njit(**flags)(function)
    cache: Any = getattr(compiled, "_cache", None)
    kept = getattr(cache, "_cache_file", None)
    if isinstance(kept, IndexDataCacheFile):
        _keep_whole(kept, ending, cache._impl.locator, function.__code__.co_filename)
        cache._cache_path = kept._cache_path  # what `stats` says
    return compiled


def _keep_whole(kept: Any, ending: str, locator: Any, source: str) -> None:
    """Give Numba's files of one kernel their checksum, and `ending` behind their names. In our own folder they are
    known by the digest of all sources, so that they hold wherever these lie and whenever they were written; what a
    user's own file compiles goes by that file, as with Numba."""
    stem, stamp = kept._index_name.removesuffix(".nbi"), kept._source_stamp
    if source.startswith(_BY_CONTENT):
        stamp = NAME
        locator._cache_path = str(kept_in() / os.path.relpath(os.path.dirname(source), _ROOT))
    kept.__class__ = _Kept
    kept.__init__(locator.get_cache_path(), stem + ending, stamp)


class _Kernel(CPUDispatcher):
    """A kernel as Python calls it; `inside` is the same one for other kernels."""

    _inside: Any = None

    @property
    def inside(self) -> Any:
        if self._inside is None:
            options = {key: value for key, value in self.targetoptions.items() if key != "nopython"}
            self._inside = _compiled(self.py_func, options | {"no_cpython_wrapper": True}, "-inside")
        return self._inside

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """What a caller needs to know of this one while it is compiled. A number that is written in the call is one as
        any other: Numba would compile anew for each."""
        plain = [types.unliteral(given) for given in args]
        named = {name: types.unliteral(given) for name, given in kws.items()}
        return self.inside.get_call_template(plain, named)

    def get_overload(self, sig: Any) -> Any:
        return self.inside.get_overload(sig)


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


class _Compiling(event.Listener):
    """While the compiler works, the collector leaves alone what was there before: the compiler makes so many objects
    that all else in the process would be searched over and over, an eighth of the time."""

    def __init__(self) -> None:
        self._depth = 0
        self._frozen = False

    def on_start(self, event: Any) -> None:
        if self._depth == 0 and gc.get_freeze_count() == 0:  # what somebody else froze stays so
            self._frozen = True
            gc.freeze()
        self._depth += 1

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._depth == 0 and self._frozen:
            self._frozen = False
            gc.unfreeze()


event.register("numba:compile", _Compiling())


def _say(line: str) -> None:
    """Once a process, of each kind."""
    kind = line.rpartition("): ")[2]
    if kind not in _said:
        _said.add(kind)
        print(line, file=sys.stderr)
