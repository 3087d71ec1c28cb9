"""How far the simulated robot is off after 0.2 s before and after the diagnosis, on labelled logs kept out of it.

Each case is a folder with robot.toml, fit_*.csv and test_*.csv; `key.json` beside them says what is wrong with it.

uv run python -m tests.bench.bench_forward_gap ../shared/plant_logs --case case_001 --case case_003
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from docs.making.figures import store
from drivers.trace import read_trace
from schemas.robot import load_robot
from service.diagnosis.documents.document import document
from service.diagnosis.evidence.unseen import unseen
from service.diagnosis.pipeline import diagnose
from service.model.effects import CATALOGUE

BOUND, FLOOR_BOUND, NULL_BOUND = 0.5, 1.5, 0.05
LIFT = 2.0  # of the torque gap, from which a single effect counts


def ratios(folder: Path) -> tuple[float, float]:
    """Platform's error after the diagnosis over that before and over the floor, rms over the test logs."""
    robot = load_robot(folder / "robot.toml")
    fits, tests = (
        [read_trace(path, robot) for path in sorted(folder.glob(f"{part}_*.csv"))] for part in ("fit", "test")
    )
    findings = diagnose(robot, fits, CATALOGUE)
    found = [simulated for trace in tests if (simulated := unseen(findings, trace).simulated) is not None]
    squares = [
        [(value or np.nan) ** 2 for value in (s.platform_before_mm, s.platform_after_mm, s.platform_floor_mm)]
        for s in found
    ]
    before, after, floor = np.sqrt(np.mean(squares, axis=0))
    names = ", ".join(effect.name for effect in document(findings).effects) or "nothing"
    print(f"{folder.name}: {names}; {before:.3f} -> {after:.3f} mm, floor {floor:.3f} mm", flush=True)
    return after / before, after / floor


def main() -> None:
    """Print each case and the medians."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--case", action="append", help="only these")
    parser.add_argument("--store", action="store_true", help="put the figures into results/rollout.json")
    arguments = parser.parse_args()
    lifted, over_floor, free = [], [], []
    for key in json.loads((arguments.folder / "key.json").read_text()):
        if arguments.case and key["case"] not in arguments.case:
            continue
        shrunk, floor = ratios(arguments.folder / key["case"])
        if key["kind"] != "unknown":
            over_floor.append(floor)
        if key["kind"] == "null":
            free.append(shrunk)
            print(f"    gap-free: {shrunk:.3f} of what it was (bound {1 - NULL_BOUND:g} to {1 + NULL_BOUND:g})")
        elif key["kind"] == "catalogue" and key["lift"] >= LIFT:
            lifted.append(shrunk)
    if lifted:
        print(f"corrected over identified, median of {len(lifted)}: {np.median(lifted):.2f} (bound {BOUND:g})")
    print(f"corrected over floor, median of {len(over_floor)}: {np.median(over_floor):.2f} (bound {FLOOR_BOUND:g})")
    if arguments.store:
        medians = {"corrected_identified": lifted, "corrected_floor": over_floor, "gap_free": free}
        found = {key: (round(float(np.median(one)), 2), len(one), None) for key, one in medians.items() if one}
        print(f"kept in {store('rollout', found)}")


if __name__ == "__main__":
    main()
