"""`deltatwin keys`: Make certificates and configurations for roles on several hosts."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.output import conclude

if TYPE_CHECKING:
    from drivers.security.certificates import WrittenKeys


class SampleSource(StrEnum):
    """Roles of which one may write samples."""

    TAP = "tap"
    PLAYER = "player"
    ROBOT = "robot"


def command(
    hosts: Annotated[
        str,
        typer.Option(
            help="Hosts the roles may run on: names or addresses, separated by commas; a first port after a colon."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder to write; a CA already in it is kept and signs the new keys.")],
    robot: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|NAME", help="Name of the robot, or its description (.toml). Default: keys for every robot."
        ),
    ] = None,
    source: Annotated[
        SampleSource, typer.Option(help="The one role that may write samples: tap, player or simulated robot.")
    ] = SampleSource.TAP,
) -> None:
    """Make keys, certificates and Zenoh configurations, so that roles on several hosts trust only each other.

    Writes a folder per host with a certificate and a configuration for --zenoh-config for each role: TLS with
    certificates on both sides, no discovery, no access beyond what the role needs. Only the estimator writes
    feedforward, payload and error; only the source writes samples. Copy each folder to its host; leave ca.key where it
    is. To renew, to add hosts or to change the source, run the command again and copy all folders again.

    Example: deltatwin keys --hosts cell-pc,192.168.4.20 --robot d3.toml --out keys
    """
    from drivers.security.certificates import make_keys, parse_hosts
    from schemas.axes_description import load_description
    from schemas.messages import Role
    from schemas.zenoh_keys import check_robot_name

    try:
        parsed = parse_hosts(hosts)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--hosts") from None
    name = None
    if robot is not None:
        name = load_description(robot).name if robot.endswith(".toml") else check_robot_name(robot)
    made = make_keys(out, parsed, name, Role[source.name])
    described = robot if robot is not None and robot.endswith(".toml") else "ROBOT.toml"
    conclude(
        f"{summary(made, out)}\nCopy each folder to its host. There, for example:",
        "estimate", "--robot", described, "--zenoh-config", made.folders[0] / "estimator.json5",
        own="" if described == robot else "ROBOT.toml: the description of your robot, which `identify` wrote",
    )  # fmt: skip


def summary(made: WrittenKeys, out: Path) -> str:
    """What was written and how long it holds."""
    folders = ", ".join(str(folder) for folder in made.folders)
    roles = ", ".join(role.name.lower() for role in made.roles)
    authority = "new CA" if made.ca_is_new else "CA kept"
    again = f"; {made.replaced} certificates replaced: copy every folder again" if made.replaced else ""
    return (
        f"{folders}: certificates of {roles}, valid until {made.valid_until:%Y-%m-%d}{again}\n"
        f"{out / 'ca.pem'}: {authority}, valid until {made.ca_valid_until:%Y-%m-%d}; {out / 'ca.key'} stays here"
    )
