"""`deltatwin import`: Read a foreign log: propose columns, units and signs, and write a log and its mapping."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.asking import confirm
from service.cli.options import AsJson, robot_file
from service.cli.output import as_json, console, say, say_next
from service.cli.output import table as printed

if TYPE_CHECKING:
    from drivers.trace.tables import Table
    from schemas.axes_description import Description
    from service.identification.proposal import Proposal
    from service.identification.readings import Stated


_Files = Annotated[
    list[Path],
    typer.Argument(
        metavar="FILE",
        help="TwinCAT Scope, CODESYS, KUKA (.dat), tables with or without a header, JSON, .mat, .npy, .npz, bags of "
        "ROS and Foxglove (rosbag2, its folder, .bag, .mcap). Several files with the same columns are runs of one "
        "machine and share one mapping; files with different columns are joined into one log.",
    ),
]
_Robot = Annotated[Path | None, robot_file(", to find signs and gear side.")]
_Out = Annotated[
    Path | None,
    typer.Option(
        help="Log to write, or a folder; for several runs a folder. Default: the first file's name with .mcap (.csv if "
        "there are not three joints)."
    ),
]
_Yes = Annotated[bool, typer.Option("--yes", help="Accept the proposal without asking.")]
_Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace existing files.")]
_Time = Annotated[str | None, typer.Option(help="Column of the time stamps.")]
_Rate = Annotated[float | None, typer.Option(min=0.1, help="Rows per second (Hz), if no column has time stamps.")]
_Position = Annotated[str | None, typer.Option(help="Columns of the positions, separated by commas, joint 1 first.")]
_Torque = Annotated[str | None, typer.Option(help="Columns of the torques or currents, separated by commas.")]
_PositionUnit = Annotated[str | None, typer.Option(help="rad, mrad, deg, turns, counts, m, cm, mm or um.")]
_CountsPerRev = Annotated[float | None, typer.Option(min=1.0, help="Increments per turn of the encoder.")]
_CountsPerM = Annotated[float | None, typer.Option(min=1.0, help="Increments per metre, for linear axes.")]
_TorqueUnit = Annotated[
    str | None,
    typer.Option(
        help="'N m', 'mN m', N, ..., 'percent RATED', 'permille RATED', 'A CONSTANT' or 'V CONSTANT' (N m, N m/A, "
        "N m/V); one constant per joint: 'A 0.2,0.2,0.1'."
    ),
]
_TorqueTimes = Annotated[
    str | None, typer.Option(metavar="NAME", help="Column by which the torques are multiplied, such as a voltage.")
]
_Where = Annotated[
    str | None, typer.Option(metavar="NAME[=VALUE]", help="Use only rows with VALUE (default 1) in this column.")
]
_Sign = Annotated[
    str | None, typer.Option(help="Sign of each torque, separated by commas, joint 1 first: 1,-1,1; or one for all.")
]
_Topic = Annotated[str | None, typer.Option(help="Topic of the joint states, if a bag has several.")]


def command(
    files: _Files,
    robot: _Robot = None,
    out: _Out = None,
    yes: _Yes = False,
    overwrite: _Overwrite = False,
    time: _Time = None,
    rate: _Rate = None,
    position: _Position = None,
    torque: _Torque = None,
    position_unit: _PositionUnit = None,
    counts_per_rev: _CountsPerRev = None,
    counts_per_m: _CountsPerM = None,
    torque_unit: _TorqueUnit = None,
    torque_times: _TorqueTimes = None,
    where: _Where = None,
    sign: _Sign = None,
    topic: _Topic = None,
    json: AsJson = False,
) -> None:
    """List the channels of foreign logs, propose how to read them, and write the mapping and the log.

    Unit, clock, sign and side of the gear are taken from the file; what the file does not say is found by fitting the
    torque to the motion (with --robot). Ambiguous points are reported; in a terminal the command asks for them.
    Nothing is repaired.

    Writes OUT and, next to it, the mapping (OUT's name with .columns.toml), to use with --columns or to edit.

    Example: deltatwin import scope.csv --robot robot.toml --yes

    Example: deltatwin import pos.csv current.csv --robot arm.toml --rate 5000 --torque-unit 'A 0.12'
    """
    from dataclasses import replace

    from schemas.axes_description import load_description
    from schemas.files import write_text
    from schemas.words import counted
    from service.identification.proposal import propose

    description = load_description(robot) if robot else None
    stated = _stated(time, rate, position, torque, position_unit, counts_per_rev, torque_unit)
    rows, signs = None if where is None else _row_filter(where), None if sign is None else _signs(sign)
    stated = replace(stated, counts_per_m=counts_per_m, torque_times=torque_times, where=rows, sign=signs)
    with console(stderr=True).status(f"reading {files[0].name}"):
        runs = _runs(files, stated, topic)
        proposal = propose(runs, description, stated)
    if not json:
        _show(runs[0], proposal)
    known = description.sources if description else []
    logs, mapping = _targets(files[: len(runs)], proposal, out, overwrite, [*files, *known])
    if not yes:
        _ask(proposal)
    samples = _write(files, logs, mapping, proposal, description)
    write_text(mapping, _toml(runs[0], proposal))  # last: on a disk that is full it would stand there without its log
    if json:
        typer.echo(_json(runs[0], proposal, logs, mapping))
        return
    joints = counted(len(proposal.columns["position"]), "joint")
    for log, count in zip(logs, samples, strict=True):
        typer.echo(f"{log}: {counted(count, 'sample')}, {joints}; mapping in {mapping}")
    own = "" if robot else "ROBOT.toml: the description of your robot, which `deltatwin init` writes"
    say_next("diagnose", *logs, "--robot", robot or "ROBOT.toml", "--out", "diagnosis", own=own)


def _ask(proposal: Proposal) -> None:
    """
    Raises:
        BadParameter: there is nobody to ask. Exit: the proposal is not taken.
    """
    import sys

    if not sys.stdin.isatty():
        raise typer.BadParameter("there is no terminal to ask; --yes accepts the proposal", param_hint="--yes")
    if not confirm("accept it?", not proposal.doubts):
        typer.echo("nothing written; correct it with --position, --torque, --time, --torque-unit ...", err=True)
        raise typer.Exit(1)


def _write(
    files: list[Path], logs: list[Path], mapping: Path, proposal: Proposal, description: Description | None
) -> list[int]:
    """Write each run's log and tell what was found in it; how many samples they have."""
    from drivers.trace import read_trace, write_trace
    from schemas.columns import Columns
    from schemas.errors import TraceError
    from schemas.toml import validate

    columns = validate(Columns, dict(proposal.columns), mapping, TraceError)
    samples = []
    for path, log in zip(files, logs, strict=False):
        with console(stderr=True).status(f"writing {log.name}"):
            trace = read_trace(path, description, columns)
            write_trace(trace, log, description.name if description else "robot")
        samples.append(len(trace))
        for finding in trace.findings:
            typer.echo(f"{path}: {finding.message}", err=True)
    return samples


def _runs(files: list[Path], stated: Stated, topic: str | None) -> list[Table]:
    """The tables of the runs that `files` are, or the one of files side by side.

    Raises:
        TraceError: a file cannot be read, or does not go with the others.
    """
    from drivers.trace import CAPTURE_ENDINGS
    from drivers.trace.tables import joined, read_table
    from schemas.errors import TraceError
    from service.identification.channels import are_runs, clocks_of

    for path in files:
        if path.name.endswith(CAPTURE_ENDINGS):
            raise TraceError(f"{path}: a capture needs no import: every command reads it with --robot")
    tables = [read_table(path, {"topic": topic} if topic else None) for path in files]
    if are_runs(tables, stated.position, stated.torque):
        return tables
    for path in files:
        if path.parent.resolve() != files[0].parent.resolve():
            raise TraceError(f"{path}: not in the folder of {files[0]}; files of one log must be in the same folder")
    return [joined(tables, clocks_of(tables, stated.time))]


def _targets(
    files: list[Path], proposal: Proposal, out: Path | None, overwrite: bool, read: list[Path]
) -> tuple[list[Path], Path]:
    """The log of each run, and the mapping. read: all files that the command reads.

    Raises:
        StorageError: one is there already, is what is read, or two would be one. BadParameter: --out is no folder.
    """
    from drivers.trace import CSV_ENDINGS
    from schemas.errors import StorageError
    from schemas.files import check_apart, check_folder, make_folder

    ending = ".mcap" if len(proposal.columns["position"]) == 3 else ".csv"
    several = len(files) > 1
    folder = out if out is not None and (several or out.is_dir()) else None
    if several and out is not None and (out.is_file() or out.name.endswith((".mcap", *CSV_ENDINGS))):
        raise typer.BadParameter(f"{out}: {len(files)} runs are read: give a folder", param_hint="--out")
    logs = []
    for path in files:
        told_apart = "" if ending == ".mcap" != path.suffix or folder else ".imported"
        name = f"{path.name.split('.')[0]}{told_apart}{ending}"
        logs.append(folder / name if folder else out or path.with_name(name))
    mapping = logs[0].with_name(logs[0].name.split(".")[0] + ".columns.toml")
    if folder is not None:
        make_folder(folder)
    for path in (*logs, mapping):
        check_folder(path.parent)
        check_apart(path, *read)
        if path.exists() and not overwrite:
            raise StorageError(f"{path}: exists already; --overwrite replaces it, --out gives another name")
    if len({path.resolve() for path in logs}) < len(logs):
        raise StorageError(f"{out}: two of the runs have the same name: import them one by one")
    return logs, mapping


def _stated(
    time: str | None,
    rate: float | None,
    position: str | None,
    torque: str | None,
    position_unit: str | None,
    counts_per_rev: float | None,
    torque_unit: str | None,
) -> Stated:
    from schemas.units import POSITION_SCALES, POSITION_UNITS, TORQUE_UNITS
    from service.identification.readings import Stated

    if position_unit is not None and position_unit not in POSITION_UNITS.values():
        raise typer.BadParameter(
            f"{position_unit!r}: {', '.join(POSITION_SCALES)} or counts", param_hint="--position-unit"
        )
    unit: tuple[str, float | list[float] | None] | None = None
    if torque_unit is not None:
        name, _, number = torque_unit.rpartition(" ")
        try:
            numbers = [float(part) for part in number.split(",")]
            unit = (name.strip(), numbers if len(numbers) > 1 else numbers[0])
        except ValueError:
            unit = (torque_unit.strip(), None)
        if unit[0] not in TORQUE_UNITS.values():
            raise typer.BadParameter(
                f"{torque_unit!r}: 'N m', 'mN m', N, ..., 'percent RATED', 'permille RATED', 'A CONSTANT' or "
                "'V CONSTANT'",
                param_hint="--torque-unit",
            )

    def names(text: str | None) -> list[str] | None:
        return None if text is None else [name.strip() for name in text.split(",")]

    return Stated(time, rate, names(position), names(torque), position_unit, counts_per_rev, unit)


def _row_filter(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value or 1)
    except ValueError:
        raise typer.BadParameter(f"{text!r}: the value is not a number", param_hint="--where") from None


def _signs(text: str) -> list[int]:
    signs = {"1": 1, "+1": 1, "+": 1, "-1": -1, "-": -1}
    given = [part.strip() for part in text.split(",")]
    if any(part not in signs for part in given):
        raise typer.BadParameter(f"{text!r}: give 1 or -1 per joint, separated by commas", param_hint="--sign")
    return [signs[part] for part in given]


def _channels(table: Table, proposal: Proposal) -> list[dict[str, Any]]:
    import numpy as np

    from service.identification.channels import rate_hz

    roles = {proposal.channels.time: "time"} | dict.fromkeys(table.time_of.values(), "time")
    for role in ("position", "torque", "position_command", "torque_command"):
        roles |= {name: f"{role} {k}" for k, name in enumerate(getattr(proposal.channels, role), 1)}
    rows = []
    for name, values in table.columns.items():
        known = values[np.isfinite(values)]
        clock = table.time_of.get(name, proposal.channels.time)
        stated = proposal.columns["time"].get("rate_hz")
        rows.append(
            {
                "channel": name,
                "unit": table.units.get(name, ""),
                "min": float(known.min()) if len(known) else None,
                "max": float(known.max()) if len(known) else None,
                "rate_hz": stated if clock is None else rate_hz(table, clock),
                "missing": len(values) - len(known),
                "taken_for": roles.get(name, ""),
            }
        )
    return rows


def _show(table: Table, proposal: Proposal) -> None:
    from rich.markup import escape

    say(f"[bold]{escape(str(table.path))}[/bold]: {table.kind}, {len(table)} rows")
    rows = []
    for row in _channels(table, proposal):
        low, high = ("-" if row[key] is None else f"{row[key]:.5g}" for key in ("min", "max"))
        rate = f"{row['rate_hz']:.6g}"
        rows.append((escape(row["channel"]), low, high, rate, row["taken_for"], escape(row["unit"])))
    head = ("channel", "min", "max", "rate, Hz", "used as", "stated unit")
    shown = len(head) if any(row[-1] for row in rows) else -1
    console().print(printed(head[:shown], [row[:shown] for row in rows], figures=slice(1, 4)), highlight=False)
    for reason in proposal.reasons:
        say(f"  {escape(reason)}")
    for doubt in proposal.doubts:
        say(f"  [yellow]check:[/yellow] {escape(doubt)}")


def _toml(table: Table, proposal: Proposal) -> str:
    import tomlkit

    from schemas.robot import toml_item

    document = tomlkit.document()
    document.add(
        tomlkit.comment(f"How to read {table.path.name} ({table.kind}). Keys: the documentation's page Column mapping.")
    )
    for line in (*proposal.reasons, *(f"check: {doubt}" for doubt in proposal.doubts)):
        document.add(tomlkit.comment(line))
    for key, value in proposal.columns.items():
        document[key] = toml_item(value)
    return tomlkit.dumps(document)


def _json(table: Table, proposal: Proposal, logs: list[Path], mapping: Path) -> str:
    document = {
        "file": str(table.path),
        "kind": table.kind,
        "channels": _channels(table, proposal),
        "columns": proposal.columns,
        "reasons": list(proposal.reasons),
        "doubts": list(proposal.doubts),
        "log": str(logs[0]),
        "logs": [str(log) for log in logs],
        "mapping": str(mapping),
    }
    return as_json("import", document)
