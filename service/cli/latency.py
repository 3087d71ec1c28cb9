"""`deltatwin latency`: how fast this machine answers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.reading import AsJson

if TYPE_CHECKING:
    import numpy as np
    from rich.table import Table

    from replay.latency import RoundTrip

QUANTILES = {"median": 0.5, "p99": 0.99, "p99.9": 0.999, "max": 1.0}


def command(
    rate: Annotated[float, typer.Option(min=1.0, help="Samples a second (Hz).")] = 4000.0,
    count: Annotated[int, typer.Option(min=1000, help="Samples to each of estimator and echo.")] = 40_000,
    json: AsJson = False,
) -> None:
    """Measure one estimator step and the round trip sample to feed-forward over Zenoh, beside the best echo that
    Zenoh's Python gives.

    Runs the real estimator process on the demo log. Ratios to the echo say what the estimator costs; the absolute times
    say what this machine and its load allow.

    Example: deltatwin latency --rate 1000 --count 10000
    """
    from drivers.trace import read_trace
    from replay.demo import LOG, ROBOT
    from replay.latency import take_turns
    from schemas.robot import load_robot
    from service.cli.output import as_json
    from service.cli.output import console as result_console
    from service.cli.progress import counting
    from service.cli.signals import terminate_as_interrupt

    terminate_as_interrupt()
    robot = load_robot(ROBOT)
    samples = read_trace(LOG, robot).samples()
    step = _steps(robot, samples)
    with counting("round trips", 2 * count) as show:
        trips = take_turns({"echo": echo, "estimator": estimator}, samples, rate, count, show)
    table = latency_table(rate)
    steps = add_row(table, "estimator step, bytes in to bytes out", step, "")
    found = add_trips(table, trips)
    if not json:
        add_ratio(table, found, "estimator", "echo")
        result_console().print(table)
        return
    document = {
        "rate_hz": rate,
        "step_us": dict(zip(QUANTILES, steps.tolist(), strict=True)),
        "round_trip_us": {what: dict(zip(QUANTILES, each.tolist(), strict=True)) for what, each in found.items()},
        "lost": {what: sum(part.lost for part in parts) for what, parts in trips.items()},
    }
    typer.echo(as_json("latency", document))


def echo(robot: str) -> None:
    """Answer as the estimator of `robot` with the least that can answer, until SIGTERM."""
    from contextlib import suppress

    from replay.latency import echo
    from service.cli.signals import terminate_as_interrupt

    terminate_as_interrupt()
    with suppress(KeyboardInterrupt):
        echo(robot)


def estimator(robot: str) -> None:
    """`deltatwin estimate` with the demo robot under the name `robot`, until SIGTERM."""
    import tempfile

    from replay.demo import ROBOT
    from schemas.robot import load_robot, save_robot
    from service.cli.estimate import command as estimate

    with tempfile.TemporaryDirectory() as folder:
        description = Path(folder) / "robot.toml"
        save_robot(load_robot(ROBOT).model_copy(update={"name": robot}), description)
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


def latency_table(rate: float) -> Table:
    """A table that `add_row` fills."""
    from rich.table import Table

    table = Table(title=f"latency at {rate:g} Hz, µs")
    for heading in ("what", *QUANTILES, "count", "lost"):
        table.add_column(heading, justify="left" if heading == "what" else "right")
    return table


def add_row(table: Table, name: str, nanoseconds: np.ndarray, lost: str) -> np.ndarray:
    """One row of (N,) ns; its (4,) quantiles in µs."""
    import numpy as np

    values = np.quantile(nanoseconds, list(QUANTILES.values())) * 1e-3
    table.add_row(name, *(f"{value:.1f}" for value in values), str(len(nanoseconds)), lost)
    return values


def add_trips(table: Table, trips: dict[str, list[RoundTrip]]) -> dict[str, np.ndarray]:
    """A row for each that answered; their quantiles."""
    import numpy as np

    return {
        what: add_row(
            table, f"round trip, {what}", np.concatenate([t.latency for t in parts]), str(sum(t.lost for t in parts))
        )
        for what, parts in trips.items()
    }


def add_ratio(table: Table, found: dict[str, np.ndarray], what: str, over: str) -> None:
    """The quantiles of one over those of another."""
    ratio = found[what] / found[over]
    table.add_row(f"{what} / {over}", *(f"{value:.2f}" for value in ratio), "", "", style="bold")
