"""`deltatwin init`: Write a first description of your machine, from questions, a URDF or a list of drives."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.asking import ask
from service.cli.output import conclude

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from service.interview import Question


OWN = "YOUR_LOG: a log of this machine, as its controller or its scope writes it"


def command(
    out: Annotated[Path, typer.Option(help="Description to write (TOML)")] = Path("robot.toml"),
    urdf: Annotated[Path | None, typer.Option(metavar="FILE", help="URDF of a serial arm, instead of a Delta")] = None,
    axes: Annotated[int | None, typer.Option(metavar="N", help="Number of servo axes, instead of a Delta")] = None,
    drives: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="CSV with one row per joint: joint, gear_ratio; of a Delta on a bus also counts_per_turn, sign, "
            "zero_counts, and rated_torque_nm or rated_current_a and torque_constant_nmpa (of the motor, rms)",
        ),
    ] = None,
    answer: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE", help="An answer, such as geometry.base_radius=0.2; missing answers are asked for"
        ),
    ] = None,
) -> None:
    """Ask for the values of a description and write it, each value with its unit and meaning.

    Lengths and masses from the drawing are enough to begin with: `identify` corrects the masses from logs. Without a
    terminal, every answer that has no default must be given with --answer.

    Example: deltatwin init --out robot.toml

    Example: deltatwin init --urdf ur10.urdf --answer name=cell-3 --out arm.toml

    Example: deltatwin init --drives drives.csv --out robot.toml
    """
    from schemas.drive_list import read_drives
    from schemas.errors import StorageError
    from schemas.files import check_apart, make_folder, write_text
    from service.interview import DELTA, count_of, fault, for_axes, for_urdf, gears, write_up

    if urdf is not None and axes is not None:
        raise typer.BadParameter("an arm from its URDF or separate axes, not both", param_hint="--axes")
    check_apart(out, *filter(None, (urdf, drives)))
    if out.exists():
        raise StorageError(f"{out}: exists already; give another name with --out")
    make_folder(out.parent)
    questions = for_urdf(urdf) if urdf is not None else for_axes(axes) if axes is not None else DELTA
    given = _given(answer or [], questions)
    listed = [] if drives is None else read_drives(drives, count_of(questions))
    if drives is not None:
        given |= gears(questions, listed, drives)
    answers = _asked(questions, given, lambda known: fault(questions, known, out, urdf))
    text = write_up(questions, answers, out, urdf, listed)
    write_text(out, text)
    conclude(f"wrote {out}: {len(answers)} answers.", "import", "YOUR_LOG", "--robot", out, own=OWN)


def _given(answers: Sequence[str], questions: Sequence[Question]) -> dict[str, str]:
    """Key -> value of each --answer."""
    keys = [question.key for question in questions]
    given = {}
    for text in answers:
        key, found, value = text.partition("=")
        if not found or key not in keys:
            raise typer.BadParameter(f"{text}: write one of {', '.join(keys)} as KEY=VALUE", param_hint="--answer")
        given[key] = value
    return given


def _asked(
    questions: Sequence[Question],
    given: Mapping[str, str],
    fault: Callable[[Mapping[str, str]], tuple[str, str] | None],
) -> dict[str, str]:
    """All answers: those given, and the rest as the terminal gives them, or by their defaults where there is none.
    fault: what is wrong with answers so far, and where; in a terminal that is asked again at once.

    Raises:
        RobotError: there is neither answer nor default nor terminal.
    """
    if not sys.stdin.isatty():
        return {question.key: _unasked(question, given) for question in questions}
    defaults = {question.key: question.default for question in questions}
    answers, before = dict(given), dict(defaults)
    while True:
        while found := fault(answers):
            where, said = found
            typer.secho(f"{said}; once more:", fg="yellow", err=True)
            again = [key for key in answers if f"{key}.".startswith(f"{where}.")] or list(answers)
            before |= {key: answers.pop(key) for key in again}
            wrong = min(again, key=lambda key: _place(key, said))
            before[wrong] = defaults[wrong] if defaults[wrong] != before[wrong] else None
        question = next((one for one in questions if one.key not in answers), None)
        if question is None:
            return answers
        answers[question.key] = ask(question.prompt, before[question.key])


def _place(key: str, said: str) -> int:
    """Where a sentence names a key; behind all else where it does not."""
    found = said.find(key.rpartition(".")[2])
    return len(said) if found < 0 else found


def _unasked(question: Question, given: Mapping[str, str]) -> str:
    from schemas.errors import RobotError

    answer = given.get(question.key, question.default)
    if answer is None:
        raise RobotError(f"{question.key}: not answered ({question.prompt}): --answer {question.key}=VALUE")
    return answer
