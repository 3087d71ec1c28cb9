"""`deltatwin estimate`: Run the online estimator: feed-forward torque, payload and model errors for every sample."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.options import Insecure, OwnEffects, RosDomain, ZenohConfig, robot_file
from service.cli.output import conclude
from service.stopping import end_at_once, interrupted, terminate_as_interrupt


def command(
    robot: Annotated[Path, robot_file(", preferably written by `identify`.")],
    zenoh_config: ZenohConfig = None,
    insecure: Insecure = False,
    ros_domain: RosDomain = None,
    effects: OwnEffects = None,
    keep: Annotated[
        Path | None, typer.Option(help="File that stores the learnt friction between runs", metavar="FILE")
    ] = None,
) -> None:
    """Answer every sample on the bus with feed-forward torque, payload and model errors, until Ctrl-C.

    For an arm the payload is the mass, centre of mass and inertia on its tool; servo axes have no payload.

    The sample rate is read from the stamps. Player, estimator and monitor may start and restart in any order.

    Example: deltatwin estimate --robot identified.toml
    """
    from drivers.bus import check_free, open_bus
    from replay.realtime import go_realtime
    from schemas.axes_description import load_description
    from schemas.messages import Role
    from schemas.questions import Question, as_delta
    from service.estimator.estimator_node import run
    from service.estimator.keep import Keeper
    from service.estimator.online import assumed, compile_estimator

    description = load_description(robot, effects)
    for said in assumed(description, robot):
        typer.echo(said, err=True)
    keeper = None if keep is None else Keeper(keep, as_delta(description, Question.LEARNING))
    check_free(description.name, Role.ESTIMATOR, zenoh_config, insecure)
    typer.echo("estimate: starting; a first run compiles, about half a minute", err=True)
    end_at_once()  # an exception from between two steps of the compiler would leave it with memory that is owned twice
    compile_estimator(description)  # before anybody can hear that the role is alive
    terminate_as_interrupt()
    standing = go_realtime("estimate")
    with open_bus(description.name, Role.ESTIMATOR, zenoh_config, insecure, ros_domain) as bus:
        typer.echo(f"estimating for {description.name}; Ctrl-C ends it", err=True)
        try:
            run(description, bus, standing, interrupted, keeper)
        except KeyboardInterrupt:
            typer.echo("estimate: stopped", err=True)
    conclude("To record samples and answers, run the monitor as well:", "monitor", "--robot", robot)
