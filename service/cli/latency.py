"""`deltatwin latency`: Measure the latency of the estimator on this machine."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.options import AsJson
from service.cli.output import QUANTILES, as_json, conclude, console, quantiles, table

if TYPE_CHECKING:
    import numpy as np

    from replay.round_trip import RoundTrip


def command(
    rate: Annotated[float, typer.Option(min=1.0, help="Samples per second (Hz).")] = 4000.0,
    count: Annotated[int, typer.Option(min=1000, help="Number of samples, each to estimator and echo.")] = 40_000,
    json: AsJson = False,
) -> None:
    """Measure one estimator step, the round trip from sample to feed-forward over Zenoh, and that of a bare echo.

    Runs the real estimator process on the demo log. The ratio to the echo is the cost of the estimator; the absolute
    times depend on this machine and its load.

    Example: deltatwin latency --rate 1000 --count 10000
    """
    from drivers.trace import read_trace
    from replay.demo import LOG, ROBOT
    from replay.round_trip import take_turns
    from schemas.robot import load_robot
    from service.cli.progress import counting

    robot = load_robot(ROBOT)
    samples = read_trace(LOG, robot).samples()
    step = _steps(robot, samples)
    with counting("round trips", 2 * count) as show:
        trips = take_turns({"echo": _echo, "estimator": _estimator}, samples, rate, count, show)
    found, rows = _round_trips(trips)
    if not json:
        own = ["estimator step, from input bytes to output bytes", *_figures(quantiles(step)), str(len(step)), ""]
        headings = ("", *QUANTILES, "count", "lost")
        console().print(table(headings, [own, *rows], f"latency at {rate:g} Hz, µs"))
        lost = sum(part.lost for part in trips["estimator"])
        conclude(*_conclusion(1e6 / rate, found["estimator"], lost, count))
        return
    document = {
        "rate_hz": rate,
        "step_us": quantiles(step),
        "round_trip_us": found,
        "lost": {what: sum(part.lost for part in parts) for what, parts in trips.items()},
    }
    typer.echo(as_json("latency", document))


def _conclusion(period: float, trip: dict[str, float], lost: int, sent: int) -> tuple[str, str]:
    """Whether answers come within a cycle, and the command that comes next. period: of the samples, µs. trip: quantiles
    of the estimator's round trip, µs."""
    in_time = not lost and trip["p99.9"] < period
    said = (
        f"{'An answer is' if in_time else 'Not every answer is'} here before the next sample, {period:g} µs later: "
        f"half of them take {trip['median']:.0f} µs or less, one in a thousand {trip['p99.9']:.0f} µs or more"
    )
    return f"{said}; {lost} of {sent} were lost.", "demo" if in_time else "doctor"


def _echo(robot: str) -> None:
    """Answer as the estimator of `robot` with the least that can answer, until SIGTERM."""
    from replay.round_trip import echo
    from service.stopping import end_at_once

    end_at_once(0)
    echo(robot)


def _estimator(robot: str) -> None:
    """`deltatwin estimate` with the demo robot under the name `robot`, until SIGTERM. It says nothing: in the terminal
    there is a bar."""
    import io
    import os
    from contextlib import redirect_stderr, redirect_stdout

    from replay.demo import ROBOT
    from schemas.robot import load_robot, save_robot
    from service.cli.estimate import command as estimate
    from service.stopping import end_at_once

    end_at_once(0)
    description = Path(os.environ["XDG_RUNTIME_DIR"]) / "robot.toml"  # which goes with the run
    save_robot(load_robot(ROBOT).model_copy(update={"name": robot}), description)
    with redirect_stderr(io.StringIO()), redirect_stdout(io.StringIO()):
        estimate(robot=description)


def _steps(robot, samples: np.ndarray) -> np.ndarray:
    """ns of each step, bytes in to bytes out."""
    import time

    import numpy as np

    from schemas.messages import SAMPLE
    from service.estimator.estimator import Estimator, rate_of

    size, data = SAMPLE.dtype.itemsize, samples.tobytes()
    messages = [data[n * size : (n + 1) * size] for n in range(len(samples))]
    estimator = Estimator(robot, *rate_of(samples))
    estimator.warm_up()
    taken = np.zeros(len(samples), np.int64)
    for n, message in enumerate(messages):
        begin = time.perf_counter_ns()
        estimator.step(message)
        estimator.feedforward.tobytes()
        if estimator.look_back() >= 0:
            estimator.payload.tobytes()
            estimator.error.tobytes()
        taken[n] = time.perf_counter_ns() - begin
    return taken


def _round_trips(trips: dict[str, list[RoundTrip]]) -> tuple[dict[str, dict[str, float]], list[list[str]]]:
    """Quantiles of each that answered, µs; a row of a table for each, and one for the estimator's over the echo's."""
    import numpy as np

    found, rows = {}, []
    for what, parts in trips.items():
        latency = np.concatenate([part.latency for part in parts])
        found[what] = quantiles(latency)
        counts = str(len(latency)), str(sum(part.lost for part in parts))
        rows.append([f"round trip, {what}", *_figures(found[what]), *counts])
    ratio = (f"{found['estimator'][key] / found['echo'][key]:.2f}" for key in QUANTILES)
    return found, [*rows, ["estimator / echo", *ratio, "", ""]]


def _figures(found: dict[str, float]) -> list[str]:
    return [f"{value:.1f}" for value in found.values()]
