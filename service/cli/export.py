"""`deltatwin export`: Export the robot to a simulator, or its estimator as code for a controller."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.machine_files import SEE, conclude_mjcf
from service.cli.options import OwnEffects, refuse
from service.cli.output import read_by, say_next

if TYPE_CHECKING:
    from schemas.robot import Robot


class Format(StrEnum):
    """What it is written for."""

    mjcf = "mjcf"
    urdf = "urdf"
    c = "c"
    fmu = "fmu"
    st = "st"
    sheet = "sheet"


_CODE = (Format.c, Format.fmu, Format.st)
ONLY_FOR = {
    "rate": _CODE, "name": _CODE, "nominal": _CODE, "fmi": (Format.fmu,), "log": (Format.sheet,), "float32": (Format.c,)
}  # fmt: skip


def command(
    context: typer.Context,
    robot: Annotated[
        Path, typer.Argument(metavar="FILE|NAME", help="Robot description (TOML), identified or corrected")
    ],
    out: Annotated[Path, typer.Option(help="File to write; for c and st: folder")],
    to: Annotated[
        Format,
        typer.Option(
            help="mjcf: MuJoCo; urdf: the whole arm, or the actuated links of a Delta for viewers; c: feed-forward and "
            "payload as C99; fmu: the same for co-simulation; st: the same as Structured Text and PLCopen XML; sheet: "
            "parameters for a controller's own rigid model"
        ),
    ] = Format.mjcf,
    effects: OwnEffects = None,
    rate: Annotated[
        float, typer.Option(min=10.0, max=50_000.0, help="For c, fmu, st: cycles per second (Hz)")
    ] = 1000.0,
    name: Annotated[str, typer.Option(help="For c, fmu, st: prefix of files, types and functions")] = "deltatwin",
    fmi: Annotated[int, typer.Option(min=2, max=3, help="For fmu: version of the standard, 2 or 3")] = 3,
    log: Annotated[
        list[Path] | None, typer.Option(help="For sheet: held-out log to report its residual torque; may be repeated")
    ] = None,
    float32: Annotated[
        bool, typer.Option("--float32", help="For c: single precision; the header states its error")
    ] = False,
    nominal: Annotated[
        bool, typer.Option("--nominal", help="For c, fmu, st: export even without identified parameters")
    ] = False,
) -> None:
    """Write the identified and corrected robot for MuJoCo or viewers, or its estimator as code for a controller.

    Effects that MuJoCo cannot express are written to a separate Python file, to be called in your own loop: friction
    and similar effects before each step; delay, filter and encoder error of a log after it. Effects that neither file
    contains are listed.

    The C code gives the same bits as `deltatwin estimate`, without heap; docs/how-to/controller.md says how to call it.

    For an arm, the URDF is its own with identified, physically possible masses, centres and inertias, and with joint
    friction; base parameters with standard errors are written to a JSON file next to it. Servo axes can be exported as
    MJCF.

    Example: deltatwin export corrected.toml --to mjcf --out robot.xml

    Example: deltatwin export arm_identified.toml --to urdf --out arm_identified.urdf

    Example: deltatwin export corrected.toml --to c --rate 1000 --out twin/

    Example: deltatwin export corrected.toml --to st --rate 500 --out plc/

    Example: deltatwin export corrected.toml --to sheet --log test_1.csv --log test_2.csv --out figures.md
    """
    import sys

    from schemas.axes_description import load_description
    from schemas.files import check_apart, make_folder, write_text
    from schemas.questions import Question, as_delta
    from service.cli.machine_files import beside_of, write_machine

    for option, formats in ONLY_FOR.items():
        if to not in formats:
            refuse(context, option, only=f"--to {' or '.join(formats)}, not for {to.value}")
    described = load_description(robot, effects)
    if to not in (Format.c, Format.st):
        check_apart(out, *described.sources, *(log or []))
    if to in (Format.mjcf, Format.urdf) and described.answering(Question.CODE) is None:
        write_machine(described, to.value, out)
        return
    description = as_delta(described, Question.CODE)
    if to is Format.c:
        _code(description, out, rate, name, nominal, float32)
        return
    if to is Format.st:
        _block(description, out, rate, name, nominal)
        return
    if to is Format.fmu:
        _unit(description, out, rate, name, fmi, nominal)
        return
    if to is Format.sheet:
        _sheet(description, robot, effects, out, log or [])
        return
    from service.rollout.simulator_files import to_mjcf, to_urdf

    make_folder(out.parent)
    if to is Format.urdf:
        write_text(out, to_urdf(description))
        print(f"wrote {out}: base and active links; a URDF cannot contain a closed chain")
        print(SEE)
        return
    made = to_mjcf(description)
    made.spec.compile()
    beside = beside_of(out, "_effects.py")
    if made.callback is not None:
        check_apart(beside, *description.sources)
    write_text(out, made.spec.to_xml())
    print(f"wrote {out}")
    if made.callback is not None:
        write_text(beside, made.callback)
        called = [name for name in made.by_callback if name not in made.measured]
        print(f"wrote {beside}")
        if called:
            print(f"  call Effects before every step for {', '.join(called)}")
        if made.measured:
            print(f"  Measurement turns true values into those of a log: {', '.join(made.measured)}")
    for name, why in made.left_out.items():
        print(f"{name} is left out: {why}", file=sys.stderr)
    conclude_mjcf(out, len(made.left_out))


def _code(robot: Robot, out: Path, rate: float, name: str, nominal: bool, single: bool) -> None:
    """`--to c`."""
    import sys

    from service.codegen.float32 import ERROR
    from service.codegen.folder import write_twin
    from service.codegen.twin import STATIC_BYTES, to_c

    twin = to_c(robot, 1.0 / rate, name, nominal, single)
    for path in write_twin(robot, 1.0 / rate, twin, out):
        print(f"wrote {path}")
    for effect, why in twin.left_out.items():
        print(f"{effect} is left out: {why}", file=sys.stderr)
    print(f"one sample every {1e6 / rate:g} us; {twin.static_bytes / 1024:.0f} KiB static, no heap")
    if twin.static_bytes > STATIC_BYTES:
        print(
            f"static memory: {twin.static_bytes} bytes, more than {STATIC_BYTES}: at {rate:g} Hz the look back waits "
            f"{twin.looked_back} samples for a torque that is reported late",
            file=sys.stderr,
        )
    if single:
        print(f"in single precision: {ERROR}")
    print(f"Compile it, link it with -lm, call {name}_init once, then {name}_step each cycle:")
    say_next("-O2", "-std=c99", "-ffp-contract=off", "-c", f"{out / name}.c", program="gcc")


def _block(robot: Robot, out: Path, rate: float, name: str, nominal: bool) -> None:
    """`--to st`."""
    import sys

    from service.codegen.folder import write_twin
    from service.codegen.plc import to_st

    project = to_st(robot, 1.0 / rate, name, nominal)
    for path in write_twin(robot, 1.0 / rate, project, out):
        print(f"wrote {path}")
    for effect, why in project.left_out.items():
        print(f"{effect} is left out: {why}", file=sys.stderr)
    print(f"one sample every {1e6 / rate:g} us; function block {name}, {len(project.pous) - 1} functions")
    print(f"next: import {out / name}.xml (CODESYS, TwinCAT: PLCopenXML), and call the block once per cycle.")


def _sheet(robot: Robot, path: Path, effects: Path | None, out: Path, logs: list[Path]) -> None:
    """`--to sheet`."""
    from schemas.files import make_folder, write_text
    from service.cli.reading import reading
    from service.codegen.sheet import to_sheet

    make_folder(out.parent)
    write_text(out, to_sheet(robot, list(reading(logs, robot, None, "reading"))))
    print(f"wrote {out}")
    if logs:
        print("next: enter the parameters of the first column in the controller, and compare its units.")
        return
    print("With held-out logs it also shows the residual torque after each group of parameters:")
    say_next(
        "export", path, *read_by(effects=effects), "--to", "sheet", "--log", "LOG", "--out", out,
        own="LOG: a log of this robot that was not used to identify it",
    )  # fmt: skip


def _unit(robot: Robot, out: Path, rate: float, name: str, fmi: int, nominal: bool) -> None:
    """`--to fmu`."""
    import sys

    from schemas.files import make_folder
    from service.codegen.fmu import write_fmu

    make_folder(out.parent)
    twin = write_fmu(robot, 1.0 / rate, 2 if fmi == 2 else 3, out, name, nominal)
    print(f"wrote {out}: FMI {fmi}.0, co-simulation, a step every {1e6 / rate:g} us, one instance per process")
    for effect, why in twin.left_out.items():
        print(f"{effect} is left out: {why}", file=sys.stderr)
    print(f"next: import {out} in your simulator, and connect the robot's samples to its inputs.")
