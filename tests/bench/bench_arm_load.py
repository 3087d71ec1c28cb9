"""The load of three arms of 4, 6 and 7 joints that MuJoCo simulates: how far mass and centre are off, how many errors
cover the truth.

uv run python -m tests.bench.bench_arm_load --robots 4 --loads 4 --store
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from docs.making import figures
from drivers.trace import read_trace
from schemas.axes_description import load_description
from schemas.chain_description import Chain
from service.identification.joint_machines import identify_axes
from service.identification.log_load import load_on
from tests.service.arms import FOUR, SEVEN, SIX, Kind, Load

CERTAIN = 1.96  # standard errors, of 95 %
HEAVY_URDF = 1.15  # masses of the URDF that identification starts from, over the true ones
MOST = {FOUR.name: 2.0, SIX.name: 5.0, SEVEN.name: 3.0}  # kg


def drawn(kind: Kind, rng: np.random.Generator) -> Load:
    """A body of 0.2 kg or more, its centre up to 15 cm off the flange, as wide as 5 to 12 cm."""
    mass = float(rng.uniform(0.2, MOST[kind.name]))
    x, y, z = rng.uniform((-0.06, -0.06, 0.0), (0.06, 0.06, 0.15))
    size = mass * rng.uniform(0.05, 0.12) ** 2 / 12 * np.array([1.0, 1.3, 0.8])
    return Load(mass, (float(x), float(y), float(z)), (float(size[0]), float(size[1]), float(size[2])))


def measured(kind: Kind, folder: Path, seed: int, loads: int) -> list[np.ndarray]:
    """A row a load: kg, kg off, its standard error, m off three times, their standard errors."""
    (folder / "arm.urdf").write_text(kind.urdf(scale=HEAVY_URDF))
    (folder / "arm.toml").write_text(kind.description())
    plain = load_description(folder / "arm.toml")
    assert isinstance(plain, Chain)
    empty = [kind.record(folder / f"empty_{k}.csv", 1000 * seed + k) for k in range(2)]
    robot = identify_axes(plain, [read_trace(path, plain) for path in empty]).robot
    rows = []
    for number in range(loads):
        load = drawn(kind, np.random.default_rng([seed, number]))
        log = kind.record(folder / "load.csv", 1000 * seed + 100 + number, load)
        found = load_on(robot, read_trace(log, robot), "flange")
        off = found.centre - load.centre
        rows.append(np.r_[load.mass, found.mass - load.mass, found.mass_error, off, found.centre_error])
    return rows


def main() -> None:
    """Print each arm, and store what all come to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=4, help="of each arm, with noise and motion of their own")
    parser.add_argument("--loads", type=int, default=4, help="of each robot")
    parser.add_argument("--store", action="store_true", help="put the figures into results/arm_load.json")
    given = parser.parse_args()
    every = []
    for kind in (FOUR, SIX, SEVEN):
        with tempfile.TemporaryDirectory() as folder:
            rows = [row for k in range(given.robots) for row in measured(kind, Path(folder), k + 10, given.loads)]
        every += rows
        table = np.array(rows)
        print(
            f"{kind.name}: {len(rows)} loads, mass off by {100 * np.abs(table[:, 1] / table[:, 0]).max():.2f} %, "
            f"centre by {1e3 * np.abs(table[:, 3:6]).max():.2f} mm at most",
            flush=True,
        )
    table = np.array(every)
    kg = np.abs(table[:, 1])
    good = np.mean(kg <= np.maximum(0.02, 0.02 * table[:, 0]))
    covered = np.abs(table[:, [1, 3, 4, 5]]) < CERTAIN * table[:, [2, 6, 7, 8]]
    percent, mm = 100 * kg / table[:, 0], 1e3 * np.linalg.norm(table[:, 3:6], axis=1)
    share = float(covered.mean())
    result = {
        "mass": (round(float(np.median(percent)), 3), len(table), f"most {percent.max():.2g} %"),
        "mass_good": (round(float(good), 3), len(table), None),
        "centre": (round(float(np.median(mm)), 3), len(table), f"most {mm.max():.2g} mm"),
        "covered": (round(share, 3), covered.size, f"mass alone {covered[:, 0].mean():.3g}"),
    }
    for key, (value, count, interval) in result.items():
        print(f"{key}: {value} of {count} ({interval})")
    if given.store:
        print(f"stored in {figures.store('arm_load', result)}")


if __name__ == "__main__":
    main()
