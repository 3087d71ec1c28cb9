"""Whole files or none; errors that no terminal obeys."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from schemas import files
from schemas.errors import LONGEST, StorageError, TraceError, printable
from schemas.files import most_unpacked, name_of, read_bytes, whole, write_text
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


def test_nothing_that_is_there_already_is_written_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not even where its name was guessed: a link that lies there leads nowhere."""
    other, path = tmp_path / "other", tmp_path / "a.txt"
    other.write_text("mine")
    names = iter(["0" * 16, "1" * 16])
    monkeypatch.setattr(files.secrets, "token_hex", lambda size: next(names))
    (tmp_path / f".part-{'0' * 16}-a.txt").symlink_to(other)
    with pytest.raises(StorageError, match=r"a\.txt: File exists"):
        write_text(path, "secret")
    assert other.read_text() == "mine"
    write_text(path, "secret")
    assert path.read_text() == "secret"


def test_two_that_write_one_file_do_not_meet(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with whole(path) as one, whole(path) as other:
        assert one != other
        one.write_text("one")
        other.write_text("other")
        assert (name_of(one), name_of(other)) == ("a.txt", "a.txt")
    assert path.read_text() == "one"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_a_file_of_secrets_is_nobody_elses_and_takes_the_place_of_a_link(tmp_path: Path) -> None:
    there, link = tmp_path / "there", tmp_path / "key"
    there.write_text("mine")
    link.symlink_to(there)
    with whole(link, 0o600, links=False) as partial:
        assert partial.stat().st_mode & 0o777 == 0o600
        partial.write_text("secret")
    assert not link.is_symlink()
    assert (link.read_text(), there.read_text()) == ("secret", "mine")
    with whole(tmp_path / ("n" * 255)) as partial:
        partial.write_text("x")
    assert (tmp_path / ("n" * 255)).read_text() == "x"


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
