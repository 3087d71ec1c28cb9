"""`deltatwin simulate`: Simulate a robot, into a log or live on the bus."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from schemas.words import percent
from service.cli.joint_motion import simulate_joints
from service.cli.options import Insecure, RosDomain, ZenohConfig, check_length, refuse, robot_file
from service.cli.output import Table, apart_from, console, in_quantiles, say_next, table
from service.cli.progress import bars
from service.stopping import interrupted

if TYPE_CHECKING:
    import numpy as np

    from drivers.motion import Planner, Trajectory
    from drivers.simulated.plant.plant import Plant
    from drivers.simulated.plant.plant_on_bus import LiveRun
    from schemas.robot import Robot
    from schemas.trace import Trace


OF_JOINTS = ("multisine", "slow")  # motions of axes and arms
KINDS = ("pick", "multisine", "bound", "slow")  # of motions that `drivers.motion.Planner` plans


def command(
    context: typer.Context,
    robot: Annotated[Path, robot_file(", or the name of a bundled one: d3-1200.")],
    motion: Annotated[
        str,
        typer.Option(
            metavar="|".join((*KINDS, "FILE")),
            help="pick: between two conveyors; multisine: excites all joints; bound: along the rim of the workspace; "
            "slow: a slow sweep; or a motion from a file, as `plan-motion` writes it.",
        ),
    ] = "pick",
    out: Annotated[Path | None, typer.Option(help="Log to write (.csv, .csv.gz, .mcap).")] = None,
    picks: Annotated[
        Path | None,
        typer.Option(help="CSV to write with the payloads and their times, for --truth of `payload`."),
    ] = None,
    duration: Annotated[float, typer.Option(min=0.5, help="Length of the motion (s).")] = 10.0,
    rate: Annotated[float, typer.Option(min=100.0, max=10000.0, help="Controller cycles per second (Hz).")] = 1000.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of motion and noise: the same seed gives the same log.")] = 0,
    payload: Annotated[
        list[float] | None, typer.Option(min=0.0, help="Mass to carry in `pick` (kg); give several to mix them.")
    ] = None,
    speed: Annotated[float, typer.Option(min=0.05, max=1.0, help="Share of the motion limits to use.")] = 1.0,
    max_speed: Annotated[float | None, typer.Option(min=0.01, help="Joint speed limit (rad/s).")] = None,
    max_acceleration: Annotated[float | None, typer.Option(min=0.1, help="Joint acceleration limit (rad/s^2).")] = None,
    max_torque: Annotated[float | None, typer.Option(min=0.1, help="Joint torque limit of the plan (N m).")] = None,
    truth: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="True parameters of the robot (TOML), or `ideal`: exactly as described, no friction, no noise. "
            "Default: the bundled ones of this robot, else ideal.",
        ),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Run in real time over Zenoh, and apply the feed-forward torque.")
    ] = False,
    loop: Annotated[int, typer.Option(min=0, help="Live: number of times to run the motion; 0: until Ctrl-C.")] = 0,
    later: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=VALUE]@SECONDS",
            help="Effect that starts while the robot runs, such as stribeck_friction@60s; VALUE: its first parameter, "
            "in SI units. May be repeated.",
        ),
    ] = None,
    zenoh_config: ZenohConfig = None,
    insecure: Insecure = False,
    ros_domain: RosDomain = None,
) -> None:
    """Simulate a closed-chain Delta (MuJoCo) with drives, friction, noise and payloads; or axes and arms as identified.

    Writes the log of a controller, joint side, in SI units. With --live it replaces the robot: it publishes samples and
    the planned motion of the next cycle, and its drives add the feed-forward torque.

    Example: deltatwin simulate --robot d3-1200 --motion pick --payload 3.8 --duration 20 --out pick.csv

    Example: deltatwin simulate --robot d3-1200 --live --payload 1 --payload 3.8

    Example: deltatwin simulate --robot arm_identified.toml --motion multisine --out arm.csv

    Example: deltatwin simulate --robot d3-1200 --live --later stribeck_friction@60s
    """
    import numpy as np

    from drivers.motion import Planner, limits_of
    from drivers.motion_file import read_motion
    from drivers.simulated.plant.later import changes
    from drivers.simulated.plant.later import later as read_later
    from drivers.simulated.plant.plant import make_plant
    from schemas.axes_description import load_description
    from schemas.errors import DataError
    from schemas.files import check_apart, check_distinct, check_folder
    from schemas.questions import Question, as_delta

    if out is None and not live:
        raise typer.BadParameter("give the file for the log (--out), or run --live", param_hint="--out")
    if motion not in KINDS and not Path(motion).suffix:
        raise typer.BadParameter(f"{motion!r} is neither a file nor one of {', '.join(KINDS)}", param_hint="--motion")
    check_length(duration, rate)
    if live:
        refuse(context, "picks", only="a log that is simulated at once, not for --live")
    else:
        refuse(context, "loop", "zenoh_config", "insecure", "ros_domain", only="--live")
    if payload and motion != "pick":
        raise typer.BadParameter(f"only `pick` carries a payload, not `{motion}`", param_hint="--payload")
    described = load_description(robot)
    check_distinct(out, picks)
    for path in (out, picks):
        if path is not None:
            check_folder(path.parent)
            check_apart(path, *described.sources, Path(motion), *([Path(truth)] if truth else []))
    if described.answering(Question.ROUTE) is None and not live and (motion in OF_JOINTS or Path(motion).suffix):
        assert out is not None
        refuse(context, "picks", "truth", "speed", "later", only="Delta robots")
        simulate_joints(robot, described, motion, out, duration, rate, seed, (max_speed, max_acceleration, max_torque))
        return
    description = as_delta(described, Question.CLOSED_LOOP if live else Question.ROUTE)
    plant, which = make_plant(description, truth, 1.0 / rate, seed)
    planner = Planner(description, plant.period, limits_of(description, max_speed, max_acceleration, max_torque))
    if planner.limits.torque > plant.truth.peak_torque_nm:
        raise DataError(f"--max-torque {max_torque} N m: the drives give {plant.truth.peak_torque_nm:.6g} N m at most")
    coming = [read_later(text, plant.described, seed) for text in later or ()]
    if motion in KINDS:
        planned = _plan(planner, motion, np.random.default_rng([seed, 1]), duration, tuple(payload or ()), speed)
    else:
        planned = read_motion(Path(motion), description, planner)
    for one in coming:
        if not live and one.at >= planned.duration:
            raise DataError(f"--later {one.name}@{one.at:g}s: the motion ends at {planned.duration:.3g} s")
        typer.echo(f"later {one.in_words}", err=True)
    made = changes(plant, seed, coming)
    if live:
        trace = _live(description, plant, planner.closed(planned), loop, made, out, zenoh_config, insecure, ros_domain)
    else:
        assert out is not None
        trace = _offline(description, plant, planned, made, out)
        if picks is not None:
            _write_picks(planned, picks)
    typer.echo(f"simulated {description.name}, {which}; workspace {_workspace(planner)}")
    if trace is None:
        say_next("monitor", "--robot", robot)
    else:
        _say_next(description, robot, trace, truth, bool(planned.payloads))


def _say_next(description: Robot, robot: Path, log: Trace, truth: str | None, carries: bool) -> None:
    """What the log is good for; a payload is estimated with an identified robot."""
    from service.identification.of_logs import refusal

    out = log.path
    if not carries and refusal(description, [log]) is None:
        say_next("identify", out, "--robot", robot, "--out", apart_from("identified.toml", robot))
    elif carries and description.identified is not None:
        say_next("payload", out, "--robot", robot)
    else:
        same = ("--truth", truth) if truth else ()
        fit = apart_from("fit.csv", out)
        say_next("simulate", "--robot", robot, *same, "--motion", "multisine", "--out", fit)


def _plan(
    planner: Planner,
    kind: str,
    rng: np.random.Generator,
    duration: float,
    masses: tuple[float, ...],
    speed: float,
) -> Trajectory:
    if kind == "pick":
        return planner.pick_and_place(rng, duration, masses, speed)
    if kind == "multisine":
        return planner.multisine(rng, duration, speed)
    if kind == "bound":
        return planner.bound(rng, duration, speed)
    return planner.slow(rng, duration)


def _offline(robot: Robot, plant: Plant, motion: Trajectory, changes: dict[int, Plant], out: Path) -> Trace:
    from drivers.simulated.plant.plant_trace import simulate
    from drivers.trace import write_trace

    with bars() as progress:
        task = progress.add_task(f"simulate {robot.name}", total=len(motion))
        trace = simulate(
            plant,
            motion,
            progress=lambda k: None if k % 200 else progress.update(task, completed=k),
            changes=changes,
        )
    write_trace(trace, out, robot.name)
    typer.echo(f"{out}: {len(trace)} samples at {1 / plant.period:.6g} Hz, {motion.duration:.3f} s")
    for load in motion.payloads:
        typer.echo(f"  {load.mass:.3f} kg from {load.pick:.3f} s to {load.release:.3f} s")
    return replace(trace, path=out)


def _write_picks(motion: Trajectory, path: Path) -> None:
    from schemas.files import write_text

    lines = [f"{load.pick:.6f},{load.release:.6f},{load.mass:.6f}\n" for load in motion.payloads]
    write_text(path, "from_s,until_s,mass_kg\n" + "".join(lines))


def _live(
    robot: Robot,
    plant: Plant,
    motion: Trajectory,
    loops: int,
    changes: dict[int, Plant],
    out: Path | None,
    zenoh_config: Path | None,
    insecure: bool,
    ros_domain: int | None,
) -> Trace | None:
    """Run it until its end or Ctrl-C. The log that was written, if any."""
    import numpy as np

    from drivers.bus import open_bus
    from drivers.simulated.plant.plant_on_bus import run_live
    from drivers.trace import write_trace
    from replay.clock import Pacer
    from replay.realtime import go_realtime
    from schemas.messages import Role
    from service.cli.progress import counting

    typer.echo(f"live {robot.name}: `deltatwin top --robot FILE` shows its payload, torque and health", err=True)
    with counting(f"live {robot.name}", len(motion) * loops) as show:
        standing = go_realtime("simulate")
        with open_bus(robot.name, Role.ROBOT, zenoh_config, insecure, ros_domain) as bus:
            run = run_live(
                plant, motion, bus, Pacer(), loops=loops, changes=changes, standing=standing, progress=show,
                stop=lambda _: interrupted(),
            )  # fmt: skip
    if not len(run.trace):
        return None
    console().print(_joints(run))
    helped = np.isfinite(run.feedforward).all(axis=1).mean()
    typer.echo(
        f"{run.cycles} cycles, feed-forward in {percent(helped, 1)}; {run.late} cycles late, "
        f"lateness {in_quantiles(run.lateness)}"
    )
    if motion.payloads:
        typer.echo(f"carried: {', '.join(f'{load.mass:.3f} kg' for load in motion.payloads)}, in turn")
    if out is None:
        return None
    write_trace(run.trace, out, robot.name)
    return replace(run.trace, path=out)


def _joints(run: LiveRun) -> Table:
    """What each joint did over the cycles that are kept."""
    import numpy as np

    def told(name: str, values: np.ndarray, form: str) -> tuple[str, ...]:
        return name, *("-" if np.isnan(value) else format(value, form) for value in values)

    def rms(values: np.ndarray) -> np.ndarray:
        return np.sqrt(np.mean(values**2, axis=0)) if len(values) else np.full(3, np.nan)

    trace, known = run.trace, np.isfinite(run.feedforward).all(axis=1)
    assert trace.position_command is not None
    rows = [
        told("tracking error, mrad rms", 1e3 * rms(trace.position - trace.position_command), ".3f"),
        told("torque, N m rms", rms(trace.torque), ".2f"),
        told("largest torque, N m", np.abs(trace.torque).max(axis=0), ".2f"),
        told("feed-forward, N m rms", rms(run.feedforward[known]), ".2f"),
    ]
    kept = "" if run.cycles == len(trace) else f", last {len(trace)} cycles"
    return table(("", "joint 1", "joint 2", "joint 3"), rows, f"live, as measured{kept}")


def _workspace(planner: Planner) -> str:
    space = planner.workspace
    return f"{2 * space.radius:.2f} m wide, z {space.bottom:.2f} to {space.top:.2f} m"
