"""`deltatwin export`: the described robot in a simulator's own terms."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from service.cli.options import OwnEffects


class Format(StrEnum):
    """What it is written for."""

    mjcf = "mjcf"
    urdf = "urdf"


def command(
    robot: Annotated[
        Path, typer.Argument(metavar="FILE|NAME", help="Robot description (TOML), identified or corrected")
    ],
    out: Annotated[Path, typer.Option(help="File to write")],
    to: Annotated[Format, typer.Option(help="mjcf: MuJoCo, the closed chain; urdf: viewers, the actuated links")] = (
        Format.mjcf
    ),
    effects: OwnEffects = None,
) -> None:
    """Write the robot, as identified and corrected, for MuJoCo, or the actuated part of it for viewers.

    Effects that MuJoCo has no word for come as a Python file beside it, to be called in your own loop: friction and the
    like before each step, what delay, filter and encoder do to a log after it. What neither has is listed.

    Example: deltatwin export corrected.toml --to mjcf --out robot.xml
    """
    import sys

    from schemas.files import make_folder, write_text
    from schemas.robot import load_robot
    from service.rollout.export import to_mjcf, to_urdf

    description = load_robot(robot, effects)
    make_folder(out.parent)
    if to is Format.urdf:
        write_text(out, to_urdf(description))
        print(f"wrote {out}: base and active links; a URDF has no closed chain")
        return
    made = to_mjcf(description)
    made.spec.compile()
    write_text(out, made.spec.to_xml())
    print(f"wrote {out}")
    if made.callback is not None:
        beside = out.with_name(f"{out.stem}_effects.py")
        write_text(beside, made.callback)
        called = [name for name in made.by_callback if name not in made.measured]
        print(f"wrote {beside}")
        if called:
            print(f"  call Effects before every step for {', '.join(called)}")
        if made.measured:
            print(f"  Measurement gives what a log shows: {', '.join(made.measured)}")
    for name, why in made.left_out.items():
        print(f"{name} is left out: {why}", file=sys.stderr)
