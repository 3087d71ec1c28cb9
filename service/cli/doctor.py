"""`deltatwin doctor`: Check what this machine can run and what is missing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.options import AsJson
from service.cli.output import as_json, console, say_next, table

if TYPE_CHECKING:
    from service.checkup import Check

SIGNS = {True: "[green]yes[/green]", False: "[yellow]no[/yellow]", None: "?"}


def command(
    bundle: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Also write the result and all versions to a file, to attach to a bug report"
        ),
    ] = None,
    json: AsJson = False,
) -> None:
    """Check real time, permissions, programs and optional packages; change nothing.

    The bundle is JSON text; read it before you send it. It contains versions and the type of the machine, but no names
    of host or user, no environment variables and no logs. The exit code is 0 even if something is missing.

    Example: deltatwin doctor --bundle machine.json
    """
    import json as json_library

    from schemas.errors import StorageError
    from schemas.files import write_text
    from service.checkup import bundle as whole
    from service.checkup import examine

    if bundle is not None and bundle.exists():
        raise StorageError(f"{bundle}: exists already; give another name with --bundle")
    with console(stderr=True).status("looking"):
        checks = examine()
    document = whole(checks)
    if bundle is not None:
        write_text(bundle, json_library.dumps(document, indent=1) + "\n")
    if json:
        typer.echo(as_json("doctor", document))
        return
    screen = console()
    versions = document["versions"]
    screen.print(f"deltatwin {versions['deltatwin']}, Python {versions['python']}", highlight=False)
    rows = [(SIGNS[check.has], check.name, check.found, check.needed) for check in checks]
    screen.print(table(("", "what", "found", "needed for"), rows, figures=slice(0)))
    missing = [check for check in checks if check.remedy]
    for check in missing:
        screen.print(f"{check.name}: {check.remedy}", highlight=False, markup=False)
    screen.print(f"Offline commands run here. {_live(checks)}", highlight=False)
    if bundle is None:
        say_next("demo")
    else:
        print(f"wrote {bundle}\nnext: read {bundle}, then attach it to your bug report.")


def _live(checks: Sequence[Check]) -> str:
    """How live roles run."""
    refused = {check.name for check in checks if check.has is False}
    if refused & {"real-time priority", "memory lock"}:
        return "Live roles run, but their timing is best effort."
    if "real-time kernel" in refused:
        return "Live roles run with real-time priority, but this kernel does not bound their latency under other load."
    return "Live roles run in real time."
