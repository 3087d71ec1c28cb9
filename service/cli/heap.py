"""Memory of commands that compute on several threads."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress

M_ARENA_MAX = -8  # of glibc's malloc.h


def share_heap() -> None:
    """Let all threads take memory from one heap, where the C library is glibc.

    With one each, what a thread gives back is free for that thread alone: a tenth of the memory of a diagnosis. Not for
    live commands, whose threads would wait for each other.
    """
    if sys.platform == "linux":
        with suppress(AttributeError):  # another C library
            ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)
