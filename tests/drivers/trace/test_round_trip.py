"""CSV and MCAP hold the same samples to the last bit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from drivers.trace import find_columns, read_trace, write_trace
from schemas.columns import Columns
from schemas.errors import TraceError
from schemas.messages import SAMPLE, Gripper
from schemas.robot import Geometry, Mass, Robot, load_robot
from schemas.trace import UNNAMED, Trace


def make_trace(count: int = 500, commands: bool = True, epoch_ns: int = 0) -> Trace:
    """Random numbers over the whole width of float64's mantissa, within what a joint can do."""
    rng = np.random.default_rng(7)
    time = np.arange(count) / 4000  # stamps on whole nanoseconds
    position = np.sin(2 * np.pi * 0.7 * time[:, None] + [0, 1, 2]) * 0.9 + rng.normal(0, 1e-5, (count, 3))
    command = {"position_command": position + 1e-3 / 3, "torque_command": rng.normal(0, 30, (count, 3))}
    trace = Trace(Path("made.csv"), time, position, rng.normal(0, 30, (count, 3)), epoch_ns=epoch_ns)
    return replace(trace, **command) if commands else trace


@pytest.mark.parametrize("ending", ["csv", "csv.gz", "mcap"])
@pytest.mark.parametrize("commands", [True, False])
def test_each_format_gives_back_every_bit(tmp_path: Path, ending: str, commands: bool) -> None:
    trace = make_trace(commands=commands)
    write_trace(trace, tmp_path / f"a.{ending}", "d3")
    read = read_trace(tmp_path / f"a.{ending}")
    assert read.time.tobytes() == trace.time.tobytes()
    assert read.samples()["position"].tobytes() == trace.position.tobytes()
    assert read.samples()["torque"].tobytes() == trace.torque.tobytes()
    assert (read.position_command is not None) == commands
    if commands:
        assert read.samples()["torque_command"].tobytes() == trace.samples()["torque_command"].tobytes()
    assert not read.findings


@pytest.mark.parametrize("ending", ["csv", "mcap"])
def test_fourth_axis_and_gripper_are_kept(tmp_path: Path, ending: str) -> None:
    angle = np.random.default_rng(1).normal(0, 2, 500)
    angle[100] = np.nan
    gripper = np.repeat(np.array([Gripper.UNKNOWN, Gripper.OPEN, Gripper.CLOSED], np.uint32), [100, 200, 200])
    write_trace(replace(make_trace(), fourth_position=angle, gripper=gripper), tmp_path / f"a.{ending}", "d3")
    samples = read_trace(tmp_path / f"a.{ending}").samples()
    assert samples["position"].shape == (500, 3)
    assert samples["fourth_position"].tobytes() == angle.tobytes()
    assert (samples["gripper"] == gripper).all()


def test_a_source_without_fourth_axis_and_gripper_says_so() -> None:
    samples = make_trace().samples()
    assert np.isnan(samples["fourth_position"]).all()
    assert (samples["gripper"] == Gripper.UNKNOWN).all()


def test_fourth_position_of_an_axis_with_torque_belongs_to_a_delta_only_with_its_description(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    position, torque = rng.normal(0, 1e-4, (500, 4)), rng.normal(0, 3, (500, 4))
    write_trace(Trace(Path("four"), np.arange(500) / 1000, position, torque), tmp_path / "a.csv")
    assert read_trace(tmp_path / "a.csv").position.shape == (500, 4)
    robot = Robot(
        name="d3",
        geometry=Geometry(active_link_length=0.36, passive_link_length=0.85, base_radius=0.19, platform_radius=0.05),
        mass=Mass(active_link=2.7, passive_link=0.55, platform=1.3),
    )
    trace = read_trace(tmp_path / "a.csv", robot)
    assert trace.position.shape == (500, 3)
    assert trace.fourth_position is not None
    assert trace.fourth_position.tobytes() == position[:, 3].tobytes()


def test_columns_of_a_foreign_table_name_fourth_axis_and_gripper(tmp_path: Path) -> None:
    names = ["t", *(f"q{j}" for j in "123"), *(f"m{j}" for j in "123"), "turn", "valve"]
    rows = np.column_stack([np.arange(50) / 1000, np.full((50, 6), 0.5), np.full(50, 180.0), np.arange(50) < 30])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header=",".join(names), comments="")
    mapping = Columns.model_validate(
        {
            "time": "t",
            "position": "q{joint}",
            "torque": "m{joint}",
            "fourth_position": {"name": "turn", "unit": "deg"},
            "gripper": {"name": "valve", "open": 1},
        }
    )
    trace = read_trace(tmp_path / "a.csv", columns=mapping)
    assert trace.fourth_position is not None
    np.testing.assert_allclose(trace.fourth_position, np.pi)
    assert trace.gripper is not None
    assert trace.gripper.tolist() == [Gripper.OPEN] * 30 + [Gripper.CLOSED] * 20


def test_csv_to_mcap_to_csv_is_the_same_file(tmp_path: Path) -> None:
    write_trace(make_trace(), tmp_path / "a.csv")
    write_trace(read_trace(tmp_path / "a.csv"), tmp_path / "b.mcap", "d3")
    write_trace(read_trace(tmp_path / "b.mcap"), tmp_path / "c.csv")
    assert (tmp_path / "c.csv").read_bytes() == (tmp_path / "a.csv").read_bytes()
    assert read_trace(tmp_path / "a.csv").samples().tobytes() == read_trace(tmp_path / "b.mcap").samples().tobytes()


@pytest.mark.parametrize("epoch_ns", [0, 1_795_000_000_123_456_789])
def test_stamps_keep_their_nanoseconds(tmp_path: Path, epoch_ns: int) -> None:
    trace = make_trace(epoch_ns=epoch_ns)
    write_trace(trace, tmp_path / "a.mcap", "d3")
    assert np.array_equal(read_trace(tmp_path / "a.mcap").time_ns, epoch_ns + np.arange(len(trace)) * 250_000)


def test_sequence_numbers_of_a_log_are_kept(tmp_path: Path) -> None:
    sequence = np.arange(500, dtype=np.uint64) + 2**40
    write_trace(replace(make_trace(), sequence=sequence), tmp_path / "a.mcap", "d3")
    assert np.array_equal(read_trace(tmp_path / "a.mcap").samples()["sequence"], sequence)


def test_a_failed_write_leaves_nothing_behind(tmp_path: Path) -> None:
    bad = replace(make_trace(), time=make_trace().time - 5.0)  # MCAP stamps cannot be negative
    (tmp_path / "a.mcap").write_bytes(b"old")
    with pytest.raises(Exception, match="below zero"):
        write_trace(bad, tmp_path / "a.mcap", "d3")
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]
    assert (tmp_path / "a.mcap").read_bytes() == b"old"


def test_a_linear_axis_stays_in_metres(data: Path, tmp_path: Path) -> None:
    trace = read_trace(data / "real" / "emps" / "emps.csv", columns=find_columns("emps"))
    write_trace(trace, tmp_path / "axis.csv")
    again = read_trace(tmp_path / "axis.csv")
    assert not trace.angular
    assert not again.angular
    for name in ("time", "position", "torque", "position_command"):
        assert getattr(again, name).tobytes() == getattr(trace, name).tobytes()
    assert (tmp_path / "axis.csv").read_text().startswith("time_s,position_command_1_m,position_1_m,torque_1_n\n")


def test_a_corrupted_chunk_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:  # uncompressed: a flipped bit would otherwise read as another number
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        schema = writer.register_schema(SAMPLE.schema_name, "ros2msg", SAMPLE.schema_text.encode())
        channel = writer.register_channel("deltatwin/d3/sample", "cdr", schema)
        for i, record in enumerate(make_trace().samples()):
            writer.add_message(channel, i, record.tobytes(), i)
        writer.finish()
    assert len(read_trace(path)) == 500
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 3] ^= 1
    path.write_bytes(raw)
    with pytest.raises(TraceError, match="not a whole MCAP file"):
        read_trace(path)


@pytest.mark.parametrize("decimal", [".", ","])
def test_stamps_since_1970_keep_their_nanoseconds_in_csv(tmp_path: Path, decimal: str) -> None:
    trace = make_trace(epoch_ns=1_795_000_000_123_456_789)
    write_trace(trace, tmp_path / "a.csv")
    columns = None
    if decimal == ",":
        text = (tmp_path / "a.csv").read_text().replace(",", ";").replace(".", ",")
        (tmp_path / "a.csv").write_text(text)
        columns = Columns(separator=";", decimal=",")
    read = read_trace(tmp_path / "a.csv", columns=columns)
    assert np.array_equal(read.time_ns, trace.time_ns)
    assert read.time.tobytes() == trace.time.tobytes()
    assert not read.findings


def test_the_log_of_another_robot_is_said_to_be_one(tmp_path: Path) -> None:
    """By its name alone: it is read all the same, as a robot may have got another name."""
    robot = load_robot("d3-1200")
    write_trace(make_trace(), tmp_path / "other.mcap", "rl5_line_3")
    assert [f.message for f in read_trace(tmp_path / "other.mcap", robot).findings] == [
        "recorded from rl5_line_3, read as d3-1200"
    ]
    assert read_trace(tmp_path / "other.mcap").findings == ()
    for name in (robot.name, UNNAMED):
        write_trace(make_trace(), tmp_path / "own.mcap", name)
        assert read_trace(tmp_path / "own.mcap", robot).findings == ()
