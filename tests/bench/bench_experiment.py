"""The paper's experiment on other motions and noise: how well its recursion weighs, and our estimator, on which model.

    python -m tests.bench.bench_experiment [--seeds 5] [--store]

Each seed is one run of `deltatwin experiment`: twelve trajectories to identify and diagnose, and a pick-and-place run
of which neither knows anything. Nothing of diagnosis or estimator was chosen on these seeds. What the command shows by
default is seed 0, so seeds begin at 1.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from docs.making.figures import store
from tests.bench.bench_diagnosis import command

IDENTIFIED, CORRECTED = "upsilon_P", "upsilon_P_corrected"


def scores(seed: int) -> dict[str, list[dict[str, Any]]]:
    """Picks of one experiment, scored, by the description that the estimator had."""
    with tempfile.TemporaryDirectory(prefix="dt-") as folder:
        said = json.loads(command("experiment", "--seed", str(seed), "--json", "--out", str(Path(folder) / "out")))
    return {model: said[model] for model in (IDENTIFIED, CORRECTED)}


def error(picks: Sequence[dict[str, Any]], of: str) -> np.ndarray:
    """Size of the error of the mass at the release, kg, a pick each."""
    return np.array([abs(pick[of] - pick["truth"]["mass"]) for pick in picks])


def figures(every: Sequence[dict[str, list[dict[str, Any]]]]) -> dict[str, tuple[float | int | str, int, str]]:
    """What was measured, by the keys of results/experiment.json."""
    picks = {model: [pick for one in every for pick in one[model]] for model in (IDENTIFIED, CORRECTED)}
    found: dict[str, tuple[float | int | str, int, str]] = {}
    for key, model, of in (
        ("recursion", IDENTIFIED, "mass_recursion"),
        ("identified", IDENTIFIED, "mass"),
        ("corrected", CORRECTED, "mass"),
    ):
        off = error(picks[model], of)
        found[key] = (round(float(np.median(off)), 3), len(off), f"largest {off.max():.3f} kg; {len(every)} runs")
    for key, model in (("settled_identified", IDENTIFIED), ("settled", CORRECTED)):
        taken = np.array([pick["settled"] is not None for pick in picks[model]])
        found[key] = (round(float(taken.mean()), 3), len(taken), f"{int(taken.sum())} of {len(taken)} picks")
    return found


def main() -> None:
    """Run the experiments, print the figures, and store them."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--seeds", type=int, default=5, help="number of experiments, from seed 1 on")
    arguments.add_argument("--store", action="store_true", help="put the figures into results/experiment.json")
    given = arguments.parse_args()
    every = []
    for seed in range(1, given.seeds + 1):
        every.append(scores(seed))
        for model, picks in every[-1].items():
            print(f"seed {seed}, {model}: " + ", ".join(f"{pick['mass']:.3f}" for pick in picks), flush=True)
    measured = figures(every)
    for key, (value, count, interval) in measured.items():
        print(f"{key}: {value} of {count} ({interval})")
    if given.store:
        print(f"stored in {store('experiment', measured)}")


if __name__ == "__main__":
    main()
