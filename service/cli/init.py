"""`deltatwin init`: a first description of your machine, by questions or from a URDF."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.output import conclude

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from service.interview import Question


def command(
    out: Annotated[Path, typer.Option(help="Description to write (TOML)")] = Path("robot.toml"),
    urdf: Annotated[Path | None, typer.Option(metavar="FILE", help="URDF of a serial arm, instead of a Delta")] = None,
    axes: Annotated[int | None, typer.Option(metavar="N", help="Number of servo axes, instead of a Delta")] = None,
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
    """
    from schemas.errors import RobotError, StorageError
    from schemas.files import make_folder, write_text
    from service.interview import DELTA, for_axes, for_urdf, write_up

    if urdf is not None and axes is not None:
        raise typer.BadParameter("an arm from its URDF or separate axes, not both", param_hint="--axes")
    if out.exists():
        raise StorageError(f"{out}: exists already; give another name with --out")
    make_folder(out.parent)
    questions = for_urdf(urdf) if urdf is not None else for_axes(axes) if axes is not None else DELTA
    given = _given(answer or [], questions)
    while True:
        answers = _asked(questions, given)
        try:
            text = write_up(questions, answers, out, urdf)
            break
        except RobotError as error:
            if not sys.stdin.isatty():
                raise
            typer.secho(f"{error}; once more:", fg="yellow", err=True)
            questions = _with_defaults(questions, answers)
            given = {}
    write_text(out, text)
    conclude(f"wrote {out}: {len(answers)} answers.", "import", "YOUR_LOG", "--robot", out)


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


def _asked(questions: Sequence[Question], given: Mapping[str, str]) -> dict[str, str]:
    """All answers: those given, and the rest as the terminal gives them, or by their defaults where there is none.

    Raises:
        RobotError: there is neither answer nor default nor terminal.
    """
    from schemas.errors import RobotError

    answers = {}
    for question in questions:
        if question.key in given:
            answers[question.key] = given[question.key]
        elif sys.stdin.isatty():
            answers[question.key] = str(typer.prompt(question.prompt, default=question.default, err=True))
        elif question.default is not None:
            answers[question.key] = question.default
        else:
            raise RobotError(f"{question.key}: not answered ({question.prompt}): --answer {question.key}=VALUE")
    return answers


def _with_defaults(questions: Sequence[Question], answers: Mapping[str, str]) -> list[Question]:
    """The same questions with what was answered before as their defaults."""
    from dataclasses import replace

    return [replace(question, default=answers[question.key]) for question in questions]
