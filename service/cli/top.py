"""`deltatwin top`: Show the running robot in the terminal: torque, payload, model errors, health, latency."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from service.cli.options import Insecure, RosDomain, ZenohConfig, robot_file
from service.cli.output import conclude, console

REFRESH_S = 0.05  # on a terminal; anywhere else a text a second
NICENESS = 10


def command(
    robot: Annotated[Path, robot_file("; its name is the robot on the bus.")],
    zenoh_config: ZenohConfig = None,
    insecure: Insecure = False,
    ros_domain: RosDomain = None,
) -> None:
    """Show the state of all roles on the bus until q or Ctrl-C, twenty times per second, or once per second in a pipe.

    It only listens, and runs at a lower priority than all roles. A robot has one observer: end its `view` first.

    Example: deltatwin top --robot identified.toml
    """
    import os
    import time

    from rich.console import Group

    from drivers.bus import open_bus
    from schemas.axes_description import load_description
    from schemas.messages import Role
    from service.cli.live import Joints, Roles
    from service.stopping import stop_requested

    description = load_description(robot)
    name = description.name
    stopped, screen = stop_requested(), console()
    with open_bus(name, Role.OBSERVER, zenoh_config, insecure, ros_domain) as bus:
        os.nice(NICENESS)
        joints, roles = Joints(bus, description), Roles(bus)
        if not (sys.stdout.isatty() and sys.__stdin__):
            while not stopped():
                time.sleep(1.0)
                screen.print(joints.picture(name), "", roles.table())
        else:
            from service.cli.screen import Screen

            def picture() -> Group:
                return Group(joints.picture(f"{name}; q or Ctrl-C ends it"), "", roles.table())

            drawn = Screen(picture, stopped, REFRESH_S)
            if failed := drawn.run(mouse=False):
                raise failed
            if drawn.return_code:  # Textual has said why
                raise SystemExit(drawn.return_code)
            screen.print(joints.picture(name), "", roles.table())  # the last of it stays in the terminal
    conclude("To record what was shown:", "monitor", "--robot", robot)
