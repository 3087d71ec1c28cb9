"""`deltatwin identify`: fit the model to traces."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.table import Table

    from service.identification.pooled import Estimate, Plain
    from service.identification.regression import Trajectory


def command(
    traces: Annotated[
        list[Path], typer.Argument(help="Logs to identify on: .csv, .csv.gz or .mcap", metavar="TRACE...")
    ],
    robot: Annotated[Path, typer.Option(help="Robot description (TOML)")],
    out: Annotated[Path, typer.Option(help="Robot description to write, with its [identified] section")],
    method: Annotated[
        Literal["pooled", "paper"],
        typer.Option(help="pooled: weighted least squares over all traces; paper: grid and mean over traces"),
    ] = "pooled",
    columns: Annotated[Path | None, typer.Option(help="Column mapping of a foreign table (TOML)")] = None,
) -> None:
    """Identify inertia, gravity, forearm and friction, with standard errors and a verdict for each.

    Example: deltatwin identify fit_*.csv --robot robot.toml --out identified.toml
    """
    from rich.console import Console

    from schemas.files import make_folder
    from schemas.robot import load_robot, save_robot
    from service.cli.reading import reading
    from service.identification.identify import identify
    from service.identification.regression import summarise
    from service.model.nominal import pack

    console = Console()
    make_folder(out.parent)
    description = load_robot(robot)
    model = pack(description)
    trajectories = [summarise(model, trace) for trace in reading(traces, description, columns, "reading")]
    result = identify(description, trajectories, method)
    save_robot(result.robot, out, template=robot)
    console.print(_parameters(result.fit.estimates))
    console.print(_residuals(result.fit, trajectories))
    for warning in result.warnings:
        console.print(f"warning: {warning}", highlight=False, markup=False, style="yellow", soft_wrap=True)
    console.print(f"wrote {out}", highlight=False, markup=False, soft_wrap=True)


def _parameters(estimates: Sequence[Estimate]) -> Table:
    from rich.table import Table

    table = Table("parameter", "value", "std. error", "unit", "verdict", "why", title="identified")
    for column in table.columns[1:3]:
        column.justify = "right"
    for estimate in estimates:
        value, error = f"{estimate.value:.4f}", f"{estimate.std_error:.4f}"
        table.add_row(estimate.name, value, error, estimate.unit, estimate.verdict, estimate.reason)
    return table


def _residuals(fit: Plain, trajectories: Sequence[Trajectory]) -> Table:
    from rich.table import Table

    from service.model.signals import ANALYSIS_HZ

    title = f"rms while moving, below {ANALYSIS_HZ:g} Hz, N m, joints 1 / 2 / 3"
    caption = f"noise of the torque in this band: {_three(fit.noise_floor)}"
    table = Table("trajectory", "torque", "residual", "held out", title=title, caption=caption)
    for column in table.columns[1:]:
        column.justify = "right"
        column.no_wrap = True
    for row, trajectory in enumerate(trajectories):
        table.add_row(trajectory.name, _three(fit.torque[row]), _three(fit.residual[row]), _three(fit.held_out[row]))
    return table


def _three(values) -> str:
    return " / ".join(f"{value:.2f}" for value in values)
