"""`deltatwin view`: Show the running robot live in Foxglove."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.options import Insecure, RosDomain, ZenohConfig, robot_file
from service.cli.output import conclude
from service.stopping import interrupted


def command(
    robot: Annotated[Path, robot_file("; its name is the robot on the bus.")],
    host: Annotated[
        str, typer.Option(help="Address to listen on; 0.0.0.0 admits every host without a check.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen on; 0 takes a free one.")] = 8765,
    layout: Annotated[
        Path | None, typer.Option(help="Write the Foxglove layout of this robot to this file (.json) and end.")
    ] = None,
    zenoh_config: ZenohConfig = None,
    insecure: Insecure = False,
    ros_domain: RosDomain = None,
) -> None:
    """Serve the bus to Foxglove: torques, model errors, payload, health, and the robot in three dimensions.

    In Foxglove: Open connection, Foxglove WebSocket, ws://127.0.0.1:8765; then import the layout. Recordings of
    `monitor` open with the same layout. At most 200 messages per second and topic are forwarded, but every pick and
    release is.

    Example: deltatwin view --robot d3.toml --layout d3.layout.json && deltatwin view --robot d3.toml
    """
    from schemas.axes_description import load_delta
    from schemas.files import check_apart, write_text
    from schemas.questions import Question

    description = load_delta(robot, Question.VIEW)
    if layout is not None:
        check_apart(layout, *description.sources)
        from drivers.view.foxglove_layout import layout as layout_of

        write_text(layout, layout_of(description.name))
        conclude(f"wrote {layout}; in Foxglove: Layouts, Import from file", "view", "--robot", robot)
        return
    from drivers.bus import open_bus
    from drivers.view.server import LiveView, run
    from schemas.messages import Role
    from schemas.words import counted

    with (
        open_bus(description.name, Role.OBSERVER, zenoh_config, insecure, ros_domain) as bus,
        LiveView(bus, description, host, port) as view,
    ):
        typer.echo(f"view of {description.name}: ws://{host}:{view.port}; Ctrl-C ends it", err=True)
        try:
            run(view, interrupted)
        except KeyboardInterrupt:
            typer.echo(f"view: stopped; {counted(view.shown, 'message')} shown", err=True)
    conclude("To record what was shown:", "monitor", "--robot", robot)
