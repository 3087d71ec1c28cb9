"""`deltatwin experiment`: Repeat the paper's experiment on a simulated robot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.options import AsJson
from service.cli.output import as_json, console, say_headline, table
from service.cli.progress import bars


def command(
    out: Annotated[Path, typer.Option(help="Folder for page, pictures, logs and descriptions.")] = Path("experiment"),
    trajectories: Annotated[int, typer.Option(min=4, help="Number of identification trajectories.")] = 12,
    duration: Annotated[float, typer.Option(min=3.0, help="Length of each trajectory (s).")] = 10.0,
    payload: Annotated[float, typer.Option(min=0.1, help="Mass to pick and place (kg).")] = 3.8,
    rate: Annotated[float, typer.Option(min=100.0, max=10000.0, help="Controller cycles per second (Hz).")] = 1000.0,
    forgetting: Annotated[
        float, typer.Option(min=0.5, max=1.0, help="Forgetting factor of the paper's recursion, per millisecond.")
    ] = 0.99,
    seed: Annotated[int, typer.Option(min=0, help="Seed of motions and noise.")] = 0,
    logs: Annotated[bool, typer.Option("--logs", help="Also write the simulated logs as CSV.")] = False,
    json: AsJson = False,
) -> None:
    """Repeat the paper's experiment on a simulated robot of the D3-1200's size, and compare with the published values.

    Twelve identification trajectories, a stress motion near the bounds of the workspace (υ_F) and a pick-and-place run
    with 3.8 kg (υ_P). The result is tables 1 and 2 and figures 2 to 9 next to the paper's values, with a separate
    section beyond the paper (diagnosis of the same logs, and the payload with the corrected description), as one
    interactive page, as PNG and as PDF. Every measurement in it is simulated.

    Example: deltatwin experiment --out experiment
    """
    from dataclasses import asdict

    import numpy as np

    from drivers.motion import Planner
    from drivers.simulated.plant.plant import make_plant
    from drivers.simulated.plant.truth import TRUTHS
    from drivers.trace import write_trace
    from schemas.files import make_folder
    from schemas.robot import load_robot, save_robot
    from service.experiment.experiment_logs import excitations, record
    from service.experiment.paper import page, run, table_1
    from service.experiment.pictures import write_page, write_pictures

    make_folder(out)
    robot = load_robot("d3-1200")
    plant, which = make_plant(robot, TRUTHS / "d3-1200-paper.toml", 1.0 / rate, seed)
    planner = Planner(robot, plant.period)
    rng = np.random.default_rng([seed, 3])
    with bars() as progress:
        task = progress.add_task("simulate", total=(trajectories + 3) * duration)
        fit = record(
            plant,
            excitations(planner, rng, trajectories, duration),
            "identification",
            lambda seconds: progress.update(task, completed=seconds),
        )
        stress_motion = planner.bound(rng, 1.5 * duration)
        pick_motion = planner.pick_and_place(rng, 1.5 * duration, (payload,), speed=0.4)
        (stress,) = record(plant, iter([stress_motion]), "upsilon_F")
        progress.update(task, completed=(trajectories + 1.5) * duration)
        (picks,) = record(plant, iter([pick_motion]), "upsilon_P")
        progress.update(task, completed=(trajectories + 3) * duration)
    with console(stderr=True).status("identifying") as status:
        found = run(robot, fit, stress, picks, pick_motion.payloads, forgetting, status.update)
    report = page(found, which)
    write_page(report, out / "experiment.html")
    write_pictures(report.drawings, out, "experiment")
    for identified, name in ((found.by_pooled.robot, "identified.toml"), (found.corrected, "corrected.toml")):
        save_robot(identified, out / name, template=Path("d3-1200"))
    if logs:
        for trace in (*fit, stress, picks):
            write_trace(trace, out / f"{trace.name}.csv", robot.name)
    shown = table_1(found)
    if json:
        errors = {
            model: dict(zip(("mean_nm", "std_nm"), found.stress.moments(torque), strict=True))
            for model, torque in found.stress.torque.items()
        }
        identified, corrected = ([asdict(score) for score in one.scores] for one in found.weighed.values())
        scores = {"upsilon_P": identified, "upsilon_P_corrected": corrected}
        typer.echo(as_json("experiment", {"upsilon_F": errors, **scores}))
        return
    console().print(table(shown.head, shown.rows, shown.title, shown.note))
    written = "experiment.html, experiment.pdf, PNG pictures, identified.toml, corrected.toml"
    typer.echo(f"everything here is simulated; wrote {written} in {out}")
    say_headline(report.headline)
