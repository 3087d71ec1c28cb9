"""What `simulate` and `plan-motion` do with axes and arms."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from schemas.words import significant
from service.cli.output import apart_from, as_json, console, say_next, table
from service.cli.progress import bars

if TYPE_CHECKING:
    import numpy as np

    from schemas.axes_description import Description
    from service.machines.joint_motions import JointMotion

TRIES = 40  # motions that are compared
DEFAULTS = {"--max-speed": 1.0, "--max-acceleration": 5.0}  # of a simulated machine, rad or m
UNITS = {"--max-speed": "rad/s", "--max-acceleration": "rad/s^2", "--max-torque": "N m"}  # of joints that turn
NOISE_SHARE = 0.005  # of a joint's largest torque, where no noise is known


def simulate_joints(
    robot: Path,
    description: Description,
    motion: str,
    out: Path,
    duration: float,
    rate: float,
    seed: int,
    limits: tuple[float | None, float | None, float | None],
) -> None:
    """`simulate` of a multisine, a slow sweep or a file. limits: speed, acceleration, torque of the options.

    Raises:
        DataError: the motion is out of limits. StorageError: the log cannot be written.
    """
    import numpy as np

    from drivers.trace import write_trace
    from schemas.trace import Trace
    from service.identification.of_logs import refusal
    from service.machines import machine_of
    from service.machines.joint_motions import limits_of, multisine
    from service.machines.simulated import simulate
    from service.model.description import base_of

    machine = machine_of(description)
    tight, missing = limits_of(machine, *limits)
    given = dict(zip(UNITS, limits, strict=True))
    given |= {name: DEFAULTS[name] for name in missing if name in DEFAULTS}
    tight, _ = limits_of(machine, *given.values())
    if motion in ("multisine", "slow"):
        rng = np.random.default_rng([seed, 1])
        path = multisine(machine, base_of(description), tight, duration, 1.0 / rate, rng, motion == "slow")
    else:
        path = _read(Path(motion), description, 1.0 / rate)
    log = simulate(machine, path, np.random.default_rng(seed))
    trace = Trace(out, log.time, log.position, log.torque, position_command=log.command, angular=description.angular)
    write_trace(trace, out, description.name)
    off = np.sqrt(np.mean((log.position - log.command) ** 2, axis=0))
    unit = "mrad" if description.angular else "mm"
    typer.echo(f"{out}: {len(trace)} samples at {rate:.6g} Hz, {path.time[-1]:.3f} s")
    errors = ", ".join(significant(1e3 * value, 2) for value in off)
    typer.echo(f"simulated {description.name} as it is described; tracking error {errors} {unit} rms")
    if refusal(description, [trace]) is None:
        say_next("identify", out, "--robot", robot, "--out", apart_from("identified.toml", robot))
    else:
        say_next("simulate", "--robot", robot, "--motion", "multisine", "--out", apart_from("fit.csv", out))


def plan_joints(
    robot: Path,
    description: Description,
    out: Path,
    duration: float,
    rate: float,
    seed: int,
    limits: tuple[float | None, float | None, float | None],
    assume: bool,
    json: bool,
) -> None:
    """`plan-motion --for identify`.

    Raises:
        DataError: a limit is not known. StorageError: the motion cannot be written.
    """
    import numpy as np

    from schemas.errors import DataError
    from service.machines import machine_of
    from service.machines.joint_motions import limits_of, most_telling, torque_of
    from service.model.description import base_of, in_units_of
    from service.model.parameters import base_parameters

    machine = machine_of(description)
    tight, missing = limits_of(machine, *limits)
    asked = [name for name in missing if name in DEFAULTS]
    if asked and not assume:
        told = ", ".join(
            f"{name} ({DEFAULTS[name]:g} {in_units_of(description, UNITS[name])} assumed)" for name in asked
        )
        raise DataError(
            f"{description.name}: no limit is given for {told}: give it as an option; --assume-limits uses these values"
        )
    given = dict(zip(UNITS, limits, strict=True))
    tight, _ = limits_of(machine, *(given | {name: DEFAULTS[name] for name in asked}).values())
    base = base_of(description)
    with bars() as progress:
        task = progress.add_task("planning", total=TRIES)
        found = most_telling(machine, base, tight, duration, 1.0 / rate, seed, TRIES, lambda: progress.advance(task))
    motion, errors = found
    torque = torque_of(machine, base, motion.theta, motion.theta_dot, motion.theta_ddot)
    noise = NOISE_SHARE * float(np.abs(torque).max())
    _write(motion, torque, description.angular, out)
    names = [(one.name, in_units_of(description, one.unit)) for one in base_parameters(machine.mechanism)]
    if json:
        figures = {"motion": str(out), "duration_s": float(motion.time[-1]), "noise_nm": noise}
        known = {name: float(noise * error) for (name, _), error in zip(names, errors, strict=True)}
        typer.echo(as_json("plan-motion", figures | {"std_errors": known, "assumed": asked}))
        return
    rows = [
        (name, significant(noise * error, 2) if np.isfinite(error) else "not identifiable", unit)
        for (name, unit), error in zip(names, errors, strict=True)
    ]
    title = f"after this run, for torque noise of {significant(noise, 2)} {in_units_of(description, 'N m')}"
    console().print(table(("parameter", "standard error", "unit"), rows, title))
    if asked:
        typer.echo(f"assumed, as not given: {', '.join(asked)}: check before a machine runs this")
    largest = zip((motion.theta_dot, motion.theta_ddot, torque), UNITS.values(), strict=True)
    used = ", ".join(f"{np.abs(values).max():.3g} {in_units_of(description, unit)}" for values, unit in largest)
    typer.echo(f"best of {TRIES}: {out}, {motion.time[-1]:.1f} s at {rate:g} Hz, up to {used}")
    say_next("simulate", "--robot", robot, "--motion", out, "--out", "tried.csv")


def _write(motion: JointMotion, torque: np.ndarray, angular: bool, out: Path) -> None:
    from drivers.trace import write_trace
    from schemas.trace import Trace

    write_trace(Trace(out, motion.time, motion.theta, torque, angular=angular), out)


def _read(path: Path, description: Description, period: float) -> JointMotion:
    """The motion of a file at a period of its own, its speed and acceleration by a spline."""
    import numpy as np
    from scipy.interpolate import make_interp_spline

    from drivers.trace import read_trace
    from service.machines.joint_motions import JointMotion

    trace = read_trace(path, description)
    time = np.arange(trace.time[0], trace.time[-1], period)
    spline = make_interp_spline(trace.time, trace.position, k=5)
    return JointMotion(period, spline(time), spline(time, 1), spline(time, 2))
