"""`deltatwin rollout`: what the simulated robot does where the real one did what a log says."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.reading import AsJson, ColumnsFrom, OwnEffects, reading

if TYPE_CHECKING:
    from rich.table import Table

    from schemas.robot import Robot
    from schemas.rollout import RolloutDocument


def command(
    traces: Annotated[list[Path], typer.Argument(help="Logs: .csv, .csv.gz or .mcap", metavar="TRACE")],
    robot: Annotated[
        list[Path],
        typer.Option(
            metavar="FILE|NAME", help="Robot description (TOML), identified or corrected; repeat to compare, best last"
        ),
    ],
    horizon: Annotated[float, typer.Option(help="Length of a window, s")] = 0.2,
    commands: Annotated[
        bool,
        typer.Option(
            "--commands", help="Put the recorded position commands in, through [servo] or the drives that the logs show"
        ),
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for rollout.json and rollout.html")] = None,
    effects: OwnEffects = None,
    columns: ColumnsFrom = None,
    json: AsJson = False,
) -> None:
    """Simulate the robot under the recorded torque and say how far its motion is from the measured one.

    Each window of a log starts in the measured state; from there on only torque goes in; or, with --commands, only the
    position commands, and the torque of the simulated drives is compared too. Beside each description
    stand the same robot as it was drawn up (plain), and the floor: what the noise of torque and start state alone
    makes of the last one.

    Example: deltatwin rollout test_*.csv --robot identified.toml --robot corrected.toml --out rollout
    """
    from rich.console import Console

    from schemas.files import make_folder, write_text
    from service.cli.output import console as result_console
    from service.rollout.document import document, sentences, write_rollout
    from service.rollout.gap import PLAIN, check_sign, rollout

    robots = _robots(robot, effects)
    console, progress = result_console(), Console(stderr=True)
    recorded = list(reading(traces, robots[PLAIN], columns, "reading"))
    last = list(robots)[-1]
    with progress.status("simulating") as status:

        def told(what: str) -> None:
            status.update(f"simulating {what}")

        # the sign of the torque is asked for with the torque going in, whatever goes in afterwards
        driven = {last: robots[last]} if commands else robots
        found = rollout(driven, recorded, horizon, told)
        check_sign(robots[last], recorded, found)
        if commands:
            found = rollout(robots, recorded, horizon, told, commands)
    result = document(found, robots, [trace.name for trace in recorded])
    if out is not None:
        make_folder(out)
        write_text(out / "rollout.json", result.model_dump_json(indent=1, by_alias=True))
        write_rollout(result, out / "rollout.html")
    if json:
        print(result.model_dump_json(indent=1, by_alias=True))
        return
    console.print(_table(result))
    console.print(_regimes(result))
    for line in sentences(result):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    if out is not None:
        console.print(f"wrote rollout.json and rollout.html in {out}", highlight=False)


def _robots(paths: list[Path], effects: Path | None) -> dict[str, Robot]:
    """Name -> description: the first one as it was drawn up, then each by its file.

    Raises:
        DataError: a description of axes, or of another robot than the first.
    """
    from schemas.axes import load_description
    from schemas.errors import DataError
    from schemas.machine import Machine
    from service.rollout.gap import PLAIN, plain

    robots: dict[str, Robot] = {}
    for path in paths:
        description = load_description(path, effects)
        if isinstance(description, Machine):
            raise DataError(f'{path}: kind = "{description.kind}": rollout simulates Delta robots')
        if not robots:
            robots[PLAIN] = plain(description)
        for key in ("geometry", "mass", "drive"):
            if getattr(description, key) != getattr(robots[PLAIN], key):
                raise DataError(f"{path}: its [{key}] is not that of {paths[0]}: compare descriptions of one robot")
        name = path.stem if path.stem not in robots else str(path)
        robots[name] = description
    return robots


def _table(result: RolloutDocument) -> Table:
    from rich.table import Table

    table = Table(
        "robot", "joint 1, mrad", "joint 2, mrad", "joint 3, mrad", "platform, mm",
        title=f"simulated less measured after {1e3 * result.horizon_s:.0f} ms, rms of {result.windows} windows",
    )  # fmt: skip
    if result.servo is not None:
        table.add_column("torque, rms N m, joints 1, 2 and 3")
    for column in table.columns[1:]:
        column.justify = "right"
    for robot in (*result.robots, result.floor):
        torque = [", ".join(map(_figure, robot.torque_nm))] if robot.torque_nm else []
        table.add_row(robot.robot, *map(_figure, robot.joint_mrad), _figure(robot.platform_mm), *torque)
    return table


def _regimes(result: RolloutDocument) -> Table:
    from rich.table import Table

    names = [robot.robot for robot in (*result.robots, result.floor)]
    table = Table("joint", "its motion", "windows", *(f"{name}, mrad" for name in names), title="by kind of motion")
    for column in table.columns[2:]:
        column.justify = "right"
    for entry in result.regimes:
        figures = [_figure(entry.joint_mrad[name]) for name in names]
        table.add_row(str(entry.joint), entry.regime, str(entry.windows), *figures)
    return table


def _figure(value: float | None) -> str:
    return "ran away" if value is None else f"{value:.3g}"
