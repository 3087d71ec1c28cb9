"""A command that fails leaves no empty folder behind."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize("there", [False, True])
def test_an_output_folder_into_which_nothing_was_written_goes_again(tmp_path: Path, there: bool) -> None:
    """Unless it was there before."""
    (tmp_path / "log.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    if there:
        (tmp_path / "deep").mkdir()
    before = sorted(tmp_path.iterdir())
    command = ("diagnose", "log.csv", "--robot", "d3-1200", "--out", "deep/er")
    done = subprocess.run(
        [sys.executable, "-m", "deltatwin", *command], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr.count("\n")) == (1, 1), done.stderr
    assert sorted(tmp_path.iterdir()) == before
