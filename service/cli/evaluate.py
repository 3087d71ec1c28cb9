"""`deltatwin evaluate`: how far each model is off on traces."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from service.identification.evaluation import Evaluation, Moments


def command(
    traces: Annotated[list[Path], typer.Argument(help="Traces: .csv, .csv.gz or .mcap", metavar="TRACE...")],
    robot: Annotated[Path, typer.Option(help="Robot description (TOML), plain, identified or corrected")],
    columns: Annotated[Path | None, typer.Option(help="Column mapping of a foreign table (TOML)")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table")] = False,
    predictions: Annotated[
        Path | None, typer.Option(help="Folder for the fullest model's torque, one CSV a trace, every row")
    ] = None,
) -> None:
    """Mean and standard deviation of measured minus predicted torque for each model.

    Offline: the motion is smoothed in both directions; joints at rest are left out.

    Example: deltatwin evaluate test_*.csv --robot identified.toml --predictions predicted/
    """
    from rich.console import Console

    from schemas.errors import TraceError
    from schemas.robot import load_robot
    from service.cli.reading import reading
    from service.identification.evaluation import evaluate

    description = load_robot(robot)
    targets = [predictions / _csv_name(path) for path in traces] if predictions else []
    for number, target in enumerate(targets):
        if target in targets[:number]:
            raise TraceError(f"{traces[number]}: a second trace for {target}")
    results: list[Evaluation] = []
    for number, trace in enumerate(reading(traces, description, columns, "evaluating")):
        result = evaluate(description, trace)
        if targets:
            _write(result, targets[number])
        result.torque.clear()
        results.append(result)
    for result in results:
        if result.unmeasured:
            print(f"{result.trace.path}: {result.unmeasured} of {len(result.trace)} rows left out", file=sys.stderr)
    if json:
        print(_json(results))
    else:
        Console().print(_table(results))


def _csv_name(path: Path) -> str:
    """`path`'s name; a trace of another format gets .csv for its ending."""
    name = path.name
    for ending in (".gz", ".mcap", ".txt", ".tsv"):
        name = name.removesuffix(ending)
    return name if name.endswith(".csv") else f"{name}.csv"


def _write(result: Evaluation, path: Path) -> None:
    import polars as pl

    from schemas.errors import TraceError

    fullest = list(result.torque.values())[-1]
    columns = {"time_s": result.trace.time} | {f"torque_model_{j + 1}_nm": fullest[:, j] for j in range(3)}
    partial = path.with_name(f".part-{path.name}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        pl.DataFrame(columns).write_csv(partial)
        partial.replace(path)  # a reader never sees half a file
    except OSError as error:
        raise TraceError(f"{path}: {error.strerror}") from error
    finally:
        partial.unlink(missing_ok=True)


def _pooled(results: list[Evaluation]) -> dict[str, Moments]:
    from service.identification.evaluation import pooled
    from service.identification.predict import FULL

    names = dict.fromkeys(name for result in results for name in result.errors)
    # a trace without a pick has no entry with a payload: there the fullest model stands for itself
    return {name: pooled(result.errors.get(name, result.errors[FULL]) for result in results) for name in names}


def _json(results: list[Evaluation]) -> str:
    from json import dumps

    from service.identification.signals import ANALYSIS_HZ

    def figures(errors: dict[str, Moments]) -> dict[str, dict[str, list[float | None]]]:
        return {
            name: {
                "mean_nm": _finite(moments.mean),
                "std_nm": _finite(moments.std),
                "rms_nm": _finite(moments.rms),
            }
            for name, moments in errors.items()
        }

    document = {
        "schema": "deltatwin.evaluation/1",
        "analysis_hz": ANALYSIS_HZ,
        "models": figures(_pooled(results)),
        "traces": [
            {
                "trace": str(result.trace.path),
                "rows": len(result.trace),
                "unmeasured_rows": result.unmeasured,
                "models": figures(result.errors),
            }
            for result in results
        ],
    }
    return dumps(document, indent=1)


def _finite(values) -> list[float | None]:
    return [float(value) if value == value else None for value in values]


def _table(results: list[Evaluation]) -> Table:
    from rich.table import Table

    from service.identification.signals import ANALYSIS_HZ

    table = Table(
        "model",
        *(f"joint {joint + 1}: mean, std" for joint in range(3)),
        title=f"torque - model, N m, below {ANALYSIS_HZ:g} Hz while moving, {len(results)} trace(s)",
    )
    for column in table.columns[1:]:
        column.justify = "right"
    for name, moments in _pooled(results).items():
        table.add_row(name, *(f"{m:.3f}, {s:.3f}" for m, s in zip(moments.mean, moments.std, strict=True)))
    return table
