"""The watch as a role: samples in over Zenoh, gap and finding out, recorded by the monitor."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from drivers.bus import open_bus
from schemas.messages import FindingVerdict, HealthFlag, Role, WatchState, stamp_ns
from schemas.robot import save_robot
from service.monitor.monitor_node import Monitor
from service.monitor.readback import read_recording
from service.monitor.writer import WriterThread
from service.watch import watch_node
from service.watch.state_machine import Patience, Watch
from service.watch.watch_node import Examination, WatchNode
from tests.service.watch.logs import KNOWN, log, motion, stribeck

ONSET = 12.0  # s
LONGEST_S = 240.0  # of a diagnosis beside other work; how long it takes is not what is tested


def test_a_change_on_the_bus_is_found_published_stored_and_recorded(
    bus_folder: Path, tmp_path: Path, until: Callable[[Callable[[], bool]], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watch_node, "NICENESS", 0)  # beside other tests it would hardly ever be its turn
    description, recording, said = tmp_path / "known.toml", tmp_path / "run.mcap", []
    save_robot(KNOWN, description)
    run = motion(21.0)
    samples = log(run, stribeck(run, ONSET)).samples()
    writer = WriterThread(recording, "known")
    with (
        open_bus("known", Role.ROBOT) as robot,
        open_bus("known", Role.MONITOR) as monitors,
        open_bus("known", Role.WATCH) as watching,
    ):
        source = robot.publisher("sample")
        monitor = Monitor(monitors, writer, HealthFlag(0))
        examination = partial(Examination, description, None, tmp_path / "found")
        role = WatchNode(Watch(KNOWN, Patience(learn=6.0, after=7.0)), watching, examination, said.append)
        until(lambda: {Role.ROBOT, Role.MONITOR} <= watching.alive)
        until(lambda: source.wait_until_heard(1.0))

        def step() -> None:
            monitor.step()
            role.step()

        with role.health:
            for k in range(0, len(samples), 200):
                for sample in samples[k : k + 200]:
                    source.put(sample.tobytes())
                step()
                time.sleep(0.01)  # twenty times real time
            assert any("gap has risen" in line for line in said), said
            give_up = time.monotonic() + LONGEST_S
            while not any("stribeck" in line for line in said):
                assert time.monotonic() < give_up, said
                step()
                time.sleep(0.05)
            role.close()
        until(lambda: (monitor.step(), monitor.tally.received["finding"] == 1)[-1])
    writer.close()
    assert role.counts()["received"] + role.counts()["lost"] == len(samples)
    recorded = read_recording(recording)
    gap, (finding,) = recorded["gap"].records, recorded["finding"].records
    assert (np.diff(gap["sequence"].astype(int)) == 1).all()
    assert {WatchState.LEARNING, WatchState.RAISED} <= {WatchState(int(s)) for s in gap["state"]}
    assert finding["verdict"] == FindingVerdict.EXPLAINED
    assert finding["joints"] == 0b010
    assert bytes(finding["effect"]).rstrip(b"\0") == b"stribeck_friction"
    assert stamp_ns(finding) * 1e-9 - finding["higher_for"] == pytest.approx(ONSET, abs=1.5)
    (folder,) = (tmp_path / "found").iterdir()
    stored = json.loads((folder / "finding.json").read_text())
    assert stored["text"] in said[-1]
    assert {path.name for path in folder.iterdir()} == {"before.mcap", "after.mcap", "finding.json"}


@pytest.mark.skipif(sys.platform != "linux", reason="threads have priorities of their own on Linux alone")
def test_who_sends_does_not_wait_for_a_watch_whose_turn_it_is_not(
    bus_folder: Path, tmp_path: Path, until: Callable[..., None]
) -> None:
    """Zenoh's threads take what comes off the socket; full, it holds up whoever publishes for 20 ms at a time."""
    save_robot(KNOWN, tmp_path / "known.toml")
    command = [Path(sys.executable).with_name("deltatwin"), "watch", "--robot", tmp_path / "known.toml"]
    command += ["--out", tmp_path / "out"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as watch, ExitStack() as last:
        last.callback(watch.kill)  # which is waited for without an end, also where this fails
        assert watch.stderr is not None
        assert any(line.startswith("watching known") for line in iter(watch.stderr.readline, "")), "it ended"
        until(lambda: any("(acc-" in text for text in _threads(watch.pid)))  # each gives itself its name
        nice = {text.split()[0]: int(text.rpartition(")")[2].split()[16]) for text in _threads(watch.pid)}
        taking = {text.split()[0] for text in _threads(watch.pid) if "(acc-" in text}
        watch.send_signal(signal.SIGINT)
    assert nice[str(watch.pid)] == os.nice(0) + 10
    assert {nice[thread] for thread in taking} == {os.nice(0)}  # `drivers.peer`: these threads take all


def _threads(process: int) -> list[str]:
    return [(task / "stat").read_text() for task in Path(f"/proc/{process}/task").iterdir()]
