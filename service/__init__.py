"""What does it mean?

Compiled kernels are cached under a digest of all sources of this room: Numba's own key is the one file a kernel is
written in, so after a change to a function that it calls from another file, it would go on running the old one.
"""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path

_ROOM = Path(__file__).parent


def _digest() -> str:
    sources = hashlib.sha256()
    for path in sorted(_ROOM.rglob("*.py")):
        sources.update(path.read_bytes())
    return sources.hexdigest()[:16]


if not os.environ.get("NUMBA_CACHE_DIR"):
    _root = _ROOM if os.access(_ROOM, os.W_OK) else Path.home() / ".cache" / "deltatwin"
    _folder = str(_root / "__pycache__" / f"kernels-{_digest()}")
    os.environ["NUMBA_CACHE_DIR"] = _folder  # Numba reads it when it is imported, which commands like --help never do
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = _folder
