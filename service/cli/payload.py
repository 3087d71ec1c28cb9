"""`deltatwin payload`: Estimate payloads: each pick and release of a Delta, or the load of an arm."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from schemas.words import counted, percent
from service.cli.options import AsJson, ColumnsFrom, OwnEffects, robot_file
from service.cli.output import Table, as_json, conclude, console, read_by, table
from service.cli.reading import files_in, prediction_files, reading

if TYPE_CHECKING:
    from service.identification.weighed_picks import CommonError, MassLevel, PayloadHistory, Score


def command(
    traces: Annotated[list[Path], typer.Argument(help="Logs: .csv, .csv.gz or .mcap", metavar="LOG")],
    robot: Annotated[Path, robot_file(" that `identify` wrote")],
    effects: OwnEffects = None,
    columns: ColumnsFrom = None,
    json: AsJson = False,
    truth: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="True payloads: CSV with from_s,until_s,mass_kg, one per log"),
    ] = None,
    predictions: Annotated[
        Path | None, typer.Option(help="Folder for <log>.csv: mass, std_dev, trusted and event after every sample")
    ] = None,
    frame: Annotated[
        str | None,
        typer.Option(metavar="LINK", help="For an arm: link of the URDF that carries the load. Default: the last one."),
    ] = None,
) -> None:
    """Find picks and releases and estimate the payload, as the online estimator does.

    For an arm: estimate the one load that it carries throughout each trace: mass, centre of mass and, if the motion
    shows it, inertia.

    A mass has two errors, each given as one standard deviation. The random error differs from mass to mass. The common
    error is the same percentage of all masses of this robot. A known load (identify --carried) calibrates the torque
    constants and removes it.

    With --truth: how soon and how accurately each mass was found, compared with the paper's recursion with a fixed
    forgetting factor on the M_Id+F of this description. For the recursion on the paper's own model: `deltatwin
    experiment`.

    Example: deltatwin payload pick_a.csv --robot identified.toml --truth pick_a.payloads.csv

    Example: deltatwin payload gripper.csv --robot arm_identified.toml --frame tool0
    """
    from dataclasses import asdict

    from schemas.axes_description import load_description
    from schemas.errors import DataError
    from schemas.questions import Question, as_delta
    from service.cli.load import weigh
    from service.identification.conclusion import of_payload
    from service.identification.weighed_picks import common_error, levels, payload_history, read_truth, score

    if truth and len(truth) != len(traces):
        raise DataError(f"--truth: {len(truth)} files for {len(traces)} logs; give one for each, in the same order")
    described = load_description(robot, effects)
    if described.answering(Question.PICKS) is None and not truth and predictions is None:
        weigh(traces, robot, described, columns, effects, frame, json)
        return
    description = as_delta(described, Question.PICKS)
    if frame is not None:
        raise DataError(f"--frame {frame}: a Delta robot has its load on the platform")
    names = [f"{path.name.split('.')[0]}.csv" for path in traces]
    read = [*described.sources, *files_in(columns), *(truth or [])]
    targets = prediction_files(predictions, names, traces, *read) if predictions else []
    screen = console()
    scores: list[Score] = []
    seen: dict[str, list[MassLevel]] = {}
    for number, trace in enumerate(reading(traces, description, columns, "estimating the payload")):
        found = payload_history(description, trace)
        if targets:
            _write(found, targets[number])
        seen[str(trace.path)] = levels(found)
        if truth:
            scores += [score(found, pick) for pick in read_truth(truth[number])]
    common = common_error(description)
    conclusion = of_payload([level for found in seen.values() for level in found])
    if json:
        weighed = [
            {"trace": path, "levels": [asdict(level) | {"event": level.event.name.lower()} for level in found]}
            for path, found in seen.items()
            if not truth
        ]
        scored = [asdict(score) for score in scores]
        document = {"traces": weighed, "picks": scored, "common_error": asdict(common), "conclusion": conclusion}
        typer.echo(as_json("payload", document))
        return
    if scores:
        screen.print(*_scored(scores))
    elif not truth:
        screen.print(*(_found(Path(path).name, found) for path, found in seen.items() if found))
    screen.print(_said(common), highlight=False, markup=False)
    conclude(conclusion, "estimate", "--robot", robot, *read_by(effects=effects))


def _write(found: PayloadHistory, path: Path) -> None:
    import numpy as np

    from schemas.files import make_folder, whole

    columns = np.column_stack(
        [found.time, found.mass, found.std_dev, found.trusted, found.event, found.random_std_dev, found.common_std_dev]
    )
    make_folder(path.parent)
    with whole(path) as partial:
        header = "time_s,mass_kg,std_dev_kg,trusted,event,random_std_dev_kg,common_std_dev_kg"
        formats = ("%.6f", "%.5f", "%.5f", "%d", "%d", "%.5f", "%.5f")
        np.savetxt(partial, columns, formats, ",", header=header, comments="")


def _said(common: CommonError) -> str:
    said = f"common error: at least {percent(common.share, 1)} of every mass, one standard deviation"
    if common.calibrated:
        return f"{said}, after a known load"
    return (
        f"{said}: no known load has calibrated the torque constants of this robot. To remove it: "
        "deltatwin identify ... --carried 3.0:loaded.csv"
    )


def _found(name: str, seen: list[MassLevel]) -> Table:
    head = ("seen at, s", "until, s", "event", "mass, kg", "random, kg", "common, kg", "trusted")
    rows = [
        (f"{one.begin:.3f}", f"{one.end:.3f}", one.event.name.lower() if one.event else "change not seen",
         f"{one.mass:.3f}", f"± {one.random_std_dev:.3f}", f"± {one.common_std_dev:.3f}", percent(one.trusted))
        for one in seen
    ]  # fmt: skip
    return table(head, rows, f"{name}: payload", figures=slice(None))


def _scored(scores: list[Score]) -> list[Table]:
    import numpy as np

    def ms(seconds: float) -> str:
        return "never" if np.isnan(seconds) else f"{seconds * 1e3:.0f}"

    each = [
        (f"{s.truth.begin:.3f}", f"{s.truth.mass:.2f}", f"{s.mass:.3f}", ms(s.settled), ms(s.seen), ms(s.released),
         f"{s.mass_recursion:.3f}", ms(s.settled_recursion))
        for s in scores
    ]  # fmt: skip
    found = np.array([(s.settled, s.settled_recursion) for s in scores]) <= 0.15
    summary = [
        (
            "found within 150 ms (within 5 % or 50 g until the release)",
            *(percent(share) for share in found.mean(axis=0)),
        )
    ]
    heavy = [s for s in scores if s.truth.mass >= 1.0]
    if heavy:
        off = np.array([np.abs(np.array([s.mass, s.mass_recursion]) / s.truth.mass - 1) for s in heavy])
        summary += [
            ("error at the release, median, >= 1 kg", *(percent(middle, 2) for middle in np.median(off, axis=0))),
            ("within 4 % at the release, >= 1 kg", *(percent(share) for share in (off <= 0.04).mean(axis=0))),
        ]
    head = (
        "picked at, s", "truth, kg", "mass, kg", "found, ms", "pick seen, ms", "release seen, ms", "paper: mass, kg",
        "paper: found, ms",
    )  # fmt: skip
    return [
        table(head, each, "payload: delays after the true pick or release", figures=slice(None)),
        table(("", "estimator", "paper's recursion"), summary, counted(len(scores), "pick")),
    ]
