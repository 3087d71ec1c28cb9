"""What is found of real machines beside what is published of them.

uv run python -m tests.bench.bench_real_machines --store

The logs and the readings are those of the tests, which hold each value to a bound.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from docs.making.figures import store
from tests.service.diagnosis import test_real_machines as machines
from tests.service.diagnosis.test_axes import DESCRIPTION

SHARED = Path(__file__).resolve().parents[3] / "shared"
Figures = dict[str, tuple[float | int | str, int | str | None, str | None]]


def emps(folder: Path) -> Figures:
    """A servo axis: with one friction for both directions, and with one for each."""
    (folder / "axes.toml").write_text(DESCRIPTION)
    document = machines.run(folder, [SHARED / "real" / "emps" / "emps.csv"])
    plain = document["plain"]
    (effect,) = (one for one in document["effects"] if one["name"] == "asymmetric_friction")
    both, more = document["base"]["f_v_1"]["value"], effect["parameters"]["delta_v"]["value"]
    return {
        "emps_mass": (round(plain["inertia_1"], 2), 1, None),
        "emps_viscous": (round(plain["f_v_1"], 1), 1, None),
        "emps_coulomb": (round(plain["f_c_1"], 2), 1, None),
        "emps_direction": (f"{both + more:.1f} and {both - more:.1f}", 1, None),
    }


def odrive(folder: Path) -> Figures:
    """Cogging of a motor, reported through a filter."""
    document = machines.odrive(SHARED, folder)
    found, count = machines.amperes_of(document), 4
    off = max(abs(found[order] / amperes - 1) for order, amperes in machines.ORDERS.items())
    (cutoff,) = (one["parameters"]["cutoff"] for one in document["effects"] if one["name"] == "torque_filter")
    return {
        "odrive_orders": (
            ", ".join(f"{found[order]:.2f}" for order in machines.ORDERS), count, f"at most {100 * off:.0f} % off"
        ),
        "odrive_filter": (round(cutoff["value"], 2), count, None),
    }  # fmt: skip


def xl330(folder: Path) -> Figures:
    """A servo that holds a weight."""
    document = machines.xl330(SHARED, folder)
    (mu,) = (one["parameters"]["mu"] for one in document["effects"] if one["name"] == "load_dependent_friction")
    low, high = mu["ci95"]
    return {"xl330_load": (round(mu["value"], 2), len(document["traces"]), f"95 %: {low:.2f} to {high:.2f}")}


def tx40(folder: Path) -> Figures:
    """An arm whose last motor turns with two axes."""
    found, _ = machines.tx40(SHARED, folder)
    viscous, wrist = machines.tx40_viscous(found)
    off = np.abs([*viscous, wrist] / np.array([*machines.TX40_VISCOUS, machines.TX40_WRIST]) - 1)
    coulomb = found.coulomb_friction.value[0] / machines.TX40_COULOMB_1 - 1
    return {"tx40": (round(100 * off.max(), 1), 1, f"Coulomb friction of axis 1: {100 * coulomb:+.0f} %")}


def ur10(folder: Path) -> Figures:
    """An arm whose log was smoothed."""
    off = 100 * (machines.ur10_friction(machines.ur10(SHARED, folder)) / machines.UR10_FRICTION - 1)
    return {"ur10": (round(np.abs(np.delete(off, 1)).max(), 1), 1, f"axis 2: {off[1]:+.0f} %")}


MACHINES: tuple[Callable[[Path], Figures], ...] = (emps, odrive, xl330, tx40, ur10)


def main() -> None:
    """Print each machine's figures, and store all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", action="store_true", help="put the figures into results/real_machines.json")
    given = parser.parse_args()
    told: Figures = {}
    for machine in MACHINES:
        with tempfile.TemporaryDirectory() as folder:
            found = machine(Path(folder))
        for key, (value, count, note) in found.items():
            print(f"{key}: {value} ({count} logs{'; ' + note if note else ''})", flush=True)
        told |= found
    if given.store:
        print(f"stored in {store('real_machines', told)}")


if __name__ == "__main__":
    main()
