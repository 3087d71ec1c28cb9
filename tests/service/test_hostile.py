"""Anybody may write anything: no role dies, no torque leaves its bounds, and good samples are answered 50 ms later."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import numpy as np

from service.monitor.readback import read_recording
from tests.service.attack import Attack

MESSAGES, ROUNDS = 3000, 3


def test_no_message_kills_a_role_or_moves_a_torque_out_of_its_bounds(bus_folder: Path, tmp_path: Path) -> None:
    with ExitStack() as stack:
        attack = Attack(tmp_path, stack)
        for seed in range(ROUNDS):
            assert attack.round(np.random.default_rng(seed), MESSAGES) == []
        assert attack.stop() == []
    recorded = read_recording(tmp_path / "run.mcap")
    assert len(recorded["sample"].records) > 400 * ROUNDS
    assert all(len(recorded[topic].records) > 100 for topic in recorded)
