"""Bags of ROS as recorders write them: split, packed, of several publishers, of ROS 1; and those that lie."""

from __future__ import annotations

import sqlite3
import struct
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore

from drivers.trace.tables import read_table
from drivers.trace.tables.bag_files import _allowed, _Clock, _rows, parts_of
from schemas.errors import TraceError

TYPE = "sensor_msgs/msg/JointState"
ROS2, ROS1 = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS1_NOETIC)
PERIOD_NS = 4_000_000
START_NS = 1_700_000_000 * 10**9


def state(
    k: int, names: Sequence[str] = ("pan", "lift"), effort: bool = True, stamped: bool = True, ros1: bool = False
) -> bytes:
    """A joint state by another hand: joint `pan` stands at k, `lift` at -k, and so on; its torque is ten times that."""
    types, sequence = ROS1.types if ros1 else ROS2.types, {"seq": k} if ros1 else {}
    sign = {"pan": 1.0, "lift": -1.0, "finger": 0.5}
    position = np.array([sign[name] * k for name in names])
    nanoseconds = START_NS + k * PERIOD_NS if stamped else 0
    message = types[TYPE](
        header=types["std_msgs/msg/Header"](
            stamp=types["builtin_interfaces/msg/Time"](sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9),
            frame_id="",
            **sequence,
        ),
        name=list(names),
        position=position,
        velocity=np.zeros(0),
        effort=10 * position if effort else np.zeros(0),
    )
    return bytes(ROS1.serialize_ros1(message, TYPE) if ros1 else ROS2.serialize_cdr(message, TYPE))


def mcap(path: Path, messages: Iterable[tuple[int, bytes]], topics: Sequence[str] = ("/joint_states",)) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema(TYPE, "ros2msg", b"")
        channels = [writer.register_channel(topic, "cdr", schema) for topic in topics]
        for k, data in messages:
            for channel in channels:
                writer.add_message(channel, START_NS + k * PERIOD_NS, data, START_NS + k * PERIOD_NS)
        writer.finish()
    return path


def db3(path: Path, messages: Iterable[tuple[int, bytes]]) -> Path:
    with sqlite3.connect(path) as bag:
        bag.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        bag.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        bag.execute("INSERT INTO topics VALUES (1, '/joint_states', ?, 'cdr')", (TYPE,))
        bag.executemany("INSERT INTO messages VALUES (?, 1, ?, ?)", ((k + 1, k, data) for k, data in messages))
    bag.close()
    return path


def states(count: int = 20, begin: int = 0) -> list[tuple[int, bytes]]:
    return [(k, state(k)) for k in range(begin, begin + count)]


def metadata(folder: Path, names: Sequence[str]) -> None:
    lines = "".join(f"    - {name}\n" for name in names)
    (folder / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n{lines}"
    )


def check(path: Path, count: int = 20) -> None:
    table = read_table(path)
    np.testing.assert_allclose(table.columns["time"], 0.004 * np.arange(count), atol=1e-12)
    np.testing.assert_allclose(table.columns["pan.position"], np.arange(count))
    np.testing.assert_allclose(table.columns["lift.effort"], -10.0 * np.arange(count))


@pytest.mark.parametrize("listed", [True, False])
@pytest.mark.parametrize("names", [[f"bag_{k}" for k in range(12)], ["z", "y", "x", "w"]])
def test_parts_follow_each_other_as_they_were_recorded(tmp_path: Path, names: list[str], listed: bool) -> None:
    """By the metadata, whatever their names; without it by their own time."""
    files = [mcap(tmp_path / f"{name}.mcap", states(5, 5 * k)).name for k, name in enumerate(names)]
    if listed:
        metadata(tmp_path, [f"old/folder/{name}" for name in files])
        mcap(tmp_path / "bag_00.mcap", states(5, 700))  # of another recording: not in the list
        check(tmp_path / "metadata.yaml", 5 * len(names))
    check(tmp_path, 5 * len(names))


def test_parts_without_metadata_go_by_numbers_and_missing_ones_are_named(tmp_path: Path) -> None:
    for k in (0, 1, 2, 10):
        mcap(tmp_path / f"bag_{k}.mcap", states(2))
    assert [path.name for path in parts_of(tmp_path)] == [f"bag_{k}.mcap" for k in (0, 1, 2, 10)]
    metadata(tmp_path, ["bag_0.mcap", "bag_7.mcap"])
    with pytest.raises(TraceError, match=r"metadata\.yaml: lists bag_7\.mcap, which is not next to it"):
        read_table(tmp_path)
    for text in ("a: [", "just words", "rosbag2_bagfile_information: [1]", "&a [*a]", "\x01"):
        (tmp_path / "metadata.yaml").write_text(text)
        with pytest.raises(TraceError, match=r"metadata\.yaml: not the metadata of a rosbag2"):
            read_table(tmp_path)


@pytest.mark.parametrize("kind", ["mcap", "db3"])
def test_packed_bags_of_either_storage(tmp_path: Path, kind: str) -> None:
    write = {"mcap": mcap, "db3": db3}[kind]
    pack = zstandard.ZstdCompressor().compress
    plain = write(tmp_path / f"plain.{kind}", states())
    (tmp_path / f"file.{kind}.zstd").write_bytes(pack(plain.read_bytes()))
    write(tmp_path / f"message.{kind}", [(k, pack(data)) for k, data in states()])
    for name in (f"plain.{kind}", f"file.{kind}.zstd", f"message.{kind}"):
        check(tmp_path / name)
    (tmp_path / f"cut.{kind}.zstd").write_bytes(b"\x28\xb5\x2f\xfd no frame")
    with pytest.raises(TraceError, match=rf"cut\.{kind}\.zstd: damaged compression"):
        read_table(tmp_path / f"cut.{kind}.zstd")


def test_what_unpacks_to_more_than_its_size_allows_ends_there(tmp_path: Path) -> None:
    bomb = zstandard.ZstdCompressor().compress(bytes(200 << 20))
    (tmp_path / "bomb.db3.zstd").write_bytes(bomb)
    with pytest.raises(TraceError, match=r"bomb\.db3\.zstd: unpacks to more than"):
        read_table(tmp_path / "bomb.db3.zstd")
    mcap(tmp_path / "bomb.mcap", [(0, bomb)])
    with pytest.raises(TraceError, match=r"joint state 1 is not whole: 131073 bytes, at most 131072 are read"):
        read_table(tmp_path / "bomb.mcap")


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_ros1_in_its_own_file_and_in_mcap(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"log.{kind}"
    messages = [(k, state(k, ros1=True)) for k in range(20)]
    if kind == "mcap":
        with path.open("wb") as stream:
            writer = Writer(stream)
            writer.start(profile="ros1", library="test")
            schema = writer.register_schema("sensor_msgs/JointState", "ros1msg", b"")
            channel = writer.register_channel("/joint_states", "ros1", schema)
            for k, data in messages:
                writer.add_message(channel, k, data, k)
            writer.finish()
        check(path)
        return
    for pack in (None, Ros1Writer.CompressionFormat.BZ2, Ros1Writer.CompressionFormat.LZ4):
        path.unlink(missing_ok=True)
        bag = Ros1Writer(path)
        if pack:
            bag.set_compression(pack)
        with bag:
            connection = bag.add_connection("/joint_states", TYPE, typestore=ROS1)
            for k, data in messages:
                bag.write(connection, START_NS + k, data)
        check(path)
    path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(TraceError, match=r"log\.bag: not a whole ROS 1 bag"):
        read_table(path)


def test_joints_that_change_their_order_are_read_by_name(tmp_path: Path) -> None:
    half = [(k, state(k, ("pan", "lift") if k < 10 else ("lift", "pan"))) for k in range(20)]
    check(mcap(tmp_path / "log.mcap", half))


def test_each_of_several_publishers_has_its_own_joints_and_stamps(tmp_path: Path) -> None:
    mixed = [(k, state(k, ("finger",) if k % 5 == 4 else ("pan", "lift"))) for k in range(50)]
    table = read_table(mcap(tmp_path / "log.mcap", mixed))
    assert table.kind == "bag of joint states, 2 publishers"
    arm, finger = ([k for k in range(50) if (k % 5 == 4) == own] for own in (False, True))
    np.testing.assert_allclose(table.columns["pan.position"], arm)
    np.testing.assert_allclose(table.columns["time"], 0.004 * np.array(arm))
    assert table.time_of["finger.effort"] == "time 2"
    np.testing.assert_allclose(table.columns["time 2"][: len(finger)], 0.004 * np.array(finger))
    np.testing.assert_allclose(table.columns["finger.effort"][: len(finger)], 5.0 * np.array(finger))
    assert np.isnan(table.columns["finger.effort"][len(finger) :]).all()


def test_of_several_topics_the_user_says_which(tmp_path: Path) -> None:
    path = mcap(tmp_path / "log.mcap", states(), ("/left/joint_states", "/right/joint_states"))
    with pytest.raises(
        TraceError, match=r"2 topics .*: /left/joint_states, /right/joint_states; give one with --topic"
    ):
        read_table(path)
    table = read_table(path, {"topic": "/right/joint_states"})
    assert (len(table), table.layout) == (20, {"topic": "/right/joint_states"})
    with pytest.raises(
        TraceError, match=r"no topic '/up' of sensor_msgs/msg/JointState, or foxglove.JointStates; topics: /left"
    ):
        read_table(path, {"topic": "/up"})


def test_efforts_that_some_messages_lack_are_missing_and_stamps_that_all_lack_are_the_recorders(tmp_path: Path) -> None:
    table = read_table(mcap(tmp_path / "log.mcap", [(k, state(k, effort=k != 3)) for k in range(20)]))
    assert np.flatnonzero(np.isnan(table.columns["pan.effort"])).tolist() == [3]
    table = read_table(mcap(tmp_path / "log.mcap", [(k, state(k, stamped=False)) for k in range(20)]))
    np.testing.assert_allclose(np.diff(table.columns["time"]), 0.004, atol=1e-9)
    assert "with the recorder's stamps" in table.kind
    assert "pan.effort" not in read_table(mcap(tmp_path / "log.mcap", [(0, state(0, effort=False))])).columns


ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n)"


@pytest.mark.parametrize(
    "messages",
    [
        f"CREATE VIEW messages AS {ENDLESS} SELECT x AS id, 1 AS topic_id, x AS timestamp, x'00' AS data FROM n",
        "CREATE VIRTUAL TABLE messages USING fts5(id, topic_id, timestamp, data)",
        "CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data AS (zeroblob(1000000000)))",
        "CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data AS (hex(zeroblob(9999))))",
    ],
)  # fmt: skip
def test_a_database_gives_what_stands_in_its_tables_and_nothing_else(tmp_path: Path, messages: str) -> None:
    with sqlite3.connect(tmp_path / "log.db3") as bag:
        bag.execute("CREATE TABLE topics(id INTEGER, name TEXT, type TEXT)")
        bag.execute("INSERT INTO topics VALUES (1, '/joint_states', ?)", (TYPE,))
        bag.execute(messages)
        if "AS (" in messages and "VIEW" not in messages:
            bag.execute("INSERT INTO messages(id, topic_id, timestamp) VALUES (1, 1, 1)")
    bag.close()
    begin = time.monotonic()
    with pytest.raises(TraceError, match=r"log\.db3: not a rosbag2 database: ") as told:
        read_table(tmp_path / "log.db3")
    assert "\n" not in str(told.value)
    if "VIEW" in messages or "VIRTUAL" in messages:
        assert "should be two tables" in str(told.value)
    assert time.monotonic() - begin < 5.0


@pytest.mark.parametrize(
    "query",
    ["SELECT hex(data) FROM messages", "SELECT * FROM seen", "SELECT data FROM other", "DELETE FROM messages",
     "ATTACH 'x.db' AS x", "PRAGMA user_version"],
)  # fmt: skip
def test_of_a_database_only_columns_of_its_two_tables_are_read(query: str) -> None:
    with sqlite3.connect(":memory:") as bag:
        bag.execute("CREATE TABLE messages(id INTEGER, data BLOB)")
        bag.execute("CREATE TABLE other(data BLOB)")
        bag.execute("CREATE VIEW seen AS SELECT data FROM messages")
        bag.set_authorizer(_allowed)
        with pytest.raises(sqlite3.DatabaseError, match=r"not authorized|prohibited"):
            bag.execute(query).fetchall()
        assert bag.execute("SELECT data FROM messages").fetchall() == []


def test_a_database_that_takes_longer_than_its_size_asks_for_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.trace.tables.bag_files.LEAST_SECONDS", -1e9)
    monkeypatch.setattr("drivers.trace.tables.bag_files.STEPS", 1)
    with pytest.raises(TraceError, match=r"log\.db3: not a rosbag2 database: it would take more than"):
        read_table(db3(tmp_path / "log.db3", states()))


def test_messages_of_more_bytes_than_the_file_has_are_not_kept(tmp_path: Path) -> None:
    """As where many rows share a page, or a join repeats them."""
    bag = sqlite3.connect(db3(tmp_path / "log.db3", states()))
    try:
        with pytest.raises(ValueError, match="its messages have more bytes than the file, 100"):
            _rows(bag, 100, tmp_path / "log.db3", lambda kinds, path: "/joint_states")
    finally:
        bag.close()


def test_a_query_ends_with_its_time_and_with_ctrl_c(monkeypatch: pytest.MonkeyPatch) -> None:
    """The view that the reader refuses, asked all the same under the reader's clock."""
    with sqlite3.connect(":memory:") as bag:
        bag.set_progress_handler(clock := _Clock(0.2), 10_000)
        with pytest.raises(sqlite3.OperationalError, match="interrupted"):
            bag.execute(f"{ENDLESS} SELECT max(x) FROM n").fetchall()
        assert clock.stop is None

        def pressed() -> float:
            raise KeyboardInterrupt

        bag.set_progress_handler(clock := _Clock(60.0), 10_000)
        monkeypatch.setattr("drivers.trace.tables.bag_files.time.monotonic", pressed)
        with pytest.raises(sqlite3.OperationalError, match="interrupted"):
            bag.execute(f"{ENDLESS} SELECT max(x) FROM n").fetchall()
        assert isinstance(clock.stop, KeyboardInterrupt)


def test_a_message_that_names_a_joint_twice_is_not_read(tmp_path: Path) -> None:
    data = state(1).replace(struct.pack("<I", 5) + b"lift\0", struct.pack("<I", 4) + b"pan\0\0")
    with pytest.raises(TraceError, match="joint state 1 is not whole: a joint is named twice"):
        read_table(mcap(tmp_path / "log.mcap", [(1, data)]))


def test_a_recording_that_was_cut_off_names_recover(tmp_path: Path) -> None:
    path = mcap(tmp_path / "log.mcap", states())
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(TraceError, match=r"deltatwin recover log\.mcap log-whole\.mcap"):
        read_table(path)
