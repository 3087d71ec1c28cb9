"""`deltatwin replay` as its user runs it: a process, a trace file, somebody listening."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.bus import open_bus
from drivers.trace import write_trace
from schemas.messages import Role
from schemas.trace import Trace


@pytest.fixture
def folder(tmp_path: Path, bus_folder: Path, bench_robot: Path) -> Path:
    time = np.arange(500) / 1000.0
    position = 0.3 * np.sin(2 * np.pi * time[:, None] + np.arange(3))
    write_trace(Trace(tmp_path / "log.csv", time, position, position * 10), tmp_path / "log.csv")
    return tmp_path


def replay(folder: Path, *options: str) -> subprocess.Popen[str]:
    arguments = ["log.csv", "--robot", "robot.toml", *options]
    return subprocess.Popen(
        [Path(sys.executable).with_name("deltatwin"), "replay", *arguments],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def test_every_sample_arrives_and_the_lateness_is_reported(
    folder: Path, until: Callable[[Callable[[], bool]], None]
) -> None:
    with open_bus("bench", Role.MONITOR) as monitor:
        inbox = monitor.subscribe("sample")
        out, error = (process := replay(folder, "--wait", "20", "--loop", "2", "--rate", "2000")).communicate(
            timeout=60
        )
        assert process.returncode == 0, error
        records: list[int] = []
        until(lambda: bool(records.extend(inbox.take()[0]["sequence"].tolist()) or len(records) >= 1000))
    assert records == list(range(1000))
    assert out.startswith("sent 1000 of 1000 samples, ")
    assert "lateness median" in out
    assert "nobody subscribes" not in error


def test_without_a_listener_it_says_so_and_plays(folder: Path) -> None:
    out, error = replay(folder, "--wait", "0", "--stop", "0.1").communicate(timeout=60)
    assert "nobody subscribes to the samples of bench yet; playing anyway" in error
    assert out.startswith("sent 101 of 101 samples")


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_interrupt_ends_an_endless_replay_with_its_report(
    folder: Path, how: int, until: Callable[[Callable[[], bool]], None]
) -> None:
    with open_bus("bench", Role.MONITOR) as monitor:
        inbox = monitor.subscribe("sample")
        process = replay(folder, "--loop", "0", "--wait", "20")
        taken = 0
        while taken < 700:
            assert inbox.wait(30.0)
            taken += len(inbox.take()[0])
        process.send_signal(how)
        out, error = process.communicate(timeout=60)
    assert process.returncode == 0, error
    assert out.startswith("sent ")
    assert " of " not in out.split(" samples")[0]
    assert "Traceback" not in error


def test_second_player_of_a_robot_is_one_clear_line(folder: Path) -> None:
    with open_bus("bench", Role.PLAYER):
        process = replay(folder)
        _, error = process.communicate(timeout=60)
    assert process.returncode == 1
    assert error.splitlines()[-1].startswith("deltatwin: robot 'bench': another player is running (process ")
    assert "Traceback" not in error
