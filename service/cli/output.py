"""What commands print. Results go to a terminal as wide as it is, anywhere else as wide as they are."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from rich.console import Console
    from rich.table import Table

PIPED_WIDTH = 1000  # characters: wider than any of our tables, so that what is piped is never wrapped or cut
QUANTILES = {"median": 0.5, "p99": 0.99, "p99.9": 0.999, "max": 1.0}


def as_json(name: str, document: Mapping[str, Any]) -> str:
    """A result for other programs: schema `deltatwin.<name>/1`, arrays of NumPy as lists, NaN as null."""
    text = json.dumps(
        {"schema": f"deltatwin.{name}/1"} | dict(document), indent=1, default=lambda value: value.tolist()
    )
    return json.dumps(json.loads(text, parse_constant=lambda _: None), indent=1)


def console(stderr: bool = False) -> Console:
    """Of standard output, for results, or of standard error, for progress."""
    from rich.console import Console

    return Console(stderr=stderr, width=None if stderr or sys.stdout.isatty() else PIPED_WIDTH)


def say(text: str) -> None:
    """A line of a result, with rich's markup in it."""
    console().print(text, highlight=False, soft_wrap=True)


def table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]] = (),
    title: str = "",
    caption: str = "",
    figures: slice = slice(1, None),
    bare: bool = False,
) -> Table:
    """A table of `rows`. figures: columns that hold figures, which stand at the right. bare: no lines, no wraps."""
    from rich.table import Table

    made = Table(title=title or None, caption=caption or None)
    if bare:
        made = Table(box=None, pad_edge=False, header_style="dim")
    right = range(len(head))[figures]
    for place, heading in enumerate(head):
        made.add_column(heading, justify="right" if place in right else "left", no_wrap=bare)
    for row in rows:
        made.add_row(*row)
    return made


def quantiles(nanoseconds: np.ndarray) -> dict[str, float]:
    """The `QUANTILES` of (N,) ns, in µs."""
    import numpy as np

    found = np.quantile(nanoseconds, list(QUANTILES.values())) * 1e-3
    return dict(zip(QUANTILES, found.tolist(), strict=True))


def in_quantiles(nanoseconds: np.ndarray, decimals: int = 1) -> str:
    """The `quantiles` as text."""
    return ", ".join(f"{name} {value:.{decimals}f}" for name, value in quantiles(nanoseconds).items()) + " µs"
