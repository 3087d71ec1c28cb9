"""`deltatwin latency`: how fast this machine answers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    import numpy as np
    from rich.table import Table

WARM_UP = 200
BLOCKS = 4  # echo and estimator take turns, so that both see the same machine


def command(
    rate: Annotated[float, typer.Option(min=1.0, help="Samples a second (Hz).")] = 4000.0,
    count: Annotated[int, typer.Option(min=1000, help="Samples to each of estimator and echo.")] = 40_000,
) -> None:
    """Measure one estimator step and the round trip sample to feed-forward over Zenoh, beside a bare Zenoh echo.

    Runs the real estimator process on the demo log. Ratios to the echo say what the estimator costs; the absolute times
    say what this machine and its load allow.

    Example: deltatwin latency --rate 1000 --count 10000
    """
    import multiprocessing
    import os
    import tempfile
    import time

    from rich.console import Console

    from drivers.bus import open_bus
    from drivers.trace import read_trace
    from replay.demo import LOG, ROBOT
    from replay.latency import Prober
    from replay.realtime import go_realtime
    from schemas.messages import Role
    from schemas.robot import load_robot, save_robot
    from service.cli.progress import counting
    from service.cli.signals import terminate_as_interrupt

    terminate_as_interrupt()
    robot = load_robot(ROBOT)
    samples = read_trace(LOG, robot).samples()
    step = _steps(robot, samples)
    spawn = multiprocessing.get_context("spawn")
    trips: dict[str, list] = {"echo": [], "estimator": []}
    with tempfile.TemporaryDirectory(prefix="dt-") as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder  # beside, not among, the roles of a running robot
        names = {name: f"latency-{name}" for name in trips}
        description = Path(folder) / "robot.toml"
        save_robot(robot.model_copy(update={"name": names["estimator"]}), description)
        processes = [
            spawn.Process(target=_echo, args=(names["echo"],)),
            spawn.Process(target=_estimate, args=(description,)),
        ]
        with counting("round trips", 2 * count) as show:
            for process in processes:
                process.start()
            go_realtime("latency")
            try:
                with open_bus(names["echo"], Role.PLAYER) as one, open_bus(names["estimator"], Role.PLAYER) as other:
                    probers = {"echo": Prober(one, samples, rate), "estimator": Prober(other, samples, rate)}
                    while not all(prober.heard for prober in probers.values()):
                        time.sleep(0.05)
                    for prober in probers.values():
                        prober.probe(WARM_UP, lambda _: None)  # the first samples design the filters
                    done = 0
                    for _ in range(BLOCKS):
                        for name, prober in probers.items():
                            trips[name].append(prober.probe(count // BLOCKS, lambda n, base=done: show(base)))
                            done += count // BLOCKS
                            show(done)
            finally:
                for process in processes:
                    process.terminate()
                    process.join(10)
    Console().print(_table(step, trips, rate))


def _echo(name: str) -> None:
    from drivers.bus import open_bus
    from replay.latency import echo
    from replay.realtime import go_realtime
    from schemas.messages import Role
    from service.cli.signals import terminate_as_interrupt

    terminate_as_interrupt()
    go_realtime("echo")
    with open_bus(name, Role.ESTIMATOR) as bus:
        try:
            echo(bus)
        except KeyboardInterrupt:
            return


def _estimate(description: Path) -> None:
    from service.cli.estimate import command as estimate

    estimate(robot=description)


def _steps(robot, samples: np.ndarray) -> np.ndarray:
    """ns of each step, bytes in to bytes out."""
    import time

    import numpy as np

    from schemas.messages import SAMPLE
    from service.estimator.estimator import Estimator, period_of

    size, data = SAMPLE.dtype.itemsize, samples.tobytes()
    messages = [data[n * size : (n + 1) * size] for n in range(len(samples))]
    estimator = Estimator(robot, period_of(samples))
    estimator.warm_up()
    taken = np.zeros(len(samples), np.int64)
    for n, message in enumerate(messages):
        begin = time.perf_counter_ns()
        result = estimator.run(np.frombuffer(message, SAMPLE.dtype))
        for records in (result.feedforward, result.payload, result.error):
            records.tobytes()
        taken[n] = time.perf_counter_ns() - begin
    return taken


def _table(step: np.ndarray, trips: dict[str, list], rate: float) -> Table:
    import numpy as np
    from rich.table import Table

    table = Table(title=f"latency at {rate:g} Hz, µs")
    for heading in ("what", "median", "p99", "p99.9", "max", "count", "lost"):
        table.add_column(heading, justify="left" if heading == "what" else "right")

    def row(name: str, nanoseconds: np.ndarray, lost: str) -> np.ndarray:
        values = np.quantile(nanoseconds, [0.5, 0.99, 0.999, 1.0]) * 1e-3
        table.add_row(name, *(f"{value:.1f}" for value in values), str(len(nanoseconds)), lost)
        return values

    row("estimator step, bytes in to bytes out", step, "")
    found = {
        name: row(f"round trip, {name}", np.concatenate([t.latency for t in parts]), str(sum(t.lost for t in parts)))
        for name, parts in trips.items()
    }
    ratio = found["estimator"] / found["echo"]
    table.add_row("estimator / echo", *(f"{value:.2f}" for value in ratio), "", "", style="bold")
    return table
