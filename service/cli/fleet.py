"""`deltatwin fleet`: Compare the logs of many robots over many days, and report which robot has changed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.options import AsJson, Backend, ColumnsFrom, Jobs, OnBackend, OwnEffects, Scheduler, refuse, robot_file
from service.cli.output import Table, console, say_headline, table
from service.cli.progress import bars

if TYPE_CHECKING:
    from schemas.fleet_document import Fleet

MOST_TOLD = 2  # figures of a change on a terminal; the page has all


def command(
    context: typer.Context,
    logs: Annotated[
        list[Path], typer.Argument(help="Folders of logs, or logs: .csv, .csv.gz, .mcap, .pcapng", metavar="LOGS")
    ],
    out: Annotated[Path, typer.Option(help="Folder for fleet.html, fleet.json and a folder per robot")],
    robot: Annotated[Path | None, robot_file(" for robots without their own robot.toml")] = None,
    columns: ColumnsFrom = None,
    effects: OwnEffects = None,
    jobs: Jobs = 2,
    backend: OnBackend = Backend.LOKY,
    scheduler: Scheduler = None,
    json: AsJson = False,
) -> None:
    """Compare every robot, day by day, with its first day, and report what has changed and since when.

    A robot is a folder: one with a robot.toml, else the first one whose name has no date. Recordings of several robots
    in one folder are separated by the robot names in them. Days come from dates in names (2026-01-31) or from stamps.
    The first day is identified and the others are diagnosed against it; a robot.toml with [identified] is used as it
    is. A robot must carry the same load on all days, preferably none. Each day is stored when it is done: the same
    command continues where it stopped and computes only new days.

    Example: deltatwin fleet logs/ --robot d3-1200 --out fleet     # logs/cell_3/2026-01-31/pick.csv
    """
    from schemas.errors import DataError
    from schemas.files import make_folder, write_text
    from schemas.words import counted

    if backend is not Backend.DASK:
        refuse(context, "scheduler", only="--backend dask")
    with bars() as progress:
        task = progress.add_task("surveying the logs", total=None)
        from drivers.trace import find_columns
        from schemas.axes_description import load_description
        from service.diagnosis.workers import backend as workers
        from service.fleet.judge import Settings, survey
        from service.fleet.logs import members
        from service.fleet.page import headline, write_page
        from service.model.effects import catalogue

        catalogue(effects)  # what is wrong for all robots is said before the first
        if columns:
            find_columns(columns)
        if robot:
            load_description(robot, effects)
        robots = members(logs, robot)
        make_folder(out)
        days = sum(len(member.days) for member in robots)
        progress.update(
            task, description=f"{counted(len(robots), 'robot')}, {counted(days, 'day')}", total=len(robots) + days
        )
        with workers(backend.value, jobs, scheduler):
            fleet = survey(robots, Settings(out, columns, effects), lambda: progress.advance(task))
        progress.update(task, description="writing")
        text = fleet.model_dump_json(indent=1, by_alias=True)
        write_text(out / "fleet.json", text)
        write_page(fleet, out / "fleet.html")
    if json:
        typer.echo(text)
    else:
        console().print(_table(fleet))
        typer.echo(f"wrote fleet.html and fleet.json in {out}")
        say_headline(headline(fleet, out))
    for what, why in (line for one in fleet.robots for line in one.unusable):
        typer.echo(why if what in why else f"{what}: {why}", err=True)
    if not any(day.verdict for one in fleet.robots for day in one.days):
        raise DataError(f"{out}: no day of any robot could be judged")


def _table(fleet: Fleet) -> Table:
    from service.fleet.page import found, when

    head, rows = ("robot", "change", "joint", "since", "last on", "days", "amount"), []
    for robot, change in found(fleet):
        joints, last = ", ".join(map(str, change.joints)), change.last if change.gone else "still seen"
        days = f"{change.days} of {change.of}"
        rows.append((robot, change.title, joints, when(change), last, days, "; ".join(change.now[:MOST_TOLD])))
    for one in fleet.robots:
        if not one.changes:
            judged = sum(day.judged for day in one.days)
            what = "nothing" if judged else "not judged"
            rows.append((one.robot, what, "", "", "", f"{judged} of {len(one.days)} judged", ""))
    return table(head, rows, "What has changed", figures=slice(0))
