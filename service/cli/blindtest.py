"""`deltatwin blindtest`: Diagnose simulated robots whose faults are sealed, then compare with the key."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from service.cli.options import AsJson, Backend, Jobs, OnBackend, Scheduler, refuse
from service.cli.output import as_json, console, say_headline, table


class Family(StrEnum):
    """Ways to draw a case."""

    KNOWN = "known"
    THREE = "three"
    OUTSIDE = "outside"
    DESCRIPTION = "description"
    PRODUCTION = "production"
    SCOPE = "scope"


def command(
    context: typer.Context,
    out: Annotated[
        Path, typer.Option(help="Folder for cases, key, answers and blindtest.html; an interrupted test continues")
    ],
    cases: Annotated[int, typer.Option(min=1, help="Number of cases")] = 100,
    family: Annotated[
        list[Family] | None,
        typer.Option(
            help="known: single effects, pairs, no gap, outside the catalogue; three: three at once; outside: two and "
            "one outside the catalogue; description: one wrong quantity; production: pick-and-place only; scope: "
            "sampled and stamped as scopes do. May be repeated; default: all, with equally many cases"
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of robots, motions, effects and severities")] = 1,
    jobs: Jobs = 2,
    backend: OnBackend = Backend.LOKY,
    scheduler: Scheduler = None,
    json: AsJson = False,
) -> None:
    """Simulate robots with hidden faults, diagnose them from their logs alone, then open the key and compare.

    Each answer is stored immediately: after Ctrl-C the same command continues where it stopped. Exit code 3 if a bound
    is missed.

    Example: deltatwin blindtest --cases 100 --family known --seed 1 --out blind

    Example: deltatwin blindtest --cases 1000 --out blind --backend dask --scheduler tcp://10.0.0.5:8786
    """
    import json as json_library

    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from schemas.errors import StorageError
    from schemas.files import make_folder, write_text
    from service.cli.main import MISSED
    from service.diagnosis import sealed_cases
    from service.diagnosis.sealed_page import BOUNDS, headline, missed, write_page
    from service.diagnosis.workers import backend as workers

    if backend is not Backend.DASK:
        refuse(context, "scheduler", only="--backend dask")
    if (out / "results.json").exists():
        raise StorageError(f"{out}: holds a finished blind test")
    make_folder(out)
    bars = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    # the backend first: one that cannot be had is told before hours of simulation
    with Progress(*bars, console=console(stderr=True)) as progress, workers(backend.value, jobs, scheduler):
        if not (out / "commitment.txt").exists():
            task = progress.add_task("simulating", total=cases)
            for _ in sealed_cases.made(out, cases, seed, jobs, [one.value for one in family or Family]):
                progress.advance(task)
            sealed_cases.seal(out)
        commitment = (out / "commitment.txt").read_text(encoding="utf-8").strip()
        progress.console.print(f"key sealed: {commitment}", highlight=False)
        task = progress.add_task("diagnosing", total=len(list((out / "cases").glob("case_*"))))
        rows = sealed_cases.answers(out, lambda: progress.advance(task))
    keys = sealed_cases.unseal(out)
    judged, refused = sealed_cases.judged(rows, keys), sealed_cases.refused(keys)
    figures = sealed_cases.summary(judged)
    write_page(judged, figures, refused, commitment, out / "blindtest.html")
    results = {"summary": figures, "refused": refused, "rows": judged}
    write_text(out / "results.json", json_library.dumps(results, indent=1))
    late = missed(figures)
    if json:
        typer.echo(as_json("blindtest", {"summary": figures, "refused": refused, "missed": late}))
    else:
        drawn = [
            (label, str(figures[key]), str(figures["counts"][key]), bound)
            for key, (label, bound) in BOUNDS.items()
            if figures[key] is not None
        ]
        title = f"{figures['cases']} cases, {figures['failed']} failed"
        console().print(table(("figure", "measured", "of", "bound"), drawn, title))
        for line in refused:
            typer.echo(line)
        typer.echo(f"wrote {out / 'blindtest.html'}")
        say_headline(headline(figures))
    if late:
        raise typer.Exit(MISSED)
