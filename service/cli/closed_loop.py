"""`deltatwin closed-loop`: Measure how feed-forward torque improves the tracking of a simulated robot, live."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from schemas.words import words
from service.cli.options import AsJson, OwnEffects, check_length, robot_file
from service.cli.output import as_json, console, say_headline, table
from service.cli.progress import bars

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rich.progress import Progress

    from drivers.motion import Planner, Trajectory
    from schemas.messages import HealthFlag
    from schemas.robot import Robot
    from schemas.trace import Trace
    from service.experiment.live_loop import Ratio, Subject, Tracking

LOGS, LOG_S = 4, 6.0  # to identify on: how many, and the length of each, s


class Known(NamedTuple):
    """What is known of the robot: as identified, and as corrected where an effect is asked for. named: what the
    correction holds, in words."""

    identified: Robot
    corrected: Robot | None
    named: str


def command(
    robot: Annotated[Path, robot_file(", or the name of a bundled one.")] = Path("d3-1200"),
    out: Annotated[Path, typer.Option(help="Folder for page, pictures and values as JSON.")] = Path("closed-loop"),
    identified: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE|NAME", help="Description from `identify`. Default: identify on simulated logs first."
        ),
    ] = None,
    effect: Annotated[
        str | None,
        typer.Option(
            metavar="NAME[:SEVERITY]",
            help="Give the robot this effect of the catalogue, with parameters drawn from --seed at a severity (1: a "
            "fault of a small Delta). Compare the rigid tau_FF with that of the corrected description.",
        ),
    ] = None,
    corrected: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Description from `diagnose`. Default, with --effect: diagnose simulated logs."
        ),
    ] = None,
    truth: Annotated[
        str | None,
        typer.Option(
            metavar="FILE", help="True parameters of the robot (TOML), or `ideal`. Default: as for `simulate`."
        ),
    ] = None,
    payload: Annotated[
        list[float] | None, typer.Option(min=0.0, help="Masses to carry (kg). Default: 1 and 3.8.")
    ] = None,
    duration: Annotated[float, typer.Option(min=3.0, help="Length of each run (s).")] = 10.0,
    rate: Annotated[float, typer.Option(min=100.0, max=10000.0, help="Controller cycles per second (Hz).")] = 1000.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of motion, noise and effect.")] = 0,
    effects: OwnEffects = None,
    json: AsJson = False,
) -> None:
    """Run a live simulated robot and the estimator over Zenoh and measure the tracking error: with feedback alone, with
    the feed-forward torque of every model, with the payload included, and with the estimator stopped halfway.

    With --effect or --corrected: with feedback alone, with the rigid and with the corrected feed-forward, on a robot
    that has the effect. Exit code 3 if too many cycles were late for a valid result.

    Example: deltatwin closed-loop --robot d3-1200 --payload 1 --payload 3.8 --out closed-loop

    Example: deltatwin closed-loop --effect stribeck_friction --out loop
    """
    import numpy as np

    from drivers.motion import Planner
    from drivers.simulated.plant.effects import draw_effect
    from drivers.simulated.plant.plant import make_plant
    from replay.realtime import go_realtime
    from schemas.axes_description import load_delta
    from schemas.files import check_apart, make_folder, write_text
    from schemas.questions import Question
    from service.cli.main import MISSED
    from service.experiment.live_loop import CORRECTED, FEEDBACK, RIGID, Subject, ratio, variants
    from service.experiment.loop_page import HEAD, NOTE, SHORT, page, row, verdict_of_correction, verdict_of_models
    from service.experiment.pictures import write_page, write_pictures

    check_length(duration, rate)
    description = load_delta(robot, Question.CLOSED_LOOP)
    plant, which = make_plant(description, truth, 1.0 / rate, seed)
    given = () if effect is None else (draw_effect(effect, plant.described, seed),)
    which += "".join(f"; {name}: {one.in_words}" for name, one in given)
    subject = Subject(description, truth, tuple(one for _, one in given), plant.period)
    make_folder(out)
    for file in ("identified.toml", "corrected.toml"):
        check_apart(out / file, *description.sources)
    planner = Planner(description, subject.period)
    masses = tuple(payload) if payload else (1.0, 3.8)
    with bars() as progress:
        known = _learn(subject, planner, seed, identified, corrected, effects, out, progress)
        motion = planner.pick_and_place(np.random.default_rng([seed, 1]), duration, masses)
        lost = None
        if known.corrected is not None:
            feeds = {FEEDBACK: None, RIGID: known.identified, CORRECTED: known.corrected}
        else:
            feeds = variants(known.identified)
            lost = f"{list(feeds)[-1]}, estimator lost half way"
            feeds[lost] = known.identified
        standing = go_realtime("closed-loop")
        runs = [_run(subject, seed, motion, name, feed, lost, standing, progress) for name, feed in feeds.items()]
    judged = [run for run in runs if run.name != lost]
    if known.corrected is not None:
        described = identified or out / "identified.toml", corrected or out / "corrected.toml"
        headline = verdict_of_correction(runs, known.named, _left_out(known.corrected), described)
        shown, compared = runs, ratio(runs[1], runs[2])
    else:
        headline, compared = verdict_of_models(judged), ratio(runs[0], judged[-1])
        shown = [runs[0], *runs[3:]]  # feedback alone, M_Id+F, full, payload-aware, estimator lost
    report = page(description.name, which, masses, runs, shown, headline)
    write_page(report, out / "closed_loop.html")
    write_pictures(report.drawings, out, "closed_loop")
    counts = not any(run.spoilt for run in judged)
    text = _as_text(which, counts, compared, runs)
    write_text(out / "closed_loop.json", text)
    if json:
        typer.echo(text)
    else:
        short = [[row(run, runs[0])[column] for column in SHORT] for run in runs]
        console().print(table([HEAD[column] for column in SHORT], short, caption=NOTE))
        typer.echo(f"wrote {out / 'closed_loop.html'}, .pdf, .json and PNG pictures")
        say_headline(headline)
    if not counts:
        raise typer.Exit(MISSED)


def _as_text(which: str, counts: bool, compared: Ratio, runs: Sequence[Tracking]) -> str:
    """The result as JSON."""
    values = {
        "robot": which,
        "counts": counts,
        "platform_ratio": {"value": compared.value, "ci95": [compared.low, compared.high]},
        "runs": [_figures(run) for run in runs],
    }
    return as_json("closed-loop", values)


def _learn(
    subject: Subject, planner: Planner, seed: int, identified: Path | None, corrected: Path | None,
    effects: Path | None, out: Path, progress: Progress,
) -> Known:  # fmt: skip
    """Read or find out what is known of the robot; what was found is written into `out`."""
    import numpy as np

    from schemas.errors import DataError
    from schemas.robot import save_robot
    from service.experiment.experiment_logs import identification_motions, record
    from service.identification.from_traces import identify
    from service.identification.regression import summarise
    from service.model.nominal import pack

    robot, wants_correction = subject.robot, bool(subject.effects) or corrected is not None
    logs: list[Trace] = []
    if identified is None or (wants_correction and corrected is None):
        task = progress.add_task("logs for the identification", total=LOGS * LOG_S)
        motions = identification_motions(planner, np.random.default_rng([seed, 2]), LOGS, LOG_S)
        logs = record(subject.plant(seed + 1), motions, "fit", lambda done: progress.update(task, completed=done))
    if identified is None:
        try:
            known = identify(robot, [summarise(pack(robot), log) for log in logs]).robot
        except DataError as error:
            if not subject.effects:
                raise
            raise DataError(f"with this effect: {error}; try a smaller severity") from error
        save_robot(known, out / "identified.toml")
    else:
        known = _load(identified, robot, effects)
    if corrected is not None:
        better = _load(corrected, robot, effects)
        return Known(known, better, _in_words(better))
    if not wants_correction:
        return Known(known, None, "")
    task = progress.add_task("diagnosis", total=None)
    better = _diagnosed(robot, logs, effects, lambda text: progress.update(task, description=f"diagnosis: {text}"))
    progress.update(task, total=1, completed=1)
    save_robot(better, out / "corrected.toml")
    return Known(known, better, _in_words(better))


def _load(path: Path, robot: Robot, effects: Path | None) -> Robot:
    from schemas.axes_description import load_delta
    from schemas.errors import RobotError
    from schemas.questions import Question

    known = load_delta(path, Question.CLOSED_LOOP, effects)
    if known.name != robot.name:
        raise RobotError(f"{path}: describes {known.name}, not {robot.name}")
    return known


def _diagnosed(robot: Robot, logs: list[Trace], effects: Path | None, progress: Callable[[str], None]) -> Robot:
    """The corrected description that `diagnose` makes of `logs`."""
    from schemas.questions import Question, as_delta
    from service.diagnosis.documents.document import corrected
    from service.diagnosis.pipeline import diagnose
    from service.model.effects import catalogue

    return as_delta(corrected(diagnose(robot, logs, catalogue(effects), progress)), Question.CLOSED_LOOP)


def _run(
    subject: Subject, seed: int, motion: Trajectory, name: str, feed: Robot | None, lost: str | None,
    standing: HealthFlag, progress: Progress,
) -> Tracking:  # fmt: skip
    from service.experiment.live_loop import follow, tracking

    task = progress.add_task(name, total=len(motion))
    run = follow(
        subject.robot,
        lambda: subject.plant(seed),
        motion,
        feed,
        standing=standing,
        progress=lambda cycle: None if cycle % 100 else progress.update(task, completed=cycle),
        lose_estimator_at=len(motion) // 2 if name == lost else None,
    )
    return tracking(subject.robot, name, run)


def _in_words(robot: Robot) -> str:
    """The effects of a description with their joints."""
    from schemas.diagnosis import placed

    return (
        ", ".join(placed(one.name, one.joints) for one in robot.effect)
        or "no effect was named, so this is the rigid model again"
    )


def _left_out(robot: Robot) -> list[str]:
    """Effects of a description that the online model does not carry."""
    from service.estimator.named_effects import carried
    from service.model.description import terms_of

    return [words(term.effect.name) for term in terms_of(robot) if not carried(term.effect)]


def _figures(run: Tracking) -> dict[str, object]:
    return {
        "name": run.name,
        "joint_rms_rad": run.joint_rms.tolist(),
        "rms_rad": run.rms,
        "platform_rms_m": run.platform_rms,
        "platform_true_rms_m": run.true_rms,
        "worst_rad": run.worst,
        "helped": run.helped,
        "held": run.held,
        "late": run.late,
        "cycles": len(run.time),
        "counts": not run.spoilt,
    }
