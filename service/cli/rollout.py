"""`deltatwin rollout`: Simulate the robot under the recorded torque and compare its motion with the log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.options import AsJson, ColumnsFrom, OwnEffects, robot_file
from service.cli.output import Table, console, read_by, say_headline, table
from service.cli.reading import reading

if TYPE_CHECKING:
    from schemas.robot import Robot
    from schemas.rollout_document import RolloutDocument


def command(
    traces: Annotated[list[Path], typer.Argument(help="Logs: .csv, .csv.gz or .mcap", metavar="LOG")],
    robot: Annotated[list[Path], robot_file(", identified or corrected; repeat to compare, best last")],
    horizon: Annotated[float, typer.Option(help="Length of a window, s")] = 0.2,
    commands: Annotated[
        bool,
        typer.Option(
            "--commands",
            help="Drive the simulation by recorded position commands, through [servo] or drives found from the logs",
        ),
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for rollout.json and rollout.html")] = None,
    effects: OwnEffects = None,
    columns: ColumnsFrom = None,
    json: AsJson = False,
) -> None:
    """Simulate the robot under the recorded torque and show how far its motion is from the measured one.

    Each window of a log starts in the measured state; from there the recorded torque alone drives the simulation. With
    --commands the position commands alone drive it, and the torque of the simulated drives is compared, too. Each
    description is compared with the robot as drawn (plain) and with the noise floor (floor): the error from the noise
    of torque and start state alone, simulated with the last description. For axes and arms the joints are compared,
    for an arm also its tool.

    Example: deltatwin rollout test_*.csv --robot identified.toml --robot corrected.toml --out rollout
    """
    from schemas.axes_description import load_description
    from schemas.errors import DataError
    from schemas.files import make_folder, write_text
    from schemas.questions import Question, as_delta
    from service.cli.joint_rollout import roll_out
    from service.identification.copies import distinct
    from service.rollout.gap import PLAIN, compare
    from service.rollout.rollout_page import document, headline, write_rollout

    described = {str(path): load_description(path, effects) for path in robot}
    others = [(Path(path).stem, one) for path, one in described.items() if one.answering(Question.COMMANDS) is None]
    if others and not commands:
        if len(others) < len(described):
            raise DataError(f"{robot[0]}, {robot[-1]}: compare descriptions of one machine")
        roll_out(traces, others, robot, columns, effects, horizon, out, json)
        return
    robots = _robots({path: as_delta(one, Question.COMMANDS) for path, one in described.items()})
    if out is not None:
        make_folder(out)
    recorded = list(reading(traces, robots[PLAIN], columns, "reading"))
    with console(stderr=True).status("simulating") as status:
        found = compare(robots, recorded, horizon, commands, lambda what: status.update(f"simulating {what}"))
    given = dict(zip(list(robots)[1:], ((path, *read_by(effects=effects)) for path in described), strict=True))
    logs = (*(trace.path for trace in distinct(recorded)), *read_by(columns))
    result = document(found, robots, [trace.name for trace in recorded])
    if out is not None:
        write_text(out / "rollout.json", result.model_dump_json(indent=1, by_alias=True))
        write_rollout(result, out / "rollout.html", given, logs)
    if json:
        print(result.model_dump_json(indent=1, by_alias=True))
        return
    console().print(_table(result), _regimes(result))
    if out is not None:
        typer.echo(f"wrote rollout.json and rollout.html in {out}")
    say_headline(headline(result, given, logs))


def _robots(described: dict[str, Robot]) -> dict[str, Robot]:
    """Name -> description, of file -> description: the first one as it was drawn up, then each by its file.

    Raises:
        DataError: one is of another robot than the first.
    """
    from service.rollout.gap import PLAIN, plain, refuse_another_robot

    refuse_another_robot(described)
    robots: dict[str, Robot] = {PLAIN: plain(next(iter(described.values())))}
    for path, one in described.items():
        name = Path(path).stem
        robots[name if name not in robots else path] = one
    return robots


def _table(result: RolloutDocument) -> Table:
    from service.rollout.rollout_page import in_figures

    head, rows = ["robot", "joint 1, mrad", "joint 2, mrad", "joint 3, mrad", "platform, mm"], []
    if result.servo is not None:
        head.append("torque, rms N m, joints 1, 2 and 3")
    for robot in (*result.robots, result.floor):
        torque = [", ".join(map(in_figures, robot.torque_nm))] if robot.torque_nm else []
        rows.append((robot.robot, *map(in_figures, robot.joint_mrad), in_figures(robot.platform_mm), *torque))
    title = f"simulated minus measured after {1e3 * result.horizon_s:.0f} ms, rms of {result.windows} windows"
    return table(head, rows, title)


def _regimes(result: RolloutDocument) -> Table:
    from service.rollout.rollout_page import in_figures

    names = [robot.robot for robot in (*result.robots, result.floor)]
    rows = [
        (str(one.joint), one.regime, str(one.windows), *(in_figures(one.joint_mrad[name]) for name in names))
        for one in result.regimes
    ]
    return table(
        ("joint", "its motion", "windows", *(f"{name}, mrad" for name in names)),
        rows,
        "by kind of motion",
        figures=slice(2, None),
    )
