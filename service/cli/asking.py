"""Questions in a terminal."""

from __future__ import annotations

import typer

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
