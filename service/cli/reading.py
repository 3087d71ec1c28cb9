"""Traces for commands that pass over many files: read one by one, with progress, what is wrong with them told."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from schemas.axes import Description
    from schemas.trace import Trace

ColumnsFrom = Annotated[
    str | None,
    typer.Option(
        "--columns",
        metavar="FILE|NAME",
        help="Column mapping of a foreign table: a TOML file (`deltatwin import` writes one), or emps, twincat_scope.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
OwnEffects = Annotated[
    Path | None, typer.Option("--effects", metavar="FILE", help="Python file with effects of your own")
]


def reading(paths: Sequence[Path], robot: Description | None, columns: str | None, title: str) -> Iterator[Trace]:
    """Yield the trace of each of `paths`; its findings go to stderr, and a progress bar where that is a terminal.

    Raises:
        TraceError: a trace is unusable. RobotError: the column mapping is.
    """
    from rich.console import Console
    from rich.progress import track

    from drivers.trace import find_columns, read_trace

    mapping = find_columns(columns) if columns else None
    console = Console(stderr=True)
    for path in track(paths, title, console=console, transient=True, disable=not console.is_terminal):
        trace = read_trace(path, robot, mapping)
        for finding in trace.findings:
            console.print(f"{path}: {finding.message}", highlight=False, markup=False, soft_wrap=True)
        yield trace
