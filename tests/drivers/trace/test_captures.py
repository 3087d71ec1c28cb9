"""Captures through the commands: convert, inspect, what contradicts the declaration, and what is no use at all."""

from __future__ import annotations

import json
import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.bus import open_bus
from drivers.ethercat.cia402 import scales
from drivers.ethercat.live_tap import FileSource, Tap
from drivers.health import Health
from drivers.trace import read_trace
from drivers.trace.capture_survey import survey_capture
from drivers.trace.capture_trace import convert_capture, read_capture
from replay.clock import wait_until
from schemas.errors import TraceError
from schemas.messages import HealthFlag, Role, SampleFlag
from schemas.robot import Robot, save_robot
from schemas.trace import Trace
from service.cli.main import app
from tests.drivers.ethercat.wire import Drive, datagram, frame, passes, pcap, robot, tshark

START = 1_700_000_000_000_000_000


def recorded(trace: Trace, path: Path, description: Robot) -> Path:
    """`trace` as the frames of three drives of `description`."""
    scale = scales(description)
    speed = np.gradient(trace.position, trace.time, axis=0)
    assert trace.position_command is not None
    packets = []
    before = None
    for row in range(len(trace)):
        drives = [
            Drive(
                position=int(s.counts(trace.position[row, j])),
                velocity=int(np.rint(speed[row, j] / abs(s.radians_per_count) * np.sign(s.radians_per_count))),
                torque=int(s.per_mille(trace.torque[row, j])),
                target=int(s.counts(trace.position_command[row, j])),
                offset=-5,
            )
            for j, s in enumerate(scale)
        ]
        time = START + int(np.rint((trace.time[row] - trace.time[0]) * 1e9))
        out, back = passes(drives, before, index=row % 256)
        packets += [(time - 30_000, out), (time, back)]
        before = drives
    return pcap(path, packets, nanoseconds=True)


def changed(description: Robot, joint: int, **values: Any) -> Robot:
    data = description.model_dump(exclude_none=True)
    data["drive"]["joint"][joint].update(values)
    return Robot.model_validate(data)


RIG = robot(velocity_unit_counts_per_s=None, velocity_unit_rpm=60 / (1 << 20))


@pytest.fixture(scope="module")
def plant_log(data: Path) -> Trace:
    return read_trace(data / "plant_logs" / "case_000" / "fit_b_multisine.csv")


@pytest.fixture(scope="module")
def capture(plant_log: Trace, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(plant_log, tmp_path_factory.mktemp("capture") / "multisine.pcap", RIG)


def contradictions(path: Path, description: Robot) -> list[str]:
    return [f.message for f in read_capture(path, description).findings if f.message.startswith("joint")]


def test_a_recorded_robot_comes_back_to_quantisation(plant_log: Trace, capture: Path) -> None:
    trace = read_trace(capture, RIG)
    step, per_mille = math.tau / (1 << 20) / 20, 1.5 * 20 / 1000

    np.testing.assert_allclose(trace.position, plant_log.position, atol=0.51 * step)
    np.testing.assert_allclose(trace.torque, plant_log.torque, atol=0.51 * per_mille)
    assert trace.position_command is not None
    assert plant_log.position_command is not None
    np.testing.assert_allclose(trace.position_command, plant_log.position_command, atol=0.51 * step)
    np.testing.assert_array_equal(trace.time_ns - START, np.rint((plant_log.time - plant_log.time[0]) * 1e9))
    assert not trace.flags.any()


def test_a_right_declaration_is_not_contradicted(capture: Path) -> None:
    assert contradictions(capture, RIG) == []


@pytest.mark.parametrize(
    ("joint", "changes", "words"),
    [
        (0, {"counts_per_turn": 1 << 19}, ["2 times", "0x606C"]),  # half the counts a turn: twice the angle
        (1, {"velocity_unit_rpm": 0.1}, ["times as fast", "0x606C"]),
        (2, {"torque_sign": -1}, ["falls when the joint accelerates"]),
        (1, {"sign": -1}, ["pushes the arm down"]),
    ],
)
def test_a_wrong_declaration_that_shows_in_the_data_is_reported(
    capture: Path, joint: int, changes: dict[str, Any], words: list[str]
) -> None:
    found = contradictions(capture, changed(RIG, joint, **changes))

    assert any(all(word in text for word in words) for text in found), found
    assert all(text.startswith(f"joint {joint + 1}:") for text in found)


@pytest.mark.parametrize("torque_sign", [1, -1])
def test_the_tap_reports_a_wrong_declaration_while_the_robot_runs(
    capture: Path, bus_folder: Path, torque_sign: int
) -> None:
    description = changed(RIG, 2, torque_sign=torque_sign)
    said: list[str] = []
    tap = Tap(FileSource(capture, wait_until, speed=50.0), description, said.append)
    with open_bus(description.name, Role.TAP) as bus:
        health = Health(bus)
        tap.run(lambda _: None, health)
    contradicted = [line for line in said if "falls when the joint accelerates" in line]

    assert [line[:7] for line in contradicted] == ([] if torque_sign == 1 else ["joint 3"])
    assert bool(health.flags & HealthFlag.WRONG_DECLARATION) is (torque_sign == -1)


def test_convert_streams_what_reading_whole_gives(capture: Path, tmp_path: Path) -> None:
    save_robot(RIG, tmp_path / "rig.toml")
    out = tmp_path / "out.mcap"
    result = CliRunner().invoke(app, ["convert", str(capture), str(out), "--robot", str(tmp_path / "rig.toml")])

    assert result.exit_code == 0, result.output
    streamed, whole = read_trace(out), read_trace(capture, RIG)
    assert streamed.samples().tobytes() == whole.samples().tobytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.mcap", "rig.toml"]


def test_inspect_counts_what_tshark_counts(data: Path, tmp_path: Path) -> None:
    path = data / "captures" / "own_three_drives_4khz.pcap"
    description = Path(__file__).parents[1] / "ethercat" / "robots" / "own_three_drives.toml"
    result = CliRunner().invoke(app, ["inspect", str(path), "--robot", str(description), "--json"])
    figures = json.loads(result.stdout)["traces"][0]
    rows = tshark(path, "ecat.cmd")

    assert figures["frames"] == len(rows)
    assert figures["datagrams"] == sum(len(row[0].split(",")) for row in rows)
    assert figures["slaves"] == 3
    assert figures["stations"] == [0x1001, 0x1002, 0x1003]
    cyclic = figures["cyclic"][0]
    assert (cyclic["command"], cyclic["bytes"], cyclic["working_counter"]) == ("LRW", 66, 9)
    assert (cyclic["sent"], cyclic["returned"], cyclic["working_counter_faults"]) == (5021, 5021, 0)
    assert cyclic["cycle_s"] == pytest.approx(1e-3, rel=1e-3)
    assert [c["state"] for c in figures["state_changes"] if c["station"] is None] == ["SAFEOP", "OP"]
    areas = {(a["station"], a["direction"]): (a["logical_address"], a["bytes"]) for a in figures["mapping"]}
    assert areas[0x1002, "outputs"] == (9, 9)
    assert areas[0x1003, "inputs"] == (53, 13)
    states = [c["state"] for c in figures["robot"]["drive_state_changes"] if c["joint"] == 2]
    assert states == ["switch_on_disabled", "ready_to_switch_on", "switched_on", "operation_enabled"]
    assert figures["robot"]["samples"] == 5021


def test_inspect_needs_no_robot(data: Path) -> None:
    captures = sorted(map(str, (data / "captures").glob("*.pcap*")))
    result = CliRunner().invoke(app, ["inspect", *captures])

    assert result.exit_code == 0, result.output
    assert result.stdout.count(" EtherCAT, ") == len(captures) == 7


def test_inspect_of_pieces_that_were_joined_says_so_and_measures_within_them(tmp_path: Path) -> None:
    times = [k * 1_000_000 for k in range(5_000, 5_100)] + [k * 1_000_000 for k in range(100)]
    times[20:23] = [t + 700_000 for t in times[20:23]]  # late and caught up with, not lost
    del times[150:153]
    path = pcap(tmp_path / "a.pcap", [(t, passes([Drive()] * 3)[1]) for t in times], nanoseconds=True)
    figures = survey_capture(path)

    assert figures["duration_s"] == pytest.approx(5.099)
    assert figures["findings"][0].startswith("time goes backwards at 1 frames, first at frame 101, by 5.099 s")
    cyclic = figures["cyclic"][0]
    assert cyclic["cycle_s"] == pytest.approx(1e-3)
    assert cyclic["jitter_max_s"] < 1e-3
    assert cyclic["lost_cycles"] == 3


def lldp() -> bytes:
    return b"\xff" * 6 + bytes(6) + b"\x88\xcc" + bytes(40)


@pytest.mark.parametrize(
    ("packets", "link_type", "message"),
    [
        ([], 1, "no frames"),
        ([lldp()] * 5, 1, "no EtherCAT among 5 frames"),
        ([lldp()] * 5, 105, "link type 105 carries no Ethernet"),
        ([frame(datagram(7, 0x01300000, bytes(2), 3))] * 5, 1, "none of 5 EtherCAT frames has a logical command"),
        ([passes([Drive()] * 3)[0]] * 5, 1, "no returned frame among 5"),
        (
            [frame(datagram(12, 0x2000, bytes(60), 9), returned=True)] * 5,
            1,
            "inputs of joint 1, joint 2, joint 3 .* on the bus: LRW 0x2000 to 0x203b",
        ),
        (
            [frame(datagram(12, 0x1000, bytes(64), 9), returned=True)] * 5,
            1,
            "inputs of joint 3 .* on the bus: LRW 0x1000 to 0x103f",
        ),
    ],
)
def test_a_capture_that_gives_no_sample_says_why(
    tmp_path: Path, packets: list[bytes], link_type: int, message: str
) -> None:
    path = pcap(tmp_path / "a.pcap", [(k * 1_000_000, p) for k, p in enumerate(packets)], link_type=link_type)
    with pytest.raises(TraceError, match=rf"a\.pcap: .*{message}"):
        read_capture(path, robot())


def test_a_truncated_capture_gives_what_it_holds_and_says_so(tmp_path: Path) -> None:
    path = pcap(tmp_path / "a.pcap", [(k * 1_000_000, passes([Drive()] * 3, index=k)[1]) for k in range(100)])
    path.write_bytes(path.read_bytes()[:-7])
    trace = read_capture(path, robot())

    assert len(trace) == 99
    assert any("cut short" in finding.message for finding in trace.findings)


def test_a_snapped_capture_says_so_and_its_working_counters_are_not_judged(tmp_path: Path) -> None:
    packets = [(k * 1_000_000, passes([Drive()] * 3, index=k)[1]) for k in range(100)]
    path = pcap(tmp_path / "a.pcap", packets, snap=60)
    with pytest.raises(
        TraceError, match=r"; 100 frames are snapped, so not whole: capture again without a snap length$"
    ):
        read_capture(path, robot())
    figures = survey_capture(path)

    assert (figures["snapped_frames"], figures["cut_frames"]) == (100, 100)
    assert (figures["cyclic"][0]["working_counter"], figures["cyclic"][0]["unanswered"]) == (None, 0)


def test_a_capture_that_is_not_there_is_named_and_not_the_target(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match=r"^.*nowhere\.pcap: No such file or directory$"):
        convert_capture(tmp_path / "nowhere.pcap", robot(), tmp_path / "a.mcap", lambda done, size: None)


def test_faults_of_the_bus_are_counted_and_flagged(tmp_path: Path) -> None:
    packets = [(k * 1_000_000, passes([Drive()] * 3, index=k)[1]) for k in range(100)]
    packets[40] = (packets[40][0], passes([Drive()] * 3, working_counter=6)[1])
    packets[60] = (packets[60][0], passes([Drive(status=8), Drive(), Drive()])[1])
    trace = read_capture(pcap(tmp_path / "a.pcap", packets), robot())
    words = " / ".join(finding.message for finding in trace.findings)

    assert np.flatnonzero(trace.flags & SampleFlag.BUS_FAULT).tolist() == [40, 60]
    assert "1 cycles with a working counter too low" in words
    assert "1 cycles with a drive in fault" in words


@pytest.mark.parametrize(
    ("written", "says"),
    [
        (b"\xff" * 500, "no frames; damaged at byte 28: no packet follows frame 0"),
        (b"", "no frames"),
    ],
)
def test_inspect_of_a_capture_without_a_frame_is_an_error(tmp_path: Path, written: bytes, says: str) -> None:
    header = struct.pack("<IIIHHqI", 0x0A0D0D0A, 28, 0x1A2B3C4D, 1, 0, -1, 28)
    (tmp_path / "a.pcapng").write_bytes(header + written)
    result = CliRunner().invoke(app, ["inspect", str(tmp_path / "a.pcapng")])

    assert (result.exit_code, result.stdout) == (1, "0 of 1 file usable, 0 without a finding.\n")
    assert result.stderr == f"deltatwin: {tmp_path / 'a.pcapng'}: {says}\n"


def test_a_capture_without_a_robot_is_one_error(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match=r"a\.pcapng: a capture is read with its robot description"):
        read_trace(tmp_path / "a.pcapng")
