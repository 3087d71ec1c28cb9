"""The robot on the bus: what a run without end keeps, and its last word."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.bus import open_bus
from drivers.motion import Planner
from drivers.simulated.plant import plant_on_bus
from drivers.simulated.plant.plant import Plant
from schemas.messages import HealthFlag, Role, StopReason


def test_a_run_without_end_keeps_its_newest_cycles_and_says_why_it_ended(
    bus_folder: Path,
    planner: Planner,
    ideal: Plant,
    monkeypatch: pytest.MonkeyPatch,
    until: Callable[[Callable[[], bool]], None],
) -> None:
    motion = planner.closed(planner.slow(np.random.default_rng(0), 1.0))
    monkeypatch.setattr(plant_on_bus, "REMEMBERED", 100)
    said: list[np.void] = []
    with open_bus("small", Role.ROBOT) as bus, open_bus("small", Role.OBSERVER) as observer:
        inbox = observer.subscribe("health")
        until(lambda: Role.ROBOT in observer.alive)
        run = plant_on_bus.run_live(ideal, motion, bus, lambda _: 0, loops=0, stop=lambda cycle: cycle == 449)
        until(lambda: bool(said.extend(inbox.take()[0]) or (said and said[-1]["reason"])))
    assert (run.cycles, len(run.trace), len(run.feedforward), len(run.lateness)) == (450, 100, 100, 100)
    np.testing.assert_allclose(run.trace.time, np.arange(350, 450) * 1e-3)
    np.testing.assert_array_equal(run.trace.position_command, motion.position[np.arange(350, 450) % len(motion)])
    assert said[-1]["reason"] == StopReason.DONE
    assert said[-1]["published"] == 450
    assert said[-1]["flags"] & HealthFlag.STALE_FEEDFORWARD  # nobody gave any
