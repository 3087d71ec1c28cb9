"""Files that are not what they claim: refused in one line and within the memory that their size asks for."""

from __future__ import annotations

import gzip
import io
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import scipy.io
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, McapRecord, Schema

from drivers.trace.tables import read_table
from schemas.errors import TraceError
from schemas.messages import SAMPLE

MEMORY = 2 << 30  # of address space behind what the interpreter and its libraries have mapped
READER = """
import resource, sys, time
from pathlib import Path
from drivers.trace import read_trace
from schemas.axes_description import load_description
from schemas.errors import DeltatwinError
from drivers.ethercat.eni import read_eni
import drivers.trace.csv_file, drivers.trace.mcap_file
mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (mapped + int(sys.argv[1]),) * 2)
path = Path(sys.argv[2])
read = {".toml": load_description, ".xml": read_eni}.get(path.suffix, read_trace)
begin = time.process_time()
try:
    read(path)
except DeltatwinError as error:
    print(error)
status = Path("/proc/self/status").read_text()  # getrusage counts what the parent had when it forked
peak = int(status.split("VmHWM:")[1].split()[0]) >> 10
print(peak, time.process_time() - begin)
"""
MB = 1 << 20


def mcap(records: list[McapRecord], summary: list[McapRecord] | None = None) -> bytes:
    builder = RecordBuilder()
    for record in [Header("ros2", "test"), *records, DataEnd(0)]:
        record.write(builder)
    data = b"\x89MCAP0\r\n" + builder.end()
    start = len(data)
    schema = Schema(id=1, name=SAMPLE.schema_name, encoding="ros2msg", data=SAMPLE.schema_text.encode())
    channel = Channel(id=1, topic="deltatwin/d3/sample", message_encoding="cdr", metadata={}, schema_id=1)
    for record in [schema, channel, *(summary or []), Footer(start, 0, 0)]:
        record.write(builder)
    return data + builder.end() + b"\x89MCAP0\r\n"


def chunk(data: bytes, claims: int, kind: str) -> Chunk:
    return Chunk(
        message_start_time=0,
        message_end_time=0,
        uncompressed_size=claims,
        uncompressed_crc=0,
        compression=kind,
        data=data,
    )


def zstd_of_zeros(count: int, told: bool = True) -> bytes:
    packer = zstandard.ZstdCompressor(write_content_size=told).compressobj(size=count if told else -1)
    return b"".join([*(packer.compress(bytes(MB)) for _ in range(count // MB)), packer.flush()])


def many_chunks() -> bytes:
    """Each within its limit, all together a bomb."""
    one = chunk(zstd_of_zeros(36 * MB), 36 * MB, "zstd")  # zeros are records of nine bytes
    return mcap([one] * 100)


def zipped_zeros() -> bytes:
    out = io.BytesIO()
    with gzip.GzipFile(fileobj=out, mode="wb") as stream:
        stream.write(b"time_s,position_1_rad,torque_1_nm\n")
        for _ in range(300):
            stream.write(b"0,0,0\n" * 200_000)
    return out.getvalue()


BOMBS: dict[str, tuple[str, Callable[[], bytes], str]] = {
    "gzip": ("a.csv.gz", zipped_zeros, "bytes unpack to more than"),
    "header line": ("a.csv", lambda: b"a," * (50 * MB) + b"\n1,2\n", "line 1 has 104857600 bytes, at most"),
    "data line": ("a.csv", lambda: b"time_s,position_1_rad\n" + b"1," * (50 * MB), "columns, at most 4096"),
    "columns": ("a.csv", lambda: b",".join(b"c%d" % n for n in range(5000)) + b"\n1\n", "5000 columns, at most 4096"),
    "chunks": ("a.mcap", many_chunks, "are unpacked"),
    "chunk that claims much": ("a.mcap", lambda: mcap([chunk(b"", 4 << 30, "zstd")]), "a chunk of 4294967296 bytes"),
    "chunk that claims little": (
        "a.mcap", lambda: mcap([chunk(zstd_of_zeros(4096 * MB), 100, "zstd")]), "claims 100 bytes has more",
    ),
    "chunk that does not say": (
        "a.mcap", lambda: mcap([chunk(zstd_of_zeros(4096 * MB, False), 100, "zstd")]), "claims 100 bytes has more",
    ),
    "lz4 chunk": (
        "a.mcap", lambda: mcap([chunk(lz4.frame.compress(bytes(1024 * MB)), 100, "lz4")]), "claims 100 bytes has more",
    ),
    "chunk among the summary": (
        "a.mcap", lambda: mcap([], [chunk(b"no zstd", 4 << 30, "zstd")]), "no messages on",
    ),
    "record": ("a.mcap", lambda: mcap([]).replace(b"\x0f\x04", b"\x0f\xff\xff\xff\xff", 1), "a damaged summary"),
    "brackets": ("a.toml", lambda: b"a = " + b"[" * 3000 + b"]" * 3000, "more than 12 deep"),
    "few brackets": ("a.toml", lambda: b"a = " + b"[" * 100 + b"]" * 100, "more than 12 deep"),
    "dotted key": ("a.toml", lambda: b".".join([b"a"] * 60_000) + b" = 1", "more than 12 deep"),
    "quoted dotted key": ("a.toml", lambda: b"a = {" + b".".join([b'"a"'] * 60_000) + b" = 1}", "more than 12 deep"),
    "long toml": ("a.toml", lambda: b"#" * (300 << 10), "307200 bytes, at most 262144 are read"),
    "digits": ("a.toml", lambda: b"a = " + b"1" * 5000, "not TOML"),
    "long eni": ("a.xml", lambda: b"<a>" * (6 * MB), "bytes, at most 16777216 are read"),
    "deep eni": ("a.xml", lambda: b"<a>" * 100_000 + b"</a>" * 100_000, "no ENI"),
    "commands of an eni": (
        "a.xml",
        lambda: b"<EtherCATConfig><Config><Cyclic><Frame>"
        + b"<Cmd><Cmd>12</Cmd><Addr>1</Addr><DataLength>1</DataLength></Cmd>" * 300
        + b"</Frame></Cyclic></Config></EtherCATConfig>",
        "300 cyclic commands, at most 256 are read",
    ),
}  # fmt: skip


@pytest.mark.parametrize("bomb", BOMBS)
def test_bomb(bomb: str, tmp_path: Path) -> None:
    name, make, message = BOMBS[bomb]
    path = tmp_path / name
    path.write_bytes(make())
    done = subprocess.run(
        [sys.executable, "-c", READER, str(MEMORY), path], capture_output=True, text=True, timeout=250
    )
    assert done.returncode == 0, done.stderr[-2000:]
    error, figures = done.stdout.splitlines()
    assert error.startswith(str(path))
    assert message in error
    peak, seconds = map(float, figures.split())
    assert peak < 1024  # MiB, libraries included
    assert seconds < 5.0


def test_a_pipe_or_device_is_no_file(tmp_path: Path) -> None:
    (tmp_path / "zeros.csv").symlink_to("/dev/zero")
    done = subprocess.run(
        [sys.executable, "-c", READER, str(MEMORY), tmp_path / "zeros.csv"], capture_output=True, text=True, timeout=100
    )
    assert "zeros.csv: not a file" in done.stdout


def test_cells_of_matlab_are_counted_before_they_are_read(tmp_path: Path) -> None:
    """A hundred thousand in half a megabyte, which would be hundreds of megabytes of objects."""
    cells = np.empty(100_000, object)
    cells[:] = [np.array([1.0])] * len(cells)
    scipy.io.savemat(tmp_path / "log.mat", {"c": cells}, do_compression=True)
    with pytest.raises(TraceError, match=r"log\.mat: not a MATLAB file: .*more than 20000 arrays"):
        read_table(tmp_path / "log.mat")
    scipy.io.savemat(tmp_path / "few.mat", {"c": cells[:500], "t": np.arange(9.0), "q": np.arange(9.0)})
    assert list(read_table(tmp_path / "few.mat").columns) == ["t", "q"]
