"""Every kind of bad trace: a clear error where the file is unusable, a flag and a line number where a row is."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from drivers.trace import read_trace, write_trace
from schemas.errors import TraceError
from schemas.messages import SAMPLE, SampleFlag
from schemas.robot import load_robot
from schemas.trace import Trace

Lines = list[str]


def spoil(path: Path, change: Callable[[Lines], None]) -> Path:
    lines = path.read_text().splitlines()
    change(lines)
    path.write_text("\n".join(lines) + "\n")
    return path


def field(lines: Lines, line: int, column: int, value: str) -> None:
    """Overwrite one cell; `line` counts from 1, as in the message."""
    fields = lines[line - 1].split(",")
    fields[column] = value
    lines[line - 1] = ",".join(fields)


def flagged(trace: Trace, flag: SampleFlag) -> list[int]:
    """Lines of the file (row + 2) that carry `flag`."""
    return (np.flatnonzero(trace.flags & flag) + 2).tolist()


def messages(trace: Trace) -> str:
    return " | ".join(f.message for f in trace.findings)


@pytest.mark.parametrize("value", ["nan", "NaN", "", " ", "inf", "-inf", "NULL"])
def test_not_a_number_is_flagged_and_kept(own_csv: Path, value: str) -> None:
    def change(lines: Lines) -> None:
        field(lines, 17, 2, value)
        field(lines, 40, 5, value)

    trace = read_trace(spoil(own_csv, change))
    assert flagged(trace, SampleFlag.NOT_A_NUMBER) == [17, 40]
    assert len(trace) == 200
    assert not np.isfinite(trace.position[15, 1])
    assert not np.isfinite(trace.torque[38, 1])
    assert "position of joint 2: 1 value missing or not finite: line 17" in messages(trace)
    assert "torque of joint 2: 1 value missing or not finite: line 40" in messages(trace)
    assert (trace.samples()["flags"] == trace.flags).all()


def test_every_line_is_counted_and_the_first_five_are_named(own_csv: Path) -> None:
    def change(lines: Lines) -> None:
        for line in (20, 30, 40, 50, 60, 70, 80):
            field(lines, line, 6, "nan")

    trace = read_trace(spoil(own_csv, change))
    assert flagged(trace, SampleFlag.NOT_A_NUMBER) == [20, 30, 40, 50, 60, 70, 80]
    assert "torque of joint 3: 7 values missing or not finite: lines 20, 30, 40, 50, 60, ..." in messages(trace)


def test_time_going_back(own_csv: Path) -> None:
    trace = read_trace(spoil(own_csv, lambda lines: field(lines, 100, 0, "0.050")))
    assert flagged(trace, SampleFlag.TIME_BACKWARDS) == [100]
    assert trace.time[98] == 0.05
    assert flagged(trace, SampleFlag.GAP_BEFORE) == [101]  # the stamp 0.098 is missing
    assert "time goes back 1 time: line 100 (0.05 s after 0.097 s)" in messages(trace)


def test_repeated_stamps(own_csv: Path) -> None:
    def change(lines: Lines) -> None:
        lines[60:60] = [lines[59], lines[59]]

    trace = read_trace(spoil(own_csv, change))
    assert flagged(trace, SampleFlag.REPEATED) == [61, 62]
    assert len(trace) == 202
    assert "stamp or sequence number repeated 2 times: lines 61, 62 (0.058 s)" in messages(trace)


def test_a_gap(own_csv: Path) -> None:
    trace = read_trace(spoil(own_csv, lambda lines: lines.__delitem__(slice(80, 90))))
    assert flagged(trace, SampleFlag.GAP_BEFORE) == [81]
    assert flagged(trace, SampleFlag.JUMP) == []  # ten cycles of motion are no jump
    assert "1 gap, 10 cycles of 1 ms missing: before line 81 (longest 11 ms)" in messages(trace)


def test_jitter_is_no_gap(own_csv: Path) -> None:
    rng = np.random.default_rng(3)

    def change(lines: Lines) -> None:
        for line in range(2, 202):
            field(lines, line, 0, f"{(line - 2) / 1000 + rng.uniform(0, 4e-4):.6f}")

    assert not read_trace(spoil(own_csv, change)).findings


def test_a_jump(own_csv: Path) -> None:
    trace = read_trace(spoil(own_csv, lambda lines: field(lines, 120, 3, "0.75")))
    assert flagged(trace, SampleFlag.JUMP) == [120, 121]  # there and back
    assert trace.position[118, 2] == 0.75
    assert "position of joint 3 jumps 2 times" in messages(trace)
    assert "lines 120, 121 (from 0.89697 to 0.75)" in messages(trace)


def test_positions_out_of_range(own_csv: Path, tmp_path: Path, robot_text: str) -> None:
    trace = read_trace(spoil(own_csv, lambda lines: field(lines, 120, 1, "2.9")))
    assert flagged(trace, SampleFlag.OUT_OF_RANGE) == [120]
    (tmp_path / "r.toml").write_text(robot_text.replace("[mass]", "joint_range_rad = [-1.0, 0.86]\n[mass]"))
    trace = read_trace(own_csv, load_robot(tmp_path / "r.toml"))
    lines = flagged(trace, SampleFlag.OUT_OF_RANGE)
    assert 120 in lines
    assert lines == (np.flatnonzero((trace.position > 0.86).any(axis=1)) + 2).tolist()


def test_degrees_for_radians(own_csv: Path) -> None:
    def change(lines: Lines) -> None:
        for line in range(2, 202):
            for column in (1, 2, 3):
                field(lines, line, column, f"{np.degrees(float(lines[line - 1].split(',')[column])):.4f}")

    message = (
        r"own\.csv: position of joint 1: 200 of 200 samples out of range, degrees for radians\? "
        r"\(5\.7296 to 40\.\d+ rad, joint range -1\.6 to 2\.2 rad; first at line 2: 5\.7296\)"
    )
    with pytest.raises(TraceError, match=message):
        read_trace(spoil(own_csv, change))


@pytest.mark.parametrize("cut", [1, 2, 3, 5, 9, 20, 45, 75])
def test_a_last_line_cut_anywhere_is_left_out_and_told(own_csv: Path, cut: int) -> None:
    raw = own_csv.read_bytes()
    whole = read_trace(own_csv)
    own_csv.write_bytes(raw[:-cut])
    trace = read_trace(own_csv)
    if cut == 1:  # only the newline is gone: the row is whole
        assert trace.samples().tobytes() == whole.samples().tobytes()
        assert not trace.findings
    else:
        assert trace.samples().tobytes() == whole.samples()[: len(trace)].tobytes()
        assert len(trace) == raw[:-cut].count(b"\n") - 1
        assert f"the last line ({len(trace) + 2}) is cut off" in messages(trace)


def test_a_missing_column(own_csv: Path) -> None:
    def change(lines: Lines) -> None:
        for i, line in enumerate(lines):
            lines[i] = ",".join(line.split(",")[:5] + line.split(",")[6:])

    with pytest.raises(
        TraceError, match=r"own\.csv: column 'torque_2_nm' is missing; line 1 has: time_s, position_1_rad.*--columns"
    ):
        read_trace(spoil(own_csv, change))


def test_a_column_twice(own_csv: Path) -> None:
    with pytest.raises(TraceError, match="column 'torque_2_nm' is there twice"):
        read_trace(spoil(own_csv, lambda lines: field(lines, 1, 6, "torque_3_nm,torque_2_nm")))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda lines: field(lines, 90, 4, "abc"), r"own\.csv: line 90, column 'torque_1_nm': 'abc' is not a number"),
        (lambda lines: field(lines, 90, 4, "1_0"), r"own\.csv: line 90, column 'torque_1_nm': '1_0' is not a number"),
        (lambda lines: field(lines, 90, 0, "0:12"), r"own\.csv: line 90, column 'time_s': '0:12' is not a number"),
        (lambda lines: lines.__setitem__(1, "0,1,1,1"), r"own\.csv: line 2 has 4 fields, the header has 7"),
        (lambda lines: field(lines, 90, 4, "1,5"), r"own\.csv: line 90 has 8 fields, the header has 7"),
    ],
)
def test_text_and_extra_fields_name_their_cell(own_csv: Path, change: Callable[[Lines], None], message: str) -> None:
    with pytest.raises(TraceError, match=message):
        read_trace(spoil(own_csv, change))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le"])
def test_the_texts_that_windows_writes_are_read(own_csv: Path, encoding: str) -> None:
    plain = read_trace(own_csv)
    mark = "\ufeff" if encoding == "utf-16-le" else ""
    own_csv.write_bytes((mark + own_csv.read_text()).replace("\n", "\r\n").encode(encoding))
    np.testing.assert_array_equal(read_trace(own_csv).torque, plain.torque)


def test_rows_without_a_stamp_and_blank_lines_are_left_out_and_told(own_csv: Path) -> None:
    def change(lines: Lines) -> None:
        field(lines, 50, 0, "")
        lines[99] = ""
        lines.extend(["", ""])  # behind the last row: the end of the file, not a row

    trace = read_trace(spoil(own_csv, change))
    assert len(trace) == 198
    assert "left out 2 rows without a possible time stamp: lines 50, 100" in messages(trace)
    assert "2 gaps, 2 cycles of 1 ms missing: before lines 51, 101" in messages(trace)


def test_a_stamp_that_no_clock_gives_is_left_out_and_told(own_csv: Path) -> None:
    def change(lines: Lines) -> None:
        field(lines, 50, 0, "1e308")

    trace = read_trace(spoil(own_csv, change))
    assert "left out 1 row without a possible time stamp: line 50" in messages(trace)
    assert np.all(np.diff(trace.time_ns) > 0)


def test_time_that_does_not_rise(own_csv: Path) -> None:
    def change(lines: Lines) -> None:
        for line in range(2, 202):
            field(lines, line, 0, "0.0")

    with pytest.raises(
        TraceError, match=r"time does not rise from row to row \(199 of 199 steps; first at line 3: 0 s"
    ):
        read_trace(spoil(own_csv, change))


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", b"", "a.csv: empty file"),
        ("a.csv", b"\n \n", "a.csv: empty file"),
        ("a.csv", b"time_s,position_1_rad\n", "no data rows: the file ends before line 2"),
        ("a.csv", b"\x7fELF\x02\x01\x01\x00\x00", "not a text table: zero byte at offset 7"),
        ("a.csv", b"PK\x03\x04\x14\x00", "an Excel file or an archive, save it as CSV"),
        ("a.csv", bytes(range(1, 256)) * 40, "is missing|is not utf-8 text"),
        ("a.csv.gz", b"\x1f\x8b\x08 broken", "broken gzip file"),
        ("a.csv.gz", gzip.compress(b"time_s\n0\n" * 1000, mtime=0)[:-20], "broken gzip file"),
        ("a.mcap", b"", "not an MCAP file"),
        ("a.mcap", b"\x7fELF" * 100, "not an MCAP file: it does not start like one$"),
        ("a.docx", b"x", "unknown kind of trace: its name must end in"),
    ],
)
def test_unusable_files(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(TraceError, match=message):
        read_trace(tmp_path / name)


@pytest.mark.parametrize("name", ["none.csv", "none.mcap", "none"])
def test_no_such_file(tmp_path: Path, name: str) -> None:
    with pytest.raises(TraceError, match=rf"{name}: No such file or directory"):
        read_trace(tmp_path / name)


def test_one_row_is_no_trace(own_csv: Path) -> None:
    with pytest.raises(TraceError, match="1 sample, at least 2 are needed"):
        read_trace(spoil(own_csv, lambda lines: lines.__delitem__(slice(2, None))))


def write_messages(path: Path, channels: dict[str, list[bytes]], schema_text: str = SAMPLE.schema_text) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema(SAMPLE.schema_name, "ros2msg", schema_text.encode())
        for topic, payloads in channels.items():
            channel = writer.register_channel(topic, "cdr", schema)
            for i, payload in enumerate(payloads):
                writer.add_message(channel, i, payload, i)
        writer.finish()


def payloads(own_csv: Path) -> list[bytes]:
    return [record.tobytes() for record in read_trace(own_csv).samples()]


def test_mcap_with_foreign_messages(own_csv: Path, tmp_path: Path) -> None:
    good, path = payloads(own_csv), tmp_path / "a.mcap"
    short = [*good[:7], good[7][:-8], *good[8:]]
    write_messages(path, {"/deltatwin/d3/sample": short})
    with pytest.raises(TraceError, match=r"message 8 on /deltatwin/d3/sample has \d+ bytes, expected \d+"):
        read_trace(path)
    shifted = [*good[:7], good[7][:-8], good[8] + b"\0" * 8, *good[9:]]  # the sum of the sizes is right
    write_messages(path, {"/deltatwin/d3/sample": shifted})
    with pytest.raises(TraceError, match="message 8 on /deltatwin/d3/sample has"):
        read_trace(path)
    write_messages(path, {"/deltatwin/d3/sample": [*good[:3], b"\1" + good[3][1:], *good[4:]]})
    with pytest.raises(TraceError, match="message 4 on /deltatwin/d3/sample has CDR header 01010000"):
        read_trace(path)
    write_messages(path, {"/joint_states": good})
    with pytest.raises(TraceError, match=r"no /deltatwin/<robot>/sample topic \(topics: /joint_states\)"):
        read_trace(path)
    write_messages(path, {"/deltatwin/d3/sample": []})
    with pytest.raises(TraceError, match="no messages on /deltatwin/d3/sample"):
        read_trace(path)
    write_messages(path, {"/deltatwin/d3/sample": good}, "float64 x\n")
    with pytest.raises(TraceError, match="is not deltatwin_msgs/msg/Sample in cdr"):
        read_trace(path)


def test_mcap_of_two_robots_needs_a_name(own_csv: Path, tmp_path: Path, robot_text: str) -> None:
    good, path = payloads(own_csv), tmp_path / "a.mcap"
    write_messages(path, {"/deltatwin/d3/sample": good, "/deltatwin/d_4/sample": good[:50]})
    with pytest.raises(TraceError, match=r"samples of several robots \(d3, d_4\): give --robot"):
        read_trace(path)
    (tmp_path / "r.toml").write_text(robot_text.replace('"d3"', '"d-4"'))
    assert len(read_trace(path, load_robot(tmp_path / "r.toml"))) == 50


def test_mcap_cut_short_points_to_recover(own_csv: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write_trace(read_trace(own_csv), path, "d3")
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(TraceError, match=r"deltatwin recover .*a\.mcap"):
        read_trace(path)


def test_mcap_keeps_disorder_and_recorded_flags(own_csv: Path, tmp_path: Path) -> None:
    trace = read_trace(own_csv)
    sequence = np.arange(200, dtype=np.uint64)
    sequence[100:] += 3  # lost on the bus, the stamps show it too
    time = trace.time + 3e-3 * (np.arange(200) >= 100)
    time[150], time[151] = time[151], time[150]
    flags = trace.flags.copy()
    flags[10] = SampleFlag.BUS_FAULT
    write_trace(replace(trace, time=time, sequence=sequence, flags=flags), tmp_path / "a.mcap", "d3")
    read = read_trace(tmp_path / "a.mcap")
    assert np.array_equal(read.time_ns, np.rint(time * 1e9))  # in the order of writing, not sorted
    assert read.flags[10] == SampleFlag.BUS_FAULT
    assert np.flatnonzero(read.flags & SampleFlag.GAP_BEFORE).tolist() == [100, 150]
    assert np.flatnonzero(read.flags & SampleFlag.TIME_BACKWARDS).tolist() == [151]
    assert "2 gaps, 4 cycles of 1 ms missing: before messages 101, 151 (longest 4 ms)" in messages(read)


def test_samples_of_an_axis_that_is_no_delta(data: Path) -> None:
    from drivers.trace import find_columns

    trace = read_trace(data / "real/emps/emps.csv", columns=find_columns("emps"))
    with pytest.raises(TraceError, match="1 joints, a sample message holds 3"):
        trace.samples()


def test_a_folder_that_holds_no_recording_is_told_as_one(tmp_path: Path) -> None:
    with pytest.raises(
        TraceError, match=r"a folder without \.db3, \.mcap or \.bag is not a rosbag: give the logs in it"
    ):
        read_trace(tmp_path)
