"""Traces for commands that pass over many files: read one by one, with progress, what is wrong with them told."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from service.cli.output import console

if TYPE_CHECKING:
    from schemas.axes_description import Description
    from schemas.trace import Trace


def reading(paths: Sequence[Path], robot: Description | None, columns: str | None, title: str) -> Iterator[Trace]:
    """Yield the trace of each of `paths`; its findings go to stderr, and a progress bar where that is a terminal.

    Raises:
        TraceError: a trace is unusable. RobotError: the column mapping is.
    """
    from drivers.trace import find_columns, read_trace

    mapping = find_columns(columns) if columns else None
    screen = console(stderr=True)
    shown: Iterable[Path] = paths
    if screen.is_terminal:
        from rich.progress import track  # a tenth of a short command's time

        shown = track(paths, title, console=screen, transient=True)
    for path in shown:
        trace = read_trace(path, robot, mapping)
        for finding in trace.findings:
            screen.print(f"{path}: {finding.message}", highlight=False, markup=False, soft_wrap=True)
        yield trace
