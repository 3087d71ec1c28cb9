"""What is said? Messages, Zenoh keys, robot description, trace, diagnosis document.

Also, because every other room imports this one first: compiled kernels are cached under a digest of all sources that
kernels are made of. Numba's own key is the one file a kernel is written in, so after a change to a function or constant
that it takes from another file it would go on running the old one.
"""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path

_HERE = Path(__file__).parent
KERNEL_ROOMS = ("drivers", "schemas", "service/estimator", "service/model")  # kernels, and all that they import


def _digest() -> str:
    sources = hashlib.sha256()
    for room in KERNEL_ROOMS:
        for path in sorted((_HERE.parent / room).rglob("*.py")):
            sources.update(path.read_bytes())
    return sources.hexdigest()[:16]


if not os.environ.get("NUMBA_CACHE_DIR"):
    _root = _HERE if os.access(_HERE, os.W_OK) else Path.home() / ".cache" / "deltatwin"
    _folder = str(_root / "__pycache__" / f"kernels-{_digest()}")
    os.environ["NUMBA_CACHE_DIR"] = _folder  # Numba reads it when it is imported, which commands like --help never do
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = _folder
