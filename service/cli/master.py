"""`deltatwin master`: drive a Delta robot over EtherCAT, with the twin's torque beside every position."""

from __future__ import annotations

import enum
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.network import Insecure, ZenohConfig

if TYPE_CHECKING:
    import numpy as np

    from drivers.bus import Inbox
    from drivers.ethercat.course import Course
    from drivers.ethercat.master import Counts
    from drivers.health import Health
    from service.estimator.estimator import Estimator


NEVER = float("inf")  # cycles: the age of what has not come


class Source(enum.StrEnum):
    """Where tau_FF comes from."""

    CYCLE = "cycle"
    BUS = "bus"
    OFF = "off"


def command(
    interface: Annotated[str, typer.Argument(help="Ethernet interface that the drives hang on.")],
    robot: Annotated[Path, typer.Option(help="Robot description (TOML) with its drives and their process data.")],
    feedforward: Annotated[
        Source,
        typer.Option(
            help="The estimator inside the cycle; one that runs elsewhere, over Zenoh (`deltatwin estimate`, fed by "
            "`deltatwin tap`); or no torque offset."
        ),
    ] = Source.CYCLE,
    rate: Annotated[float, typer.Option(min=1.0, help="Cycles a second (Hz).")] = 1000.0,
    duration: Annotated[float, typer.Option(min=1.0, help="Length of the pick-and-place (s).")] = 30.0,
    speed: Annotated[float, typer.Option(min=0.05, max=1.0, help="Share of the acceleration limits to use.")] = 0.5,
    carry: Annotated[bool, typer.Option(help="Grip a product on every way there (digital output 0x60FE).")] = True,
    seed: Annotated[int, typer.Option(help="Seed of the pick-and-place.")] = 0,
    max_torque: Annotated[
        float | None, typer.Option(min=0.0, help="Largest torque offset (N m, joint side). Default: rated torque.")
    ] = None,
    max_slope: Annotated[float, typer.Option(min=0.0, help="Its steepest change (N m/s).")] = 5000.0,
    zenoh_config: ZenohConfig = None,
    insecure: Insecure = False,
) -> None:
    """Bring three CiA 402 drives into operation, run a pick-and-place and stop them again.

    Cyclic synchronous position mode; tau_FF goes out as torque offset 0x60B2 in the drive's unit, limited in size and
    slope, and is zero when the estimator is more than three cycles behind. Ctrl-C stops the drives.

    Example: deltatwin master eth1 --robot d3.toml --duration 60
    """
    from drivers.ethercat.master import Master, TorqueOffset, check_interface, follow
    from schemas.robot import load_robot
    from service.cli.signals import terminate_as_interrupt

    terminate_as_interrupt()
    description = load_robot(robot)
    check_interface(interface)

    import numpy as np

    from drivers.bus import open_bus
    from drivers.ethercat.course import course
    from drivers.health import Health
    from drivers.plant.motion import Planner
    from replay.clock import wait_until
    from replay.realtime import go_realtime
    from schemas.messages import HealthFlag, Role
    from service.cli.progress import counting
    from service.estimator.estimator import Estimator

    period = 1 / rate
    motion = Planner(description, period).pick_and_place(
        np.random.default_rng(seed), duration, masses=(1.0,) if carry else (), speed=speed
    )
    with ExitStack() as stack:
        show = stack.enter_context(counting(f"master {interface}", len(motion)))
        torque: InCycle | OverBus | None = None
        if feedforward is Source.CYCLE:
            torque = InCycle(Estimator(description, period))
        realtime = go_realtime("master")
        health: Health | None = None
        if feedforward is Source.BUS:
            bus = stack.enter_context(open_bus(description.name, Role.MASTER, zenoh_config, insecure))
            torque = OverBus(bus.subscribe("feedforward", 64), period)
            health = Health(bus, HealthFlag(0) if realtime else HealthFlag.NO_REALTIME)
        master = stack.enter_context(Master(interface, description, period, wait_until))
        plan = course(master.operate(), motion)
        offset = TorqueOffset(master.scale, max_torque, max_slope, period)
        typer.echo(f"drives in operation on {interface} for {len(plan) * period:.1f} s; Ctrl-C stops them", err=True)
        sent = np.zeros(len(plan), np.int64)
        done = 0
        try:
            for done, _ in enumerate(follow(master, plan, torque or nothing, offset), start=1):
                sent[done - 1] = master.sent_ns
                if done % 256 == 0:
                    show(done)
                if health and master.sent_ns >= health.due_ns:
                    tell(health, master.counts)
        except KeyboardInterrupt:
            pass
        show(done)
    typer.echo(summary(done, len(plan), master.counts, sent[:done]))
    if torque:
        typer.echo(torque.summary())


def tell(health: Health, counts: Counts) -> None:
    """Publish what became of the cycles so far; BUS_FAULT stays once a working counter was wrong."""
    from schemas.messages import HealthFlag

    if counts.faulty:
        health.flags |= HealthFlag.BUS_FAULT
    health.publish(received=counts.cycles, invalid=counts.faulty, late=counts.missed)


def nothing(sample: np.ndarray, course: Course, number: int) -> tuple[np.ndarray, float]:
    """No feed-forward."""
    import numpy as np

    return np.zeros(3), 0.0


class InCycle:
    """tau_FF from an estimator that steps between two frames, for the planned motion of the coming cycle."""

    def __init__(self, estimator: Estimator) -> None:
        from schemas.messages import REFERENCE

        self._estimator = estimator
        self._reference = REFERENCE.empty(1)[0]
        self._payload: np.void | None = None
        estimator.warm_up()

    def __call__(self, sample: np.ndarray, course: Course, number: int) -> tuple[np.ndarray, float]:
        reference = self._reference
        reference["sequence"] = sample["sequence"][0] + 1
        reference["position"] = course.position[number]
        reference["velocity"] = course.velocity[number]
        reference["acceleration"] = course.acceleration[number]
        self._estimator.plan(reference)
        result = self._estimator.run(sample)
        if len(result.payload) and result.payload["trusted"][-1]:
            self._payload = result.payload[-1]
        return result.feedforward["torque"][0], 0.0

    def summary(self) -> str:
        """The last payload that was trusted."""
        if self._payload is None:
            return "payload: none trusted"
        mass, std_dev = self._payload["mass"], self._payload["std_dev"]
        return f"payload last trusted: {mass:.3f} kg (standard deviation {std_dev:.3f} kg)"


class OverBus:
    """tau_FF as it comes over Zenoh from an estimator elsewhere that hears a tap on the same wire."""

    def __init__(self, inbox: Inbox, period: float) -> None:
        import numpy as np

        self._inbox, self._period_ns = inbox, period * 1e9
        self._torque, self._stamp = np.zeros(3), 0
        self._ages: list[float] = []

    def __call__(self, sample: np.ndarray, course: Course, number: int) -> tuple[np.ndarray, float]:
        from schemas.messages import stamp_ns

        records, _ = self._inbox.take()
        if len(records):
            self._torque, self._stamp = records["torque"][-1], int(stamp_ns(records[-1]))
        age = (int(stamp_ns(sample)[0]) - self._stamp) / self._period_ns if self._stamp else NEVER
        self._ages.append(age)
        return self._torque, age

    def summary(self) -> str:
        """How old the torque was when it was used."""
        import numpy as np

        from drivers.ethercat.master import STALE_CYCLES

        ages = np.sort(self._ages)
        stale = int((ages > STALE_CYCLES).sum())
        used = ages[ages < NEVER]
        if not len(used):
            return "tau_FF: none came over Zenoh; is `deltatwin estimate` running, and a tap that feeds it?"
        median, p99, p999 = (used[int(len(used) * share)] for share in (0.5, 0.99, 0.999))
        return (
            f"age of tau_FF: median {median:.0f}, p99 {p99:.0f}, p99.9 {p999:.0f}, max {used[-1]:.0f} cycles; "
            f"stale, so zero, in {stale} of {len(ages)} cycles"
        )


def summary(done: int, planned: int, counts: Counts, sent: np.ndarray) -> str:
    """What the cycles were like."""
    import numpy as np

    text = f"{done} of {planned} cycles; {counts.faulty} with a wrong working counter, {counts.missed} missed"
    if done < 2:
        return text
    times = np.sort(np.diff(sent)) * 1e-3
    median, p99, p999 = (times[int(len(times) * share)] for share in (0.5, 0.99, 0.999))
    return (
        f"{text}; cycle time median {median:.1f}, standard deviation {times.std():.1f}, p99 {p99:.1f}, "
        f"p99.9 {p999:.1f}, max {times[-1]:.1f} µs"
    )
