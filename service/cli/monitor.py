"""`deltatwin monitor`: Record the messages on the bus to an MCAP file."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.options import Insecure, RosDomain, ZenohConfig, robot_file
from service.cli.output import conclude

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from service.monitor.monitor_node import Monitor


SILENCE_S = 3.0  # without a sample, until it is said what else runs here


def command(
    robot: Annotated[Path, robot_file("; its name is the robot on the bus.")],
    out: Annotated[
        Path | None, typer.Option(help="File to write. Default: the robot's name and the time, in this folder.")
    ] = None,
    zenoh_config: ZenohConfig = None,
    insecure: Insecure = False,
    ros_domain: RosDomain = None,
) -> None:
    """Record samples, feed-forward, payload, errors and health to an MCAP file until Ctrl-C.

    Once a second it publishes the number of received, lost and repeated messages and the latency of the feed-forward.
    If the disk fails, it reports that and continues to count.

    Example: deltatwin monitor --robot d3.toml --out run.mcap
    """
    import datetime

    from drivers.bus import open_bus, running
    from drivers.view.viewer_scene import ViewerScene
    from replay.realtime import PRIORITY, go_realtime
    from schemas.axes_description import load_description
    from schemas.errors import StorageError
    from schemas.files import check_folder
    from schemas.messages import Role
    from schemas.questions import Question
    from schemas.words import counted
    from service.cli.progress import counting
    from service.monitor.monitor_node import Monitor, run
    from service.monitor.writer import WriterThread
    from service.stopping import stop_requested

    description = load_description(robot)
    name = description.name
    path = out or Path(f"{name}-{datetime.datetime.now(datetime.UTC):%Y%m%dT%H%M%SZ}.mcap")
    if path.suffix != ".mcap":
        raise StorageError(f"{path}: a recording is an MCAP file; give a name that ends in .mcap")
    if path.exists():
        raise StorageError(f"{path}: exists already; give another name with --out")
    check_folder(path.parent)  # before anything runs: a monitor that cannot record has nothing to do
    viewed = description.answering(Question.VIEW)
    scene = None if viewed is None else ViewerScene(viewed)
    stopped = stop_requested()
    with counting(f"monitor {name}", 0) as show:
        standing = go_realtime("monitor", PRIORITY - 10)  # below those whose work it watches
        with open_bus(name, Role.MONITOR, zenoh_config, insecure, ros_domain) as bus:
            writer = WriterThread(path, name, scene, description.topics)
            monitor = Monitor(bus, writer, standing, description.topics)
            hint = _Silence(name, description.topics.sample, monitor.tally.received, running)
            try:
                run(monitor, stopped, lambda count: (show(count), hint()))
            finally:
                writer.close()
    typer.echo(summary(monitor))
    if writer.failed:
        raise typer.Exit(1)
    conclude(f"wrote {counted(writer.written, 'message')} to {path}", "inspect", path, "--robot", robot)


class _Silence:
    """Says once, when no sample has come for a while, what runs on this host instead."""

    def __init__(self, robot: str, topic: str, received: Mapping[str, int], running: Callable[[], list[str]]) -> None:
        self._robot, self._topic, self._received, self._running = robot, topic, received, running
        self._say_at: float | None = time.monotonic() + SILENCE_S

    def __call__(self) -> None:
        if self._say_at is None or time.monotonic() < self._say_at:
            return
        self._say_at = None
        others = [role for role in self._running() if not role.startswith(f"{self._robot}.")]
        if not self._received[self._topic]:
            heard = f"; running on this host: {', '.join(others)}" if others else ""
            typer.echo(f"monitor: no samples of {self._robot} yet{heard}", err=True)


def summary(monitor: Monitor) -> str:
    """Counts by topic as text."""
    from service.monitor.tally import THINNED

    lines = [f"{'topic':<17} {'received':>10} {'lost':>8} {'repeated':>9} {'out of order':>13} {'restarts':>9}"]
    for topic, received in monitor.tally.received.items():
        if topic in THINNED:
            lines.append(f"{topic:<17} {received:>10}")
            continue
        counts = monitor.tally.count(topic)
        lines.append(
            f"{topic:<17} {received:>10} {counts.lost:>8} {counts.repeated:>9} {counts.out_of_order:>13} "
            f"{counts.restarts:>9}"
        )
    lost = monitor.tally.thinned_lost
    thinned = [topic for topic in monitor.tally.received if topic in THINNED]
    lines.append(f"lost messages of {', '.join(thinned)} together: {'unknown' if lost is None else lost}")
    lines.append(f"rejected messages: {monitor.rejected}")
    return "\n".join(lines)
