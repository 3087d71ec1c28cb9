"""Markdown from plain values."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

_EQUATION = re.compile(r"(\$\$?)(.+?)\1", re.DOTALL)
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
    """A docstring as Markdown: paragraphs kept, what is between grave accents stays code, and what is between dollar
    signs becomes an equation, in a line of its own if there are two."""
    import inspect

    parts = _EQUATION.split(inspect.cleandoc(docstring or ""))
    said = [
        _plain(text) + (equation(tex, display=sign == "$$") if tex else "")
        for text, sign, tex in zip(parts[::3], [*parts[1::3], ""], [*parts[2::3], ""], strict=True)
    ]
    return "".join(said) + "\n"


def equation(tex: str, display: bool) -> str:
    """LaTeX as MathML, which browsers draw by themselves. display: in a line of its own."""
    from latex2mathml.converter import convert

    drawn = convert(" ".join(tex.split()), display="block" if display else "inline")
    return f"<span>{drawn}</span>"  # at the start of a line Markdown takes `math` for a paragraph of its own


def _plain(text: str) -> str:
    parts = text.split("`")
    return "`".join(part if i % 2 else _SPECIAL.sub(r"\\\1", part).replace("<", "&lt;") for i, part in enumerate(parts))
