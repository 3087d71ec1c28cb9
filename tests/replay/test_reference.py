"""The stored run of the demo log must come out again."""

import csv

import numpy as np

from drivers.trace import read_trace
from replay.demo import LOG, PAYLOADS, ROBOT
from replay.process import process
from schemas.messages import PayloadEvent
from schemas.robot import load_robot
from tests.replay.reference import STORED, difference, run

# Bit for bit on one machine; on another the compiler may fuse other multiplications and additions.
TOLERANCE = 1e-6  # N m, kg


def test_the_stored_run_comes_out_again():
    moved = difference(dict(np.load(STORED)), run(), TOLERANCE)
    assert not moved, "\n".join(
        ["the results moved; if that is meant: uv run python -m tests.replay.reference, and say why", *moved]
    )


def test_a_moved_result_is_named_with_its_place():
    stored = dict(np.load(STORED))
    changed = {name: values.copy() for name, values in stored.items()}
    changed["feedforward.torque"][120, 1] += 0.5
    (line,) = difference(stored, changed, TOLERANCE)
    assert line.startswith("feedforward.torque: 1 of")
    assert "by at most 0.5; first at row 1200, joint 2" in line


def test_the_stored_run_weighs_what_was_picked():
    """The reference is not only stable but right: events and masses against the log's own key."""
    robot = load_robot(ROBOT)
    samples = read_trace(LOG, robot).samples()
    payload = process(robot, samples).payload
    picks = list(csv.DictReader(PAYLOADS.open()))
    events = payload[payload["event"] != 0]
    assert events["event"].tolist() == [PayloadEvent.PICK, PayloadEvent.RELEASE] * len(picks)
    for on, off, truth in zip(events[::2], events[1::2], picks, strict=True):
        begin, end, mass = (float(truth[key]) for key in ("from_s", "until_s", "mass_kg"))
        assert begin < on["sequence"] * 1e-3 < begin + 0.2
        assert end < off["sequence"] * 1e-3 < end + 0.15
        last = payload[payload["sequence"] < end * 1e3][-1]
        assert last["trusted"]
        assert abs(last["mass"] - mass) < max(0.01 * mass, 0.02)
