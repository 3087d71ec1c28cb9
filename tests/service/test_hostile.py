"""Anybody may write anything: no role dies, no torque leaves its bounds, and good samples are answered 50 ms later."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import numpy as np

from schemas.messages import OF_DELTA, topics_of
from service.monitor.readback import read_recording
from tests.service.attack import GOOD, Attack

MESSAGES, ROUNDS = 3000, 3
RATE = 4000.0  # a second: far below what the roles take on a quiet host


def test_no_message_kills_a_role_or_moves_a_torque_out_of_its_bounds(bus_folder: Path, tmp_path: Path) -> None:
    with ExitStack() as stack:
        attack = Attack(tmp_path, stack)
        for seed in range(ROUNDS):
            assert attack.round(np.random.default_rng(seed), MESSAGES, RATE) == []
        assert attack.stop() == []
        arrived = attack.arrived()
    watched = arrived.pop("watch")  # at the lowest priority: on a busy host it is passed over
    assert watched.counted > 0
    assert all(of.counted > 0.9 * of.sent for of in arrived.values()), arrived
    recorded = read_recording(tmp_path / "run.mcap")
    assert len(recorded["sample"].records) > GOOD * ROUNDS
    assert all(len(recorded[topic].records) > 100 for topic in topics_of(OF_DELTA))
