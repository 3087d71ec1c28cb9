"""Markdown from plain values."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

_SPECIAL = re.compile(r"([|\\*_\[\]])")


def cell(text: object) -> str:
    """Text for a cell of a table, in one line, nothing in it read as Markdown but code between grave accents."""
    return _plain(" ".join(str(text).split()))


def code(text: object) -> str:
    """Text set as code, in a cell too; empty where there is none."""
    said = " ".join(str(text).split())
    return f"`{said}`" if said else ""


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of cells that are Markdown already."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def prose(docstring: str | None) -> str:
    """A docstring as Markdown: paragraphs kept, what is between grave accents stays code."""
    import inspect

    return _plain(inspect.cleandoc(docstring or "")) + "\n"


def _plain(text: str) -> str:
    parts = text.split("`")
    return "`".join(part if i % 2 else _SPECIAL.sub(r"\\\1", part).replace("<", "&lt;") for i, part in enumerate(parts))
