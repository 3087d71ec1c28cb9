"""What a new user meets: other systems, wrong names, files that are there, pipes, bounds that are missed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from drivers.trace import write_trace
from replay.demo import LOG, PAYLOADS, ROBOT
from schemas.errors import BusError
from schemas.trace import Trace
from service.cli.main import app
from service.diagnosis.sealed_page import BOUNDS, missed

# A system without POSIX modules, on which a file can be synced only if it may be written (Windows).
ELSEWHERE = """
import os, sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name in ("fcntl", "pwd", "grp", "resource", "termios", "pysoem"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
for name in ("fcntl", "pwd", "grp", "resource", "termios"):
    sys.modules.pop(name, None)
sys.meta_path.insert(0, Blocked())
real = os.fsync
def fsync(descriptor):
    if not os.readlink(f"/proc/self/fd/{descriptor}") or int(
        next(line for line in open(f"/proc/self/fdinfo/{descriptor}") if line.startswith("flags")).split()[1], 8
    ) & 3 == 0:
        raise OSError(9, "Bad file descriptor")
    real(descriptor)
os.fsync = fsync
del os.sched_setscheduler, os.getuid
from service.cli.main import main
"""


def elsewhere(folder: Path, *commands: tuple[str, ...]) -> list[str]:
    """Commands one after another in one process of such a system: what each printed last on stderr, or "done"."""
    code = (
        ELSEWHERE
        + f"""
import traceback
for arguments in {commands!r}:
    sys.argv = ["deltatwin", *arguments]
    try:
        main()
    except SystemExit as end:
        print("ended", end.code)
    except BaseException as error:
        traceback.print_exc()
        print("raised", repr(error))
"""
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=280, check=False
    )
    ends = [line for line in done.stdout.splitlines() if line.startswith(("ended", "raised"))]
    assert len(ends) == len(commands), done.stderr
    return [*ends, done.stderr]


@pytest.fixture
def own(tmp_path: Path) -> Path:
    from drivers.trace import read_trace

    trace = read_trace(LOG)
    part = slice(0, 3000)
    write_trace(Trace(LOG, trace.time[part], trace.position[part], trace.torque[part]), tmp_path / "own.csv")
    return tmp_path / "own.csv"


def test_offline_commands_run_without_posix(tmp_path: Path, own: Path) -> None:
    robot = ("--robot", str(ROBOT))
    *ends, _ = elsewhere(
        tmp_path,
        ("inspect", "own.csv"),
        ("convert", "own.csv", "own.mcap"),
        ("import", "own.csv", *robot, "--yes", "--out", "again.mcap"),
        ("evaluate", "own.csv", *robot, "--predictions", "predicted"),
        ("payload", "own.csv", *robot),
        ("identify", str(LOG), *robot, "--out", "identified.toml"),
        ("diagnose", "own.csv", *robot, "--out", "found"),
        ("rollout", "own.csv", *robot, "--horizon", "0.1"),
        ("simulate", "--robot", "d3-1200", "--duration", "1.5", "--motion", "slow", "--out", "slow.csv"),
    )
    assert ends == ["ended 0"] * 9
    for name in ("own.mcap", "again.mcap", "slow.csv", "predicted/own.csv", "identified.toml", "found/report.html"):
        assert (tmp_path / name).stat().st_size > 0


def test_live_commands_say_that_they_need_linux(tmp_path: Path) -> None:
    robot = ("--robot", str(ROBOT))
    commands = [
        ("monitor", *robot),
        ("estimate", *robot),
        ("demo",),
        ("tap", "eth1", *robot),
        ("master", "eth1", *robot),
    ]
    *ends, told = elsewhere(tmp_path, *commands)
    assert ends == ["ended 1"] * len(commands)
    said = [line for line in told.splitlines() if line.startswith("deltatwin:")]
    assert [line.split()[1:4] for line in said] == [[c[0], "needs", "Linux:"] for c in commands]
    assert "Traceback" not in told


def test_convert_does_not_overwrite_silently(tmp_path: Path, own: Path) -> None:
    (tmp_path / "log.mcap").write_bytes(b"mine")
    done = CliRunner().invoke(app, ["convert", str(own), str(tmp_path / "log.mcap")])
    assert "log.mcap: exists already; --overwrite replaces it" in str(done.exception)
    assert (tmp_path / "log.mcap").read_bytes() == b"mine"
    assert CliRunner().invoke(app, ["convert", str(own), str(tmp_path / "log.mcap"), "--overwrite"]).exit_code == 0


def test_payload_of_a_robot_that_was_never_identified(own: Path) -> None:
    done = CliRunner().invoke(app, ["payload", str(own), "--robot", "d3-1200"])
    assert "d3-1200 was never identified, so no payload can be estimated" in str(done.exception)


def test_results_as_json(tmp_path: Path, own: Path) -> None:
    shown = CliRunner().invoke(app, ["payload", str(LOG), "--robot", str(ROBOT), "--json"])
    levels = json.loads(shown.stdout)["traces"][0]["levels"]
    assert sum(level["event"] == "pick" for level in levels) == len(PAYLOADS.read_text().splitlines()) - 1


def test_a_pipe_gets_whole_lines(own: Path) -> None:
    """The widest table there is: no line is wrapped, none is cut short with an ellipsis."""
    done = subprocess.run(
        [sys.executable, "-m", "deltatwin", "inspect", own],
        capture_output=True, text=True, check=True, env=os.environ | {"COLUMNS": "20"},
    )  # fmt: skip
    row = next(line for line in done.stdout.splitlines() if line.startswith("position_1"))
    assert len(row.split()) == 8
    assert "…" not in done.stdout


@pytest.mark.parametrize("command", ["estimate", "watch"])
def test_what_the_bus_refuses_is_refused_before_anything_that_takes_long(
    bus_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    from service.estimator.estimator import Estimator

    for name in ("warm_up", "run"):
        monkeypatch.setattr(Estimator, name, lambda *_: pytest.fail("compiled first"))
    arguments = [command, "--robot", str(ROBOT)]
    if command == "watch":
        arguments += ["--reference", str(LOG), "--out", str(tmp_path / "found")]
    for text, said in ((None, "gone.json5"), ('{mode: "peer"}', "--insecure")):
        config = tmp_path / ("mine.json5" if text else "gone.json5")
        if text:
            config.write_text(text)
        done = CliRunner().invoke(app, [*arguments, "--zenoh-config", str(config)])
        assert isinstance(done.exception, BusError)
        assert said in str(done.exception)


def test_a_move_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    arguments = ["simulate", "--robot", "d3-1200", "--duration", "3", "--max-speed", "0.3", "--out", "a.csv"]
    done = CliRunner().invoke(app, arguments)
    assert "at this speed, longer than the motion of 3 s" in str(done.exception)


def test_ethercat_demo_refuses_a_short_run_at_once() -> None:
    done = CliRunner().invoke(app, ["ethercat-demo", "--duration", "4"])
    assert done.exit_code == 2
    assert "--duration" in done.output


def test_missed_bounds_are_named_but_for_the_machines_speed() -> None:
    held = {key: float(bound.split()[1]) for key, (_, bound) in BOUNDS.items()}
    assert missed(held) == []
    assert missed(held | {"right_first": 0.89, "seconds_median": 20.1, "pair_both": None}) == [
        "right effect first (single, findable)"
    ]


def test_a_monitor_of_the_wrong_robot_says_who_is_here(bus_folder: Path, bench_robot: Path, tmp_path: Path) -> None:
    from drivers.bus import open_bus
    from schemas.messages import Role

    with open_bus("d3-1200", Role.PLAYER):
        command = [
            sys.executable,
            "-m",
            "deltatwin",
            "monitor",
            "--robot",
            bench_robot,
            "--out",
            tmp_path / "a.mcap",
        ]
        monitor = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert monitor.stderr is not None
        lines: list[str] = []
        give_up = time.monotonic() + 60
        while time.monotonic() < give_up and not any("no samples" in line for line in lines):
            lines.append(monitor.stderr.readline())
        monitor.terminate()
        monitor.communicate(timeout=30)
    assert "monitor: no samples of bench yet; running on this host: d3-1200.player" in lines[-1]


def test_demo_gives_a_sign_of_life_before_anything_heavy_is_loaded() -> None:
    code = """
import sys
class Stop:
    def find_spec(self, name, path=None, target=None):
        if name in ("numpy", "zenoh", "numba"):
            raise KeyboardInterrupt
sys.meta_path.insert(0, Stop())
sys.argv = ["deltatwin", "demo"]
from service.cli.main import main
main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.startswith("loading; a first run compiles")
    assert done.returncode == 130
