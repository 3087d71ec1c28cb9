"""Processes that start, fail, linger and are left behind."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import psutil
import pytest

from schemas.errors import BusError
from service import supervisor
from service.supervisor import Supervisor

POLITE = "import time\nprint('ready', flush=True)\ntry:\n time.sleep(99)\nexcept KeyboardInterrupt:\n print('whole')"
DEAF = "import signal, time\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\nprint('ready', flush=True)\ntime.sleep(99)"

# Ends when the other one of a folder has been asked to end too, or says that it has not.
TOGETHER = """
import pathlib, sys, time
print('ready', flush=True)
try:
    time.sleep(99)
except KeyboardInterrupt:
    pathlib.Path(sys.argv[1], sys.argv[2]).touch()
    give_up = time.monotonic() + 10
    while len(list(pathlib.Path(sys.argv[1]).iterdir())) < 2 and time.monotonic() < give_up:
        time.sleep(0.01)
    print('together' if time.monotonic() < give_up else 'alone')
"""


def python(script: str) -> tuple[str, ...]:
    return sys.executable, "-c", script


def test_one_that_ends_before_it_is_ready_is_named_with_its_last_line(tmp_path: Path) -> None:
    script = python("print('first'); raise SystemExit('deltatwin: no such thing')")
    with Supervisor(tmp_path) as crew, pytest.raises(BusError, match=r"^tap did not start: no such thing$"):
        crew.launch("tap", script, "ready").wait_ready()


def test_one_that_fails_later_is_named_with_its_last_line(tmp_path: Path) -> None:
    with Supervisor(tmp_path) as crew:
        process = crew.launch("tap", python("print('ready', flush=True); input(); raise SystemExit('gone')"), "ready")
        process.wait_ready()
        crew.check()
        process.tell("go on")
        with pytest.raises(BusError, match=r"^tap failed: gone$"):
            process.wait(60)
        with pytest.raises(BusError, match=r"^tap failed: gone$"):
            crew.check()


def test_what_is_left_is_ended_politely_and_then_by_force(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor, "STOP_TIME", 5.0)
    pids = []

    def torn_out() -> None:
        with Supervisor(tmp_path) as crew:
            for name, script in (("polite", POLITE), ("deaf", DEAF)):
                log = tmp_path / f"{name}.log"
                process = crew.launch(name, python(script), lambda log=log: "ready" in log.read_text())
                process.wait_ready()
                pids.append(process.pid)
            raise RuntimeError("torn out")

    with pytest.raises(RuntimeError, match="torn out"):
        torn_out()
    assert not any(psutil.pid_exists(pid) for pid in pids)
    assert (tmp_path / "polite.log").read_text() == "ready\nwhole\n"


def test_where_an_exception_leaves_it_all_are_asked_at_once_and_who_was_not_ready_is_not_waited_for(
    tmp_path: Path,
) -> None:
    asked = tmp_path / "asked"
    asked.mkdir()
    since = time.monotonic()

    def torn_out() -> None:
        with Supervisor(tmp_path) as crew:
            for name in ("one", "two"):
                crew.launch(name, (*python(TOGETHER), str(asked), name), "ready").wait_ready()
            compiling = crew.launch("deaf", python(DEAF), "never said")
            while not compiling.log.read_text():
                time.sleep(0.01)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        torn_out()
    assert [(tmp_path / f"{name}.log").read_text() for name in ("one", "two")] == ["ready\ntogether\n"] * 2
    assert time.monotonic() - since < supervisor.STOP_TIME
