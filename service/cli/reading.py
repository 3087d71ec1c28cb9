"""Traces for commands that pass over many files: read one by one, with progress, what is wrong with them told."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from service.cli.output import console
from service.cli.terminal import wrapped

if TYPE_CHECKING:
    from schemas.axes_description import Description
    from schemas.trace import Trace


def files_in(*options: str | None) -> list[Path]:
    """What options name that take a file or the name of something that comes with deltatwin."""
    return [Path(one) for one in options if one]


def prediction_files(folder: Path, names: Sequence[str], traces: Sequence[Path], *read: Path) -> list[Path]:
    """A file in `folder` for each of `traces`. names: theirs. read: what the command reads besides.

    Raises:
        StorageError: a file is one that is read. TraceError: two are the same.
    """
    from schemas.errors import TraceError
    from schemas.files import check_apart

    targets = [folder / name for name in names]
    for number, target in enumerate(targets):
        check_apart(target, *traces, *read)
        if target in targets[:number]:
            raise TraceError(f"{traces[number]}: a second log that would be written to {target}")
    return targets


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
            said = f"{path}: {finding.message}"
            said = wrapped(said, screen.width) if screen.is_terminal else said  # above the bar
            screen.print(said, highlight=False, markup=False, soft_wrap=True)
        yield trace
