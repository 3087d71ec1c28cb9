"""What commands print. Results go to a terminal as wide as it is, anywhere else as wide as they are."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from rich.console import Console, ConsoleOptions, RenderableType

    from service.pages import Headline

PIPED_WIDTH = 1000  # characters: wider than any of our tables, so that what is piped is never wrapped or cut
GUTTER = 3  # characters between two columns
QUANTILES = {"median": 0.5, "p99": 0.99, "p99.9": 0.999, "max": 1.0}


def as_json(name: str, document: Mapping[str, Any]) -> str:
    """A result for other programs: schema `deltatwin.<name>/1`, arrays of NumPy as lists, NaN as null."""
    text = json.dumps(
        {"schema": f"deltatwin.{name}/1"} | dict(document), indent=1, default=lambda value: value.tolist()
    )
    return json.dumps(json.loads(text, parse_constant=lambda _: None), indent=1)


def console(stderr: bool = False) -> Console:
    """Of standard output, for results, or of standard error, for progress."""
    from rich.console import Console

    return Console(stderr=stderr, width=None if stderr or sys.stdout.isatty() else PIPED_WIDTH)


def say(text: str) -> None:
    """A line of a result, with rich's markup in it."""
    console().print(text, highlight=False, soft_wrap=True)


@dataclass
class Table:
    """A table in the one style that all have. Where the terminal is too narrow for its longest words, each row is told
    line by line instead: nothing is cut, no word is broken.

    figures: columns that hold figures, which stand at the right, and together where there are several in a cell.
    """

    head: Sequence[str]
    rows: list[Sequence[str]]
    title: str
    caption: str
    figures: slice

    def add_row(self, *row: str) -> None:
        """One more row."""
        self.rows.append(row)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        from rich.cells import cell_len
        from rich.text import Text

        cells = [[Text.from_markup(cell).plain for cell in row] for row in (self.head, *self.rows)]
        columns = list(zip(*cells, strict=True))
        width = [max(map(cell_len, column)) for column in columns]
        figures = range(len(columns))[self.figures]
        least = [
            max(map(cell_len, (*column[0].split(), *_parts(column[1:], place in figures))), default=0)
            for place, column in enumerate(columns)
        ]
        room = options.max_width - GUTTER * (len(columns) - 1)
        while sum(width) > room and width != least:
            width[max(range(len(width)), key=lambda place: width[place] - least[place])] -= 1
        if self.title:
            yield f"[bold]{self.title}[/bold]"
        if sum(width) <= room:
            yield self._drawn(width)
        else:
            yield from self._told()
        if self.caption:
            yield self.caption

    def _drawn(self, widths: Sequence[int]) -> RenderableType:
        from rich import box
        from rich.table import Table as Drawn

        made = Drawn(box=box.SIMPLE_HEAD, pad_edge=False, header_style="dim", show_edge=False)
        right = range(len(self.head))[self.figures]
        for place, (heading, width) in enumerate(zip(self.head, widths, strict=True)):
            made.add_column(heading, justify="right" if place in right else "left", width=width)
        for row in self.rows:
            made.add_row(*map(str.strip, row))  # rich cuts a word behind a blank that begins a cell
        return made

    def _told(self) -> Iterator[RenderableType]:
        from rich.padding import Padding

        for row in self.rows:
            name, *rest = zip(self.head, row, strict=True)
            yield f"{name[0]}: {name[1]}" if name[0] else name[1]
            for heading, cell in rest:
                if cell:
                    yield Padding(f"{heading}: {cell}" if heading else cell, (0, 0, 0, 2), expand=False)


def _parts(cells: Sequence[str], whole: bool) -> Iterator[str]:
    """What is not broken of cells: lines, if `whole`, else words."""
    for cell in cells:
        yield from cell.splitlines() if whole else cell.split()


def table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]] = (),
    title: str = "",
    caption: str = "",
    figures: slice = slice(1, None),
) -> Table:
    """A table of `rows`, cells with rich's markup in them. figures: columns that hold figures."""
    return Table(head, list(rows), title, caption, figures)


def conclude(said: str, *following: object, own: str = "") -> None:
    """How a command ends: what it comes to, and what comes next, as `say_next` says it."""
    print(said)
    say_next(*following, own=own)


def read_by(columns: object = None, effects: object = None) -> tuple[object, ...]:
    """The words by which the command that comes next reads the same logs, with the same effects."""
    mapping = ("--columns", columns) if columns else ()
    return (*mapping, "--effects", effects) if effects else mapping


def apart_from(name: str, *read: Path) -> str:
    """`name` for a file that the next command writes; with a number where that is one of those that it reads."""
    stem, ending = name.split(".")
    tries = (name, *(f"{stem}_{number}.{ending}" for number in range(2, len(read) + 3)))
    taken = {path.resolve() for path in read}
    return next(one for one in tries if Path(one).resolve() not in taken)


def say_next(*following: object, own: str = "", program: str = "deltatwin") -> None:
    """The words of the command that comes next, of `program`. own: a word of them, in capitals, in whose place the user
    puts something of his own, and what that is."""
    print(f"next: {program} {shlex.join(map(str, following))}")
    if own:
        print(own)


def say_headline(headline: Headline) -> None:
    """How a command that writes a page ends: what the page says first."""
    for line in (headline.answer, f"{headline.number} {headline.of}", *headline.lines):
        print(line)
    if not headline.command:
        print(f"next: {headline.step}")
        return
    print(capitalised(headline.step))
    say_next(*headline.command, own=headline.own)


def capitalised(text: str) -> str:
    """With a capital in front."""
    return text[:1].upper() + text[1:]


def quantiles(nanoseconds: np.ndarray) -> dict[str, float]:
    """The `QUANTILES` of (N,) ns, in µs."""
    import numpy as np

    found = np.quantile(nanoseconds, list(QUANTILES.values())) * 1e-3
    return dict(zip(QUANTILES, found.tolist(), strict=True))


def in_quantiles(nanoseconds: np.ndarray, decimals: int = 1) -> str:
    """The `quantiles` as text."""
    return ", ".join(f"{name} {value:.{decimals}f}" for name, value in quantiles(nanoseconds).items()) + " µs"
