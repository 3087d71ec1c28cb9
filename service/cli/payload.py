"""`deltatwin payload`: what was picked in traces."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.reading import AsJson, ColumnsFrom, OwnEffects, reading

if TYPE_CHECKING:
    from rich.table import Table

    from service.identification.payload import Level, PayloadHistory, Score


def command(
    traces: Annotated[list[Path], typer.Argument(help="Traces: .csv, .csv.gz or .mcap", metavar="TRACE")],
    robot: Annotated[Path, typer.Option(metavar="FILE|NAME", help="Robot description (TOML) that `identify` wrote")],
    effects: OwnEffects = None,
    columns: ColumnsFrom = None,
    json: AsJson = False,
    truth: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="What was really picked: CSV with from_s,until_s,mass_kg; one a trace"),
    ] = None,
    predictions: Annotated[
        Path | None, typer.Option(help="Folder for <trace>.csv with mass, std_dev, trusted, event after every sample")
    ] = None,
) -> None:
    """Find picks and releases and weigh what was picked, as the online estimator does it.

    With --truth beside it: how soon, how close, and the same for the paper's recursion at a fixed forgetting factor, on
    the M_Id+F of this description. Identified the paper's way, other factors, rest left out: `deltatwin experiment`.

    Example: deltatwin payload pick_a.csv --robot identified.toml --truth pick_a.payloads.csv
    """
    from dataclasses import asdict

    from schemas.errors import DataError
    from schemas.robot import load_robot
    from service.cli.output import as_json
    from service.cli.output import console as result_console
    from service.identification.payload import levels, payload_history, read_truth, score

    if truth and len(truth) != len(traces):
        raise DataError(f"--truth: {len(truth)} files for {len(traces)} traces; give one a trace, in their order")
    description = load_robot(robot, effects)
    console = result_console()
    scores: list[Score] = []
    weighed: list[dict[str, Any]] = []
    for number, trace in enumerate(reading(traces, description, columns, "weighing")):
        found = payload_history(description, trace)
        if predictions is not None:
            _write(found, predictions / f"{trace.path.name.split('.')[0]}.csv")
        if truth:
            scores += [score(found, pick) for pick in read_truth(truth[number])]
        elif json:
            seen = [asdict(level) | {"event": level.event.name.lower()} for level in levels(found)]
            weighed.append({"trace": str(trace.path), "levels": seen})
        else:
            console.print(_found(trace.path.name, levels(found)))
    if json:
        scored = [asdict(score) for score in scores]
        typer.echo(as_json("payload", {"traces": weighed, "picks": scored}))
    elif scores:
        for table in _scored(scores):
            console.print(table)


def _write(found: PayloadHistory, path: Path) -> None:
    import numpy as np

    from schemas.errors import StorageError
    from schemas.files import whole

    columns = np.column_stack([found.time, found.mass, found.std_dev, found.trusted, found.event])
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{path.parent}: {error.strerror}") from error
    with whole(path) as partial:
        header = "time_s,mass_kg,std_dev_kg,trusted,event"
        np.savetxt(partial, columns, ("%.6f", "%.5f", "%.5f", "%d", "%d"), ",", header=header, comments="")


def _found(name: str, seen: list[Level]) -> Table:
    from rich.table import Table

    table = Table("seen at, s", "until, s", "what", "mass, kg", "std dev, kg", "trusted", title=f"{name}: payload")
    for level in seen:
        what = level.event.name.lower()
        table.add_row(
            f"{level.begin:.3f}", f"{level.end:.3f}", what, f"{level.mass:.3f}", f"{level.std_dev:.3f}",
            f"{level.trusted:.0%}",
        )  # fmt: skip
    return table


def _scored(scores: list[Score]) -> list[Table]:
    import numpy as np
    from rich.table import Table

    each = Table(
        "picked at, s", "truth, kg", "mass, kg", "found, ms", "pick seen, ms", "release seen, ms",
        "paper: mass, kg", "paper: found, ms", title="payload: delays after the true pick or release",
    )  # fmt: skip

    def ms(seconds: float) -> str:
        return "never" if np.isnan(seconds) else f"{seconds * 1e3:.0f}"

    for s in scores:
        each.add_row(
            f"{s.truth.begin:.3f}", f"{s.truth.mass:.2f}", f"{s.mass:.3f}", ms(s.settled), ms(s.seen), ms(s.released),
            f"{s.mass_recursion:.3f}", ms(s.settled_recursion),
        )  # fmt: skip
    summary = Table("", "estimator", "paper's recursion", title=f"{len(scores)} picks")
    heavy = [s for s in scores if s.truth.mass >= 1.0]

    def row(label: str, of: list[Score], value) -> None:
        summary.add_row(label, *(value(of, suffix) for suffix in ("", "_recursion")))

    def found(of: list[Score], suffix: str) -> str:
        return f"{np.mean([getattr(s, f'settled{suffix}') <= 0.15 for s in of]):.0%}"

    def off(of: list[Score], suffix: str) -> np.ndarray:
        return np.array([abs(getattr(s, f"mass{suffix}") / s.truth.mass - 1) for s in of])

    row("found within 150 ms (5 % or 50 g, and staying)", scores, found)
    if heavy:
        row("error at the release, median, >= 1 kg", heavy, lambda of, suffix: f"{np.median(off(of, suffix)):.2%}")
        row("within 4 % at the release, >= 1 kg", heavy, lambda of, suffix: f"{np.mean(off(of, suffix) <= 0.04):.0%}")
    return [each, summary]
