"""The one style of tables: on a terminal of any width no word is broken and nothing is cut."""

from __future__ import annotations

import io

import numpy as np
import pytest
from rich.console import Console
from rich.text import Text

from service.cli.output import conclude, table

WORDS = [
    "identifiable",
    "coulomb_friction_1",
    "1.0123",
    "±",
    "N m",
    "strongest",
    "[green]holds[/green]",
    "",
    "a b c",
    "é€",
]


def drawn(width: int, seed: int) -> tuple[str, list[str]]:
    """A table of random words at a width, and its cells as they are read."""
    rng = np.random.default_rng(seed)
    columns, rows = int(rng.integers(1, 8)), int(rng.integers(0, 6))
    cells = [[" ".join(rng.choice(WORDS, rng.integers(1, 4))) for _ in range(columns)] for _ in range(rows)]
    head = [f"column {place}" for place in range(columns)]
    stream = io.StringIO()
    made = table(head, cells, "what it is", "a note on it", slice(1, int(rng.integers(1, 8))))
    Console(file=stream, width=width).print(made)
    return stream.getvalue(), [Text.from_markup(cell).plain for row in cells for cell in row]


@pytest.mark.parametrize("width", [24, 40, 60, 80, 120, 400])
def test_no_word_is_broken_nothing_is_cut_and_no_line_is_too_long(width: int) -> None:
    for seed in range(200):
        text, cells = drawn(width, seed)
        assert max(map(len, text.splitlines())) <= width, text
        read = text.split()
        for word in " ".join(cells).split():
            assert read.count(word) >= " ".join(cells).split().count(word), (word, text)
        assert "what it is" in text
        assert "…" not in text


def test_a_table_that_fits_has_a_line_a_row() -> None:
    stream = io.StringIO()
    Console(file=stream, width=80).print(table(("model", "joint 1"), [("full", "0.1"), ("M_KH", "12.3")]))
    assert [line.rstrip() for line in stream.getvalue().splitlines()] == [
        "model   joint 1", "───────────────", "full        0.1", "M_KH       12.3",
    ]  # fmt: skip


def test_what_comes_next_can_be_copied(capsys: pytest.CaptureFixture[str]) -> None:
    conclude("It explains [them].", "diagnose", "a log.csv", "--robot", "r.toml")
    assert capsys.readouterr().out == "It explains [them].\nnext: deltatwin diagnose 'a log.csv' --robot r.toml\n"


@pytest.mark.parametrize("width", [40, 60, 80])
def test_figures_that_belong_together_stay_in_a_line(width: int) -> None:
    stream, triplet = io.StringIO(), "28.1 / 26.9 / 17.1"
    rows = [("a log of the day before.csv", triplet, triplet, triplet)]
    Console(file=stream, width=width).print(table(("log", "torque", "residual", "held out"), rows))
    assert stream.getvalue().count(triplet) == 3, stream.getvalue()
