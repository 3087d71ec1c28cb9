"""`deltatwin inspect`: Show what a log contains and what is wrong with it."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from service.cli.options import AsJson, ColumnsFrom, robot_file
from service.cli.output import apart_from, as_json, conclude, console, read_by, say, table

if TYPE_CHECKING:
    from schemas.axes_description import Description
    from schemas.trace import Trace

ROWS_SHOWN = 12  # changes of a capture
STAMPS = ("rate_hz", "jitter_std_s", "jitter_p99_s", "jitter_max_s", "gaps", "repeats", "backwards")


def command(
    traces: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG", help="Recorded logs (.csv, .csv.gz, .mcap) or EtherCAT captures (.pcap, .pcapng)."
        ),
    ],
    robot: Annotated[Path | None, robot_file(": joint range, gear ratio, its columns table.")] = None,
    columns: ColumnsFrom = None,
    json: AsJson = False,
) -> None:
    """Show rate, jitter, gaps, repeats and ranges of each channel, and what is missing or wrong.

    For a capture: slaves, cycle time and its jitter, working-counter faults, lost cycles, state changes, mapping; with
    --robot also the objects of the drives, and whether they contradict their declared scaling.

    Exit code 1 if a log is unusable; the other logs are still shown.

    Example: deltatwin inspect pick_a.csv pick_b.mcap --robot d3.toml
    """
    from drivers.trace import CAPTURE_ENDINGS, find_columns, read_trace
    from drivers.trace.capture_survey import survey_capture
    from drivers.trace.survey import survey
    from schemas.axes_description import load_description
    from schemas.errors import TraceError
    from schemas.questions import Question, as_delta

    description = load_description(robot) if robot else None
    mapping = find_columns(columns) if columns else None
    failed, surveys = False, []
    following = _Following(description)
    for path in traces:
        try:
            capture = path.name.endswith(CAPTURE_ENDINGS)
            with console(stderr=True).status(f"reading {path.name}"):
                if capture:
                    surveys.append(survey_capture(path, description and as_delta(description, Question.FIELDBUS)))
                    following.captures.append(path)
                else:
                    trace = read_trace(path, description, mapping)
                    surveys.append(survey(trace))
                    following.add(path, trace, surveys[-1])
        except TraceError as error:
            failed = True
            surveys.append({"path": str(path), "error": str(error)})
            if not json:
                typer.echo(f"deltatwin: {error}", err=True)
            continue
        if not json:
            (_show_capture if capture else _show)(surveys[-1])
    if json:
        typer.echo(as_json("inspection", {"traces": surveys}))
    else:
        _conclude(surveys, traces, robot, columns, following)
    if failed:
        raise typer.Exit(1)


class _Following:
    """What the next command can do with the logs. of_use: those that a model of `description` can be fitted to.
    captures: of a bus."""

    def __init__(self, description: Description | None) -> None:
        from service.identification.of_logs import Asked

        self._asked = None if description is None else Asked(description)
        self.of_use: list[Path] = []
        self.captures: list[Path] = []

    def add(self, path: Path, trace: Trace, figures: dict[str, Any]) -> None:
        """figures: what `survey` says of it."""
        from drivers.trace.survey import is_of_use
        from schemas.errors import DataError, TraceError

        if self._asked is not None and is_of_use(figures) and path not in self.of_use:
            with suppress(DataError, TraceError):
                self._asked.add(trace)
                self.of_use.append(path)

    def refusal(self) -> str | None:
        """Why `identify` refuses the logs that are of use; None where it does not."""
        return None if self._asked is None else self._asked.refusal()


def _conclude(
    surveys: list[dict[str, Any]], traces: list[Path], robot: Path | None, columns: object, following: _Following
) -> None:
    from schemas.words import counted

    usable = [path for path, one in zip(traces, surveys, strict=True) if "error" not in one]
    clean = sum("error" not in one and not one["findings"] for one in surveys)
    said = f"{len(usable)} of {counted(len(surveys), 'file')} usable, {clean} without a finding."
    unread = [path for path, one in zip(traces, surveys, strict=True) if "deltatwin import" in one.get("error", "")]
    if not usable and unread:
        conclude(said, "import", unread[0], *(("--robot", robot) if robot else ()))
    elif robot and following.of_use:
        read = ("--robot", robot, *read_by(columns))
        if refused := following.refusal():
            conclude(f"{said} {_too_little(refused, len(following.of_use))}", "evaluate", *following.of_use, *read)
        else:
            conclude(said, "identify", *following.of_use, *read, "--out", apart_from("identified.toml", robot))
    elif robot and following.captures:
        capture = following.captures[0]
        target = apart_from(f"{capture.name.partition('.')[0]}.mcap", *Path().glob("*.mcap"))
        conclude(said, "convert", capture, target, "--robot", robot)
    elif usable and not robot:
        conclude(said, "init", "--help")
    else:
        print(said)  # no command makes anything of these, or the error names it


def _too_little(refused: str, logs: int) -> str:
    more = " Several logs of one robot can be given together: their motion adds up." if logs == 1 else ""
    return f"Not enough to identify the robot: {refused}.{more}"


def _show(figures: dict[str, Any]) -> None:
    from schemas.words import counted

    say(
        f"[bold]{escape(figures['path'])}[/bold]: {counted(figures['samples'], 'sample')}, "
        f"{counted(figures['joints'], 'joint')}, "
        f"{figures['duration_s']:.6g} s from {figures['start_s']:.9g} s"
    )
    bases: dict[tuple, list[str]] = {}  # channels with the same stamps
    for name, channel in figures["channels"].items():
        bases.setdefault(tuple(channel[key] for key in STAMPS), []).append(name)
    stamps = table(("stamps of", "rate", "jitter std", "p99", "max", "gaps", "repeats", "back"))
    for base, names in bases.items():
        rate, *jitter, gaps, repeats, back = base
        stamps.add_row(
            "all channels" if len(bases) == 1 else "\n".join(names),
            f"{rate:.6g} Hz",
            *(f"{value * 1e6:.3f} µs" for value in jitter),
            *(_count(value) for value in (gaps, repeats, back)),
        )
    console().print(stamps, highlight=False)
    head = ("channel", "unit", "min", "max", "smallest step", "longest hold", "missing")
    values = table(head, figures=slice(2, None))
    for name, channel in figures["channels"].items():
        hold = channel["longest_hold_s"]
        values.add_row(
            name,
            channel["unit"],
            *(_number(channel[key]) for key in ("min", "max", "resolution")),
            "-" if hold is None else f"{hold * 1e3:.4g} ms",
            _count(channel["missing"]),
        )
    console().print(values, highlight=False)
    if figures["missing"]:
        say(f"not recorded: {', '.join(figures['missing'])}")
    for finding in figures["findings"]:
        kind = f"[yellow]{finding['flag']}[/yellow]" if finding["flag"] else "[dim]note[/dim]"
        say(f"{kind}: {escape(finding['message'])}")
    if not figures["findings"]:
        say("[green]nothing wrong found[/green]")
    say("")


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.5g}"


def _show_capture(figures: dict[str, Any]) -> None:
    """Print what `drivers.trace.capture_survey.survey_capture` found."""
    say(
        f"[bold]{escape(figures['path'])}[/bold]: {figures['frames']} frames, {figures['ethercat_frames']} EtherCAT, "
        f"{figures['datagrams']} datagrams, {figures['duration_s']:.6g} s"
    )
    stations = ", ".join(f"{station:#06x}" for station in figures["stations"]) or "none"
    say(f"slaves: {figures['slaves']}; configured stations: {stations}")
    for entry in figures["cyclic"]:
        _say_cyclic(entry)
    for name, text in (
        ("cut_frames", "EtherCAT frames that are not whole"),
        ("snapped_frames", "frames snapped by the capture"),
        ("damaged_frames", "frames marked as damaged by the analyzer"),
        ("repeated_frames", "frames captured twice (a bridge, a mirror port, every interface at once), left out"),
        ("pseudo_frames", "GPIO events of the analyzer"),
        ("foreign_frames", "packets that carry no Ethernet"),
    ):
        if figures[name]:
            say(f"[yellow]{figures[name]}[/yellow] {text}")
    changes = figures["state_changes"]
    for change in changes[:ROWS_SHOWN]:
        who = "all slaves" if change["station"] is None else f"station {change['station']:#06x}"
        code = f", AL status code {change['al_status_code']:#06x}" if "al_status_code" in change else ""
        say(f"{change['time_s']:12.6f} s  {who}: {change['state']}{code}")
    _more(len(changes))
    for area in figures["mapping"]:
        say(
            f"station {area['station']:#06x} maps {area['bytes']} bytes of {area['direction']} "
            f"({area['physical_address']:#06x}) at logical address {area['logical_address']:#x}"
        )
    if "robot" in figures:
        _show_robot(figures["robot"])
    for finding in figures["findings"]:
        say(f"[yellow]{escape(finding)}[/yellow]")
    say("")


def _say_cyclic(entry: dict[str, Any]) -> None:
    name = f"{entry['command']} {entry['logical_address']:#x}, {entry['bytes']} bytes"
    say(f"[bold]{name}[/bold]: {entry['sent']} sent, {entry['returned']} returned")
    if entry["cycle_s"] is not None and entry["jitter_std_s"] is None:
        say(f"  cycle {entry['cycle_s'] * 1e6:.2f} µs by the number of frames")
    elif entry["cycle_s"] is not None:
        jitter = [f"{entry[key] * 1e6:.2f}" for key in ("jitter_std_s", "jitter_p99_s", "jitter_max_s")]
        say(
            f"  cycle {entry['cycle_s'] * 1e6:.2f} µs, jitter {jitter[0]} µs std, {jitter[1]} p99, {jitter[2]} max; "
            f"lost cycles {_count(entry['lost_cycles'])}"
        )
    if entry["working_counter"] is not None:
        say(
            f"  working counter {entry['working_counter']}, {_count(entry['working_counter_faults'])} below, "
            f"{_count(entry['unanswered'])} of them unanswered"
        )


def _show_robot(robot: dict[str, Any]) -> None:
    for joint in (1, 2, 3):
        objects = [entry for entry in robot["objects"] if entry["joint"] == joint]
        say(f"joint {joint}: " + ", ".join(f"{o['object']} at {o['logical_address']:#x}" for o in objects))
    if "error" in robot:
        say(f"[yellow]{escape(robot['error'])}[/yellow]")
        return
    say(f"{robot['samples']} samples")
    changes = robot["drive_state_changes"]
    for change in changes[:ROWS_SHOWN]:
        say(f"{change['stamp_s']:.6f} s  joint {change['joint']}: {change['state'].replace('_', ' ')}")
    _more(len(changes))
    for finding in robot["findings"]:
        say(f"[dim]note:[/dim] {escape(finding)}")


def _more(found: int) -> None:
    if found > ROWS_SHOWN:
        say(f"... {found - ROWS_SHOWN} more (--json)")


def _count(value: int) -> str:
    """A number of faults, marked where there are any."""
    return f"[yellow]{value}[/yellow]" if value else "0"
