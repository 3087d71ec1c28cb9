"""What `payload` tells of a machine that carries one load all through a log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from service.cli.output import Table, as_json, conclude, console, read_by, table
from service.cli.reading import reading

if TYPE_CHECKING:
    import numpy as np

    from schemas.axes_description import Description
    from service.identification.log_load import Load


def weigh(
    traces: Sequence[Path], robot: Path, description: Description, columns: str | None, effects: Path | None,
    frame: str | None, json: bool,
) -> None:  # fmt: skip
    """Estimate and print the load of each of `traces`.

    Raises:
        UnansweredError: the machine has no frame that a load could hang on. Others as `load_on`.
    """
    import typer

    from service.identification.conclusion import of_load
    from service.identification.log_load import AXES, load_on
    from service.machines import machine_of

    machine_of(description).load(frame)  # before any log is read
    found = [load_on(description, trace, frame) for trace in reading(traces, description, columns, "weighing")]
    said = "\n".join(of_load(one) for one in found)
    if json:
        told = [
            asdict(one) | {"seen": one.seen, "centre_told": one.centre_told, "inertia_told": one.inertia_told}
            for one in found
        ]
        units = {"mass": "kg", "centre": "m", "inertia": "kg m^2", "torque": "N m"}
        document = {"loads": told, "inertia_axes": AXES, "units": units, "conclusion": said}
        typer.echo(as_json("payload", document))
        return
    console().print(_table(found), _left(found))
    for one in found:
        if one.centre_told:
            centre = ", ".join(f"{value:.4f}" for value in one.centre)
            known = f'frame = "{one.frame}", mass_kg = {one.mass:.4f}, centre_m = [{centre}]'
            typer.echo(f"for the description: `payload = {{ {known} }}`")
    conclude(said, "rollout", *traces, "--robot", robot, *read_by(columns, effects))


def _table(found: Sequence[Load]) -> Table:
    head = ("log", "frame", "mass, kg", "centre x, y, z, mm", "inertia xx, yy, zz about the centre, g m^2")
    rows = [
        (
            one.trace,
            one.frame,
            f"{one.mass:.3f} ± {one.mass_error:.3f}",
            _vector(1e3 * one.centre, 1e3 * one.centre_error) if one.centre_told else "not identifiable",
            _vector(1e3 * one.inertia[[0, 2, 5]], 1e3 * one.inertia_error[[0, 2, 5]])
            if one.inertia_told
            else "not identifiable",
        )
        for one in found
    ]
    return table(head, rows, "load, in the frame's axes, ± one standard error", figures=slice(2, None))


def _vector(values: np.ndarray, errors: np.ndarray) -> str:
    return ", ".join(f"{value:.1f} ± {error:.1f}" for value, error in zip(values, errors, strict=True))


def _left(found: Sequence[Load]) -> Table:
    head = ("log", *(f"joint {joint}" for joint in range(1, len(found[0].before) + 1)))
    rows = [(one.trace, *(f"{b:.3g}, {a:.3g}" for b, a in zip(one.before, one.after, strict=True))) for one in found]
    return table(head, rows, "residual torque without, with the load, rms N m while moving", figures=slice(1, None))
