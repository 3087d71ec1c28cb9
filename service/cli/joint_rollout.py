"""What `rollout` tells of axes and arms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.cli.output import Table, as_json, conclude, console, read_by, table
from service.cli.reading import reading

if TYPE_CHECKING:
    from schemas.axes import Axes
    from schemas.chain import Chain
    from service.rollout.joints import JointRollout


def roll_out(
    traces: Sequence[Path],
    machines: Sequence[tuple[str, Axes | Chain]],
    paths: Sequence[Path],
    columns: str | None,
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
    from service.rollout.joints import compare, named

    robots = named(machines)
    if out is not None:
        make_folder(out)
    recorded = list(reading(traces, machines[0][1], columns, "reading"))
    with console(stderr=True).status("simulating") as status:
        found = compare(robots, recorded, horizon, lambda what: status.update(f"simulating {what}"))
    said = _said(found)
    document = _document(found, [trace.name for trace in recorded]) | {"conclusion": said}
    if out is not None:
        write_text(out / "rollout.json", as_json("joint-rollout", document))
    if json:
        typer.echo(as_json("joint-rollout", document))
        return
    console().print(_table(found))
    if out is not None:
        typer.echo(f"wrote rollout.json in {out}")
    conclude("\n".join(said), "diagnose", *traces, "--robot", paths[-1], *read_by(columns), "--out", "diagnosis")


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
    title = f"simulated less measured after {1e3 * found.horizon:.0f} ms, rms of {found.windows} windows"
    return table(head, rows, title)


def _thousandths(value: float) -> str:
    return f"{1e3 * value:.3g}" if math.isfinite(value) else "ran away"


def _said(found: JointRollout) -> list[str]:
    """What a reader should know first."""
    *robots, floor, still = found.deviations
    last = robots[-1]
    share = last.joint_rms / still.joint_rms
    worst = max(range(len(share)), key=lambda joint: share[joint])
    least = f"{100 * min(share):.2g} to " if len(share) > 1 else ""
    lines = [
        f"{last.name}: after {1e3 * found.horizon:.0f} ms its joints are off by {least}{100 * share[worst]:.2g} % of "
        f"their way, joint {worst + 1} most."
    ]
    if not last.good.any():
        lines = []
    elif share[worst] > 1.0:
        lines.append(f"Joint {worst + 1} is off by more than its way: sign or unit of its torque, or a load?")
    if last.good.any() and (one := last.tool_rms) is not None and (noise := floor.tool_rms) is not None:
        lines.append(f"Its tool is off by {1e3 * one:.3g} mm; noise alone gives {1e3 * noise:.3g} mm.")
    lines += [
        f"{one.name}: runs away in {int((~one.good).sum())} of {len(one.good)} windows, which no figure counts."
        for one in robots
        if not one.good.all()
    ]
    return lines
