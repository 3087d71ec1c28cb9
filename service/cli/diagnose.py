"""`deltatwin diagnose`: Find the unmodelled effects that explain the residual torque, and correct the description."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.heap import share_heap
from service.cli.options import AsJson, ColumnsFrom, OwnEffects, robot_file
from service.cli.output import console, read_by, say_headline
from service.cli.reading import files_in, reading


def command(
    traces: Annotated[list[Path], typer.Argument(help="Logs to diagnose: .csv, .csv.gz or .mcap", metavar="LOG")],
    robot: Annotated[Path, robot_file()],
    out: Annotated[Path, typer.Option(help="Folder for diagnosis.json, corrected.toml and report.html")],
    columns: ColumnsFrom = None,
    baseline: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE|NAME",
            help="Identified description that gives the gap before the correction; default: identify from these logs",
        ),
    ] = None,
    effects: OwnEffects = None,
    json: AsJson = False,
    test: Annotated[
        list[Path] | None,
        typer.Option(metavar="LOG", help="Log to test the correction on, used for nothing else; may be repeated"),
    ] = None,
    loaded: Annotated[
        list[Path] | None,
        typer.Option(metavar="LOG", help="Log with known loads, to test the estimator on; default: simulated loads"),
    ] = None,
    loads: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE", help="Known loads of a --loaded log: CSV with from_s,until_s,mass_kg; one per log"
        ),
    ] = None,
    pdf: Annotated[
        bool, typer.Option("--pdf", help="Also print the report to report.pdf, with Chromium or Chrome")
    ] = False,
) -> None:
    """Show where torque and model differ, which effect explains it, and how far the gap shrinks on held-out logs.

    --robot may also describe axes (kind = "axes") or an arm with a URDF (kind = "chain"). Effects that --robot or
    --baseline already contain are not searched. --test reports events (stretches far above the rest of the residual)
    separately. For a Delta the result also compares the estimator with and without the correction: mass, false events
    and feed-forward.

    Example: deltatwin diagnose fit_*.csv --robot robot.toml --out diagnosis --test other_day.csv

    Example: deltatwin diagnose fit_*.csv --robot corrected.toml --out again --effects rubber_stop.py
    """
    share_heap()
    from schemas.axes_description import load_description, save_description
    from schemas.errors import DataError
    from schemas.files import check_apart, make_folder, write_text
    from service.diagnosis.documents.document import corrected, document, frequency_response, made_from
    from service.diagnosis.documents.headline import Given, headline
    from service.diagnosis.documents.online_text import noted
    from service.diagnosis.documents.report import write_report
    from service.diagnosis.documents.text import paragraphs
    from service.diagnosis.documents.worth import online_trial
    from service.diagnosis.pipeline import diagnose
    from service.identification.copies import refuse_copies
    from service.identification.weighed_picks import read_truth
    from service.model.effects import catalogue
    from service.pages import browser, print_page

    if pdf:
        browser()  # that there is one, before anything that takes long
    if len(loaded or []) != len(loads or []):
        raise DataError(f"--loads: {len(loads or [])} files for {len(loaded or [])} logs (--loaded); give one per log")
    make_folder(out)
    known = catalogue(effects)
    description = load_description(robot, effects)
    check_apart(out / "corrected.toml", *description.sources, *([baseline] if baseline else []), *files_in(columns))
    reference = load_description(baseline, effects) if baseline else None
    recorded = list(reading(traces, description, columns, "reading"))
    tests = list(reading(test or [], description, columns, "reading"))
    refuse_copies([*recorded, *tests])
    carriers = list(reading(loaded or [], description, columns, "reading"))
    picks = [read_truth(path) for path in loads or []]
    with console(stderr=True).status("starting") as status:
        findings = diagnose(description, recorded, known, status.update, reference, tests)
        status.update("testing the corrected description in the estimator")
        tried = online_trial(findings, recorded, tests, list(zip(carriers, picks, strict=True)))
        status.update("writing the report")
        named = filter(None, (baseline, effects, columns and Path(columns)))
        sources = [*traces, robot, *named, *(test or []), *(loaded or []), *(loads or [])]
        result = document(findings, tests, made_from(sources), tried, frequency_response(findings))
        write_text(out / "diagnosis.json", result.model_dump_json(indent=1, by_alias=True))
        target = out / "corrected.toml"
        save_description(corrected(findings), target, template=robot)
        if tried is not None:
            write_text(target, noted(target.read_text(encoding="utf-8"), tried))
        said = headline(result, Given(target, traces, test or [], read_by(columns, effects)))
        write_report(findings, result, out / "report.html", said)
        if pdf:
            status.update("printing the report")
            print_page(out / "report.html", out / "report.pdf")
    if json:
        typer.echo(result.model_dump_json(indent=1, by_alias=True))
        return
    for group in paragraphs(result):
        print("\n".join(group), end="\n\n")
    written = "diagnosis.json, corrected.toml, report.html" + (", report.pdf" if pdf else "")
    typer.echo(f"wrote {written} in {out}")
    say_headline(said)
