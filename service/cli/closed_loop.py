"""`deltatwin closed-loop`: what feed-forward torque does for the tracking of a live robot."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.options import AsJson, OwnEffects, robot_file
from service.cli.output import as_json, console, table
from service.cli.progress import bars

if TYPE_CHECKING:
    from service.experiment.closed_loop import Tracking
    from service.experiment.pictures import Page

LOGS, LOG_S = 4, 6.0  # to identify on: how many, and the length of each, s


def command(
    robot: Annotated[Path, robot_file(", or one that comes along.")] = Path("d3-1200"),
    out: Annotated[Path, typer.Option(help="Folder for page, pictures and figures as JSON.")] = Path("closed-loop"),
    identified: Annotated[
        Path | None,
        typer.Option(metavar="FILE|NAME", help="What `identify` wrote. Default: identify on simulated logs first."),
    ] = None,
    truth: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="What the robot really is (TOML), or `ideal`. Default: as `simulate`."),
    ] = None,
    payload: Annotated[list[float] | None, typer.Option(min=0.0, help="Masses to carry (kg).")] = None,
    duration: Annotated[float, typer.Option(min=3.0, help="Length of each run (s).")] = 10.0,
    rate: Annotated[float, typer.Option(min=100.0, max=10000.0, help="Controller cycles a second (Hz).")] = 1000.0,
    seed: Annotated[int, typer.Option(min=0, help="Of motion and noise.")] = 0,
    effects: OwnEffects = None,
    json: AsJson = False,
) -> None:
    """Run a live simulated robot and the estimator over Zenoh and measure the tracking error: with feedback alone, with
    the feed-forward torque of every model, with the payload in it, and with the estimator lost half way.

    Example: deltatwin closed-loop --robot d3-1200 --payload 1 --payload 3.8 --out closed-loop
    """
    import numpy as np

    from drivers.motion import Planner
    from drivers.plant.plant import make_plant
    from replay.realtime import go_realtime
    from schemas.errors import RobotError
    from schemas.files import make_folder, write_text
    from schemas.robot import load_robot
    from service.experiment.closed_loop import follow, tracking, variants
    from service.experiment.logs import identification_motions, record
    from service.experiment.pictures import write_page, write_pictures
    from service.identification.identify import identify
    from service.identification.regression import summarise
    from service.model.nominal import pack

    description = load_robot(robot)
    period = 1.0 / rate
    make_folder(out)
    planner = Planner(description, period)
    runs: list[Tracking] = []
    with bars() as progress:
        if identified is None:
            task = progress.add_task("logs to identify on", total=LOGS * LOG_S)
            plant, _ = make_plant(description, truth, period, seed + 1)
            motions = identification_motions(planner, np.random.default_rng([seed, 2]), LOGS, LOG_S)
            logs = record(plant, motions, "fit", lambda seconds: progress.update(task, completed=seconds))
            known = identify(description, [summarise(pack(description), log) for log in logs]).robot
        else:
            known = load_robot(identified, effects)
            if known.name != description.name:
                raise RobotError(f"{identified}: describes {known.name}, not {description.name}")
        masses = tuple(payload) if payload else (1.0, 3.8)
        motion = planner.pick_and_place(np.random.default_rng([seed, 1]), duration, masses)
        standing = go_realtime("closed-loop")
        feeds = variants(known)
        lost = f"{list(feeds)[-1]}, estimator lost half way"
        for name, feed in [*feeds.items(), (lost, known)]:
            task = progress.add_task(name, total=len(motion))
            run = follow(
                description,
                lambda: make_plant(description, truth, period, seed)[0],
                motion,
                feed,
                standing=standing,
                progress=lambda cycle, task=task: None if cycle % 100 else progress.update(task, completed=cycle),
                lose_estimator_at=len(motion) // 2 if name == lost else None,
            )
            runs.append(tracking(description, name, run))
    rows = [_row(run, runs[0]) for run in runs]
    which = make_plant(description, truth, period, seed)[1]
    page = _page(description.name, which, masses, runs, rows)
    write_page(page, out / "closed_loop.html")
    write_pictures(page.drawings, out, "closed_loop")
    figures = [
        {
            "name": run.name,
            "joint_rms_rad": run.joint_rms.tolist(),
            "rms_rad": run.rms,
            "platform_rms_m": run.platform_rms,
            "worst_rad": run.worst,
            "helped": run.helped,
            "late": run.late,
        }
        for run in runs
    ]
    text = as_json("closed-loop", {"runs": figures})
    write_text(out / "closed_loop.json", text)
    if json:
        typer.echo(text)
        return
    short = [[row[column] for column in SHORT] for row in rows]
    console().print(table([HEAD[column] for column in SHORT], short, caption=NOTE))
    typer.echo(f"wrote {out / 'closed_loop.html'}, .pdf, .json and PNG pictures")


NOTE = (
    "rms tracking error, and the worst of any joint; times smaller than with feedback alone; cycles helped by "
    "feed-forward; cycles that began late"
)
SHORT = (0, 4, 5, 6, 7, 8, 9)  # columns of HEAD that a terminal has room for
HEAD = (
    "fed with", "joint 1, mrad", "joint 2, mrad", "joint 3, mrad", "all, mrad", "platform, mm", "worst, mrad",
    "times smaller", "helped", "late",
)  # fmt: skip


def _row(run: Tracking, reference: Tracking) -> tuple[str, ...]:
    joints = (f"{value * 1e3:.3f}" for value in run.joint_rms)
    return (
        run.name,
        *joints,
        f"{run.rms * 1e3:.3f}",
        f"{run.platform_rms * 1e3:.3f}",
        f"{run.worst * 1e3:.2f}",
        f"{reference.rms / run.rms:.1f}",
        f"{run.helped:.1%}",
        str(run.late),
    )


def _page(robot: str, which: str, masses: tuple[float, ...], runs: list[Tracking], rows: list[tuple[str, ...]]) -> Page:
    import numpy as np

    from service.experiment.pictures import Figure, Line, Page, PageTable, Panel, by_joint

    shown = [runs[0], *runs[3:]]  # feedback alone, M_Id+F, full, payload-aware, estimator lost
    lines = [Line(run.name, run.time, run.error * 1e3, colour, "thin") for colour, run in enumerate(shown)]
    panels = by_joint(lines, "error / mrad", "joint {}")
    joints = np.array(["joint 1", "joint 2", "joint 3"])
    bars = Panel(
        "",
        "rms error / mrad",
        tuple(Line(run.name, joints, run.joint_rms * 1e3, colour, "bars") for colour, run in enumerate(runs[:-1])),
    )
    loads = ", ".join(f"{mass:g} kg" for mass in masses)
    return Page(
        f"Closed loop: {robot}",
        (
            f"Everything here is simulated: the robot is a rigid-body plant (MuJoCo; {which}) in real time, the "
            f"estimator a process of its own; they talk over Zenoh. The motion, pick-and-place with {loads}, and the "
            "noise are the same in every run; what the drives are fed differs.",
        ),
        (
            PageTable("Tracking error", HEAD, tuple(rows), NOTE),
            Figure("closed_loop_error", "Tracking error over time", "Measured minus commanded joint angle.", panels),
            Figure("closed_loop_rms", "Tracking error by model", "rms after the first half second.", (bars,)),
        ),
    )
