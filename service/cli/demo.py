"""`deltatwin demo`: Run estimator and monitor on a bundled log, in real time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.options import AsJson
from service.cli.output import Table, apart_from, as_json, console, quantiles, say_headline, table

if TYPE_CHECKING:
    import numpy as np

    from service.monitor.readback import Recorded
    from service.pages import Headline


def command(
    out: Annotated[Path, typer.Option(help="Folder for the recording, the picture and the logs.")] = Path(
        "deltatwin-demo"
    ),
    json: AsJson = False,
) -> None:
    """Replay a bundled Delta log in real time through player, estimator and monitor, each a process of its own.

    Shows a live table for 10 s, then errors of each model, payload against truth, latency and loss. Writes demo.mcap
    (for Foxglove and PlotJuggler) and demo.html to the folder. A robot has one observer: end its `view` first.

    Example: deltatwin demo --out /tmp/demo
    """
    import sys
    import time

    print("loading; a first run compiles, about half a minute", file=sys.stderr, flush=True)
    from rich.live import Live

    from drivers.bus import open_bus
    from replay.demo import LOG, ROBOT
    from schemas.files import make_folder
    from schemas.messages import Role
    from schemas.robot import load_robot
    from service.supervisor import Supervisor

    screen = console(stderr=True)
    robot = load_robot(ROBOT)
    recording, page = out / "demo.mcap", out / "demo.html"
    make_folder(out)
    recording.unlink(missing_ok=True)  # of an earlier run
    with open_bus(robot.name, Role.OBSERVER) as bus, Supervisor(out) as crew:
        with screen.status("starting monitor and estimator (a first run compiles, about half a minute)"):
            roles = [
                crew.start(lambda: Role.MONITOR in bus.alive, "monitor", "--robot", ROBOT, "--out", recording),
                crew.start(lambda: Role.ESTIMATOR in bus.alive, "estimate", "--robot", ROBOT),
            ]
            # While they start.
            from service.cli.live import Joints
            from service.monitor.readback import read_recording
            from service.monitor.recording_picture import picture
            from service.pages import write_page

            for role in roles:
                role.wait_ready()
        live = Joints(bus, robot)
        player = crew.start("", "replay", LOG, "--robot", ROBOT, "--wait", 20)
        with Live(console=screen, refresh_per_second=8, transient=True) as display:
            while player.running:
                crew.check()
                time.sleep(0.1)
                display.update(live.picture("replaying"))
        time.sleep(0.5)  # the last answers
    crew.check()
    recorded = read_recording(recording)
    results = {"errors": _errors(recorded), "payload": _payloads(recorded), "bus": _delivery(recorded)}
    said = _headline(results)
    write_page("recording", page, said, title=f"{LOG.name} replayed", figure=picture(recorded))
    if json:
        typer.echo(as_json("demo", results | {"recording": str(recording), "picture": str(page)}))
        return
    for shown in _tables(results):
        console().print(shown)
    typer.echo(f"{player.last_words()}\nrecording: {recording}\npicture:   {page}")
    say_headline(said)


def _errors(recorded: dict[str, Recorded]) -> dict[str, dict[str, np.ndarray]]:
    from service.monitor.recording_picture import errors_by_model

    errors = errors_by_model(recorded["error"].records)
    return {model: {"mean_nm": mean, "std_nm": std} for model, (mean, std) in errors.items()}


def _payloads(recorded: dict[str, Recorded]) -> list[dict[str, Any]]:
    from replay.demo import PAYLOADS
    from schemas.messages import PayloadEvent, stamp_ns
    from service.estimator.kalman import SMOOTHING_LAG
    from service.identification.weighed_picks import Weighed, delay, read_truth

    records = recorded["payload"].records
    known = stamp_ns(records) * 1e-9 + SMOOTHING_LAG
    found = Weighed(
        known, *(records[name] for name in ("mass", "std_dev", "random_std_dev", "common_std_dev", "trusted", "event"))
    )
    rows = []
    for pick in read_truth(PAYLOADS):
        held = found.mass[found.held(pick)]
        rows.append(
            {
                "picked_s": pick.begin,
                "truth_kg": pick.mass,
                "mass_kg": float(held[-1]) if len(held) else float("nan"),
                "pick_seen_ms": _ms(delay(found, PayloadEvent.PICK, pick.begin, pick.end)),
                "release_seen_ms": _ms(delay(found, PayloadEvent.RELEASE, pick.end, pick.end + 0.4)),
            }
        )
    return rows


def _headline(results: dict[str, Any]) -> Headline:
    """Whether all came through and every payload was found; how near the full model is."""
    import numpy as np

    from schemas.words import counted, percent, significant
    from service.pages import Headline

    picks, lost = results["payload"], results["bus"]["lost"]
    right = sum(abs(row["mass_kg"] - row["truth_kg"]) <= max(0.05 * row["truth_kg"], 0.05) for row in picks)
    book, full = (
        float(np.sqrt(np.mean(results["errors"][model]["mean_nm"] ** 2 + results["errors"][model]["std_nm"] ** 2)))
        for model in ("M_KH", "full")
    )
    return Headline(
        "good" if right == len(picks) and not lost else "bad",
        f"{right} of {counted(len(picks), 'payload')} found within the larger of 5 % and 50 g; "
        f"{counted(lost, 'sample') if lost else 'no sample'} lost.",
        percent(1 - full / book),
        f"smaller torque error, {significant(book)} → {significant(full)} N m rms (M_KH → full model with payload)",
        "describe your own robot, then read its logs with `deltatwin import`:",
        command=("init", "--out", apart_from("robot.toml", *Path().glob("robot*.toml"))),
    )


def _ms(seconds: float) -> int | None:
    return None if seconds != seconds else round(1000 * seconds)


def _delivery(recorded: dict[str, Recorded]) -> dict[str, Any]:
    import numpy as np

    samples, answers = recorded["sample"], recorded["feedforward"]
    _, mine, its = np.intersect1d(samples.records["sequence"], answers.records["sequence"], return_indices=True)
    sent = int(samples.records["sequence"][-1]) + 1
    came = len(samples.records)
    latency = quantiles(answers.arrival[its] - samples.arrival[mine])
    return {"samples": came, "lost": sent - came, "answered": len(mine), "sample_to_feedforward_us": latency}


def _tables(results: dict[str, Any]) -> list[Table]:
    from schemas.words import change

    errors = [
        (model, *(f"{m:+.2f}, {s:.2f}" for m, s in zip(error["mean_nm"], error["std_nm"], strict=True)))
        for model, error in results["errors"].items()
    ]
    payloads = []
    for row in results["payload"]:
        truth, mass = row["truth_kg"], row["mass_kg"]
        seen = ("-" if row[key] is None else str(row[key]) for key in ("pick_seen_ms", "release_seen_ms"))
        off = change(mass / truth, 1)
        payloads.append((f"{row['picked_s']:.2f}", f"{truth:.2f}", f"{mass:.3f}", off, *seen))
    *counts, latency = results["bus"].values()
    bus = (*map(str, counts), *(f"{value:.0f}" for value in latency.values()))
    weighed = ("picked at, s", "truth, kg", "estimate, kg", "error", "pick seen after, ms", "release seen after, ms")
    delivered = ("samples", "lost", "answered", "sample to feed-forward, µs: median", "p99", "p99.9", "max")
    return [
        table(("model", *(f"joint {n}: mean, std" for n in (1, 2, 3))), errors, "measured - predicted torque, N m"),
        table(weighed, payloads, "payload", figures=slice(None)),
        table(delivered, [bus], "bus", figures=slice(None)),
    ]
