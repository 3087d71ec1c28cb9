"""`deltatwin inspect`: what a trace holds and what is wrong with it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from service.cli.options import AsJson, ColumnsFrom, robot_file
from service.cli.output import as_json, console, say, table

STAMPS = ("rate_hz", "jitter_std_s", "jitter_p99_s", "jitter_max_s", "gaps", "repeats", "backwards")


def command(
    traces: Annotated[
        list[Path],
        typer.Argument(
            metavar="TRACE", help="Recorded traces (.csv, .csv.gz, .mcap) or EtherCAT captures (.pcap, .pcapng)."
        ),
    ],
    robot: Annotated[Path | None, robot_file(": joint range, gear ratio, its columns table.")] = None,
    columns: ColumnsFrom = None,
    json: AsJson = False,
) -> None:
    """Show rate, jitter, gaps, repeats and ranges of each channel, and what is missing or wrong.

    A capture: slaves, cycle time and its jitter, working-counter faults, lost cycles, state changes, mapping; with
    --robot also the objects of its drives and what contradicts their declared scaling.

    Exit code 1 if a trace is unusable; the others are shown all the same.

    Example: deltatwin inspect pick_a.csv pick_b.mcap --robot d3.toml
    """
    from drivers.trace import CAPTURE_ENDINGS, find_columns, read_trace
    from drivers.trace.capture_survey import survey_capture
    from drivers.trace.survey import survey
    from schemas.axes import load_description, no_axes
    from schemas.errors import TraceError
    from service.cli.capture_tables import show_capture

    description = load_description(robot) if robot else None
    mapping = find_columns(columns) if columns else None
    failed, surveys = False, []
    for path in traces:
        try:
            capture = path.name.endswith(CAPTURE_ENDINGS)
            with console(stderr=True).status(f"reading {path.name}"):
                if capture:
                    surveys.append(survey_capture(path, no_axes(description, str(path))))
                else:
                    surveys.append(survey(read_trace(path, description, mapping)))
        except TraceError as error:
            failed = True
            surveys.append({"path": str(path), "error": str(error)})
            if not json:
                typer.echo(f"deltatwin: {error}", err=True)
            continue
        if not json:
            (show_capture if capture else _show)(surveys[-1])
    if json:
        typer.echo(as_json("inspection", {"traces": surveys}))
    if failed:
        raise typer.Exit(1)


def _show(figures: dict[str, Any]) -> None:
    from rich.markup import escape

    from service.cli.capture_tables import count

    say(
        f"[bold]{escape(figures['path'])}[/bold]: {figures['samples']} samples, {figures['joints']} joints, "
        f"{figures['duration_s']:.6g} s from {figures['start_s']:.9g} s"
    )
    bases: dict[tuple, list[str]] = {}  # channels with the same stamps
    for name, channel in figures["channels"].items():
        bases.setdefault(tuple(channel[key] for key in STAMPS), []).append(name)
    stamps = table(("stamps of", "rate", "jitter std", "p99", "max", "gaps", "repeats", "back"), bare=True)
    for base, names in bases.items():
        rate, *jitter, gaps, repeats, back = base
        stamps.add_row(
            "all channels" if len(bases) == 1 else "\n".join(names),
            f"{rate:.6g} Hz",
            *(f"{value * 1e6:.3f} µs" for value in jitter),
            *(count(value) for value in (gaps, repeats, back)),
        )
    console().print(stamps, highlight=False)
    head = ("channel", "unit", "min", "max", "smallest step", "longest hold", "missing")
    values = table(head, figures=slice(2, None), bare=True)
    for name, channel in figures["channels"].items():
        hold = channel["longest_hold_s"]
        values.add_row(
            name,
            channel["unit"],
            *(_number(channel[key]) for key in ("min", "max", "resolution")),
            "-" if hold is None else f"{hold * 1e3:.4g} ms",
            count(channel["missing"]),
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
