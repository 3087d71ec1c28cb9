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
from schemas.messages import SAMPLE
from schemas.trace import Trace


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


def test_a_linear_axis_stays_in_metres(shared: Path, tmp_path: Path) -> None:
    trace = read_trace(shared / "real" / "emps" / "emps.csv", columns=find_columns("emps"))
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
