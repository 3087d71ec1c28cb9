"""Options of commands that spread their work over processes or hosts."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer


class Backend(StrEnum):
    """Where joblib runs the work."""

    LOKY = "loky"
    DASK = "dask"


Jobs = Annotated[int, typer.Option(min=1, help="Processes on this host")]
OnBackend = Annotated[Backend, typer.Option(help="joblib backend; dask: install deltatwin[dask]")]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Dask scheduler, tcp://host:port, whose workers see the same folders; default: this host",
    ),
]
