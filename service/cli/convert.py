"""`deltatwin convert`: Convert a log to another format."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.options import ColumnsFrom, robot_file
from service.cli.output import conclude
from service.cli.progress import bars
from service.cli.reading import files_in


def command(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="IN",
            help="Recorded log (.csv, .csv.gz, .mcap) or EtherCAT capture (.pcap, .pcapng; with --robot).",
        ),
    ],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="File to write; its ending selects the format.")],
    robot: Annotated[Path | None, robot_file(": joint range, gear ratio, columns table, topic.")] = None,
    columns: ColumnsFrom = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace OUT if it exists.")] = False,
) -> None:
    """Write a log as .csv, .csv.gz (joint side, SI, full precision) or .mcap (ROS 2 messages, opens in Foxglove).

    Rows are kept as recorded; faults in them are reported here and flagged in the MCAP. OUT appears only when it is
    complete.

    For a capture, --robot gives the layout and scaling of the drives; frames that contradict them are reported.

    Example: deltatwin convert scope_export.csv pick.mcap --robot d3.toml --columns twincat.toml
    """

    from drivers.trace import CAPTURE_ENDINGS, find_columns, read_trace, write_trace
    from schemas.axes_description import load_description
    from schemas.errors import StorageError
    from schemas.files import check_apart
    from schemas.questions import Question, as_delta
    from schemas.trace import UNNAMED

    description = load_description(robot) if robot else None
    check_apart(target, source, *(description.sources if description else ()), *files_in(columns))
    if target.exists() and not overwrite:
        raise StorageError(f"{target}: exists already; --overwrite replaces it")
    mapping = find_columns(columns) if columns else None
    capture = source.name.endswith(CAPTURE_ENDINGS)
    delta = as_delta(description, Question.FIELDBUS) if description and capture else None
    if delta and target.name.endswith(".mcap"):
        from drivers.trace.capture_trace import convert_capture  # as a stream: a capture can be larger than the memory

        with bars() as progress:
            task = progress.add_task(f"converting {source.name}", total=None)
            made, findings = convert_capture(
                source, delta, target, lambda done, size: progress.update(task, completed=done, total=size)
            )
        for finding in findings:
            typer.echo(f"{source}: {finding.message}", err=True)
        _conclude(target, made, 3, robot)
        return
    with bars() as progress:
        reading = progress.add_task(f"reading {source.name}", total=None)
        trace = read_trace(source, description, mapping)
        progress.remove_task(reading)
        writing = progress.add_task(f"writing {target.name}", total=len(trace))
        write_trace(
            trace,
            target,
            description.name if description else UNNAMED,
            lambda done: progress.update(writing, completed=done),
        )
    for finding in trace.findings:
        typer.echo(f"{source}: {finding.message}", err=True)
    _conclude(target, len(trace), trace.position.shape[1], robot)


def _conclude(target: Path, samples: int, joints: int, robot: Path | None) -> None:
    from schemas.words import counted

    said = f"{target}: {counted(samples, 'sample')}, {counted(joints, 'joint')}"
    if robot:
        conclude(said, "evaluate", target, "--robot", robot)
    else:
        conclude(said, "inspect", target)
