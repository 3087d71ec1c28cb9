"""`deltatwin tap`: Publish the samples of a live EtherCAT bus."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.options import Insecure, RosDomain, ZenohConfig, robot_file
from service.cli.output import conclude
from service.stopping import interrupted


def command(
    interface: Annotated[
        str,
        typer.Argument(
            metavar="INTERFACE", help="Network interface on the bus, or a capture to play as if it were live."
        ),
    ],
    robot: Annotated[Path, robot_file(": name, scaling and mapping of its drives.")],
    count: Annotated[int, typer.Option(min=0, help="Samples to publish; 0: until Ctrl-C.")] = 0,
    speed: Annotated[float, typer.Option(min=1e-3, help="For a capture: speed-up factor.")] = 1.0,
    wait: Annotated[float, typer.Option(min=0.0, help="Longest wait for a subscriber before the start (s).")] = 1.0,
    zenoh_config: ZenohConfig = None,
    insecure: Insecure = False,
    ros_domain: RosDomain = None,
) -> None:
    """Listen to an EtherCAT bus and publish one sample per cycle over Zenoh; never send a frame.

    The interface is connected to a network analyzer or a mirror port, or is the master's own. Working-counter faults,
    lost cycles and drive states go to the health messages and to stderr. Reading an interface needs CAP_NET_RAW.

    Example: deltatwin tap eth1 --robot d3.toml
    """
    from drivers.bus import open_bus
    from drivers.ethercat.live_tap import FileSource, InterfaceSource, Tap
    from drivers.health import Health
    from replay.clock import wait_until
    from replay.realtime import go_realtime
    from schemas.axes_description import load_delta
    from schemas.messages import Role
    from schemas.questions import Question

    description = load_delta(robot, Question.FIELDBUS)
    path = Path(interface)
    is_capture = path.is_file() or path.suffix in (".pcap", ".pcapng")
    source = FileSource(path, wait_until, speed) if is_capture else InterfaceSource(interface)
    tap = Tap(source, description, lambda line: typer.echo(line, err=True))
    standing = go_realtime("tap")
    try:
        with open_bus(description.name, Role.TAP, zenoh_config, insecure, ros_domain) as bus:
            publisher = bus.publisher("sample")
            publisher.wait_until_heard(wait)
            with Health(bus, standing) as health:
                tap.run(publisher.put, health, count, interrupted)
    except KeyboardInterrupt:
        pass
    finally:
        source.close()
    counted = tap.assembler.count
    conclude(
        f"published {counted('samples')} samples; {counted('lost')} cycles lost, "
        f"{counted('counter_faults')} working-counter faults, {counted('not_enabled')} cycles not in operation",
        "monitor" if description.identified is None else "estimate", "--robot", robot,
    )  # fmt: skip
