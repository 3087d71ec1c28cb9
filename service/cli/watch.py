"""`deltatwin watch`: Monitor the residual of the running robot, and diagnose what has changed when it rises."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.options import Insecure, OwnEffects, ZenohConfig, robot_file
from service.cli.output import conclude, read_by


def command(
    robot: Annotated[Path, robot_file(" that `identify` or `diagnose` wrote.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder for findings and the motion that shows them. Default: <robot>-watch.")
    ] = None,
    reference: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="LOG",
            help="Production log from when the description was made, whose gap is the level; may be repeated. "
            "Default: the level is that of the first motion on the bus.",
        ),
    ] = None,
    learn: Annotated[float, typer.Option(min=2.0, help="Length of motion from which the level is learnt (s).")] = 30.0,
    after: Annotated[float, typer.Option(min=6.0, help="Time from a rise to its diagnosis (s).")] = 28.0,
    effects: OwnEffects = None,
    zenoh_config: ZenohConfig = None,
    insecure: Insecure = False,
) -> None:
    """Compare a machine with its description once a second, until Ctrl-C, and publish the difference as `gap`.

    The gap is compared with its level in motion of the same kind; motion of a new kind is learnt and raises no alarm.
    Stretches with a payload, as reported by gripper or estimator, are left out. When the gap rises and stays high, the
    motion since then is diagnosed against the motion before, in a process of the lowest priority. The result (what has
    changed, since when, where and how much) is published as `finding`, printed, and stored with the motion.

    Example: deltatwin watch --robot corrected.toml --out findings

    Example: deltatwin watch --robot corrected.toml --reference monday.mcap
    """
    import os
    from functools import partial

    from drivers.bus import check_free, open_bus
    from replay.process import process
    from schemas.axes_description import load_description
    from schemas.errors import DataError
    from schemas.files import make_folder
    from schemas.messages import LOAD, TOPICS, Role
    from service.cli.reading import reading
    from service.stopping import stop_requested
    from service.watch.state_machine import Patience, Watch
    from service.watch.watch_node import Examination, WatchNode, beyond_description, run

    description = load_description(robot, effects)
    if description.identified is None:
        raise DataError(f"{robot}: no [identified] parameters to compare the robot with: run `deltatwin identify`")
    check_free(description.name, Role.WATCH, zenoh_config, insecure)
    folder = out or Path(f"{description.name}-watch")
    make_folder(folder)  # before anything runs: a watch that cannot store has nothing to do
    watch = Watch(description, Patience(learn, after))
    if not reference:  # what learns from one compiles there
        watch.warm_up()
    for trace in reading(reference or [], description, None, "learning"):
        samples = trace.samples(TOPICS[description.topics.sample])
        carried = process(description, samples).payload if description.bears_load else LOAD.empty(0)
        watch.learn(trace, carried)
    if reference and watch.learnt < learn:
        typer.echo(
            f"watch: {watch.learnt:.1f} s of free motion in the reference, {learn:g} s are needed for a level; motion "
            "of other kinds is learnt from the bus and raises no alarm",
            err=True,
        )
    watch.settle()
    if reference and (doubt := beyond_description(watch)):
        typer.echo(
            f"watch: level learnt from the reference; {doubt}: is it a log of another robot, or with another sign or "
            "unit of the torque, or had the robot changed by then?",
            err=True,
        )
    stopped = stop_requested()
    with open_bus(description.name, Role.WATCH, zenoh_config, insecure) as bus:
        os.nice(10)  # nobody steers by it; but Zenoh's thread, begun before, takes what comes: who sends waits for that
        typer.echo(f"watching {description.name}; findings go to {folder}; Ctrl-C ends it", err=True)
        node = WatchNode(watch, bus, partial(Examination, robot, effects, folder), partial(print, flush=True))
        run(node, stopped)
    counts = node.counts()
    typer.echo(f"watch: stopped; {counts['received']} samples, {counts['lost']} lost", err=True)
    _conclude(folder, node.found, robot, effects)


def _conclude(folder: Path, found: int, robot: Path, effects: Path | None) -> None:
    """found: how many findings there are in `folder`."""
    from schemas.words import counted

    described = ("--robot", robot, *read_by(effects=effects))
    motions = sorted(folder.glob("*/after.mcap"))
    if found and motions:
        said = f"{counted(found, 'finding')} in {folder}. To diagnose the motion of the last one again:"
        conclude(said, "diagnose", motions[-1], *described, "--out", "diagnosis")
    else:
        conclude("No change was found. To go on, whenever the robot runs:", "watch", *described, "--out", folder)
