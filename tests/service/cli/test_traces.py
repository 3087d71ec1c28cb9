"""`convert` and `inspect` as a user runs them."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from drivers.trace import read_trace, write_trace
from replay.demo import ROBOT
from schemas.robot import SHIPPED
from schemas.trace import Trace
from service.cli.main import main
from service.stopping import ENDING
from tests.service import arm
from tests.service.model.test_description import OWN

Run = Callable[..., "Done"]
FIT = "--motion multisine --duration 10"  # long enough to identify on
CARRIED = """
[[effect]]
name = "stribeck_friction"
joints = [1]
parameters = {f_s = {value = 3.0, unit = "N m"}, v_s = {value = 0.1, unit = "rad/s"}}
"""


class Done(NamedTuple):
    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def deltatwin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[Run]:
    """The command in this process, run in `tmp_path`; the signal handlers it sets are put back."""
    handlers = {kind: signal.getsignal(kind) for kind in ENDING}
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str | Path) -> Done:
        monkeypatch.setattr(sys, "argv", ["deltatwin", *map(str, arguments)])
        code: object = 0
        try:
            main()
        except SystemExit as end:
            code = end.code
        told = capsys.readouterr()
        return Done(code if isinstance(code, int) else 0, str(told.out), str(told.err))

    yield run
    for kind, handler in handlers.items():
        signal.signal(kind, handler)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    time_s = np.arange(1000) / 1000
    motion = 0.6 * np.sin(2 * np.pi * time_s)[:, None] + [0.1, 0.2, 0.3]
    write_trace(Trace(Path("made"), time_s, motion, 10 * motion), tmp_path / "log.csv")
    return tmp_path / "log.csv"


def test_convert_there_and_back(deltatwin: Run, log: Path) -> None:
    there = deltatwin("convert", log, "log.mcap")
    said = "log.mcap: 1000 samples, 3 joints\nnext: deltatwin inspect log.mcap\n"
    assert (there.returncode, there.stdout, there.stderr) == (0, said, "")
    assert deltatwin("convert", "log.mcap", "back.csv.gz").returncode == 0
    assert deltatwin("convert", "back.csv.gz", "back.csv").returncode == 0
    assert (log.parent / "back.csv").read_bytes() == log.read_bytes()


def test_convert_tells_what_is_wrong_with_the_rows(deltatwin: Run, log: Path) -> None:
    lines = log.read_text().splitlines()
    log.write_text("\n".join([*lines[:500], *lines[510:]]) + "\n")
    done = deltatwin("convert", log, "out.mcap")
    assert done.returncode == 0
    assert f"{log}: 1 gap, 10 cycles of 1 ms missing: before line 501" in done.stderr
    assert read_trace(log.parent / "out.mcap").flags.any()


@pytest.mark.parametrize(
    ("target", "message"),
    [("out.xlsx", "out.xlsx: unknown kind of trace"), ("none/out.mcap", "none/out.mcap: No such file or directory")],
)
def test_convert_fails_in_one_line(deltatwin: Run, log: Path, target: str, message: str) -> None:
    done = deltatwin("convert", log, target)
    assert done.returncode == 1
    assert done.stderr.startswith(f"deltatwin: {message}")
    assert done.stderr.count("\n") == 1
    assert [p.name for p in log.parent.iterdir()] == ["log.csv"]


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_convert_stopped_half_way_leaves_the_old_file(tmp_path: Path, stop: signal.Signals) -> None:
    count = 500_000  # seconds of writing
    time_s = np.arange(count) / 4000
    motion = np.sin(time_s)[:, None] * [0.5, 0.6, 0.7]
    write_trace(Trace(Path("made"), time_s, motion, motion), tmp_path / "long.csv")
    (tmp_path / "out.mcap").write_bytes(b"old")
    command = [sys.executable, "-c", "from service.cli.main import main; main()"]
    command += ["convert", "--overwrite", "long.csv", "out.mcap"]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    while not any(part.stat().st_size for part in tmp_path.glob(".part-*-out.mcap")) and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(stop)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert sorted(p.name for p in tmp_path.iterdir()) == ["long.csv", "out.mcap"]
    assert (tmp_path / "out.mcap").read_bytes() == b"old"


def test_inspect_json_has_the_figures(deltatwin: Run, log: Path) -> None:
    lines = log.read_text().splitlines()
    lines[700] = lines[700].rsplit(",", 1)[0] + ",nan"
    log.write_text("\n".join([*lines[:500], *lines[510:], lines[-1]]) + "\n")
    done = deltatwin("inspect", log, "--json")
    assert done.returncode == 0
    (figures,) = json.loads(done.stdout)["traces"]
    assert (figures["samples"], figures["joints"], figures["gaps"], figures["repeats"]) == (991, 3, 1, 1)
    assert figures["rate_hz"] == pytest.approx(1000)
    assert figures["longest_step_s"] == pytest.approx(0.011)
    assert figures["missing"] == ["position_command", "torque_command"]
    assert figures["flags"] == {"NOT_A_NUMBER": 1, "GAP_BEFORE": 1, "REPEATED": 1}
    channel = figures["channels"]["position_2"]
    assert (channel["unit"], channel["missing"]) == ("rad", 0)
    assert (channel["min"], channel["max"]) == pytest.approx((-0.4, 0.8), abs=1e-5)
    assert figures["channels"]["torque_3"]["missing"] == 1


def test_inspect_measures_jitter(deltatwin: Run, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    time_s = np.arange(20_000) / 1000 + rng.normal(0, 20e-6, 20_000)
    motion = np.sin(time_s)[:, None] * [0.5, 0.6, 0.7]
    write_trace(Trace(Path("made"), time_s, motion, motion), tmp_path / "a.csv")
    (figures,) = json.loads(deltatwin("inspect", "a.csv", "--json").stdout)["traces"]
    assert figures["jitter_std_s"] == pytest.approx(20e-6 * np.sqrt(2), rel=0.05)  # a step has two stamps


def test_inspect_shows_the_others_when_one_is_unusable(deltatwin: Run, log: Path) -> None:
    done = deltatwin("inspect", "none.mcap", log)
    assert done.returncode == 1
    assert done.stderr == "deltatwin: none.mcap: No such file or directory\n"
    assert "1000 samples, 3 joints, 0.999 s from 0 s" in done.stdout
    assert "position_3" in done.stdout
    assert "…" not in done.stdout  # it fits in 80 columns
    assert "not recorded: position_command, torque_command" in done.stdout
    assert "nothing wrong found" in done.stdout


def test_inspect_gives_each_channel_its_own_rate(deltatwin: Run, data: Path, tmp_path: Path) -> None:
    path = data / "captures" / "twincat_scope_default.csv"
    done = deltatwin("inspect", path, "--columns", "twincat_scope", "--json")
    (figures,) = json.loads(done.stdout)["traces"]
    rates = {name: channel["rate_hz"] for name, channel in figures["channels"].items()}
    assert rates == pytest.approx(
        {
            "position_1": 1000,
            "position_2": 1000,
            "position_3": 1000,
            "torque_1": 5000,
            "torque_2": 1000,
            "torque_3": 200,
        }
    )


@pytest.mark.parametrize("name", ["convert", "inspect"])
def test_help_has_an_example(deltatwin: Run, name: str, tmp_path: Path) -> None:
    done = deltatwin(name, "--help")
    assert done.returncode == 0
    assert f"Example: deltatwin {name}" in done.stdout


def test_a_pipe_is_no_recording(deltatwin: Run, tmp_path: Path) -> None:
    """Nor waited for: nobody may ever write to it."""
    os.mkfifo(tmp_path / "run.mcap")
    done = deltatwin("recover", tmp_path / "run.mcap", tmp_path / "out.mcap")
    assert done.returncode != 0
    assert done.stderr.strip().endswith("run.mcap: not a file")
    assert not (tmp_path / "out.mcap").exists()


@pytest.mark.parametrize(
    "command",
    [
        "identify log.csv --robot robot.toml --out {}",
        "convert log.csv --robot robot.toml --overwrite {}",
        "export robot.toml --to urdf --out {}",
        "simulate --robot robot.toml --motion pick --duration 1 --out {}",
        "plan-motion --robot robot.toml --for identify --assume-limits --duration 5 --out {}",
    ],
)
@pytest.mark.parametrize("written", ["robot.toml", "sub/../robot.toml"])
def test_no_result_takes_the_place_of_what_is_read(
    deltatwin: Run, tmp_path: Path, log: Path, command: str, written: str
) -> None:
    assert log.name == "log.csv"
    (tmp_path / "sub").mkdir()
    before = (SHIPPED / "d3-1200.toml").read_text(encoding="utf-8")
    (tmp_path / "robot.toml").write_text(before, encoding="utf-8")
    done = deltatwin(*command.format(written).split())
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == f"deltatwin: {written}: is an input file; give another name to write to\n"
    assert (tmp_path / "robot.toml").read_text(encoding="utf-8") == before


@pytest.mark.parametrize(
    ("command", "written"),
    [
        ("identify log.csv --robot small.toml --out small.urdf", "small.urdf"),
        ("identify log.csv --robot small.toml --out columns.toml", "columns.toml"),
        ("identify log.csv --robot d3-1200 --columns columns.toml --out columns.toml", "columns.toml"),
        ("export small.toml --to urdf --out small.urdf", "small.urdf"),
        ("export small.toml --to mjcf --out columns.toml", "columns.toml"),
        ("convert log.csv --robot small.toml --overwrite small.urdf", "small.urdf"),
        ("simulate --robot small.toml --motion multisine --out small.urdf", "small.urdf"),
        ("plan-motion --robot small.toml --for identify --out small.urdf", "small.urdf"),
        ("export delta.toml --to urdf --out bus.xml", "bus.xml"),
        ("export delta.toml --to mjcf --effects own_effects.py --out own.xml", "own_effects.py"),
        ("export out/description.toml --to c --nominal --out out", "out/description.toml"),
        ("view --robot delta.toml --layout delta.toml", "delta.toml"),
        ("view --robot delta.toml --layout bus.xml", "bus.xml"),
    ],
)
def test_no_result_takes_the_place_of_what_a_description_names(
    deltatwin: Run, tmp_path: Path, log: Path, command: str, written: str
) -> None:
    arm.write(tmp_path, more='columns = "columns.toml"\n')
    (tmp_path / "columns.toml").write_text('time = "time_s"\n', encoding="utf-8")
    (tmp_path / "bus.xml").write_text("<EtherCATConfig/>", encoding="utf-8")
    (tmp_path / "own_effects.py").write_text(OWN, encoding="utf-8")
    plain = (SHIPPED / "d3-1200.toml").read_text(encoding="utf-8")
    known = plain.replace("[drive]\n", '[drive]\neni = "bus.xml"\n') + CARRIED
    (tmp_path / "delta.toml").write_text(known, encoding="utf-8")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "description.toml").write_text(plain, encoding="utf-8")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.*")}
    done = deltatwin(*command.split())
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.endswith(f"deltatwin: {written}: is an input file; give another name to write to\n")
    assert before.items() <= {path: path.read_bytes() for path in tmp_path.rglob("*.*")}.items()


@pytest.mark.parametrize("out", [".", "sub"])
@pytest.mark.parametrize(
    "command", ["export small.toml --to mjcf", "export d3-1200 --to mjcf", "identify log.csv --robot d3-1200"]
)
def test_a_folder_is_no_file(deltatwin: Run, tmp_path: Path, log: Path, command: str, out: str) -> None:
    arm.write(tmp_path)
    (tmp_path / "sub").mkdir()
    done = deltatwin(*command.split(), "--out", out)
    assert (done.returncode, done.stderr) == (1, f"deltatwin: {out}: exists and is not a file\n")


def test_more_samples_than_a_log_holds_are_not_simulated(deltatwin: Run) -> None:
    for command in ("simulate --robot d3-1200 --out a.csv", "closed-loop"):
        done = deltatwin(*command.split(), "--duration", "1e9")
        assert done.returncode == 2
        said = " ".join(done.stderr.replace("│", " ").split())
        assert "1e+09 s at 1000 Hz: a log has 40 million samples (8 GiB) at most, here 40000 s" in said


def test_a_recording_of_another_ending_is_refused_before_it_begins(deltatwin: Run, tmp_path: Path) -> None:
    done = deltatwin("monitor", "--robot", "d3-1200", "--out", "a.csv")
    assert done.stderr == "deltatwin: a.csv: a recording is an MCAP file; give a name that ends in .mcap\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("robot", "options", "following"),
    [
        (
            "d3-1200",
            "--payload 3.8 --truth ideal",
            "simulate --robot d3-1200 --truth ideal --motion multisine --out fit.csv",
        ),
        ("d3-1200", FIT, "identify out.csv --robot d3-1200 --out identified.toml"),
        ("d3-1200", "--truth ideal", "simulate --robot d3-1200 --truth ideal --motion multisine --out fit.csv"),
        ("identified.toml", "--payload 3.8", "payload out.csv --robot identified.toml"),
        ("identified.toml", FIT, "identify out.csv --robot identified.toml --out identified_2.toml"),
        ("small.toml", FIT, "identify out.csv --robot small.toml --out identified.toml"),
        ("small.toml", "--motion multisine", "simulate --robot small.toml --motion multisine --out fit.csv"),
    ],
)
def test_what_follows_a_simulation_can_be_done(
    deltatwin: Run, tmp_path: Path, robot: str, options: str, following: str
) -> None:
    arm.write(tmp_path)
    shutil.copy(ROBOT, tmp_path / "identified.toml")
    done = deltatwin("simulate", "--robot", robot, "--duration", "3", "--out", "out.csv", *options.split())
    assert done.stdout.splitlines()[-1] == f"next: deltatwin {following}"


def test_two_results_are_two_files(deltatwin: Run, tmp_path: Path) -> None:
    done = deltatwin("simulate", "--robot", "d3-1200", "--duration", "1", "--out", "p.csv", "--picks", "./p.csv")
    assert done.stderr == "deltatwin: p.csv: is named for two results; give each a name of its own\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "command",
    [
        "closed-loop --out out",
        "diagnose log.csv --robot d3-1200 --out out",
        "estimate --robot d3-1200",
        "evaluate log.csv --robot d3-1200",
        "export d3-1200 --to urdf --out out.urdf",
        "fleet days --robot d3-1200 --out out",
        "master nowhere0 --robot d3-1200",
        "payload log.csv --robot d3-1200",
        "plan-motion --robot d3-1200 --for identify --assume-limits --out out.csv",
        "rollout log.csv --robot d3-1200",
        "watch --robot d3-1200",
    ],
)
def test_effects_that_are_not_there_are_never_ignored(deltatwin: Run, tmp_path: Path, log: Path, command: str) -> None:
    done = deltatwin(*command.split(), "--effects", "nope.py")
    said = "deltatwin: nope.py: no such file; a Python file with effects is needed\n"
    assert (done.returncode, done.stdout, done.stderr) == (1, "", said)
    assert list(tmp_path.iterdir()) == [log]


@pytest.mark.parametrize("command", ["evaluate", "payload"])
def test_no_prediction_takes_the_place_of_a_log(deltatwin: Run, tmp_path: Path, log: Path, command: str) -> None:
    before = log.read_bytes()
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "log.csv").write_bytes(before)
    done = deltatwin(command, "log.csv", "--robot", "d3-1200", "--predictions", "sub/..")
    assert done.stderr == "deltatwin: sub/../log.csv: is an input file; give another name to write to\n"
    done = deltatwin(command, "log.csv", "sub/log.csv", "--robot", "d3-1200", "--predictions", "told")
    assert done.stderr == "deltatwin: sub/log.csv: a second log that would be written to told/log.csv\n"
    assert log.read_bytes() == before
    assert not (tmp_path / "told").exists()


@pytest.mark.parametrize(
    ("rows", "value", "note"),
    [
        (3000, "0.3", "no joint moves; position_1, position_2, position_3, torque_1, torque_2, torque_3: the same"),
        (3000, "{moving}", "note: position_3, torque_3: the same value in every row"),
        (300, "{moving}", "note: lasts 0.299 s: a model is fitted to 0.4 s or more"),
    ],
)  # fmt: skip
def test_inspect_says_what_no_single_row_shows(
    deltatwin: Run, tmp_path: Path, rows: int, value: str, note: str
) -> None:
    head = ["time_s", *(f"position_{j}_rad" for j in (1, 2, 3)), *(f"torque_{j}_nm" for j in (1, 2, 3))]
    lines = [",".join(head)]
    for row in range(rows):
        two = [value.format(moving=0.3 * np.sin(0.01 * row))] * 2
        lines.append(",".join([f"{0.001 * row:.3f}", *two, "0.3", *two, "5"]))
    (tmp_path / "still.csv").write_text("\n".join([*lines, ""]))
    done = deltatwin("inspect", "still.csv", "--robot", "d3-1200")
    assert note in done.stdout.replace("\n", " ")
    assert "nothing wrong found" not in done.stdout
    assert "next: deltatwin identify" not in done.stdout
    assert ("next: deltatwin evaluate" in done.stdout) is (rows > 400 and value != "0.3")


def test_inspect_ends_with_what_can_be_done_with_what_it_read(deltatwin: Run, tmp_path: Path, log: Path) -> None:
    (tmp_path / "empty.csv").touch()
    (tmp_path / "foreign.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    assert "next:" not in deltatwin("inspect", "missing.csv", "empty.csv").stdout
    assert "next: deltatwin import foreign.csv\n" in deltatwin("inspect", "missing.csv", "foreign.csv").stdout
    (tmp_path / "text.mcap").write_text("a,b\n1,2\n", encoding="utf-8")
    (tmp_path / "binary.csv").write_bytes(bytes(range(256)))
    unread = deltatwin("inspect", "text.mcap", "binary.csv", "--robot", "d3-1200")
    assert "text.mcap: not an MCAP file: it does not start like one\n" in unread.stderr
    assert "next:" not in unread.stdout
    read = deltatwin("inspect", "foreign.csv", log.name, "--robot", "d3-1200")
    assert read.returncode == 1
    assert "too little motion" in read.stdout
    assert "their motion adds up" in read.stdout
    assert "next: deltatwin evaluate log.csv --robot d3-1200\n" in read.stdout
