"""The table of faults with the exported code in the master's cycle, in place of the estimator: the same rows hold."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from schemas.messages import HealthFlag, Role
from tests.drivers.ethercat import test_faults as table
from tests.drivers.ethercat.test_faults import Process, Wire, wire
from tests.service.codegen.built import needs_compiler
from tests.service.codegen.compiled import compiled

__all__ = ["wire"]
pytestmark = needs_compiler
STAYS: dict[str, Callable[[Wire, Process], None]] = {
    "frames lost": lambda wire, master: table.test_frames_that_are_lost(wire, master, 0.05),
    "cut for some cycles": table.test_a_cable_that_is_cut_for_some_cycles,
    "twice": table.test_frames_that_come_twice,
    "overtaking": table.test_frames_that_overtake_each_other,
    "held up": table.test_frames_that_are_held_up,
    "late": table.test_frames_that_are_late_by_less_than_a_cycle,
    "clock": lambda wire, master: table.test_a_clock_that_slips(wire, master, "3600000000000"),
    "interrupted": table.test_ctrl_c_is_said_with_its_reason_and_the_torque_fades,
}


@pytest.fixture(scope="module")
def library(wire: Wire) -> str:
    return str(compiled(Path(wire.robot), wire.folder / "twin", table.RATE))


@pytest.fixture
def running(wire: Wire, library: str) -> Iterator[Process]:
    """A master whose drives get a torque of the library."""
    master = wire.master(library, duration=300)
    yield master
    master.stop()


def test_what_a_master_lives_through(wire: Wire, running: Process, library: str) -> None:
    table.loaded(wire)
    for row in STAYS.values():
        if not running.process.is_alive() and table.NO_ANSWER in running.said:
            running = wire.master(library, duration=300)  # the host did not let the segment run
        row(wire, running)


@pytest.mark.parametrize(
    ("switch", "says"),
    [("silence 3", "a drive does not take part in the process data"), ("trip 2", "drive 2 is not in operation")],
)
def test_a_drive_that_fails(wire: Wire, running: Process, switch: str, says: str) -> None:
    since = time.monotonic()
    wire.segment.say(switch)
    within = time.monotonic() - since + table.SOON
    wire.heard.told(Role.TAP, HealthFlag.BUS_FAULT, since, within)
    table.ends_in_a_fault(wire, running, since, says, within)


def test_a_cable_that_stays_cut(wire: Wire, running: Process) -> None:
    since = wire.spoil("cut")
    table.ends_in_a_fault(wire, running, since, table.NO_ANSWER)
    wire.heard.told(Role.TAP, HealthFlag.STALE_INPUT, since)


def test_frames_that_are_corrupted(wire: Wire, running: Process) -> None:
    table.ends_in_no_traceback(wire, running)


def test_a_library_for_another_cycle_ends_before_the_first_frame(wire: Wire, library: str, tmp_path: Path) -> None:
    slow = compiled(Path(wire.robot), tmp_path / "slow", 250.0)
    master = wire.start("master", table.rig.NEAR, "--robot", wire.robot, "--feedforward", str(slow))
    assert master.ends(table.READY) == 1
    assert "made for a sample every 4000 us, not 1000 us" in master.said.splitlines()[-1]
    missing = wire.start("master", table.rig.NEAR, "--robot", wire.robot, "--feedforward", "nowhere.so")
    assert missing.ends(table.READY) == 2
    assert "not cycle, bus, off or the path of an existing library" in missing.said.replace("\n", " ")
