"""`deltatwin monitor`: everything on the bus to MCAP."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.network import Insecure, ZenohConfig

if TYPE_CHECKING:
    from service.monitor.node import Monitor


def command(
    robot: Annotated[Path, typer.Option(help="Robot description (TOML); its name is the robot on the bus.")],
    output: Annotated[
        Path | None, typer.Option(help="File to write. Default: the robot's name and the time, in this folder.")
    ] = None,
    zenoh_config: ZenohConfig = None,
    insecure: Insecure = False,
) -> None:
    """Record samples, feed-forward, payload, errors and health to an MCAP file until Ctrl-C.

    Says once a second on the bus how many messages came, were lost or came twice, and how long a feed-forward took. If
    the disk fails later it says so and goes on watching.

    Example: deltatwin monitor --robot d3.toml --output run.mcap
    """
    import datetime

    from drivers.bus import open_bus
    from replay.realtime import PRIORITY, go_realtime
    from schemas.errors import StorageError
    from schemas.files import check_folder
    from schemas.messages import HealthFlag, Role
    from schemas.robot import load_robot
    from service.cli.progress import counting
    from service.cli.signals import stop_requested
    from service.monitor.node import Monitor, run
    from service.monitor.writer import WriterThread

    name = load_robot(robot).name
    path = output or Path(f"{name}-{datetime.datetime.now(datetime.UTC):%Y%m%dT%H%M%SZ}.mcap")
    if path.exists():
        raise StorageError(f"{path}: exists already; give another name with --output")
    check_folder(path.parent)  # before anything runs: a monitor that cannot record has nothing to do
    stopped = stop_requested()
    with counting(f"monitor {name}", 0) as show:
        realtime = go_realtime("monitor", PRIORITY - 10)  # below those whose work it watches
        with open_bus(name, Role.MONITOR, zenoh_config, insecure) as bus:
            writer = WriterThread(path, name)
            monitor = Monitor(bus, writer, HealthFlag(0) if realtime else HealthFlag.NO_REALTIME)
            try:
                run(monitor, stopped, show)
            finally:
                writer.close()
    typer.echo(summary(monitor))
    if writer.failed:
        raise typer.Exit(1)
    typer.echo(f"wrote {writer.written} messages to {path}")


def summary(monitor: Monitor) -> str:
    """Counts by topic as text."""
    from service.monitor.tally import THINNED

    lines = [f"{'topic':<12} {'received':>10} {'lost':>8} {'repeated':>9} {'out of order':>13} {'restarts':>9}"]
    for topic, received in monitor.tally.received.items():
        if topic in THINNED:
            lines.append(f"{topic:<12} {received:>10} {'cannot be told':>18}")
            continue
        counts = monitor.tally.count(topic)
        lines.append(
            f"{topic:<12} {received:>10} {counts.lost:>8} {counts.repeated:>9} {counts.out_of_order:>13} "
            f"{counts.restarts:>9}"
        )
    lines.append(f"rejected payloads {monitor.rejected}")
    return "\n".join(lines)
