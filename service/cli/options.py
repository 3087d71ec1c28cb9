"""Options that several commands have."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer


def robot_file(about: str = "") -> Any:
    """`--robot`. about: what there is to say beside, from the punctuation or space behind `Robot description` on."""
    return typer.Option(metavar="FILE|NAME", help=f"Robot description (TOML){about}")


ColumnsFrom = Annotated[
    str | None,
    typer.Option(
        "--columns",
        metavar="FILE|NAME",
        help="Column mapping of a foreign table: a TOML file (`deltatwin import` writes one), or emps, twincat_scope.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


def _usable(effects: Path | None) -> Path | None:
    """Also where the description names no effect: who gives the file means it to be used.

    Raises:
        RobotError: as `catalogue`.
    """
    if effects is not None:
        from service.model.effects import catalogue

        catalogue(effects)
    return effects


def refuse(context: typer.Context, *options: str, only: str) -> None:
    """options: parameters of the command. only: what they are for, and what was not asked for.

    Raises:
        BadParameter: one of them is on the command line, where it would do nothing.
    """
    for option in options:
        source = context.get_parameter_source(option)
        if source is not None and source.name == "COMMANDLINE":
            raise typer.BadParameter(f"--{option.replace('_', '-')}: only for {only}")


def check_length(duration: float, rate: float) -> None:
    """duration: s. rate: Hz.

    Raises:
        BadParameter: no log holds so many samples.
    """
    from schemas.files import MAX_LOG_BYTES, MOST_SAMPLES

    if duration * rate > MOST_SAMPLES:
        raise typer.BadParameter(
            f"{duration:g} s at {rate:g} Hz: a log has {MOST_SAMPLES / 1e6:g} million samples "
            f"({MAX_LOG_BYTES >> 30} GiB) at most, here {MOST_SAMPLES / rate:.6g} s",
            param_hint="--duration",
        )


OwnEffects = Annotated[
    Path | None,
    typer.Option("--effects", metavar="FILE", help="Python file with effects of your own", callback=_usable),
]

# of every command that goes on the bus
ZenohConfig = Annotated[
    Path | None,
    typer.Option(help="Zenoh configuration, instead of local sockets; across hosts: one made by `deltatwin keys`."),
]
Insecure = Annotated[
    bool, typer.Option("--insecure", help="Accept a --zenoh-config with which anybody on the network can send.")
]
RosDomain = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        min=0,
        max=232,
        help="Use topics as ROS 2's rmw_zenoh does, in this ROS_DOMAIN_ID, over this host's router. Same for all roles",
    ),
]


class Backend(StrEnum):
    """Where joblib runs the work."""

    LOKY = "loky"
    DASK = "dask"


# of commands that spread their work over processes or hosts
Jobs = Annotated[int, typer.Option(min=1, help="Processes on this host")]
OnBackend = Annotated[Backend, typer.Option(help="joblib backend; dask: install deltatwin[dask]")]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Dask scheduler, tcp://host:port; its workers must see the same folders. Default: this host",
    ),
]
