"""Where results go: to a terminal as wide as it is, anywhere else as wide as they are."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

PIPED_WIDTH = 1000  # characters: wider than any of our tables, so that what is piped is never wrapped or cut


def console() -> Console:
    """Of standard output, for results; progress goes to `Console(stderr=True)`."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else PIPED_WIDTH)
