"""The error of the feed-forward torque over the noise, of robots drawn at random, each with one effect in all its logs.

Four logs are fitted and the description is corrected by that effect alone; the feed-forward for the motion of one more
log, which goes nowhere else, is then held against the torque that was measured in it, as `diagnose` does in its trial.

uv run python -m tests.bench.bench_feedforward --robots 961 962 963 --seed 91 --store
"""

from __future__ import annotations

import argparse
from collections import defaultdict

import numpy as np
from joblib import Parallel, delayed

from docs.making.figures import store
from drivers.motion import Planner
from drivers.simulated.plant.cases import PERIOD
from drivers.simulated.plant.plant_trace import simulate
from schemas.errors import DataError
from service.diagnosis.documents.worth import online_trial
from service.diagnosis.pipeline import diagnose
from tests.bench.bench_payload import SPEED, Machine
from tests.bench.payload_draws import CARRIED, NAMED, fit_logs, scenario_of

SECONDS = 6.0  # of the log that is kept out


def ratios(robot: str, name: str, seed: int) -> tuple[float, float] | str:
    """Error over noise, description as identified and as corrected by the effect `name`; or why there is none."""
    machine = Machine.of(robot)
    planner, scenario = Planner(machine.robot, PERIOD), scenario_of(name, machine, seed)
    rng = np.random.default_rng([seed, 75])
    kept_out = simulate(
        scenario.picking.plant(machine.robot, machine.truth, seed + 1),
        planner.pick_and_place(rng, SECONDS, speed=rng.uniform(*SPEED)),
        "kept_out",
    )
    try:
        candidates = [NAMED[name]] if name in NAMED else []
        findings = diagnose(machine.robot, fit_logs(machine, planner, scenario, seed), candidates)
        found = online_trial(findings, [], [kept_out])
    except DataError as refused:
        return str(refused)
    if found is None or found.identified is None or found.corrected is None:
        return f"no trial: {found.reason if found else 'no estimator'}"
    return found.identified.feedforward_over_noise, found.corrected.feedforward_over_noise


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", default=["961", "962", "963"], help="names, or seeds of random ones")
    parser.add_argument("--only", nargs="+", choices=("clean", *CARRIED), default=[], metavar="NAME")
    parser.add_argument("--seed", type=int, default=91)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--store", action="store_true", help="put the figures into results/feedforward.json")
    asked = parser.parse_args()
    names = asked.only or ["clean", *CARRIED]
    rows = [(name, robot, asked.seed + number) for name in names for number, robot in enumerate(asked.robots)]
    found = Parallel(n_jobs=asked.jobs, return_as="generator")(
        delayed(ratios)(robot, name, seed) for name, robot, seed in rows
    )
    after: dict[str, list[float]] = defaultdict(list)
    for (name, robot, _), pair in zip(rows, found, strict=True):
        if not isinstance(pair, tuple):
            print(f"{name:27} {robot:8} {pair}", flush=True)
            continue
        print(f"{name:27} {robot:8} {pair[0]:7.3g} -> {pair[1]:7.3g}", flush=True)
        after[name].append(pair[1])
    if asked.store:
        told = {
            name: (round(float(np.mean(some)), 2), len(some), f"worst robot {max(some):.2f}")
            for name, some in after.items()
        }
        print(f"kept in {store('feedforward', told)}")


if __name__ == "__main__":
    main()
