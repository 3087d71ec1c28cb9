"""`deltatwin verify`: Compare a controller's recorded answers with those of the exported code."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from schemas.words import counted
from service.cli.options import AsJson
from service.cli.output import conclude

if TYPE_CHECKING:
    from service.codegen.recorded_answers import Compared


def command(
    twin: Annotated[Path, typer.Argument(metavar="FOLDER", help="What `deltatwin export --to c` or `--to st` wrote")],
    log: Annotated[Path, typer.Option(help="Recording (MCAP) with the controller's samples and its answers")],
    json: AsJson = False,
) -> None:
    """Compare each recorded answer with that of the twin: torque, source, flags; payload and errors if recorded.

    The recording must begin with the controller's first sample after init. Exit code 3 if an answer differs by more
    than the rounding of another mathematics library.

    Example: deltatwin verify twin/ --log run.mcap
    """
    from service.cli.main import MISSED
    from service.codegen.folder import read_twin
    from service.codegen.recorded_answers import verify
    from service.monitor.readback import read_recording

    manifest, robot = read_twin(twin)
    found = verify(robot, manifest, read_recording(log))
    differs = any(one.first is not None for one in found.values())
    if json:
        from service.cli.output import as_json

        print(as_json("verify", {topic: _document(one) for topic, one in found.items()}))
    else:
        for topic, one in found.items():
            print(f"{topic}: {_said(one)}")
        conclude(_conclusion(found), "inspect", log)
    if differs:
        raise typer.Exit(MISSED)


def _document(one: Compared) -> dict[str, Any]:
    return one._asdict() | {"first": None if one.first is None else one.first._asdict()}


def _said(one: Compared) -> str:
    parts = [f"{one.answers} answers, {one.alike} bit-identical"]
    if one.missing:
        parts.append(f"{counted(one.missing, 'sample')} without an answer")
    if one.alike < one.answers:
        off = ", ".join(f"{name} {value:.3g}" for name, value in one.largest.items() if value)
        parts.append(f"largest differences: {off or 'none in a value with a unit'}")
    if one.first is not None:
        first, joint = one.first, f" of joint {one.first.joint}" if one.first.joint else ""
        parts.append(
            f"first at sequence {first.sequence} (t = {first.stamp_s:.6f} s): {first.field}{joint} is "
            f"{first.answered:.9g}, not {first.expected:.9g} {first.unit}".rstrip()
        )
    return "; ".join(parts)


def _conclusion(found: dict[str, Compared]) -> str:
    if all(one.alike == one.answers for one in found.values()):
        return "the controller gives the same answers as its twin, bit for bit"
    feedforward = found["feedforward"]
    if all(one.first is None for one in found.values()):
        return "the controller gives the same answers as its twin, except for the rounding of its mathematics library"
    if 0 <= feedforward.last_row < feedforward.answers // 2:
        return (
            "the controller's torque equals its twin's only in the second half: the recording begins after the "
            "controller's start, or parameters were loaded during it; record from init on"
        )
    return (
        "the controller does not give the same answers as its twin: see the first difference. Are code, parameters or "
        "cycle different?"
    )
