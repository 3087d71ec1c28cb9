"""`deltatwin replay`: Play a log on the bus in real time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.options import ColumnsFrom, Insecure, RosDomain, ZenohConfig, robot_file
from service.cli.output import conclude, in_quantiles, read_by
from service.stopping import interrupted

if TYPE_CHECKING:
    from replay.player import Played


def command(
    trace: Annotated[Path, typer.Argument(metavar="LOG", help="Recorded log (.csv, .csv.gz, .mcap).")],
    robot: Annotated[Path, robot_file("; its name is the robot on the bus.")],
    columns: ColumnsFrom = None,
    rate: Annotated[
        float | None,
        typer.Option(min=1e-3, help="Samples per second, evenly spaced (Hz). Default: the recorded times."),
    ] = None,
    speed: Annotated[float, typer.Option(min=1e-3, help="Speed-up factor.")] = 1.0,
    loop: Annotated[int, typer.Option(min=0, help="Number of times to play; 0: until Ctrl-C.")] = 1,
    start: Annotated[float, typer.Option(min=0.0, help="Start, after the log's first sample (s).")] = 0.0,
    stop: Annotated[float | None, typer.Option(min=0.0, help="End, after the log's first sample (s).")] = None,
    wait: Annotated[float, typer.Option(min=0.0, help="Longest wait for subscribers before the start (s).")] = 2.0,
    zenoh_config: ZenohConfig = None,
    insecure: Insecure = False,
    ros_domain: RosDomain = None,
) -> None:
    """Play a recorded log over Zenoh at the controller's rate.

    No sample is dropped or reordered; the lateness of the samples is reported at the end. Stamps are those of the
    trace and continue to rise over loops.

    Example: deltatwin replay pick.csv --robot d3.toml --loop 0
    """
    from drivers.bus import open_bus
    from drivers.health import Health
    from drivers.trace import find_columns, read_trace
    from replay.player import play, schedule
    from replay.realtime import go_realtime
    from schemas.axes_description import load_description
    from schemas.messages import TOPICS, Role
    from service.cli.progress import counting

    description = load_description(robot)
    topic = description.topics.sample
    recorded = read_trace(trace, description, find_columns(columns) if columns else None)
    for finding in recorded.findings:
        typer.echo(f"{trace}: {finding.message}", err=True)
    plan = schedule(recorded, TOPICS[topic], rate=rate, speed=speed, loops=loop, start=start, stop=stop)
    with counting(f"replay {description.name}", len(plan) * loop) as show:
        standing = go_realtime("replay")
        with open_bus(description.name, Role.PLAYER, zenoh_config, insecure, ros_domain) as bus:
            publisher = bus.publisher(topic)
            heard = publisher.wait_until_heard(wait)
            if not heard:
                typer.echo(f"nobody subscribes to the samples of {description.name} yet; playing anyway", err=True)
            with Health(bus, standing) as health:
                played = play(plan, publisher.put, health, show, interrupted)
    said = summary(played, plan.period_ns)
    if heard:
        conclude(said, "evaluate", trace, "--robot", robot, *read_by(columns))
    else:
        conclude(f"{said}\nNobody has subscribed. In a second terminal:", "estimate", "--robot", robot)


def summary(played: Played, period_ns: int) -> str:
    """What was sent and how late."""
    planned = "" if played.planned is None else f" of {played.planned}"
    if played.sent == 0:
        return f"sent 0{planned} samples"
    return (
        f"sent {played.sent}{planned} samples, {played.late} later than the period of {period_ns * 1e-3:.6g} µs; "
        f"lateness {in_quantiles(played.lateness, 2)}"
    )
