"""What `rollout` tells of axes and arms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from schemas.words import significant
from service.cli.output import Table, as_json, conclude, console, read_by, table
from service.cli.reading import reading

if TYPE_CHECKING:
    from schemas.axes_description import Description
    from service.rollout.joints import JointRollout


def roll_out(
    traces: Sequence[Path],
    machines: Sequence[tuple[str, Description]],
    paths: Sequence[Path],
    columns: str | None,
    effects: Path | None,
    horizon: float,
    out: Path | None,
    json: bool,
) -> None:
    """Simulate machines over `traces` and print how far they are from them.

    Raises:
        As `service.rollout.joints.compare`.
    """
    import typer

    from schemas.files import make_folder, write_text
    from service.identification.copies import distinct
    from service.rollout.joints import compare, named, sentences

    robots = named(machines)
    if out is not None:
        make_folder(out)
    recorded = list(reading(traces, machines[0][1], columns, "reading"))
    with console(stderr=True).status("simulating") as status:
        found = compare(robots, recorded, horizon, lambda what: status.update(f"simulating {what}"))
    said = sentences(found)
    document = _document(found, [trace.name for trace in recorded]) | {"conclusion": said}
    if out is not None:
        write_text(out / "rollout.json", as_json("joint-rollout", document))
    if json:
        typer.echo(as_json("joint-rollout", document))
        return
    console().print(_table(found))
    if out is not None:
        typer.echo(f"wrote rollout.json in {out}")
    once = [trace.path for trace in distinct(recorded)]
    conclude("\n".join(said), "diagnose", *once, "--robot", paths[-1], *read_by(columns, effects), "--out", "diagnosis")


def _document(found: JointRollout, traces: list[str]) -> dict[str, Any]:
    robots = [
        {
            "robot": one.name,
            "joint": one.joint_rms,
            "tool_m": one.tool_rms,
            "growth": one.growth,
            "ran_away": int((~one.good).sum()),
        }
        for one in found.deviations
    ]
    unit = "rad" if found.angular else "m"
    figures = {"horizon_s": found.horizon, "period_s": found.period, "windows": found.windows, "unit": unit}
    return {"traces": traces} | figures | {"robots": robots}


def _table(found: JointRollout) -> Table:
    unit, tool = "mrad" if found.angular else "mm", found.deviations[0].tool_rms is not None
    head = ["robot", *(f"joint {j}, {unit}" for j in range(1, found.deviations[0].joint.shape[1] + 1))]
    rows = []
    for one in found.deviations:
        row = [one.name, *map(_thousandths, one.joint_rms)]
        rows.append([*row, "-" if one.tool_rms is None else _thousandths(one.tool_rms)] if tool else row)
    head += ["tool, mm"] if tool else []
    title = f"simulated minus measured after {1e3 * found.horizon:.0f} ms, rms of {found.windows} windows"
    return table(head, rows, title)


def _thousandths(value: float) -> str:
    return significant(1e3 * value) if math.isfinite(value) else "ran away"
