"""Logs for the tutorials, as a controller's scope exports them: `python -m docs.making.samples` writes them anew.

A simulated Delta (MuJoCo) with one effect of the catalogue; motor degrees and thousandths of the drives' rated torque, in a
table with semicolons and decimal commas. What the tutorial is to find is not said in the files.
"""

from __future__ import annotations

import gzip
import tempfile
from pathlib import Path

import numpy as np

from drivers.plant.cases import simulate_case
from drivers.plant.families import Draw
from drivers.trace import read_trace
from schemas.robot import load_robot
from schemas.trace import Trace

FOLDER = Path(__file__).resolve().parents[1] / "tutorials" / "data" / "delta"
SEED, EFFECT = 20_261, "joint_offset"
EVERY = 2  # samples of the simulation of which a row is kept: 500 Hz
RATED_NM = 2.4  # of a motor, before the gear
NAMES = {"fit_a_pick": "picks", "fit_b_multisine": "multisine", "fit_c_slow": "sweep", "test_a_pick": "other_day"}


def table(trace: Trace, gear_ratio: float) -> str:
    """A log as a foreign table."""
    rows = slice(None, None, EVERY)
    time = 1000 * (trace.time[rows] - trace.time[0])
    degrees = np.degrees(trace.position[rows]) * gear_ratio
    permille = trace.torque[rows] / gear_ratio / RATED_NM * 1000
    head = [
        "Time [ms]",
        *(f"Axis{j} ActPos [deg]" for j in (1, 2, 3)),
        *(f"Axis{j} ActTrq [permille]" for j in (1, 2, 3)),
    ]
    lines = ["Name;Delta cell 7", "", ";".join(head)]
    for stamp, angle, torque in zip(time, degrees, permille, strict=True):
        numbers = [f"{stamp:.0f}", *(f"{value:.4f}" for value in angle), *(f"{value:.1f}" for value in torque)]
        lines.append(";".join(numbers).replace(".", ","))
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write the logs, packed."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print(simulate_case(folder, SEED, Draw("catalogue", (EFFECT,), 1.5))["fx"])
        gear_ratio = load_robot(folder / "robot.toml").drive.gear_ratio
        print((folder / "robot.toml").read_text(encoding="utf-8"))
        for path in sorted(folder.glob("*.csv")):
            if path.stem in NAMES:
                packed = gzip.compress(table(read_trace(path), gear_ratio).encode("utf-8"), mtime=0)
                (FOLDER / f"{NAMES[path.stem]}.csv.gz").write_bytes(packed)


if __name__ == "__main__":
    main()
