"""`deltatwin blindtest`: the diagnosis on simulated cases whose answers are sealed."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Backend(StrEnum):
    """Where joblib runs the cases."""

    LOKY = "loky"
    DASK = "dask"


def command(
    out: Annotated[Path, typer.Option(help="New folder for cases, key, answers and blindtest.html")],
    cases: Annotated[int, typer.Option(min=10, help="Number of cases")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Of robots, motions, effects and severities")] = 1,
    jobs: Annotated[int, typer.Option(min=1, help="Processes on this host")] = 2,
    backend: Annotated[Backend, typer.Option(help="joblib backend for the diagnosis")] = Backend.LOKY,
    scheduler: Annotated[str | None, typer.Option(help="Dask scheduler of a cluster, tcp://host:port")] = None,
) -> None:
    """Simulate robots with hidden faults, diagnose them from their logs alone, then open the key and count.

    Example: deltatwin blindtest --cases 100 --seed 1 --out blind
    """
    import json

    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
    from rich.table import Table

    from schemas.errors import StorageError
    from service.diagnosis import blindtest
    from service.diagnosis.blindpage import BOUNDS, write_page

    if (out / "commitment.txt").exists():
        raise StorageError(f"{out}: holds a blind test already")
    out.mkdir(parents=True, exist_ok=True)
    console = Console()
    bars = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*bars, console=console) as progress:
        task = progress.add_task("simulating", total=cases)
        for _ in blindtest.made(out, cases, seed, jobs):
            progress.advance(task)
        digest = blindtest.seal(out)
        progress.console.print(f"key sealed, sha256 {digest}", highlight=False)
        folders = sorted((out / "cases").glob("case_*"))
        task = progress.add_task("diagnosing", total=len(folders))
        with blindtest.backend(backend.value, jobs, scheduler):
            rows = blindtest.answers(folders, lambda: progress.advance(task))
    (out / "answers.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")
    judged = blindtest.judged(rows, blindtest.unseal(out))
    figures = blindtest.summary(judged)
    (out / "results.json").write_text(json.dumps({"summary": figures, "rows": judged}, indent=1), encoding="utf-8")
    write_page(judged, figures, digest, out / "blindtest.html")
    table = Table("figure", "measured", "bound", title=f"{figures['cases']} cases, {figures['failed']} failed")
    for key, (label, bound) in BOUNDS.items():
        table.add_row(label, str(figures[key]), bound)
    console.print(table)
    console.print(f"wrote {out / 'blindtest.html'}", highlight=False)
