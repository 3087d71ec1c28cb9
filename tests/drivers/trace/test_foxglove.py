"""Joint states as Foxglove writes them, in protobuf and JSON, against its own library."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from drivers.trace.tables import read_table
from drivers.trace.tables.foxglove import decode
from schemas.errors import TraceError

NAMES = ("elbow", "base")


def states(encoding: str, effort: bool = True) -> list[bytes]:
    """Sixty, joints in two orders."""
    made = []
    for k in range(60):
        joints = [
            {"name": name, "position": 0.1 * k + j, "velocity": -0.0} | ({"effort": 2.0 * k - j} if effort else {})
            for j, name in enumerate(NAMES)
        ][:: 1 if k < 30 else -1]
        stamp = {"sec": 1_700_000_000, "nsec": k * 4_000_000}
        if encoding == "json":
            made.append(json.dumps({"timestamp": stamp, "joints": joints}).encode())
            continue
        messages = pytest.importorskip("foxglove.messages")
        one = [messages.JointState(**joint) for joint in joints]
        made.append(messages.JointStates(timestamp=messages.Timestamp(**stamp), joints=one).encode())
    return made


def bag(path: Path, messages: list[bytes], encoding: str, schema: str = "foxglove.JointStates") -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel("/joints", encoding, writer.register_schema(schema, "", b""))
        for k, message in enumerate(messages):
            writer.add_message(channel, k, message, k)
        writer.finish()
    return path


@pytest.mark.parametrize("encoding", ["protobuf", "json"])
def test_joint_states_are_read_by_name(encoding: str, tmp_path: Path) -> None:
    table = read_table(bag(tmp_path / "log.mcap", states(encoding), encoding))
    rows = np.arange(60)
    np.testing.assert_allclose(table.columns["elbow.position"], 0.1 * rows)
    np.testing.assert_allclose(table.columns["base.position"], 0.1 * rows + 1)
    np.testing.assert_allclose(table.columns["base.effort"], 2.0 * rows - 1)
    np.testing.assert_allclose(table.columns["time"], 0.004 * rows, atol=1e-12)
    assert table.epoch_ns == 1_700_000_000_000_000_000
    assert table.units["base.effort"] == "N m"


@pytest.mark.parametrize("encoding", ["protobuf", "json"])
def test_a_field_that_no_joint_has_is_no_column(encoding: str, tmp_path: Path) -> None:
    table = read_table(bag(tmp_path / "log.mcap", states(encoding, effort=False), encoding))
    assert not any("effort" in name for name in table.columns)
    assert "elbow.velocity" in table.columns


def test_joint_states_of_ros_in_json(tmp_path: Path) -> None:
    one = {"header": {"stamp": {"sec": 5, "nanosec": 7}}, "name": list(NAMES), "position": [1.0, 2.0], "effort": [3, 4]}
    found = decode(json.dumps(one).encode(), "json")
    assert (found.stamp, found.names) == (5_000_000_007, list(NAMES))
    assert [values.tolist() for values in found.values] == [[1.0, 2.0], [], [3.0, 4.0]]


@pytest.mark.parametrize(
    ("message", "encoding"),
    [
        (b"[" * 60_000, "json"), (b'{"joints": 3}', "json"), (b'{"name": ["a"], "position": [[]]}', "json"),
        (b'{"name": ["a", "a"]}', "json"), (b"null", "json"), (b'{"joints": [{"name": 3}]}', "json"),
        (b"\x12\x05abc", "protobuf"), (b"\xff" * 30, "protobuf"), (b"\x11\x00", "protobuf"), (b"\x13", "protobuf"),
        (b"\x12\x03\x0a\x01\xff", "protobuf"), (b"\x12\x00" * 100, "protobuf"),
    ],
)  # fmt: skip
def test_what_is_none_is_refused_in_a_line(message: bytes, encoding: str, tmp_path: Path) -> None:
    with pytest.raises(TraceError, match="joint state 1 is not whole") as said:
        read_table(bag(tmp_path / "log.mcap", [message], encoding))
    assert "\n" not in str(said.value)


def test_an_encoding_that_is_not_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match="/joints is in flatbuffer; protobuf, json are read"):
        read_table(bag(tmp_path / "log.mcap", [b"1234"], "flatbuffer"))
    with pytest.raises(TraceError, match="/joints is in cdr; protobuf, json are read"):
        read_table(bag(tmp_path / "log.mcap", [b"1234"], "cdr"))


def test_a_dump_of_states_goes_by_names_and_by_its_whole_stamp(tmp_path: Path) -> None:
    """A line a message: the rest of a second, alone, is no clock."""
    path = tmp_path / "dump.jsonl"
    path.write_bytes(b"\n".join(states("json")))
    table = read_table(path)
    np.testing.assert_allclose(table.columns["joints.base.position"], 0.1 * np.arange(60) + 1)
    np.testing.assert_allclose(table.columns["timestamp"], 0.004 * np.arange(60), atol=1e-12)
    assert table.epoch_ns == 1_700_000_000_000_000_000
    ros = [{"name": ["b", "a"], "position": [1, 2], "effort": [3, 4], "t": k} for k in range(9)]
    (tmp_path / "ros.json").write_text(json.dumps(ros))
    assert read_table(tmp_path / "ros.json").columns["a.effort"].tolist() == [4.0] * 9


def test_texts_that_name_joints_in_a_table(tmp_path: Path) -> None:
    """As `rostopic echo -p` writes them."""
    head = "%time,field.name0,field.name1,field.position0,field.position1,field.effort0,field.effort1"
    rows = [f"{k},zed,alpha,{k}.5,{k}.25,1.5,2.5" for k in range(20)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([head, *rows]))
    assert read_table(path).paths == {
        "field.position0": "zed", "field.effort0": "zed", "field.position1": "alpha", "field.effort1": "alpha"
    }  # fmt: skip
    path.write_text("\n".join([head, *rows, "20,alpha,zed,1,2,3,4"]))
    with pytest.raises(TraceError, match=r"'field.name0' names several joints"):
        read_table(path)
