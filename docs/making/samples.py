"""Logs for the tutorials, as a controller's scope exports them: `python -m docs.making.samples` writes them anew.

A simulated Delta (MuJoCo) with one effect of the catalogue; motor degrees and thousandths of the drives' rated torque,
in a table with semicolons and decimal commas. What the tutorial is to find is not said in the files. And a small arm,
whose URDF has two wrong masses. The servo axis beside them is a real log, see the licence there.
"""

from __future__ import annotations

import gzip
import tempfile
from pathlib import Path

import numpy as np

from drivers.simulated.plant.cases import simulate_case
from drivers.simulated.plant.families import Draw
from drivers.trace import read_trace
from schemas.robot import load_robot
from schemas.trace import Trace
from tests.service import arm

FOLDER = Path(__file__).resolve().parents[1] / "tutorials" / "data"
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


def pack(text: str, path: Path) -> None:
    """Write a packed file, the same bytes from the same text."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gzip.compress(text.encode("utf-8"), mtime=0))


def write_delta() -> None:
    """Logs of a Delta."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print(simulate_case(folder, SEED, Draw("catalogue", (EFFECT,), 1.5))["fx"])
        gear_ratio = load_robot(folder / "robot.toml").drive.gear_ratio
        print((folder / "robot.toml").read_text(encoding="utf-8"))
        for path in sorted(folder.glob("*.csv")):
            if path.stem in NAMES:
                pack(table(read_trace(path), gear_ratio), FOLDER / "delta" / f"{NAMES[path.stem]}.csv.gz")


def write_arm() -> None:
    """Logs of an arm, its URDF with wrong masses, and its description."""
    folder = FOLDER / "arm"
    folder.mkdir(parents=True, exist_ok=True)
    arm.write(
        folder, arm.URDF.replace('mass value="3"', 'mass value="5"').replace('mass value="1.5"', 'mass value="0.5"')
    )
    with tempfile.TemporaryDirectory() as name:
        for seed, log in enumerate(("monday", "tuesday", "wednesday")):
            path = arm.record(Path(name) / f"{log}.csv", seed)
            values = np.loadtxt(path, delimiter=",", skiprows=1)
            lines = [
                ",".join(f"{value:.7g}" for value in row[:4]) + "," + ",".join(f"{v:.4g}" for v in row[4:])
                for row in values
            ]
            head = path.read_text(encoding="utf-8").splitlines()[0]
            pack("\n".join([head, *lines]) + "\n", folder / f"{log}.csv.gz")


def main() -> None:
    """Write all logs anew."""
    write_delta()
    write_arm()


if __name__ == "__main__":
    main()
