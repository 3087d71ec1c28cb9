"""`deltatwin identify`: Identify the parameters of the model from logs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from service.cli.options import AsJson, ColumnsFrom, robot_file
from service.cli.output import Table, as_json, conclude, console, read_by, table
from service.cli.reading import files_in, reading

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from schemas.axes_description import Description
    from service.identification.calibration import CalibratedFigure
    from service.identification.pooled import ParameterEstimate, Plain

CHANGED = {True: "corrected", False: "left as described"}


def command(
    traces: Annotated[list[Path], typer.Argument(help="Logs to identify on: .csv, .csv.gz or .mcap", metavar="LOG")],
    robot: Annotated[Path, robot_file()],
    out: Annotated[Path, typer.Option(help="Robot description to write, with its [identified] section")],
    method: Annotated[
        Literal["pooled", "paper"],
        typer.Option(help="pooled: weighted least squares over all logs; paper: grid and mean over logs"),
    ] = "pooled",
    carried: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KG:LOG",
            help="Known load carried throughout a log: 3.0:log.csv (kg). Calibrates torque constants and platform mass",
        ),
    ] = None,
    rig: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LOG:KEY=VALUE,...",
            help="Known body that a servo axis moves in this log: log.csv:mass=0.5,length=0.1 (kg, m). Keys: mass, "
            "length, inertia (kg m^2), angle (rad, where it hangs), axis",
        ),
    ] = None,
    spread: Annotated[bool, typer.Option("--spread", help="Also show the parameters of each log alone")] = False,
    json: AsJson = False,
    columns: ColumnsFrom = None,
) -> None:
    """Identify inertia, gravity, forearm mass and friction, with a standard error and a verdict for each.

    Example: deltatwin identify fit_*.csv --robot robot.toml --out identified.toml --carried 3.0:loaded.csv
    """
    from dataclasses import asdict

    from schemas.axes_description import load_description, save_description
    from schemas.files import check_apart, make_folder
    from service.identification import rigs
    from service.identification.conclusion import of_fit
    from service.identification.of_logs import identify_logs
    from service.model.description import in_units_of

    make_folder(out.parent)
    description = load_description(robot)
    loads = [_load(text) for text in carried or ()]
    check_apart(out, *description.sources, *traces, *(path for _, path in loads), *files_in(columns))
    heavy = reading([path for _, path in loads], description, columns, "reading")
    known = [(mass, log) for (mass, _), log in zip(loads, heavy, strict=True)]
    of_logs = rigs.of_logs([rigs.Rig.read(text) for text in rig or ()], [str(path) for path in traces])
    logs = reading(traces, description, columns, "reading")
    result, figures = identify_logs(description, logs, method, known, of_logs)
    save_description(result.robot, out, template=robot)
    if json:
        parameters = [
            asdict(estimate) | {"unit": in_units_of(description, estimate.unit)} for estimate in result.fit.estimates
        ]
        document = {"parameters": parameters, "warnings": list(result.warnings), "conclusion": of_fit(result.fit)[0]}
        if figures:
            document["calibration"] = [asdict(figure) for figure in figures]
        if spread:
            document["runs"] = _runs(result.fit, [path.name for path in traces])
        typer.echo(as_json("identification", document | {"out": str(out)}))
        return
    screen = console()
    screen.print(_parameters(result.fit.estimates, description))
    if figures:
        screen.print(_calibrated(figures))
    if spread:
        screen.print(_spread(result.fit, [path.name for path in traces], description))
    screen.print(_residuals(result.fit, [path.name for path in traces], description))
    for warning in result.warnings:
        typer.secho(f"warning: {warning}", fg="yellow")
    print(f"wrote {out}")
    said, explained = of_fit(result.fit)
    if explained:
        own = "OTHER_LOG: a log of this robot that was not used here"
        conclude(said, "evaluate", "OTHER_LOG", "--robot", out, *read_by(columns), own=own)
    else:
        conclude(said, "diagnose", *traces, "--robot", robot, *read_by(columns), "--out", "diagnosis")


def _load(text: str) -> tuple[float, Path]:
    """Mass and trace of a --carried."""
    mass, _, path = text.partition(":")
    try:
        if not path:
            raise ValueError
        return float(mass), Path(path)
    except ValueError:
        raise typer.BadParameter(f"--carried {text}: give mass in kg and log, such as 3.0:log.csv") from None


def _calibrated(figures: Sequence[CalibratedFigure]) -> Table:
    rows = [(one.name, *_figures(one.value, one.std_error), one.unit, CHANGED[one.changed]) for one in figures]
    return table(("", "value", "std. error", "unit", ""), rows, "calibrated by the known load", figures=slice(1, 3))


def _parameters(estimates: Sequence[ParameterEstimate], robot: Description) -> Table:
    from service.model.description import in_units_of

    rows = [
        (one.name, *_figures(one.value, one.std_error), in_units_of(robot, one.unit), one.verdict, one.reason)
        for one in estimates
    ]
    return table(
        ("parameter", "value", "std. error", "unit", "verdict", "reason"), rows, "identified", figures=slice(1, 3)
    )


def _runs(fit: Plain, names: Sequence[str]) -> list[dict[str, object]]:
    """Each log's parameters by a fit to it alone."""
    return [
        {"trace": name, "parameters": {one.name: value for one, value in zip(fit.estimates, values, strict=True)}}
        for name, values in zip(names, fit.runs.tolist(), strict=True)
    ]


def _spread(fit: Plain, names: Sequence[str], robot: Description) -> Table:
    """Parameters of each log alone, and how far they are apart."""
    import numpy as np

    from service.model.description import in_units_of

    rows = []
    for one, values in zip(fit.estimates, fit.runs.T, strict=True):
        told = [_figures(value, one.std_error)[0] for value in (one.value, float(np.ptp(values)), *values.tolist())]
        rows.append((one.name, *told, in_units_of(robot, one.unit)))
    head = ("parameter", "all", "highest - lowest", *names, "unit")
    return table(head, rows, "each log alone", figures=slice(1, len(head) - 1))


def _residuals(fit: Plain, names: Sequence[str], robot: Description) -> Table:
    from service.model.description import in_units_of

    joints = " / ".join(str(joint + 1) for joint in range(len(fit.noise)))
    title = f"rms while moving, below {fit.problem.band.cutoff_hz:g} Hz, {in_units_of(robot, 'N m')}, joints {joints}"
    caption = f"noise of the torque in this band: {_each(fit.noise_floor)}"
    rows = [
        (name, *(_each(rms[row], fit.torque[row] > 0) for rms in (fit.torque, fit.residual, fit.held_out)))
        for row, name in enumerate(names)
    ]
    return table(("log", "torque", "residual", "held out"), rows, title, caption)


def _each(values: np.ndarray, moves: np.ndarray | None = None) -> str:
    """A figure a joint; a joint of which no row counts has none."""
    import numpy as np

    told = ["-" if np.isnan(value) else f"{value:.3g}" for value in values]
    return " / ".join(told if moves is None else np.where(moves, told, "never moves"))


def _figures(value: float, std_error: float) -> tuple[str, str]:
    """A value and its error with as many decimals as the error's second digit takes, four at least."""
    import math

    smallest = std_error if math.isfinite(std_error) and std_error > 0 else abs(value) / 100
    decimals = 4 if not math.isfinite(smallest) or smallest == 0 else max(4, 1 - math.floor(math.log10(smallest)))
    return f"{value:.{decimals}f}", f"{std_error:.{decimals}f}"
