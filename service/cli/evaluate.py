"""`deltatwin evaluate`: Compare measured and predicted torque on logs, for each model."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from schemas.words import counted
from service.cli.options import AsJson, ColumnsFrom, OwnEffects, robot_file
from service.cli.output import Table, apart_from, as_json, conclude, console, read_by, table
from service.cli.reading import files_in, prediction_files, reading

if TYPE_CHECKING:
    from schemas.axes_description import Description
    from schemas.trace import Trace
    from service.identification.evaluation import Evaluation, Moments


MOST_EVENTS = 4  # listed


def command(
    traces: Annotated[list[Path], typer.Argument(help="Logs: .csv, .csv.gz or .mcap", metavar="LOG")],
    robot: Annotated[Path, robot_file(", plain, identified or corrected; also of axes")],
    effects: OwnEffects = None,
    columns: ColumnsFrom = None,
    json: AsJson = False,
    predictions: Annotated[
        Path | None, typer.Option(help="Folder for the torque of the last model: one CSV per log, with all rows")
    ] = None,
) -> None:
    """Show mean and standard deviation of measured minus predicted torque for each model.

    Offline: the motion is smoothed in both directions; joints at rest are left out. Events (stretches far above the
    rest of the residual) are listed, and the last model is also shown without them.

    Example: deltatwin evaluate test_*.csv --robot identified.toml --predictions predicted/
    """
    from schemas.axes_description import load_description
    from schemas.questions import Question
    from service.identification.conclusion import of_evaluation
    from service.identification.copies import distinct
    from service.identification.evaluation import evaluate
    from service.identification.held import told_of_held
    from service.model.description import in_units_of

    description = load_description(robot, effects)
    unit = in_units_of(description, "N m")
    read = (*description.sources, *files_in(columns))
    targets = prediction_files(predictions, [_csv_name(path) for path in traces], traces, *read) if predictions else []
    results: list[Evaluation] = []
    for number, trace in enumerate(reading(traces, description, columns, "evaluating")):
        result = evaluate(description, trace)
        if targets:
            _write(result, targets[number], unit)
        result.torque.clear()
        results.append(result)
    for result in results:
        if result.unmeasured:
            print(f"{result.trace.path}: {result.unmeasured} of {len(result.trace)} rows left out", file=sys.stderr)
    for line in told_of_held({str(result.trace.path): result.held for result in results}):
        print(f"warning: {line}", file=sys.stderr)
    if json:
        print(_json(results, unit, of_evaluation(description, results)[0]))
        return
    console().print(_table(results, unit))
    for result in results:
        if result.events:
            print(_events(result, unit))
    said, explained = of_evaluation(description, results)
    traces = [trace.path for trace in distinct([result.trace for result in results])]
    described, read = ("--robot", robot, *read_by(effects=effects)), read_by(columns)
    if description.identified is None:
        _conclude_unidentified(said, description, robot, [result.trace for result in results], read)
    elif explained and description.answering(Question.LEARNING) is None:
        conclude(said, "rollout", *traces, *described, *read)
    elif explained:
        conclude(said, "estimate", *described)
    else:
        conclude(said, "diagnose", *traces, *described, *read, "--out", "diagnosis")


def _conclude_unidentified(
    said: str, description: Description, robot: Path, logs: list[Trace], read: tuple[object, ...]
) -> None:
    """End with `identify`, or if that would refuse the logs with a motion that it would take."""
    from service.identification.of_logs import refusal

    if refused := refusal(description, logs):
        options = ("--robot", robot, "--for", "identify", "--assume-limits", "--out", "motion.csv")
        conclude(f"{said} Not enough to identify it: {refused}.", "plan-motion", *options)
    else:
        out = apart_from("identified.toml", robot)
        conclude(said, "identify", *(log.path for log in logs), "--robot", robot, *read, "--out", out)


def _csv_name(path: Path) -> str:
    """`path`'s name; a log of another format gets .csv for its ending."""
    name = path.name
    for ending in (".gz", ".mcap", ".txt", ".tsv"):
        name = name.removesuffix(ending)
    return name if name.endswith(".csv") else f"{name}.csv"


def _write(result: Evaluation, path: Path, unit: str) -> None:
    from drivers.data_frames import pl
    from schemas.files import make_folder, whole

    fullest = list(result.torque.values())[-1]
    ending = unit.replace(" ", "").lower()
    columns = {"time_s": result.trace.time}
    columns |= {f"torque_model_{j + 1}_{ending}": values for j, values in enumerate(fullest.T)}
    make_folder(path.parent)
    with whole(path) as partial:
        pl.DataFrame(columns).write_csv(partial)


def _json(results: list[Evaluation], unit: str, conclusion: str) -> str:
    from dataclasses import asdict

    from service.identification.evaluation import pooled_by_model
    from service.identification.frequency import MEASURED, responses

    def figures(errors: dict[str, Moments]) -> dict[str, dict[str, Any]]:
        return {
            name: {"mean_nm": moments.mean, "std_nm": moments.std, "rms_nm": moments.rms}
            for name, moments in errors.items()
        }

    spectra = {name: [result.spectra[name] for result in results] for name in results[0].spectra}
    measured = spectra.pop(MEASURED)
    response = responses(measured, spectra, "m/(N s)" if unit == "N" else "rad/(N m s)")
    document = {
        "frequency_response": [one.model_dump() for one in response],
        "analysis_hz": round(min(result.band_hz for result in results), 3),
        "unit": unit,
        "conclusion": conclusion,
        "models": figures(pooled_by_model(results)),
        "outside_events": figures(pooled_by_model(results, "calm")),
        "traces": [
            {
                "trace": str(result.trace.path),
                "rows": len(result.trace),
                "unmeasured_rows": result.unmeasured,
                "torque_held_s": round(result.held, 6),
                "models": figures(result.errors),
                "outside_events": figures(result.calm),
                "events": [asdict(event) | {"joint": event.joint + 1} for event in result.events],
            }
            for result in results
        ],
    }
    return as_json("evaluation", document)


def _table(results: list[Evaluation], unit: str) -> Table:
    from service.identification.evaluation import pooled_by_model

    shown = pooled_by_model(results)
    if any(result.events for result in results):
        name, moments = list(pooled_by_model(results, "calm").items())[-1]
        shown[f"{name}, outside events"] = moments
    rows = [
        (name, *(f"{m:.3g}, {s:.3g}" for m, s in zip(moments.mean, moments.std, strict=True)))
        for name, moments in shown.items()
    ]
    head = ("model", *(f"joint {joint + 1}: mean, std" for joint in range(len(rows[0]) - 1)))
    below = min(result.band_hz for result in results)
    title = f"torque minus model, {unit}, below {below:.3g} Hz while moving, {counted(len(results), 'log')}"
    return table(head, rows, title)


def _events(result: Evaluation, unit: str) -> str:
    from service.identification.events import rhythm

    share = 1.0 - result.calm_share
    beat = rhythm(result.events)
    keeping = f", most of them every {beat:.3g} s" if beat is not None else ""
    strongest = sorted(result.events, key=lambda event: -event.level)[:MOST_EVENTS]
    told = "; ".join(f"joint {e.joint + 1} {e.start:.2f} to {e.end:.2f} s ({e.level:.3g} {unit})" for e in strongest)
    return (
        f"{result.trace.path}: {counted(len(result.events), 'event')} far above the rest of the residual ("
        f"{100 * share:.0f} % of the motion){keeping}; strongest: {told}"
    )
