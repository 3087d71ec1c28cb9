"""What goes to a terminal is wrapped at its width, whoever prints it; what goes to a pipe or a file is not."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

USUAL_WIDTH = 80  # characters, of a terminal that does not say its width
COLOUR = re.compile(r"\x1b\[[\d;]*m")
CONTROL = re.compile(r"\x1b\[[\d;?]*[A-Za-ln-z]|\r")  # bars and screens, which know where they draw
# Documents and commands, which are copied: one write each, or one line.
WHOLE = re.compile(r"\{|next: (?:deltatwin|python -m|gcc) ")
# What is never broken: a word, and what stands between quotes, such as a path or a command.
WORD = re.compile(r"(?:`[^`\n]*`|(?<!\w)'[^'\n]*'(?!\w)|\S)+")
CLEAR = "\r\x1b[2K"


def wrap_terminals() -> None:
    """Wrap what is printed from now on, where it goes to a terminal."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream.isatty() and not isinstance(stream, Wrapped):
            setattr(sys, name, Wrapped(stream))


class Wrapped:
    """A stream to a terminal, wrapped between words. above: whether another process draws a bar in the last line, which
    a new line takes the place of."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._column, self.above = stream, 0, False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write it wrapped; how many characters of it were written."""
        if CONTROL.search(text):
            self._column = 0
            self._stream.write(text)
            return len(text)
        begins = CLEAR if self.above and not self._column else ""
        shown = text if WHOLE.match(text) else wrapped(text, self._width(), self._column)
        self._stream.write(begins + shown)
        *before, last = COLOUR.sub("", shown).split("\n")
        self._column = len(last) + (0 if before else self._column)
        return len(text)

    def entered(self) -> None:
        """The user has ended the line."""
        self._column = 0

    def _width(self) -> int:
        try:
            return int(os.environ["COLUMNS"])
        except (KeyError, ValueError):
            return os.get_terminal_size(self._stream.fileno()).columns or USUAL_WIDTH


@contextmanager
def above_a_bar() -> Iterator[None]:
    """While another process draws a bar, lines on standard error go above it."""
    stream = sys.stderr
    if not isinstance(stream, Wrapped):
        yield
        return
    stream.above = True
    try:
        yield
    finally:
        stream.above = False


def wrapped(text: str, width: int, column: int = 0) -> str:
    """`text` with its longer lines broken between words. column: where its first line begins."""
    lines = text.split("\n")
    return "\n".join(_broken(line, width, 0 if number else column) for number, line in enumerate(lines))


def _broken(line: str, width: int, column: int) -> str:
    if column + len(COLOUR.sub("", line)) <= width or WHOLE.match(line):
        return line
    indent = line[: len(line) - len(line.lstrip(" "))]
    parts, at, end = [], column, 0
    for word in WORD.finditer(line):
        size, blanks = len(COLOUR.sub("", word[0])), line[end : word.start()]
        if at + len(blanks) + size > width and at > len(indent):
            parts.append("\n" + indent)
            at = len(indent)
        else:
            parts.append(blanks)
            at += len(blanks)
        parts.append(word[0])
        at, end = at + size, word.end()
    return "".join(parts) + line[end:].rstrip(" ")
