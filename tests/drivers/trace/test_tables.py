"""Foreign files, written here by other libraries or by hand, come back as the numbers that were put in."""

from __future__ import annotations

import json
import sqlite3
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from mcap.writer import Writer

from drivers.trace import read_trace
from drivers.trace.tables import joined, read_table
from schemas.columns import Columns
from schemas.errors import TraceError
from tests.drivers.trace.headers import codesys_trace, kuka_header

TIME = np.arange(300) / 500
POSITION = 0.4 * np.sin(2 * np.pi * TIME)[:, None] + [0.1, 0.2, 0.3]
TORQUE = 8.0 * np.cos(2 * np.pi * TIME)[:, None] + [1.0, 2.0, 3.0]
BLOCK = np.column_stack([TIME, POSITION, TORQUE])
NAMES = ["t", "q1", "q2", "q3", "m1", "m2", "m3"]


def mapping(**more: Any) -> Columns:
    return Columns.model_validate({"time": "t", "position": "q{joint}", "torque": "m{joint}", **more})


def comes_back(path: Path, columns: Columns) -> None:
    trace = read_trace(path, columns=columns)
    np.testing.assert_allclose(trace.time - trace.time[0], TIME, atol=1e-9)
    np.testing.assert_allclose(trace.position, POSITION, atol=1e-9)
    np.testing.assert_allclose(trace.torque, TORQUE, atol=1e-9)


def test_npy_of_rows_or_columns(tmp_path: Path) -> None:
    numbered = Columns.model_validate({"time": "1", "position": ["2", "3", "4"], "torque": ["5", "6", "7"]})
    for name, array in (("rows", BLOCK.T), ("columns", BLOCK)):
        np.save(tmp_path / f"{name}.npy", array)
        comes_back(tmp_path / f"{name}.npy", numbered)


def test_npz_by_name(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", t=TIME, q=POSITION, m=TORQUE.T, rate=500.0)
    comes_back(tmp_path / "log.npz", mapping(position="q_{joint}", torque="m_{joint}"))


def test_mat_with_structures(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "log.mat", {"log": {"t": TIME, "q": POSITION, "m": TORQUE}, "note": "text"})
    comes_back(tmp_path / "log.mat", mapping(time="log.t", position="log.q_{joint}", torque="log.m_{joint}"))


def test_json_records_inside_an_object_and_by_the_line(tmp_path: Path) -> None:
    records = [dict(zip(NAMES, row, strict=True)) | {"on": True} for row in BLOCK.tolist()]
    (tmp_path / "log.json").write_text(json.dumps({"robot": "d3", "entries": records}))
    (tmp_path / "log.jsonl").write_text("\n".join(map(json.dumps, records)))
    (tmp_path / "lists.json").write_text(json.dumps({n: BLOCK[:, k].tolist() for k, n in enumerate(NAMES)}))
    for name in ("log.json", "log.jsonl", "lists.json"):
        comes_back(tmp_path / name, mapping())


def joint_state(row: np.ndarray) -> bytes:
    """One `sensor_msgs/JointState` in CDR, of joints a, bb, ccc, without velocities."""
    out = struct.pack("<4xII", int(row[0]), round(row[0] % 1 * 1e9))[4:]
    out += struct.pack("<I5s3x", 5, b"base\0")
    out += struct.pack("<I", 3)
    for name in (b"a\0", b"bb\0", b"ccc\0"):
        out += b"\0" * (-len(out) % 4) + struct.pack("<I", len(name)) + name
    for values in (row[1:4], row[:0], row[4:7]):
        out += b"\0" * (-len(out) % 4) + struct.pack("<I", len(values))
        out += (b"\0" * (-len(out) % 8) if len(values) else b"") + values.astype("<f8").tobytes()
    return b"\0\1\0\0" + out


JOINT_STATES = {
    "time": "time",
    "position": ["a.position", "bb.position", "ccc.position"],
    "torque": ["a.effort", "bb.effort", "ccc.effort"],
}


def test_rosbag2_of_either_storage(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "bag.db3") as bag:
        bag.execute("CREATE TABLE topics(id INTEGER, name TEXT, type TEXT, serialization_format TEXT)")
        bag.execute("CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        bag.execute("INSERT INTO topics VALUES (1, '/tf', 'tf2_msgs/msg/TFMessage', 'cdr')")
        bag.execute("INSERT INTO topics VALUES (2, '/joint_states', 'sensor_msgs/msg/JointState', 'cdr')")
        for k, row in enumerate(BLOCK):
            bag.execute("INSERT INTO messages VALUES (?, 2, ?, ?)", (k, k, joint_state(row)))
    with (tmp_path / "bag.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", b"")
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for k, row in enumerate(BLOCK):
            writer.add_message(channel, k, joint_state(row), k)
        writer.finish()
    for name in ("bag.db3", "bag.mcap"):
        comes_back(tmp_path / name, Columns.model_validate(JOINT_STATES))
    cut = joint_state(BLOCK[0])[:-3]
    with sqlite3.connect(tmp_path / "bag.db3") as bag:
        bag.execute("UPDATE messages SET data = ? WHERE id = 7", (cut,))
    with pytest.raises(TraceError, match=r"bag\.db3: joint state 8 is not whole"):
        read_table(tmp_path / "bag.db3")


def test_kuka_trace_header_and_blocks(tmp_path: Path) -> None:
    BLOCK[:, 1:].astype("<f8").tofile(tmp_path / "pick_KRCIpo.r64")
    header = kuka_header(NAMES[1:], "Zeit", "PICK_KRCIpo.R64", 300)
    (tmp_path / "pick_KRCIpo.dat").write_text(header, encoding="latin-1", newline="")
    comes_back(tmp_path / "pick_KRCIpo.dat", mapping(time="Zeit"))
    assert read_table(tmp_path / "pick_KRCIpo.dat").units["q1"] == "°"
    (tmp_path / "pick_KRCIpo.r64").write_bytes(b"\0" * 800)
    with pytest.raises(TraceError, match=r"channel 'q1': ValueError PICK_KRCIpo\.R64 holds 17 of its 300 values"):
        read_table(tmp_path / "pick_KRCIpo.dat")


def test_codesys_as_its_editor_saves_it(tmp_path: Path) -> None:
    signals = {f"PLC_PRG.{name}": BLOCK[:, k].tolist() for k, name in enumerate(NAMES[1:], 1)}
    lines, xml = codesys_trace(signals, TIME)
    (tmp_path / "log.csv").write_text(lines)
    (tmp_path / "log.trace").write_text(xml, encoding="utf-16")
    text = ["Editor V3.5 Trace: Trace", r"C:\robot.project", "Timestamp(us) " + " ".join(NAMES[1:])]
    text += [" ".join([str(round(row[0] * 1e6)), *map(repr, row[1:])]) for row in BLOCK.tolist()]
    (tmp_path / "log.txt").write_text("\r\n".join(text) + "\r\n")
    for name in ("log.csv", "log.trace"):
        table = read_table(tmp_path / name)
        assert table.kind == "CODESYS trace"
        assert table.units["time"] == "us"
        np.testing.assert_allclose(table.columns["time"] * 1e-6, TIME, atol=1e-9)
        np.testing.assert_array_equal(table.columns["PLC_PRG.m2"], TORQUE[:, 1])
    prefixed = {"position": "PLC_PRG.q{joint}", "torque": "PLC_PRG.m{joint}", "time": {"name": "time", "unit": "us"}}
    comes_back(tmp_path / "log.trace", Columns.model_validate(prefixed))
    table = read_table(tmp_path / "log.txt")
    comes_back(tmp_path / "log.txt", mapping(time={"name": "Timestamp(us)", "unit": "us"}, **table.layout))


@pytest.mark.parametrize(
    ("separator", "decimal", "head"),
    [(",", ".", ""), (";", ",", "Export of line 4\n\n"), ("\t", ".", ""), ("\t", ",", ""), (" ", ".", "")],
)
def test_layout_of_a_plain_table_is_found(tmp_path: Path, separator: str, decimal: str, head: str) -> None:
    rows = "".join(separator.join(map(repr, row)).replace(".", decimal) + "\n" for row in BLOCK.tolist())
    for header in (True, False):
        path = tmp_path / f"log_{header}.csv"
        path.write_text(head + (separator.join(NAMES) + "\n" if header else "") + rows)
        table = read_table(path)
        assert list(table.columns) == (NAMES if header else ["1", "2", "3", "4", "5", "6", "7"])
        np.testing.assert_array_equal(np.column_stack(list(table.columns.values())), BLOCK)
        names: dict[str, Any] = {"time": "1", "position": ["2", "3", "4"], "torque": ["5", "6", "7"]}
        comes_back(
            path,
            Columns.model_validate(
                (mapping().model_dump(exclude_unset=True) if header else names) | dict(table.layout)
            ),
        )


def test_units_below_the_names_and_latin_1_are_found(tmp_path: Path) -> None:
    rows = "".join(";".join(map(repr, row)) + "\n" for row in BLOCK.tolist())
    (tmp_path / "log.csv").write_text(";".join(NAMES) + "\n[s];°;°;°;Nm;Nm;Nm\n" + rows, encoding="latin-1")
    table = read_table(tmp_path / "log.csv")
    assert [table.units[name] for name in ("t", "q1", "m3")] == ["s", "°", "Nm"]
    assert table.layout["encoding"] == "latin-1"


def test_dates_flags_products_percent_and_unsigned(tmp_path: Path) -> None:
    """Time of day, rows where the drive is on, duty times voltage, per cent of rated, 16 bits meant signed."""
    names = ["when", "on", *NAMES[1:], "volts"]
    stamps = [f"22.11.2026 09:30:{second:06.3f}" for second in TIME]
    rows = []
    for k, row in enumerate(BLOCK):
        counts = np.round(row[1:4] / (2 * np.pi) * 4096).astype(int) % 65536
        percent = row[4:7] / 24.0 / 20.0 * 100
        rows.append(";".join(map(str, [stamps[k], "TRUE" if k >= 100 else "FALSE", *counts, *percent, 24.0])))
    path = tmp_path / "log.csv"
    path.write_text(";".join(names) + "\n" + "\n".join(rows) + "\n")
    table = read_table(path)
    assert table.units["when"] == "datetime"
    np.testing.assert_allclose(table.columns["when"], TIME, atol=1e-6)
    columns = mapping(
        separator=";",
        time={"name": "when", "unit": "datetime"},
        position={"name": "q{joint}", "unit": "counts", "counts_per_rev": 4096, "bits": 16},
        torque={"name": "m{joint}", "unit": "percent", "rated": 20.0, "times": "volts"},
    )
    trace = read_trace(path, columns=columns)
    np.testing.assert_allclose(trace.torque, TORQUE, atol=1e-9)
    np.testing.assert_allclose(trace.position, POSITION, atol=np.pi / 4096)
    np.testing.assert_allclose(trace.time, TIME, atol=1e-6)
    assert trace.epoch_ns == np.datetime64("2026-11-22T09:30:00", "ns").astype(int)
    where = {"name": "on", "equals": 1.0}
    text = path.read_text().replace("TRUE", "1").replace("FALSE", "0")
    path.write_text(text)
    kept = read_trace(path, columns=columns.model_copy(update={"where": Columns(where=where).where}))  # pyright: ignore[reportArgumentType]
    assert len(kept) == 200
    assert "100 of 300 rows do not have 1 in column 'on' and were left out" in [f.message for f in kept.findings]


@pytest.mark.parametrize(
    ("form", "hours"),
    [("2026-11-22T{}Z", 0), ("2026-11-22 {}+02:00", 2), ("22.11.2026 {} -0130", -1.5), ("2026/11/22 {}", 0)],
)
def test_a_zone_behind_the_time_of_day_counts(tmp_path: Path, form: str, hours: float) -> None:
    rows = [",".join(map(str, [form.format(f"09:30:{row[0]:09.6f}"), *row[1:]])) for row in BLOCK.tolist()]
    (tmp_path / "log.csv").write_text(",".join(NAMES) + "\n" + "\n".join(rows) + "\n")
    trace = read_trace(tmp_path / "log.csv", columns=mapping(time={"name": "t", "unit": "datetime"}))
    np.testing.assert_allclose(trace.time, TIME, atol=1e-6)
    assert trace.epoch_ns / 1e9 == np.datetime64("2026-11-22T09:30:00").astype(int) - 3600 * hours


def test_files_side_by_side_at_a_stated_rate(tmp_path: Path) -> None:
    for name, values in (("position", POSITION), ("current", TORQUE)):
        text = "J1,J2,J3\n" + "".join(",".join(map(repr, row)) + "\n" for row in values.tolist())
        (tmp_path / f"{name}.csv").write_text(text)
    both = joined([read_table(tmp_path / "position.csv"), read_table(tmp_path / "current.csv")])
    assert list(both.columns) == ["J1", "J2", "J3", "current:J1", "current:J2", "current:J3"]
    columns = Columns.model_validate(
        {"time": {"rate_hz": 500}, "position": "J{joint}", "torque": "current:J{joint}", "beside": ["current.csv"]}
    )
    comes_back(tmp_path / "position.csv", columns)
    (tmp_path / "current.csv").write_text("J1,J2,J3\n1,2,3\n4,5,6\n")
    with pytest.raises(TraceError, match=r"current\.csv: 2 rows, but position\.csv has 300"):
        read_trace(tmp_path / "position.csv", columns=columns)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.npy", b"\x93NUMPY\x01\x00garbage"),
        ("a.npz", b"PK\x03\x04 nothing"),
        ("a.mat", b"MATLAB 5.0 MAT-file" + bytes(200)),
        ("a.json", b'{"a": [1, 2'),
        ("a.json", b"[" * 100_000),
        ("a.json", b'{"robot": "d3"}'),
        ("a.db3", b"SQLite format 3\0" + bytes(200)),
        ("a.dat", b"no header"),
        ("a.trace", b"<Trace><TraceData/></Trace>"),
        ("a.xml", b'<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>'),
        ("a.csv", b"only words\nand more words\n"),
        ("a.csv", codesys_trace({"a": [0.0]}, TIME[:1])[0].replace("Flags; 32", "Flags; " + "9" * 5000).encode()),
    ],
)
def test_damaged_files_are_one_line_that_names_them(tmp_path: Path, name: str, data: bytes) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(TraceError, match=name.replace(".", r"\.")) as told:
        read_table(tmp_path / name)
    assert "\n" not in str(told.value)


def test_a_length_in_a_bag_that_sqlite_takes_for_more_than_memory(tmp_path: Path) -> None:
    """Eight bytes made the greatest number, anywhere: one line at most, also where SQLite wants too much memory."""
    bag = sqlite3.connect(tmp_path / "whole.db3")
    bag.execute("PRAGMA page_size = 512")
    bag.execute("CREATE TABLE topics(id INTEGER, name TEXT, type TEXT, serialization_format TEXT)")
    bag.execute("CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB)")
    bag.execute("INSERT INTO topics VALUES (2, '/joint_states', 'sensor_msgs/msg/JointState', 'cdr')")
    bag.execute("INSERT INTO messages VALUES (0, 2, 0, ?)", (bytes(100),))
    bag.commit()
    bag.close()
    whole, told = (tmp_path / "whole.db3").read_bytes(), set[str]()
    for at in range(0, len(whole) - 8, 3):
        (tmp_path / "a.db3").write_bytes(whole[:at] + b"\xff" * 7 + b"\x7f" + whole[at + 8 :])
        try:
            read_table(tmp_path / "a.db3")
        except TraceError as error:
            told.add(str(error))
    assert all("\n" not in line and "a.db3: " in line for line in told)
    assert any("longer than memory" in line for line in told)


def test_mat_with_data_of_no_type_is_refused_before_scipy_crashes(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "log.mat", {"t": TIME})
    data = bytearray((tmp_path / "log.mat").read_bytes())
    at = data.index(struct.pack("<II", 9, 8 * len(TIME)))
    for kind in (8, 14, 200):
        data[at] = kind
        (tmp_path / "log.mat").write_bytes(data)
        with pytest.raises(TraceError, match=rf"log\.mat: .*element of type {kind} and 2400 bytes"):
            read_table(tmp_path / "log.mat")


def test_mat_with_an_array_that_lacks_a_part_is_refused_before_scipy_crashes(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "log.mat", {"q": TIME, "z": TIME * 1j})
    data = bytearray((tmp_path / "log.mat").read_bytes())
    assert read_table(tmp_path / "log.mat").columns
    data[data.index(b"\1\0\1\0q") - 23] |= 0x08  # complex: what follows would be taken for the imaginary part
    (tmp_path / "log.mat").write_bytes(data)
    with pytest.raises(TraceError, match=r"log\.mat: .*array of 4 parts at byte \d+, some are missing"):
        read_table(tmp_path / "log.mat")


def test_matlab_7_3_says_how_to_save_it(tmp_path: Path) -> None:
    (tmp_path / "log.mat").write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64" + bytes(600))
    with pytest.raises(TraceError, match=r"save\('log\.mat', \.\.\., '-v7'\)"):
        read_table(tmp_path / "log.mat")


def test_without_a_mapping_import_is_named(tmp_path: Path) -> None:
    np.save(tmp_path / "log.npy", BLOCK)
    with pytest.raises(TraceError, match=r"log\.npy: .*deltatwin import log\.npy"):
        read_trace(tmp_path / "log.npy")


def test_twincat_export_with_decimal_comma(data: Path) -> None:
    for name, decimal in (("default", ","), ("decimal_comma", ",")):  # both are German
        table = read_table(data / "captures" / f"twincat_scope_{name}.csv")
        assert table.kind == "TwinCAT Scope export"
        assert (table.layout["decimal"], table.layout["header_line"], table.layout["data_line"]) == (decimal, 7, 25)
        assert table.time_of["func_OS"].startswith("Name")


def test_real_bag_of_joint_states(data: Path) -> None:
    table = read_table(data / "real" / "ur10_unisa" / "ur10_exciting_trajectory.db3")
    assert len(table) == 3441
    np.testing.assert_allclose(np.diff(table.columns["time"]), 0.008, atol=1e-6)
    assert table.units["elbow_joint.effort"] == "N m"
    assert np.abs(table.columns["shoulder_lift_joint.effort"]).max() > 100  # gravity of the arm, N m
