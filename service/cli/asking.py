"""Questions in a terminal."""

from __future__ import annotations

import sys

import typer

from service.cli.terminal import Wrapped
from service.stopping import interrupted


def ask(question: str, default: str | None) -> str:
    """
    Raises:
        KeyboardInterrupt: Ctrl-C, which Typer takes for the end of input. Abort: the input ends.
    """
    try:
        return str(typer.prompt(question, default=default, err=True))
    except typer.Abort:
        interrupted()
        raise
    finally:
        _entered()


def confirm(question: str, default: bool) -> bool:
    """
    Raises:
        As `ask`.
    """
    try:
        return typer.confirm(question, default=default, err=True)
    except typer.Abort:
        interrupted()
        raise
    finally:
        _entered()


def _entered() -> None:
    """Behind an answer both streams are at the start of a line."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, Wrapped):
            stream.entered()
