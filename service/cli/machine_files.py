"""What `export` writes of axes and arms."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from service.cli.output import say_next

if TYPE_CHECKING:
    from schemas.axes_description import Description


SEE = "next: open it in a viewer for URDF, such as RViz or Foxglove."


def beside_of(out: Path, end: str) -> Path:
    """The file of the model's name that ends in `end`."""
    return out.parent / f"{out.stem}{end}"


def write_machine(description: Description, to: str, out: Path) -> None:
    """Write the MJCF or URDF of a machine, with its parameters and their errors as JSON beside it.

    Raises:
        UnansweredError: the machine has no such file. RobotError: figures that no body can have.
    """
    from schemas.files import make_folder, write_text
    from service.machines import machine_of

    machine = machine_of(description)
    made = machine.to_urdf() if to == "urdf" else machine.to_mjcf()
    make_folder(out.parent)
    beside = beside_of(out, "_parameters.json")
    write_text(out, made.text)
    write_text(beside, made.figures)
    print(f"wrote {out}")
    print(
        f"wrote {beside}: base parameters with standard errors, rotor inertias, constant loads, width of the "
        "friction transition"
    )
    for line in made.said:
        print(line)
    if description.identified is None:
        print(
            f"{description.name} was never identified: these are the described parameters; run deltatwin identify",
            file=sys.stderr,
        )
    for name, why in made.left_out.items():
        print(f"{name} is left out: {why}", file=sys.stderr)
    if to == "urdf":
        print(SEE)
    else:
        conclude_mjcf(out, len(made.left_out))


def conclude_mjcf(out: Path, left_out: int) -> None:
    """How the export of a model for MuJoCo ends. left_out: how many effects it lacks."""
    from schemas.words import counted

    print(f"The model lacks {counted(left_out, 'effect')}." if left_out else "The model has all that is described.")
    say_next("mujoco.viewer", f"--mjcf={out}", program="python -m")
