"""The `deltatwin` command: every file of this folder with a `command` in it is a subcommand of the file's name."""

from __future__ import annotations

import importlib
import pkgutil
import sys

import typer

import service.cli
from schemas.errors import DeltatwinError

app = typer.Typer(
    name="deltatwin",
    help="Controller-side twin for Delta robots: feed-forward torque, payload mass, and the sim-to-real gap explained.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for _found in pkgutil.iter_modules(service.cli.__path__):
    if _found.name != "main":
        _module = importlib.import_module(f"service.cli.{_found.name}")
        if hasattr(_module, "command"):
            app.command(_found.name.replace("_", "-"))(_module.command)


def main() -> None:
    """Run a subcommand; a known error is one line on stderr and exit code 1, wrong usage 2, Ctrl-C 130."""
    try:
        app()
    except DeltatwinError as error:
        print(f"deltatwin: {error}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
