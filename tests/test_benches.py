"""Every bench starts as CONTRIBUTING.md says, and one with nothing to measure by says so."""

from __future__ import annotations

import runpy
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from schemas.errors import DataError
from tests.bench import bench_payload, bench_stop
from tests.conftest import REPOSITORY

BEFORE = '\nTraceback (most recent call last):\n  File "/home/a/deltatwin/.venv/lib/site-packages/a.pth", line 1\n'
BENCHES = sorted(path.stem for path in (REPOSITORY / "tests" / "bench").glob("bench_*.py"))


def start(*arguments: str, path: str | None = None) -> subprocess.CompletedProcess[str]:
    environment = None if path is None else {"PATH": path}
    return subprocess.run(
        [sys.executable, "-m", *arguments],
        cwd=REPOSITORY, env=environment, capture_output=True, text=True, timeout=240, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("bench", BENCHES)
def test_starts(bench: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", [bench, "--help"])
    monkeypatch.delitem(sys.modules, f"tests.bench.{bench}", raising=False)  # another bench may have imported it
    with pytest.raises(SystemExit) as end:
        runpy.run_module(f"tests.bench.{bench}", run_name="__main__")
    assert end.value.code == 0
    assert capsys.readouterr().out.startswith("usage: ")


def test_a_small_run_goes_to_its_end() -> None:
    done = start("tests.bench.bench_trace", "2000")
    assert done.returncode == 0, done.stderr
    assert "x library" in done.stdout


def test_a_robot_that_cannot_be_identified_is_a_row_that_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise DataError("fit_0: a payload?")

    monkeypatch.setattr(bench_payload, "logs", lambda *_: ([], None, None))
    monkeypatch.setattr(bench_payload, "identify", refuse)
    rows = bench_payload.one("d3-1200", "clean", 1, 24.0, (True, False))
    row = {"robot": "d3-1200", "scenario": "clean", "error": "fit_0: a payload?"}
    assert rows == [row | {"commands": True}, row | {"commands": False}]


@pytest.mark.parametrize(
    ("code", "said", "ended"),
    [
        (0, "stopped", "0"),
        (130, "", "130"),
        (-signal.SIGINT, "", "in Python's start"),
        (1, f"Fatal Python error: init_import_site{BEFORE}KeyboardInterrupt", "in Python's start"),
        (1, f"Fatal Python error: init_sys_streams: can't initialize{BEFORE}KeyboardInterrupt", "in Python's start"),
        (1, "KeyboardInterrupt\n", "in Python's start"),
        (1, f"{BEFORE}KeyboardInterrupt", "traceback"),
        (1, "estimate: starting\nKeyboardInterrupt\n", "code 1"),
        (-signal.SIGINT, f'{BEFORE}  File "/a/service/stopping.py", line 3', "traceback"),
        (1, f'Fatal Python error: init_import_site{BEFORE}  File "/a/deltatwin/__main__.py"', "traceback"),
        (-signal.SIGABRT, "FATAL: exception not rethrown", "aborted"),
        (None, "", "not ended"),
    ],
)
def test_a_stop_before_our_first_line_is_not_ours(code: int | None, said: str, ended: str) -> None:
    assert bench_stop.how_it_ended(code, said, signal.SIGINT) == ended


def test_what_is_missing_is_said_in_a_line(tmp_path: Path) -> None:
    done = start("tests.bench.bench_replay", path=str(tmp_path))
    assert done.returncode == 0
    assert done.stderr.startswith("skipped: needs cyclictest (package rt-tests)")
    assert done.stderr.count("\n") == 1
