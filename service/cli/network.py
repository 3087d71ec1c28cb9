"""The options of every command that goes on the bus."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ZenohConfig = Annotated[
    Path | None,
    typer.Option(help="Zenoh configuration instead of local sockets; across hosts one that `deltatwin keys` made."),
]
Insecure = Annotated[
    bool, typer.Option("--insecure", help="Take a --zenoh-config with which anybody on the network may speak.")
]
RosDomain = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        min=0,
        max=232,
        help="Speak as ROS 2 nodes with rmw_zenoh do, in this ROS_DOMAIN_ID, by this host's router; every role alike.",
    ),
]
