"""Where results go: to a terminal as wide as it is, anywhere else as wide as they are."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

PIPED_WIDTH = 1000  # characters: wider than any of our tables, so that what is piped is never wrapped or cut


def as_json(name: str, document: Mapping[str, Any]) -> str:
    """A result for other programs: schema `deltatwin.<name>/1`, arrays of NumPy as lists, NaN as null."""
    text = json.dumps(
        {"schema": f"deltatwin.{name}/1"} | dict(document), indent=1, default=lambda value: value.tolist()
    )
    return json.dumps(json.loads(text, parse_constant=lambda _: None), indent=1)


def console() -> Console:
    """Of standard output, for results; progress goes to `Console(stderr=True)`."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else PIPED_WIDTH)
