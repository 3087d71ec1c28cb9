"""The stored run of the demo log: what is kept of it, and how it is written anew.

After a change that is meant to move the results: `uv run python -m tests.replay.reference`, and say why in the commit.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from drivers.trace import read_trace
from replay.demo import LOG, ROBOT
from replay.process import process
from schemas.robot import load_robot

STORED = Path(__file__).with_name("reference.npz")
EVERY = 10  # samples; enough to see what moves, small enough to keep
FIELDS = {
    "feedforward": ("sequence", "torque", "source", "flags"),
    "payload": ("sequence", "mass", "std_dev", "trusted"),
    "error": ("sequence", "kh", "id", "id_friction", "full"),
}


def run() -> dict[str, np.ndarray]:
    """The demo log through the estimator: `message.field` to every EVERY-th row, and all payload events."""
    robot = load_robot(ROBOT)
    result = process(robot, read_trace(LOG, robot).samples())
    kept = {
        f"{message}.{field}": getattr(result, message)[field][::EVERY]
        for message, fields in FIELDS.items()
        for field in fields
    }
    events = result.payload[result.payload["event"] != 0]
    return kept | {"events": np.stack([events["sequence"], events["event"]], axis=1)}


def difference(stored: dict[str, np.ndarray], now: dict[str, np.ndarray], tolerance: float) -> list[str]:
    """One line a field that moved by more than `tolerance`: how far, and where first."""
    lines = []
    for name, old in stored.items():
        new = now[name]
        if old.shape != new.shape:
            lines.append(f"{name}: {len(old)} rows stored, {len(new)} now: {old.tolist()} / {new.tolist()}"[:400])
            continue
        moved = ~np.isclose(old.astype(float), new.astype(float), rtol=0, atol=tolerance, equal_nan=True)
        if moved.any():
            row = tuple(np.argwhere(moved)[0])
            lines.append(
                f"{name}: {moved.sum()} of {moved.size} values moved, by at most "
                f"{np.nanmax(np.abs(old.astype(float) - new.astype(float))):.3g}; first at row {row[0] * EVERY}"
                f"{f', joint {row[1] + 1}' if len(row) > 1 else ''}: stored {old[row]}, now {new[row]}"
            )
    return lines


if __name__ == "__main__":
    found = run()
    for line in difference(dict(np.load(STORED)), found, 0.0) if STORED.exists() else []:
        print(line)
    np.savez_compressed(STORED, allow_pickle=False, **found)
    print(f"wrote {STORED.name}")
