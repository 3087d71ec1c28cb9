"""Where compiled kernels are kept. To be imported before Numba is, which reads it then.

Compiled kernels are cached under a digest of all sources that kernels are made of. Numba's own key is the one file a
kernel is written in, so after a change to a function or constant that it takes from another file it would go on running
the old one. By the same content they are those of any copy: a layer of a container, a fresh clone, a folder that moved.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import stat
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

_HERE = Path(__file__).parent
# Kernels, and all that they import.
KERNEL_ROOMS = ("drivers", "schemas", "service/estimator", "service/model", "service/rollout")


def _digest() -> str:
    sources = hashlib.sha256()
    for room in KERNEL_ROOMS:
        for path in sorted((_HERE.parent / room).rglob("*.py")):
            sources.update(path.read_bytes())
    return sources.hexdigest()[:16]


def _cache_folder() -> Path:
    """Where compiled kernels are kept: beside the sources, in the home, in a temporary folder of this user's alone (who
    can write there can have this process run anything), or else for this process only."""
    home = Path(os.path.expanduser("~"))
    for place in (_HERE / "__pycache__", home / ".cache" / "deltatwin"):
        folder = place / NAME
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK | os.X_OK):
                return folder
    neither = f"compiled kernels can be stored neither in {_HERE} nor in {home}"
    with suppress(OSError):
        own = Path(tempfile.gettempdir()) / f"deltatwin-{os.getuid()}"
        own.mkdir(mode=0o700, exist_ok=True)
        found, folder = own.lstat(), own / NAME
        if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077:
            if not folder.exists():
                folder.mkdir()
                print(f"{neither}: they are stored in {own}", file=sys.stderr)
            return folder
    try:
        folder = Path(tempfile.mkdtemp(prefix="deltatwin-"))
    except OSError as error:
        raise SystemExit(f"{neither} nor in a temporary folder ({error}); set NUMBA_CACHE_DIR to a folder") from error
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    print(f"{neither}: they are compiled for this run only", file=sys.stderr)
    return folder


NAME = f"kernels-{_digest()}"
if not os.environ.get("NUMBA_CACHE_DIR"):
    _folder = str(_cache_folder())
    os.environ["NUMBA_CACHE_DIR"] = _folder  # Numba reads it when it is imported
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = _folder


def kept_in() -> Path:
    """The folder of compiled kernels."""
    return Path(os.environ["NUMBA_CACHE_DIR"])
