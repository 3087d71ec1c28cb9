"""Progress on a terminal: bars, and a live line for a loop that cannot afford one, which counts in shared memory while
another process draws."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from service.cli.output import console
from service.cli.terminal import above_a_bar
from service.stopping import ENDING

if TYPE_CHECKING:
    from rich.progress import Progress

REFRESH_S = 0.25


def bars() -> Progress:
    """Bars that go away at the end. Draws only on a terminal."""
    from rich.progress import Progress

    screen = console(stderr=True)
    return Progress(console=screen, transient=True, disable=not screen.is_terminal)


@contextmanager
def counting(title: str, total: int) -> Iterator[Callable[[int], None]]:
    """Yield a function that takes how many samples are done, of `total` (0: no end). Draws only on a terminal."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    import multiprocessing

    context = multiprocessing.get_context("spawn")  # a fork would take the session's threads and locks along
    done = context.Value("q", 0, lock=False)
    running = context.Value("b", 1, lock=False)
    drawing = context.Process(target=_draw, args=(title, total, done, running, os.getpid()), daemon=True)
    # A terminal's Ctrl-C goes to that process too: it has nothing to say about it, while it loads as little as later.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING) if hasattr(signal, "pthread_sigmask") else None
    try:
        drawing.start()
    finally:
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    def show(count: int) -> None:
        done.value = count

    try:
        with above_a_bar():
            yield show
    finally:
        running.value = 0
        drawing.join()


def _draw(title: str, total: int, done, running, parent: int) -> None:
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = [TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()]
    if total:
        columns.append(TimeRemainingColumn())
    with Progress(*columns, console=console(stderr=True), auto_refresh=False) as progress:
        task = progress.add_task(title, total=total or None)
        more = True
        while more:
            more = bool(running.value) and os.getppid() == parent
            progress.update(task, completed=done.value, refresh=True)
            if more:
                time.sleep(REFRESH_S)
