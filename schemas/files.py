"""Files on disk: read within limits, written whole. Every reader and writer of a file goes through here.

Limits are there for files that are not what they claim to be; each stands far above the largest honest one, and its
error names file and limit.
"""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path

from schemas.errors import DeltatwinError, StorageError

MIB = 1 << 20
MAX_LOG_BYTES = 8 << 30  # of samples, unpacked: an hour at 8 kHz is 5 GB as our CSV, 5.7 GB as messages
MOST_SAMPLES = 40_000_000  # of three joints in that: 200 bytes each as messages, 174 as CSV
MAX_EXPANSION = 100  # times its size that a packed log may unpack to: measured ones give 3 to 20, bombs 1000
FREE_EXPANSION_BYTES = 64 * MIB  # that any may unpack to: a small log of a robot at rest packs well
PART = ".part-"  # in front of the name of a file that is not complete, and of a number
MOST_NAME = 200  # letters of a file's own name in that: file systems end at 255 bytes
_MADE: list[Path] = []  # by `make_folder`, outer before inner


def opened(path: Path, error: type[DeltatwinError]) -> BufferedReader:
    """`path` opened to be read.

    Raises:
        error: there is no such file, it cannot be read, or it is a device or pipe, which have no end.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode) and not path.is_dir():  # before it is opened: a pipe would wait
            raise error(f"{path}: not a file")
        return path.open("rb")
    except (OSError, ValueError) as cause:  # ValueError: a zero byte in the name
        raise error(f"{path}: {getattr(cause, 'strerror', cause)}") from cause


def read_bytes(path: Path, limit: int, error: type[DeltatwinError]) -> bytes:
    """The whole of a file.

    Raises:
        error: it cannot be read, or has more than `limit` bytes.
    """
    with opened(path, error) as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > limit:
            raise error(f"{path}: {size} bytes, at most {limit} are read")
        try:
            return stream.read(size)  # not `limit`: memory is taken for what is asked
        except OSError as cause:
            raise error(f"{path}: {cause.strerror}") from cause


def most_unpacked(packed: int) -> int:
    """Bytes that `packed` bytes of a compressed log may unpack to before they are taken for a bomb."""
    return min(MAX_LOG_BYTES, max(FREE_EXPANSION_BYTES, MAX_EXPANSION * packed))


@contextmanager
def whole(path: Path, mode: int = 0o666, links: bool = True) -> Iterator[Path]:
    """A file to write to that becomes `path` once it is complete and on disk; before, and on any error, `path` is as
    it was. Its name beforehand cannot be told, and nothing that is there already is written to.

    mode: of a new file, less what the process masks. links: a link at `path` stays one, and what it leads to is
    written; otherwise the file takes its place.

    Raises:
        StorageError: it cannot be written.
    """
    target = Path(os.path.realpath(path)) if links else Path(os.path.realpath(path.parent)) / path.name
    partial = target.parent / f"{PART}{secrets.token_hex(8)}-{target.name[-MOST_NAME:]}"
    try:
        if (target.exists() and not target.is_file()) or (target.is_symlink() and not links and target.is_dir()):
            raise StorageError(f"{path}: exists and is not a file")
        os.close(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0), mode))
        yield partial
        with partial.open("rb+") as written:  # Windows syncs only what may be written
            os.fsync(written.fileno())
        partial.replace(target)
    except OSError as error:
        raise StorageError(f"{path}: {error.strerror or error}") from error
    finally:
        with suppress(OSError):  # a read-only disk refuses this even where there is nothing
            partial.unlink(missing_ok=True)


def name_of(partial: Path) -> str:
    """The name that a file which `whole` made will have."""
    name = partial.name
    return name.removeprefix(PART)[17:] if name.startswith(PART) else name


def write_text(path: Path, text: str) -> None:
    """Write a whole text file.

    Raises:
        StorageError: it cannot be written.
    """
    with whole(path) as partial:
        partial.write_text(text, encoding="utf-8")


def make_folder(path: Path) -> None:
    """Make a folder for what is written later, so that a long computation is not lost.

    Raises:
        StorageError: it cannot be made, or nothing can be written in it.
    """
    missing = [one for one in (path, *path.parents) if not one.exists()]
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{path}: {error.strerror}") from error
    finally:
        _MADE.extend(one.absolute() for one in reversed(missing) if one.is_dir())
    check_folder(path)


def remove_unused_folders() -> None:
    """Remove the folders that `make_folder` has made and into which nothing was written."""
    while _MADE:
        with suppress(OSError):  # it is not empty, or not there any more
            _MADE.pop().rmdir()


def check_apart(path: Path, *inputs: Path) -> None:
    """
    Raises:
        StorageError: the file that is to be written is one of those that are read, or it is a folder.
    """
    if path.is_dir():
        raise StorageError(f"{path}: exists and is not a file")
    if path.resolve() in (one.resolve() for one in inputs):
        raise StorageError(f"{path}: is an input file; give another name to write to")


def check_distinct(*outputs: Path | None) -> None:
    """
    Raises:
        StorageError: two results of one command would be one file.
    """
    paths = [path for path in outputs if path is not None]
    for number, path in enumerate(paths):
        if path.resolve() in (one.resolve() for one in paths[:number]):
            raise StorageError(f"{path}: is named for two results; give each a name of its own")


def check_folder(path: Path) -> None:
    """
    Raises:
        StorageError: there is no such folder, or nothing can be written in it.
    """
    if not path.is_dir():
        raise StorageError(f"{path}: no such folder")
    if not os.access(path, os.W_OK | os.X_OK):
        raise StorageError(f"{path}: cannot be written")
