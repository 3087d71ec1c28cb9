"""Every command that writes, on a disk that is full or read-only: one line, exit code 1, the old file whole."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.trace import write_trace
from replay.demo import LOG, ROBOT
from schemas.trace import Trace
from service.monitor.recording import RecordingWriter
from tests.service.monitor.test_recording import SAMPLE, WALL_NS, filled

PEER = Path(__file__).with_name("disk_peer.py")
OLD = "what stood here before"
WRITING = {  # command line, and the file or folder of {disk} that it writes; {in} holds inputs
    "convert-csv": ("convert --overwrite {in}/log.csv {disk}/old.csv", "old.csv"),
    "convert-gzip": ("convert --overwrite {in}/log.csv {disk}/old.csv.gz", "old.csv.gz"),
    "convert-mcap": ("convert --overwrite {in}/log.csv {disk}/old.mcap", "old.mcap"),
    "recover": ("recover {in}/run.mcap {disk}/new.mcap", None),
    "identify": (f"identify {LOG} --robot {ROBOT} --out {{disk}}/old.toml", "old.toml"),
    "simulate": ("simulate --robot d3-1200 --duration 0.5 --motion slow --out {disk}/old.csv", "old.csv"),
    "evaluate": ("evaluate {in}/log.csv --robot {in}/robot.toml --predictions {disk}", "log.csv"),
    "import": ("import {in}/log.csv --robot {in}/robot.toml --yes --overwrite --out {disk}/old.mcap", "old.mcap"),
    "export": ("export {in}/robot.toml --to urdf --out {disk}/old.urdf", "old.urdf"),
    "layout": ("view --robot {in}/robot.toml --layout {disk}/old.json", "old.json"),
    "keys": ("keys --hosts a --robot {in}/robot.toml --out {disk}/keys", None),
}
LONG = {  # refuse before they compute
    "simulate-picks": "simulate --robot d3-1200 --out {in}/other.csv --picks {disk}/picks.csv",
    "diagnose": "diagnose {in}/log.csv --robot {in}/robot.toml --out {disk}",
    "closed-loop": "closed-loop --robot d3-1200 --out {disk}/loop",
    "experiment": "experiment --out {disk}",
    "demo": "demo --out {disk}/demo",
    "blindtest": "blindtest --cases 1 --out {disk}",
    "monitor": "monitor --robot {in}/robot.toml --out {disk}/new.mcap",
    "monitor-nowhere": "monitor --robot {in}/robot.toml --out {disk}/nowhere/new.mcap",
    "watch": f"watch --robot {ROBOT} --out {{disk}}/findings",
    "estimate": f"estimate --robot {ROBOT} --keep {{disk}}/friction.json",
    "plan-motion": f"plan-motion --assume-limits --for identify --robot {ROBOT} --out {{disk}}/motion.csv",
    "rollout": "rollout {in}/nowhere.csv --robot {in}/robot.toml --out {disk}",
    "fleet": "fleet {in}/log.csv --robot {in}/robot.toml --out {disk}/fleet",
    "segment": "segment lo --robot {in}/robot.toml --out {disk}/new.mcap",
}


@pytest.fixture
def inputs(tmp_path: Path, bench_robot: Path) -> Path:
    """robot.toml, log.csv of 3 s and a recording, beside an empty folder `disk`."""
    time = np.arange(3000) / 1000
    motion = 0.5 + 0.3 * np.sin(2 * np.pi * np.outer(time, [0.7, 1.1, 1.7]) + [0, 1, 2])
    torque = -5 * np.cos(motion) + 0.1 * np.random.default_rng(0).standard_normal(motion.shape)
    write_trace(Trace(Path("made"), time, motion, torque), tmp_path / "log.csv")
    recording = RecordingWriter(tmp_path / "run.mcap", "bench")
    recording.write("sample", filled(SAMPLE, 3000), WALL_NS + np.arange(3000))
    recording.close()
    (tmp_path / "disk").mkdir()
    return tmp_path


def run(inputs: Path, commands: list[str], limit: int = 0, mount: str = "") -> list[dict[str, Any]]:
    """How each of `commands` ended, in a mount namespace of their own where `mount` asks for one."""
    disk = inputs / "disk"
    lines = [json.dumps(command.format(disk=disk, **{"in": inputs}).split()) for command in commands]
    peer = f"exec {sys.executable} {PEER} {disk} {limit}"
    shell = ["unshare", "-m", "sh", "-ec", f"cd {disk}; {mount}; {peer}"] if mount else ["sh", "-ec", peer]
    ended = subprocess.run(shell, input="\n".join(lines), capture_output=True, text=True, timeout=200)
    assert ended.returncode == 0, ended.stderr
    return json.loads(ended.stdout)


def may_mount() -> bool:
    """Whether a disk of its own can be mounted here: by root, where the kernel lets it."""
    if os.geteuid() != 0 or shutil.which("unshare") is None:
        return False
    return subprocess.run(["unshare", "-m", "true"], capture_output=True).returncode == 0


def told(name: str, ended: dict[str, Any], why: str) -> None:
    """One line that says why, exit code 1, nothing left behind."""
    assert ended["code"] == 1, (name, ended)
    (line,) = [line for line in ended["stderr"].splitlines() if line.startswith("deltatwin: ")]
    assert why in line, (name, line)
    assert "Traceback" not in ended["stderr"]
    assert not [path for path in ended["files"] if ".part" in path], (name, ended)
    assert set(ended["files"].values()) <= {OLD}, (name, ended)


OLDS = [old for _, old in WRITING.values() if old]
PUT_OLD = "".join(f"printf '{OLD}' > {old}; " for old in OLDS)
FILL = "dd if=/dev/zero of=filler bs=1k 2>/dev/null || true"


def test_full_disk(inputs: Path) -> None:
    """A small disk, filled; for those who may not mount one, a limit on the size of files."""
    commands = [command for command, _ in WRITING.values()]
    if may_mount():
        mount = f"mount -t tmpfs -o size=256k small {inputs}/disk; cd {inputs}/disk; {PUT_OLD}"
        why, runs = "No space left on device", run(inputs, commands, mount=f"{mount}{FILL}")
    else:
        subprocess.run(["sh", "-ec", PUT_OLD], cwd=inputs / "disk", check=True)
        why, runs = "File too large", run(inputs, commands, limit=100)
    for name, ended in zip(WRITING, runs, strict=True):
        told(name, ended, why)
        assert set(ended["files"]) == set(OLDS)


def test_a_log_that_does_not_fit_leaves_no_mapping(inputs: Path) -> None:
    """The disk holds the mapping, which is small, and not the log."""
    command = "import {in}/log.csv --robot {in}/robot.toml --yes --out {disk}/new.mcap"
    if may_mount():
        (ended,) = run(inputs, [command], mount=f"mount -t tmpfs -o size=64k small {inputs}/disk; cd {inputs}/disk")
    else:
        (ended,) = run(inputs, [command], limit=64 << 10)
    told("import", ended, "new.mcap")
    assert ended["files"] == {}


def test_read_only_disk(inputs: Path) -> None:
    if not may_mount():
        pytest.skip("needs root and unshare to mount a disk of its own")
    for old in OLDS:
        (inputs / "disk" / old).write_text(OLD)
    mount = f"mount --bind {inputs}/disk {inputs}/disk; mount -o remount,ro,bind {inputs}/disk"
    commands = {name: command for name, (command, _) in WRITING.items()} | LONG
    for name, ended in zip(commands, run(inputs, list(commands.values()), mount=mount), strict=True):
        told(name, ended, "no such folder" if name == "monitor-nowhere" else "")
        assert str(inputs / "disk") in ended["stderr"], (name, ended)
        assert set(ended["files"]) == set(OLDS)
