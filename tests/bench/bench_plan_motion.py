"""A planned run on cases that production alone leaves open: is the right name found with it, and with a random one?

Random robots with one effect make two unhurried runs of one pick-and-place. Where the diagnosis of these names nothing,
or first something else, a run is planned from it, made on the same plant after the others, and the diagnosis repeated
with it; beside that, the same with a random multisine of the same length.

uv run python -m tests.bench.bench_plan_motion --cases 30 --seed 1
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from typer.testing import CliRunner

from docs.making.figures import store
from drivers.motion import Planner
from drivers.motion_file import read_motion
from drivers.simulated.plant.cases import PAUSE, PERIOD, random_case
from drivers.simulated.plant.effects import CATALOGUE, EFFECTS
from drivers.simulated.plant.plant import Plant
from drivers.simulated.plant.plant_trace import simulate
from schemas.errors import DataError, DeltatwinError
from schemas.robot import Robot, save_robot
from schemas.trace import Trace
from service.cli.main import app
from service.diagnosis.documents.document import corrected, document
from service.diagnosis.pipeline import diagnose
from service.model.effects import CATALOGUE as KNOWN

BOUND = 0.9
RUNS = 2
SPEED = (0.15, 0.45)  # of the limits; faster production leaves too little open to come to thirty cases
RUN, PLANNED = 3.0, 10.0  # s
SEVERITY = (0.5, 1.0)  # 1: a fault that maintenance would want to know of
STRAY = 0.3  # rad from the command: the drives lost it


class Case:
    """A robot with an effect on its plant, and the production runs it made."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng([seed, 29])
        names = list(CATALOGUE)
        self.name = names[seed % len(names)]
        drawn = random_case(seed)
        self.robot, self.truth = drawn.robot, drawn.truth
        severity = float(np.exp(rng.uniform(*np.log(SEVERITY))))
        effect = EFFECTS[self.name].draw(rng, self.truth, severity)
        self.plant = Plant(self.robot, self.truth, (effect,), PERIOD, seed)
        self.planner = Planner(self.robot, PERIOD)
        pick = self.planner.pick_and_place(rng, RUN, speed=rng.uniform(*SPEED))
        self.production = [self.run(pick, f"pick_{number}") for number in range(RUNS)]
        self.after = self.plant.time
        self.random = self.planner.multisine(rng, PLANNED)

    def run(self, motion, name: str) -> Trace:
        """Made next."""
        trace = simulate(self.plant, motion, name)
        assert trace.position_command is not None
        if np.abs(trace.position - trace.position_command).max() > STRAY:
            raise DeltatwinError(f"{name}: the drives lost the robot")
        self.plant.time += PAUSE
        return trace

    def extra(self, motion) -> str:
        """First name with one more run."""
        self.plant.time = self.after
        return first(diagnose(self.robot, [*self.production, self.run(motion, "extra")], KNOWN))


def first(findings) -> str:
    """The strongest effect named, or nothing."""
    return next((effect.name for effect in document(findings).effects), "nothing")


def one(case: Case, folder: Path, seed: int) -> tuple[str, str, str, float] | None:
    """First names by production alone, with the planned run, with the random one, s of planning; None: it was right."""
    findings = diagnose(case.robot, case.production, KNOWN)
    alone = first(findings)
    if alone == case.name:
        return None
    save_robot(case.robot, folder / "robot.toml")
    fixed = corrected(findings)
    assert isinstance(fixed, Robot)
    save_robot(fixed, folder / "corrected.toml")
    (folder / "diagnosis.json").write_text(document(findings).model_dump_json(by_alias=True))
    begin, before = time.perf_counter(), time.process_time()
    arguments = [
        "plan-motion",
        "--robot",
        str(folder / "robot.toml"),
        "--out",
        str(folder / "motion.csv"),
        "--assume-limits",
    ]
    arguments += ["--seed", str(seed)]
    done = CliRunner().invoke(app, [*arguments, "--diagnosis", str(folder)])
    if isinstance(done.exception, DataError):  # nothing came into question: as it advises
        print(f"    {done.exception}", flush=True)
        done = CliRunner().invoke(app, [*arguments, "--for", "identify"], catch_exceptions=False)
    spent = time.perf_counter() - begin
    print(f"    {time.process_time() - before:.0f} s of the processor")
    print("    " + "    ".join(done.output.splitlines(keepends=True)), end="", flush=True)
    planned = case.extra(read_motion(folder / "motion.csv", case.robot, case.planner))
    return alone, planned, case.extra(case.random), spent


def main() -> None:
    """Print each open case and the shares."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=30, help="open cases to come to")
    parser.add_argument("--seed", type=int, default=1, help="of the first case")
    parser.add_argument("--seconds", type=float, default=7200.0, help="no new case after this time")
    parser.add_argument("--store", action="store_true", help="put the figures into results/plan_motion.json")
    arguments = parser.parse_args()
    begin, right, spent, tried = time.perf_counter(), [], [], 0
    while len(right) < arguments.cases and time.perf_counter() - begin < arguments.seconds:
        seed = arguments.seed + tried
        tried += 1
        try:
            case = Case(seed)
            with TemporaryDirectory() as folder:
                found = one(case, Path(folder), seed)
        except DeltatwinError as error:
            print(f"case {seed}: {error}", flush=True)
            continue
        if found is None:
            print(f"case {seed}: {case.name} named by production alone", flush=True)
            continue
        alone, planned, random, seconds = found
        right.append((planned == case.name, random == case.name))
        spent.append(seconds)
        print(
            f"case {seed}: {case.name}; alone {alone}, planned {planned}, random {random}; {seconds:.0f} s", flush=True
        )
    if right:
        planned, random = np.mean(right, axis=0)
        print(
            f"{len(right)} open cases of {tried}: right with the planned run {planned:.0%} (bound {BOUND:.0%}), with a "
            f"random one {random:.0%}; planning up to {max(spent):.0f} s"
        )
        if arguments.store:
            count, (mine, other) = len(right), np.sum(right, axis=0).tolist()
            kept = {"planned_right": (mine, count, None), "random_right": (other, count, None)}
            kept["time"] = (f"{min(spent):.0f} to {max(spent):.0f}", count, None)
            print(f"kept in {store('plan_motion', kept)}")


if __name__ == "__main__":
    main()
