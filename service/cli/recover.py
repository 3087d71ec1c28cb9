"""`deltatwin recover`: Repair an incomplete recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.options import AsJson
from service.cli.output import as_json, console, say_next


def command(
    source: Annotated[
        Path, typer.Argument(metavar="IN", help="Recording whose writer was killed or whose disk was full (.mcap).")
    ],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="Whole file to write; must not exist.")],
    json: AsJson = False,
) -> None:
    """Copy every readable message of a broken MCAP file to a whole one.

    Example: deltatwin recover run.mcap run-whole.mcap
    """
    import os

    import rich.progress

    from schemas.errors import StorageError
    from schemas.files import opened
    from service.monitor.repair import recover

    screen = console(stderr=True)
    with opened(source, StorageError) as raw:
        size = os.fstat(raw.fileno()).st_size
        title, quiet = f"recover {source.name}", not screen.is_terminal
        with rich.progress.wrap_file(raw, size, description=title, console=screen, disable=quiet) as stream:
            saved = recover(source, stream, target)
    if json:
        typer.echo(as_json("recovery", vars(saved) | {"out": str(target)}))
        return
    for topic, count in sorted(saved.counts.items()):
        typer.echo(f"{count:>10}  {topic}")
    state = "the file was whole" if saved.whole else "the end was missing or damaged"
    chunks = f"; {saved.bad_chunks} damaged chunks left out" if saved.bad_chunks else ""
    typer.echo(f"saved {sum(saved.counts.values())} messages over {saved.span_s:.3f} s in {target} ({state}{chunks})")
    say_next("inspect", target)
