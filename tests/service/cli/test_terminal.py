"""What goes to a terminal is wrapped at its width between words, whoever prints it; a pipe gets whole lines."""

from __future__ import annotations

import io
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from replay.demo import LOG, ROBOT
from service.cli.terminal import CLEAR, Wrapped, wrapped
from tests.service.cli.test_init import terminal

PROGRAM = Path(sys.executable).with_name("deltatwin")
LONG = "deltatwin: " + "the longest part without a fault lasts 0.2 s; " * 5


class Terminal(io.StringIO):
    """One that is 40 characters wide."""

    def fileno(self) -> int:
        raise AssertionError("COLUMNS says the width")


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> tuple[Terminal, Wrapped]:
    monkeypatch.setenv("COLUMNS", "40")
    below = Terminal()
    return below, Wrapped(below)


@pytest.mark.parametrize("width", [20, 40, 79, 200])
@pytest.mark.parametrize("text", [LONG, f"  {LONG}", f"{LONG}\n\n{LONG}\n", "short", "", "\n"])
def test_no_line_is_too_long_and_no_word_is_lost(width: int, text: str) -> None:
    shown = wrapped(text, width)
    assert all(len(line) <= width for line in shown.splitlines()), shown
    assert shown.split() == text.split()
    assert all(line.startswith("  ") for line in shown.splitlines() if text.startswith("  "))


@pytest.mark.parametrize(
    "whole", ["`deltatwin identify a.csv --robot b.toml`", "'a path with blanks/in it.csv'", "x" * 60]
)
def test_paths_and_commands_are_not_broken(whole: str) -> None:
    assert whole in wrapped(f"{LONG}{whole} {LONG}", 30).split("\n")


@pytest.mark.parametrize("whole", [f"next: deltatwin {LONG}", f'{{\n "conclusion": "{LONG}"\n}}'])
def test_what_is_copied_is_as_it_was_said(screen: tuple[Terminal, Wrapped], whole: str) -> None:
    print(whole, file=screen[1])
    assert screen[0].getvalue() == f"{whole}\n"


def test_colours_and_what_draws_itself_pass(screen: tuple[Terminal, Wrapped]) -> None:
    below, above = screen
    print(f"\x1b[33m{'word ' * 7}\x1b[0m", file=above)
    print(f"\r{'bar ' * 30}", file=above)
    assert below.getvalue() == f"\x1b[33m{'word ' * 7}\x1b[0m\n\r{'bar ' * 30}\n"


def test_a_question_and_its_answer_are_one_line(screen: tuple[Terminal, Wrapped]) -> None:
    below, above = screen
    for text in ("a" * 30, " ", "b" * 20):
        above.write(text)
    assert below.getvalue() == f"{'a' * 30} \n{'b' * 20}"


def test_a_line_takes_the_place_of_a_bar_that_another_process_draws(screen: tuple[Terminal, Wrapped]) -> None:
    below, above = screen
    above.above = True
    print("no samples", "yet", file=above)
    above.above = False
    print("end", file=above)
    assert below.getvalue() == f"{CLEAR}no samples yet\nend\n"


@pytest.mark.parametrize(
    "command",
    [
        ("evaluate", LOG, "--robot", ROBOT),
        ("inspect", LOG, "--robot", ROBOT),
        ("identify", LOG, "--robot", "d3-1200", "--out", "identified.toml"),
        ("identify", LOG, LOG, "--robot", "d3-1200", "--out", "identified.toml"),
        ("plan-motion", "--robot", "d3-1200", "--for", "identify", "--out", "motion.csv"),
        ("convert", "--help"),
    ],
)
def test_a_terminal_of_80_columns_is_clean(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str | Path, ...]
) -> None:
    """But for commands to be copied, and words that are longer, such as paths."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("COLUMNS", raising=False)
    deep = shutil.copy(LOG, tmp_path)  # a path as long as some are
    _, said = terminal([PROGRAM, *(deep if word == LOG else word for word in command)], [])
    last = [line.split("\x1b[2K")[-1] for line in said.split("\n")]  # of what was drawn in a line
    drawn = [re.sub(r"\x1b\[[\d;?]*[A-Za-z]", "", line) for line in last]
    long = [line for line in drawn if len(line) > 80 and not line.startswith("next: ") and " " in line.strip()]
    assert not long, "\n".join(long)
    assert len(drawn) > 1


@pytest.mark.parametrize(("columns", "width"), [(None, 120), ("60", 60), ("200", 120)])
def test_help_in_a_pipe_is_as_wide_as_asked(columns: str | None, width: int) -> None:
    named = {key: value for key, value in os.environ.items() if key != "COLUMNS"}
    environment = named if columns is None else named | {"COLUMNS": columns}
    done = subprocess.run([PROGRAM, "diagnose", "--help"], capture_output=True, text=True, check=True, env=environment)
    longest = max(map(len, done.stdout.splitlines()))
    assert width - 20 < longest <= width
