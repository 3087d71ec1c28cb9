"""Whole files or none; errors that no terminal obeys."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from schemas.errors import LONGEST, StorageError, TraceError, printable
from schemas.files import most_unpacked, read_bytes, whole, write_text
from schemas.trace import Finding


def test_the_old_file_stays_until_the_new_one_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    write_text(path, "old")
    with pytest.raises(RuntimeError), whole(path) as partial:  # noqa: PT012
        partial.write_text("half")
        assert path.read_text() == "old"
        raise RuntimeError
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]
    write_text(path, "new")
    assert path.read_text() == "new"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_a_link_stays_a_link_and_a_device_a_device(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "there" / "file")
    write_text(link, "through")
    assert link.is_symlink()
    assert (tmp_path / "there" / "file").read_text() == "through"
    for what in ("/dev/null", tmp_path):
        with pytest.raises(StorageError, match="exists and is not a file"):
            write_text(Path(what), "x")
    assert not Path("/dev/null").is_file()


def test_more_than_the_limit_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(bytes(101))
    assert len(read_bytes(path, 101, TraceError)) == 101
    with pytest.raises(TraceError, match=r"a: 101 bytes, at most 100 are read"):
        read_bytes(path, 100, TraceError)
    with path.open("ab") as stream:
        stream.truncate(9 << 30)  # sparse
    with pytest.raises(TraceError, match="are read"):
        read_bytes(path, 8 << 30, TraceError)


def test_honest_logs_may_unpack() -> None:
    hour = 3600 * 4000 * 160  # our CSV at 4 kHz
    assert most_unpacked(hour // 20) > hour
    assert most_unpacked(1000) == 64 << 20
    assert most_unpacked(132_000) < 4 << 30


def test_nothing_from_a_file_commands_the_terminal() -> None:
    hostile = "a\x1b[2J\x9b31m\r\n\u202ez\udc80é µ𝄞"
    escaped = "a\\x1b[2J\\x9b31m\\r\\n\\u202ez\\udc80é µ𝄞"
    assert printable(hostile) == escaped
    assert str(TraceError(hostile)) == escaped
    assert Finding(0, hostile, None).message == escaped  # pyright: ignore[reportArgumentType]
    assert len(str(TraceError("x" * 10_000_000))) < LONGEST + 10
