"""Logs of the simulated robot to identify on."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from drivers.motion import Planner, Trajectory
from drivers.simulated.plant.plant import Plant
from drivers.simulated.plant.plant_trace import simulate
from schemas.trace import Trace


def identification_motions(
    planner: Planner, rng: np.random.Generator, count: int, duration: float
) -> Iterator[Trajectory]:
    """`count` motions of `duration` s in turn: multisine, pick-and-place, multisine, slow sweep, ..."""
    kinds = (
        lambda: planner.multisine(rng, duration),
        lambda: planner.pick_and_place(rng, duration),
        lambda: planner.multisine(rng, duration, 0.7),
        lambda: planner.slow(rng, duration),
    )
    for number in range(count):
        yield kinds[number % len(kinds)]()


def excitations(planner: Planner, rng: np.random.Generator, count: int, duration: float) -> Iterator[Trajectory]:
    """`count` motions of `duration` s that excite inertia, weight and friction alike, as an identification wants."""
    for number in range(count):
        share = rng.uniform(0.7, 1.0)
        yield (
            planner.multisine(rng, duration, share)
            if number % 2 == 0
            else planner.pick_and_place(rng, duration, speed=0.6 * share)
        )


def record(
    plant: Plant, motions: Iterator[Trajectory], name: str, progress: Callable[[float], object] = lambda seconds: None
) -> list[Trace]:
    """Traces `name`_1, `name`_2, ... of `plant` taken through `motions`. progress: told how many seconds are done."""
    traces, done = [], 0.0
    for number, motion in enumerate(motions, start=1):

        def tell(cycle: int, before: float = done) -> None:
            if cycle % 200 == 0:
                progress(before + cycle * plant.period)

        traces.append(simulate(plant, motion, f"{name}_{number}", progress=tell))
        done += motion.duration
    return traces
