"""The `deltatwin` command: one file a subcommand in this folder, one line each here."""

from __future__ import annotations

import sys

import typer

from schemas.errors import DeltatwinError
from service.cli import convert, evaluate, identify, inspect, replay

app = typer.Typer(
    name="deltatwin",
    help="Controller-side twin for Delta robots: feed-forward torque, payload mass, and the sim-to-real gap explained.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("convert")(convert.command)
app.command("evaluate")(evaluate.command)
app.command("identify")(identify.command)
app.command("inspect")(inspect.command)
app.command("replay")(replay.command)


def main() -> None:
    """Run a subcommand; a known error is one line on stderr and exit code 1, wrong usage 2, Ctrl-C 130."""
    try:
        app()
    except DeltatwinError as error:
        print(f"deltatwin: {error}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(130)
