"""`deltatwin master`: Drive a Delta robot over EtherCAT, with feed-forward torque in every cycle."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.options import Insecure, OwnEffects, RosDomain, ZenohConfig, robot_file
from service.cli.output import conclude, in_quantiles, read_by

if TYPE_CHECKING:
    import numpy as np

    from drivers.bus import Bus
    from drivers.ethercat.soem_master import Counts
    from drivers.health import Health
    from drivers.motion import Planner, Trajectory
    from schemas.messages import HealthFlag
    from schemas.robot import Robot
    from service.feedforward_source import InCycle, OverBus, Steps


CYCLE, BUS, OFF = "cycle", "bus", "off"  # where tau_FF comes from; else a library


def command(
    interface: Annotated[str, typer.Argument(metavar="INTERFACE", help="Ethernet interface of the drives.")],
    robot: Annotated[Path, robot_file(" with its drives and their process data.")],
    feedforward: Annotated[
        str,
        typer.Option(
            metavar="cycle|bus|off|FILE",
            help="cycle: the estimator runs inside the cycle; bus: it runs elsewhere and answers over Zenoh "
            "(`deltatwin estimate`, fed by `deltatwin tap`); off: no torque offset; FILE: in place of the estimator, a "
            "library (.so) compiled from what `deltatwin export --to c` wrote, in that folder.",
        ),
    ] = CYCLE,
    rate: Annotated[float, typer.Option(min=1.0, help="Cycles per second (Hz).")] = 1000.0,
    motion: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Motion to run instead of the pick-and-place, as `plan-motion` writes it."),
    ] = None,
    duration: Annotated[float, typer.Option(min=1.0, help="Length of the pick-and-place (s).")] = 30.0,
    speed: Annotated[float, typer.Option(min=0.05, max=1.0, help="Share of the acceleration limits to use.")] = 0.5,
    carry: Annotated[bool, typer.Option(help="Grip a product on every outward move (digital output 0x60FE).")] = True,
    seed: Annotated[int, typer.Option(help="Seed of the pick-and-place.")] = 0,
    max_torque: Annotated[
        float | None, typer.Option(min=0.0, help="Largest torque offset (N m, joint side), below the rated torque.")
    ] = None,
    zenoh_config: ZenohConfig = None,
    insecure: Insecure = False,
    ros_domain: RosDomain = None,
    effects: OwnEffects = None,
) -> None:
    """Bring three CiA 402 drives into operation, run a pick-and-place or a motion from a file and stop them again.

    Cyclic synchronous position mode. tau_FF is sent as torque offset 0x60B2 in the drive's unit, within the peak and
    slope of the description's `limits`; without a new value it fades to zero within torque_fade_s. With elastic gears
    and drives that map position offset 0x60B0, the motors lead the planned joints by the twist of the gears. Over the
    bus the planned motion is published as `reference`, and only answers to it are used. `health` is published in every
    mode. Ctrl-C stops the drives. A motion from a file is refused if it breaks a limit of speed, acceleration, torque,
    joint range or workspace, or does not start and end at rest; the robot grips no product in it.

    Example: deltatwin master eth1 --robot d3.toml --duration 60

    Example: deltatwin master eth1 --robot corrected.toml --feedforward twin/libtwin.so
    """
    from drivers.ethercat.interface import check_interface
    from drivers.ethercat.soem_master import Master, OffsetRamp, PositionRamp, follow
    from schemas.axes_description import load_delta
    from schemas.questions import Question

    description = load_delta(robot, Question.FIELDBUS, effects)
    check_interface(interface)

    import numpy as np

    from drivers.ethercat.master_health import Report
    from drivers.ethercat.setpoints import SetpointPlan
    from drivers.motion import Planner
    from replay.clock import wait_until
    from replay.realtime import go_realtime
    from schemas.messages import StopReason
    from service.cli.progress import counting
    from service.estimator.bounds import bounds_of
    from service.feedforward_source import InCycle, OverBus, goes_ahead, nothing
    from service.stopping import stop_requested

    period = 1 / rate
    twists = feedforward != OFF and goes_ahead(description)
    peak, slope = bounds_of(description)
    masses = (1.0,) if carry else ()
    planned = _planned(motion, description, Planner(description, period), seed, duration, masses, speed)
    course = SetpointPlan(planned, description.geometry.joint_range_rad)
    sent = np.zeros(len(course), np.int64)
    with ExitStack() as stack:
        show = stack.enter_context(counting(f"master {interface}", len(planned)))
        torque: InCycle | OverBus | None = None
        if feedforward not in (BUS, OFF):
            torque = InCycle(_steps(feedforward, description, period))
        standing = go_realtime("master")
        needed = feedforward == BUS or zenoh_config is not None
        bus, health = _said_on(stack, needed, standing, description.name, zenoh_config, insecure, ros_domain)
        if feedforward == BUS and bus:
            torque = OverBus(bus, peak, period)
        done, interrupted = 0, False
        with Master(interface, description, period, wait_until) as master:
            plan = course.begin(master.operate())
            stopped = stop_requested()  # asked between two cycles; torn out of one, a Ctrl-C could be swallowed there
            limit = peak if max_torque is None else min(peak, max_torque)
            fade = description.limits.torque_fade_s
            offset, ahead = OffsetRamp(master.scale, limit, slope, fade, period), PositionRamp(fade, period)
            _say_operating(interface, len(plan) * period, twists and not master.goes_ahead)
            with Report(health, master, offset, torque.counts if torque else None) as tell:
                for done, _ in enumerate(follow(master, plan, torque or nothing, offset, ahead), start=1):
                    sent[done - 1] = master.sent_ns
                    if done % 256 == 0:
                        show(done)
                    tell()
                    if interrupted := stopped():
                        break
        if health and interrupted:
            health.stop(StopReason.INTERRUPTED)
        show(done)
    said = summary(done, len(plan), master.counts, sent[:done])
    following = "monitor" if description.identified is None else "watch"
    conclude(f"{said}\n{torque.summary()}" if torque else said, following, "--robot", robot, *read_by(effects=effects))


def _say_operating(interface: str, duration: float, behind: bool) -> None:
    """duration: s. behind: elastic gears that the motors cannot go before."""
    typer.echo(f"drives in operation on {interface} for {duration:.1f} s; Ctrl-C stops them", err=True)
    if behind:
        typer.echo("the gears are elastic, but not all drives map 0x60B0: the motors do not lead the plan", err=True)


def _planned(
    motion: Path | None, description: Robot, planner: Planner, seed: int, duration: float, masses: tuple[float, ...],
    speed: float,
) -> Trajectory:  # fmt: skip
    """The motion of a file, or else a pick-and-place."""
    import numpy as np

    if motion is not None:
        from drivers.motion_file import read_motion

        return read_motion(motion, description, planner)
    return planner.pick_and_place(np.random.default_rng(seed), duration, masses=masses, speed=speed)


def _said_on(
    stack: ExitStack, needed: bool, standing: HealthFlag, name: str, zenoh_config: Path | None, insecure: bool,
    ros_domain: int | None,
) -> tuple[Bus | None, Health | None]:  # fmt: skip
    """The bus and the health that is published on it; none of either where there is no bus and it is not `needed`."""
    from drivers.bus import open_bus
    from drivers.health import Health
    from schemas.errors import BusError, RoleTakenError
    from schemas.messages import Role

    try:
        bus = stack.enter_context(open_bus(name, Role.MASTER, zenoh_config, insecure, ros_domain))
        return bus, stack.enter_context(Health(bus, standing))
    except BusError as error:
        if needed or isinstance(error, RoleTakenError):
            raise  # two masters would fight for the drives
        typer.echo(f"master: {error}; it continues without publishing its health", err=True)
        return None, None


def _steps(feedforward: str, robot: Robot, period: float) -> Steps:
    """What answers inside the cycle."""
    if feedforward == CYCLE:
        from service.estimator.estimator import Estimator

        return Estimator(robot, period)
    path = Path(feedforward)
    if not path.is_file():
        raise typer.BadParameter(f"{feedforward!r}: not cycle, bus, off or the path of an existing library")
    from service.codegen.library import Library

    return Library(path, robot, period)


def summary(done: int, planned: int, counts: Counts, sent: np.ndarray) -> str:
    """What the cycles were like."""
    import numpy as np

    text = (
        f"{done} of {planned} cycles; {counts.lost} lost, {counts.faulty} with a wrong working counter, "
        f"{counts.missed} missed"
    )
    if counts.clock:
        text += f", {counts.clock} with an implausible clock"
    if done < 2:
        return text
    times = np.diff(sent)
    return f"{text}; cycle time {in_quantiles(times)}, standard deviation {times.std() * 1e-3:.1f} µs"
