"""`deltatwin plan-motion`: Plan the motion that best separates alternative causes, or that identifies best."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.options import AsJson, OwnEffects, robot_file
from service.cli.output import as_json, say_next
from service.cli.progress import bars

if TYPE_CHECKING:
    import numpy as np

    from drivers.motion import MotionLimits, Planner, Trajectory
    from schemas.diagnosis import Diagnosis
    from schemas.robot import EffectEntry, Robot
    from service.planning.question import Apart, Figures, Pair

NOISE_SHARE = 0.005  # of the torque limit, where no noise is known
MOST_TOLD = 6  # pairs


class Purpose(enum.StrEnum):
    """What a run is for."""

    DIAGNOSE = "diagnose"
    IDENTIFY = "identify"


_Robot = Annotated[Path, robot_file(", with its limits")]
_Out = Annotated[Path, typer.Option(help="Motion to write (.csv), for `simulate`, `master` and `replay`")]
_Diagnosis = Annotated[Path | None, typer.Option(help="Folder that `diagnose` wrote")]
_For = Annotated[
    Purpose, typer.Option("--for", help="diagnose: separate its alternative models; identify: base parameters.")
]
_Duration = Annotated[float, typer.Option(min=5.0, max=15.0, help="Length of the run (s)")]
_Rate = Annotated[float, typer.Option(min=100.0, max=10000.0, help="Controller cycles per second (Hz)")]
_Seed = Annotated[int, typer.Option(min=0, help="Seed of the search: the same seed gives the same motion")]
_Speed = Annotated[float | None, typer.Option(min=0.01, help="Joint speed limit (rad/s)")]
_Acceleration = Annotated[float | None, typer.Option(min=0.1, help="Joint acceleration limit (rad/s^2)")]
_Torque = Annotated[float | None, typer.Option(min=0.1, help="Joint torque limit, without friction (N m)")]
_Assume = Annotated[bool, typer.Option("--assume-limits", help="Derive missing limits from the robot's size.")]


def command(
    robot: _Robot,
    out: _Out,
    diagnosis: _Diagnosis = None,
    purpose: _For = Purpose.DIAGNOSE,
    duration: _Duration = 10.0,
    rate: _Rate = 1000.0,
    seed: _Seed = 0,
    max_speed: _Speed = None,
    max_acceleration: _Acceleration = None,
    max_torque: _Torque = None,
    assume_limits: _Assume = False,
    effects: OwnEffects = None,
    json: AsJson = False,
) -> None:
    """Plan the motion that separates the causes that a diagnosis could not, and show how well it will separate them.

    The motion stays in the workspace of the description and within the limits of speed, acceleration and torque in its
    [limits] or in the options; it is for the empty robot and starts and ends at rest. A limit given in neither place is
    an error. The expected separation takes only the noise of the torque into account, no other deviation of the robot.
    For axes and arms: with --for identify, within the limits of the URDF and of the options.

    Example: deltatwin plan-motion --robot r.toml --diagnosis diag --out motion.csv

    Example: deltatwin plan-motion --robot r.toml --for identify --out motion.csv --max-acceleration 120
    """
    from drivers.motion import Planner, limits_of
    from schemas.axes_description import load_description
    from schemas.files import check_apart, check_folder
    from schemas.questions import Question, as_delta
    from service.cli.joint_motion import plan_joints
    from service.planning.plan import at_rate
    from service.planning.question import PERIOD

    check_folder(out.parent)
    described = load_description(robot, effects)
    check_apart(out, *described.sources)
    most = (max_speed, max_acceleration, max_torque)
    if described.answering(Question.RIVALS) is None and purpose is Purpose.IDENTIFY:
        plan_joints(robot, described, out, duration, rate, seed, most, assume_limits, json)
        return
    description = as_delta(described, Question.RIVALS)
    limits = limits_of(description, *most)
    assumed = _assumed(description, limits, *most)
    _refuse(robot, description, limits, {} if assume_limits else assumed)
    planner = Planner(description, PERIOD, limits)
    known, question, carried = _question(purpose, description, diagnosis, effects, limits.torque)
    motion, spent = _searched(planner, question, duration, seed)
    sent = at_rate(motion, 1.0 / rate)
    _write(out, planner, sent, _driven(known, description, carried, sent, limits.torque))
    lines, result = _shown(question, question.shown(motion, whole=True))
    if json:
        taken = {key: value for key, (_, value, _) in assumed.items()}
        run = {"motion": str(out), "duration_s": sent.duration, "planned_in_s": round(spent, 1)}
        typer.echo(as_json("plan-motion", run | {"assumed_limits": taken} | result))
        return
    lines += [*_assumed_lines(assumed), f"planned in {spent:.0f} s: {out}, {_used(sent, planner)}"]
    typer.echo("\n".join(lines))
    say_next("simulate", "--robot", robot, "--motion", out, "--out", "tried.csv")


def _searched(planner: Planner, question: Apart | Figures, duration: float, seed: int) -> tuple[Trajectory, float]:
    """The motion that shows most, and the s that finding it took."""
    import time

    from service.planning.plan import evaluations, plan

    begin = time.perf_counter()
    with bars() as progress:
        task = progress.add_task("planning", total=evaluations(duration))
        motion = plan(planner, question, duration, lambda: progress.advance(task), seed)
    return motion, time.perf_counter() - begin


def _assumed_lines(assumed: dict[str, tuple[str, float, str]]) -> list[str]:
    line = f"assumed, as not given: the limit of {_listed(assumed)}: check before a robot runs this"
    return [line] if assumed else []


def _refuse(
    path: Path, robot: Robot, limits: MotionLimits, open_ones: dict[str, tuple[str, float, str]]
) -> None:  # fmt: skip
    """
    Raises:
        DataError: a limit is not given, or a speed is said beyond that of the description.
    """
    from schemas.errors import DataError

    if open_ones:
        raise DataError(
            f"{path}: no limit is given for {_listed(open_ones)}: write it in [limits], or give it as an option; "
            "--assume-limits uses these values"
        )
    if limits.speed > (most := robot.limits.joint_speed_radps):
        raise DataError(f"--max-speed {limits.speed:g} rad/s: limits.joint_speed_radps of {robot.name} is {most:g}")


def _question(
    purpose: Purpose, robot: Robot, diagnosis: Path | None, effects: Path | None, torque: float
) -> tuple[Robot, Apart | Figures, Sequence[EffectEntry]]:
    """The robot as it is known, what the run has to tell, and the effects that it will show.

    Raises:
        BadParameter: rivals are to be told apart, and no diagnosis is named.
    """
    if purpose is Purpose.IDENTIFY:
        return robot, _figures(robot, torque), robot.effect
    if diagnosis is None:
        raise typer.BadParameter("give the folder of a diagnosis, or --for identify", param_hint="--diagnosis")
    known, found = _diagnosed(diagnosis, robot, effects)
    return known, _apart(known, found, diagnosis), found.rivals[0].effects


def _driven(
    known: Robot, robot: Robot, carried: Sequence[EffectEntry], sent: Trajectory, most: float
) -> np.ndarray:  # fmt: skip
    """(N, 3) N m that the motion is expected to take. most: limit of the plan, N m.

    Raises:
        DataError: more than the drives give.
    """
    import numpy as np

    from schemas.errors import DataError
    from service.estimator.bounds import bounds_of
    from service.planning.question import expected

    torque = expected(known, carried, sent)
    peak = bounds_of(robot).peak_nm
    if np.abs(torque).max() > peak:
        raise DataError(
            f"with friction the motion needs {np.abs(torque).max():.4g} N m, but the drives give only {peak:.4g} N m: "
            f"plan with less than --max-torque {most:.4g}"
        )
    return torque


def _write(out: Path, planner: Planner, sent: Trajectory, torque: np.ndarray) -> None:
    """
    Raises:
        DataError, PoseError: at the controller's rate it keeps no limit, or leaves what the arms reach.
    """
    from drivers.motion_file import write_motion

    planner.period = sent.period
    planner.check(sent, str(out))
    write_motion(sent, torque, planner, out)


def _shown(question: Apart | Figures, shown: Any) -> tuple[list[str], dict[str, Any]]:
    """What the run is expected to show, in lines and for JSON. shown: by `question`."""
    from service.planning.question import Apart

    if isinstance(question, Apart):
        pairs = question.learned(shown)
        return _told(pairs), {"pairs": [vars(pair) for pair in pairs]}
    learned = question.learned(shown)
    sigma = ", ".join(f"{s:.2g}" for s in question.view.sigma)
    lines = [f"After this run, for torque noise of {sigma} N m in the band:"]
    lines += [f"  {name} ± {error:.2g} {unit}".rstrip() for name, (error, unit) in learned.items()]
    return lines, {"std_errors": {name: error for name, (error, _) in learned.items()}}


def _assumed(
    robot: Robot, limits: MotionLimits, speed: float | None, acceleration: float | None, torque: float | None
) -> dict[str, tuple[str, float, str]]:
    """Limits that neither the description nor an option gives: key of [limits] -> option, value, unit."""
    told = {key for key in robot.limits.model_fields_set if getattr(robot.limits, key) is not None}
    every = {
        "joint_speed_radps": (speed, "--max-speed", limits.speed, "rad/s"),
        "joint_acceleration_radps2": (acceleration, "--max-acceleration", limits.acceleration, "rad/s^2"),
        "peak_torque_nm": (torque, "--max-torque", limits.torque, "N m"),
    }
    return {key: one[1:] for key, one in every.items() if one[0] is None and key not in told}


def _listed(assumed: dict[str, tuple[str, float, str]]) -> str:
    return ", ".join(f"{key} ({option}): {value:.3g} {unit}" for key, (option, value, unit) in assumed.items())


def _diagnosed(folder: Path, robot: Robot, effects: Path | None) -> tuple[Robot, Diagnosis]:
    """The corrected description and the document of a diagnosis of `robot`.

    Raises:
        DataError: it is of another robot, or what is there is no diagnosis. RobotError: it left no corrected.toml.
    """
    from pydantic import ValidationError

    from schemas.diagnosis import Diagnosis
    from schemas.errors import DataError
    from schemas.files import MIB, read_bytes
    from schemas.robot import load_robot

    path = folder / "diagnosis.json"
    try:
        found = Diagnosis.model_validate_json(read_bytes(path, 64 * MIB, DataError))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "file"
        raise DataError(f"{path}: {where}: {first['msg']}: not written by `deltatwin diagnose`") from error
    if found.robot != robot.name:
        raise DataError(f"{path}: a diagnosis of robot {found.robot!r}, not of {robot.name!r}")
    corrected = load_robot(folder / "corrected.toml", effects)
    for key in ("geometry", "mass", "drive"):
        if getattr(corrected, key) != getattr(robot, key):
            raise DataError(f"{folder / 'corrected.toml'}: its [{key}] differs from that of robot {robot.name!r}")
    return corrected, found


def _apart(known: Robot, found: Diagnosis, folder: Path) -> Apart:
    """
    Raises:
        DataError: there are no two rivals. RobotError: a rival that is not known.
    """
    import numpy as np

    from schemas.errors import DataError
    from service.model.description import terms_of
    from service.planning.question import Apart, View

    rivals = [terms_of(known.model_copy(update={"effect": rival.effects})) for rival in found.rivals]
    question = Apart(View.of(known, np.array(found.gap.noise_floor_nm), found.gap.band_hz), rivals)
    if not question.pairs:
        raise DataError(
            f"{folder}: there are no alternative models that a motion could separate "
            f"({len(rivals)} candidate{'' if len(rivals) == 1 else 's'}); --for identify plans a run without them"
        )
    return question


def _figures(known: Robot, torque: float) -> Figures:
    """torque: N m, limit, by which the noise is assumed where the description has none."""
    import numpy as np

    from service.planning.question import Figures, View

    noise = known.identified.torque_noise_nm if known.identified else None
    view = View.of(known, np.array(noise.value) if noise else np.full(3, NOISE_SHARE * torque))
    return Figures(replace(view, sigma=view.sigma * view.band.white_share**0.5))


def _told(pairs: list[Pair]) -> list[str]:
    """What the run is expected to show, and what not."""
    told = [
        f"After this run {pair.one} and {pair.other} differ by {pair.errors:.0f} standard errors."
        for pair in pairs
        if pair.told
    ]
    more = len(told) - MOST_TOLD
    lines = told[:MOST_TOLD] + ([f"... and {more} more pairs by more than that."] if more > 0 else [])
    return lines + [
        f"No run within these limits was found that separates {pair.one} from {pair.other} ({pair.errors:.1f} standard "
        "errors)."
        for pair in pairs
        if not pair.told
    ]


def _used(motion: Trajectory, planner: Planner) -> str:
    """How much of the limits a motion takes."""
    import numpy as np

    limits = planner.limits
    torque = planner.torque(motion.position, motion.velocity, motion.acceleration)
    used = (
        f"{np.abs(values).max():.3g} of {limit:.3g} {unit}"
        for values, limit, unit in (
            (motion.velocity, limits.speed, "rad/s"),
            (motion.acceleration, limits.acceleration, "rad/s^2"),
            (torque, limits.torque, "N m"),
        )
    )
    return f"{motion.duration:.1f} s at {1 / motion.period:.0f} Hz, up to {', '.join(used)}"
