"""Stamps that are garbage are told in one short line; names keep their dots."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.trace.quality import RowNames, check
from schemas.axes_description import Axes, Axis
from schemas.trace import Trace

MOTOR = Axes(name="motor", kind="axes", axis=[Axis()])


def turning(speed: float) -> Trace:
    time = np.arange(4000) * 1e-3
    angle = speed / 3.0 * np.sin(3.0 * time)
    return Trace(Path("spin.csv"), time, angle[:, None], np.zeros((4000, 1)))


def test_garbage_for_a_stamp_is_told_in_one_short_line():
    made = turning(5.0)
    made.time[1000] = 3.5e149
    found = check(made, RowNames("line", np.arange(len(made)) + 2), MOTOR)
    assert len(found.findings) >= 1
    assert all(len(finding.message) < 200 for finding in found.findings)


@pytest.mark.parametrize(
    ("file", "name"),
    [("run.csv", "run"), ("2026-11-22.v1.2.csv.gz", "2026-11-22.v1.2"), ("kp=0.5.mcap", "kp=0.5"), ("bare", "bare")],
)
def test_a_name_keeps_its_dots(file, name):
    made = turning(1.0)
    assert Trace(Path("logs") / file, made.time, made.position, made.torque).name == name


def test_a_servo_motor_turns_faster_than_a_deltas_joint_and_jumps_still():
    made = turning(500.0)  # rad/s, 4800 rpm
    rows = RowNames("line", np.arange(len(made)) + 2)
    assert check(made, rows, MOTOR).findings == ()
    assert "jumps" in check(made, rows, None).findings[-1].message
    made.position[1000:] += 0.2  # a twentieth of a turn in one cycle
    found = check(made, rows, MOTOR).findings
    assert [finding.rows.tolist() for finding in found] == [[1000]]
