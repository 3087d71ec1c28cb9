"""`deltatwin estimate`: the estimator on the bus."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.options import Insecure, OwnEffects, RosDomain, ZenohConfig, robot_file
from service.stopping import interrupted

if TYPE_CHECKING:
    from schemas.robot import Robot


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
    from schemas.robot import Robot
    from service.estimator.estimator_node import run
    from service.estimator.keep import Keeper
    from service.estimator.online import compile_estimator

    description = load_description(robot, effects)
    if isinstance(description, Robot) and description.identified is None:
        typer.echo(
            f"{robot}: no [identified] parameters: friction is zero and rho 1; run `deltatwin identify`", err=True
        )
    if isinstance(description, Robot) and description.limits.peak_torque_nm is None:
        typer.echo(assumed_limit(robot, description), err=True)
    keeper = None if keep is None else Keeper(keep, as_delta(description, Question.LEARNING))
    check_free(description.name, Role.ESTIMATOR, zenoh_config, insecure)
    typer.echo("estimate: starting; a first run compiles, about half a minute", err=True)
    compile_estimator(description)  # before anybody can hear that the role is alive
    standing = go_realtime("estimate")
    with open_bus(description.name, Role.ESTIMATOR, zenoh_config, insecure, ros_domain) as bus:
        typer.echo(f"estimating for {description.name}; Ctrl-C ends it", err=True)
        try:
            run(description, bus, standing, interrupted, keeper)
        except KeyboardInterrupt:
            typer.echo("estimate: stopped", err=True)


def assumed_limit(file: Path, robot: Robot) -> str:
    """What stands in for a largest torque that a description does not state."""
    from service.estimator.bounds import bounds_of

    peak, most = bounds_of(robot).peak_nm, robot.limits.max_payload_kg
    return f"{file}: limits.peak_torque_nm is not set: {peak:.3g} N m assumed, the torque at 10 g with {most:g} kg"
