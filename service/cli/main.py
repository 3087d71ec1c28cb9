"""The `deltatwin` command: every file of this folder with a `command` in it is a subcommand of the file's name."""

from __future__ import annotations

import importlib
import os
import pkgutil
import sys
from typing import NoReturn

import typer

import service.cli
from schemas.errors import DeltatwinError, printable

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
        try:
            app()
        finally:
            sys.stdout.flush()  # here, where a full disk or a closed pipe behind it can still be told
    except DeltatwinError as error:
        _end(str(error))
    except OSError as error:
        if sys.stdout.fileno() == 1:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what is left in the buffer goes nowhere
        _end(printable(f"{error.filename or 'output'}: {error.strerror or error}"))
    except MemoryError:
        _end("out of memory; a shorter log, or a machine with more")
    except KeyboardInterrupt:
        sys.exit(130)


def _end(said: str) -> NoReturn:
    print(f"deltatwin: {said}", file=sys.stderr)
    sys.exit(1)


if __name__ == "__main__":
    main()
