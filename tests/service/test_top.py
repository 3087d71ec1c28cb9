"""`deltatwin top`: what is on the bus is on the terminal, whole at 80 columns, and Ctrl-C ends it."""

from __future__ import annotations

import fcntl
import io
import os
import re
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from drivers.bus import Bus, open_bus
from drivers.health import Health
from schemas.messages import FEEDFORWARD, MODEL_ERROR, PAYLOAD, SAMPLE, HealthFlag, PayloadEvent, Role, set_stamp
from schemas.robot import load_robot
from service.cli.live import Joints

PROGRAM = Path(sys.executable).with_name("deltatwin")
CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


def publish(player: Bus, estimator: Bus, number: int, event: PayloadEvent = PayloadEvent.NONE) -> None:
    """One cycle of a robot: torque 1, 2, 3 N m, 1.234 kg, joint 2 at rest."""
    for bus, topic, message, values in (
        (player, "sample", SAMPLE, {"torque": [1.0, 2.0, 3.0], "position": [0.1, 0.2, 0.3]}),
        (estimator, "feedforward", FEEDFORWARD, {"torque": [1.5, 2.5, 3.5]}),
        (estimator, "payload", PAYLOAD, {"mass": 1.234, "trusted": 1, "event": event}),
        (estimator, "error", MODEL_ERROR, {"full": [0.3, np.nan, 0.5], "kh": 1.0, "id_friction": 0.7}),
    ):
        record = message.empty(1)
        record["sequence"] = number
        set_stamp(record, np.array([number * 1_000_000]))
        for name, value in values.items():
            record[name] = value
        bus.publisher(topic).put(record.tobytes())


class Heard:
    """A bus on which one cycle of a robot was heard, and the health of nobody."""

    def __init__(self) -> None:
        self.records: dict[str, np.ndarray] = {}

    def publisher(self, topic: str) -> Heard:
        self.topic = topic
        return self

    def put(self, message: bytes) -> None:
        dtype = {"sample": SAMPLE, "feedforward": FEEDFORWARD, "payload": PAYLOAD, "error": MODEL_ERROR}[
            self.topic
        ].dtype
        self.records[self.topic] = np.frombuffer(message, dtype)

    def subscribe(self, topic: str) -> SimpleNamespace:
        return SimpleNamespace(take=lambda: (self.records.get(topic, np.zeros(0)), 0))


def test_joints_have_columns_of_one_width_whatever_is_carried(bench_robot: Path) -> None:
    bus: Any = Heard()
    publish(bus, bus, 1)
    screen = Console(width=80, file=io.StringIO())
    screen.print(Joints(bus, load_robot(bench_robot)).picture("bench"))
    lines = screen.file.getvalue().splitlines()  # type: ignore[attr-defined]
    ends = [found.end() for found in re.finditer(r"joint \d", lines[1])]
    assert len(set(np.diff(ends))) == 1
    assert ends[2] - ends[1] < 12
    (payload,) = (line for line in lines if line.startswith("payload, kg"))
    assert re.search(r" 1\.234 +± nan random, ± nan common +trusted", payload)


@pytest.mark.parametrize("terminal", [False, True])
def test_what_is_on_the_bus_is_shown(bus_folder: Path, bench_robot: Path, until: Callable, terminal: bool) -> None:
    master, slave = os.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 60, 80, 0, 0))
    output = slave if terminal else subprocess.PIPE
    with open_bus("bench", Role.PLAYER) as player, open_bus("bench", Role.ESTIMATOR) as estimator:
        health = Health(estimator, HealthFlag.NO_REALTIME)
        health.flags = HealthFlag.FRICTION_DRIFT
        process = subprocess.Popen([PROGRAM, "top", "--robot", bench_robot], stdout=output, stderr=subprocess.PIPE)
        until(lambda: Role.OBSERVER in player.alive and Role.OBSERVER in estimator.alive)
        seen, give_up, number = b"", time.monotonic() + 60.0, 0
        os.set_blocking(master, False)
        if process.stdout is not None:
            os.set_blocking(process.stdout.fileno(), False)
        while time.monotonic() < give_up and not (b"friction drift" in seen and b"1.234" in seen and b"pick" in seen):
            publish(player, estimator, number, PayloadEvent.PICK if number == 200 else PayloadEvent.NONE)
            if health.due:
                health.publish(received=number, published=number, lost=0)
            number += 1
            time.sleep(2e-3)
            try:
                seen += (os.read(master, 1 << 16) if terminal else process.stdout.read()) or b""  # type: ignore[union-attr]
            except BlockingIOError:
                continue
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0, process.stderr and process.stderr.read()
    os.close(slave)
    os.close(master)
    text = CONTROL.sub("\n" if terminal else "", seen.decode())
    for said in ("torque measured, N m", "+2.00", "+2.50", "1.234", "trusted", "at rest", "0.50", "estimator", "runs"):
        assert said in text, text
    assert not terminal or max(len(line) for line in text.replace("\r", "").split("\n")) <= 80


@pytest.mark.parametrize("by", [b"q", b"\x03", signal.SIGTERM])
def test_the_terminal_is_as_it_was(bus_folder: Path, bench_robot: Path, by: bytes | signal.Signals) -> None:
    """Standard error is not the terminal, and nothing is on the bus: the screen is there, and nothing of it stays."""
    master, slave = os.openpty()
    before = termios.tcgetattr(slave)
    process = subprocess.Popen(
        [PROGRAM, "top", "--robot", bench_robot], stdin=slave, stdout=slave, stderr=subprocess.DEVNULL,
        env=os.environ | {"TERM": "xterm-256color", "COLORTERM": "truecolor"},
    )  # fmt: skip
    seen = b""
    while b"bench; q or Ctrl-C ends it" not in seen:
        seen += os.read(master, 1 << 16)
    during = termios.tcgetattr(slave)
    assert during[3] & termios.ECHO == 0
    if isinstance(by, bytes):
        os.write(master, by)
    else:
        process.send_signal(by)
    while b"next: deltatwin monitor" not in seen:
        seen += os.read(master, 1 << 16)
    assert process.wait(30) == 0
    assert termios.tcgetattr(slave) == before
    os.close(slave)
    os.close(master)
    shown, left = (seen.rfind(code) for code in (b"\x1b[?1049h", b"\x1b[?1049l"))
    assert -1 < shown < left < seen.rfind(b"\x1b[?25h")
    assert not re.search(rb"\x1b\[[0-9;]*[34]8;[25];", seen)  # no colours but the terminal's own


def test_it_ends_when_the_terminal_is_gone(bus_folder: Path, bench_robot: Path) -> None:
    """Of which no signal tells where the terminal is not the controlling one."""
    master, slave = os.openpty()
    process = subprocess.Popen(
        [PROGRAM, "top", "--robot", bench_robot], stdin=slave, stdout=slave, stderr=subprocess.PIPE
    )
    os.close(slave)
    seen = b""
    while b"ends it" not in seen:
        seen += os.read(master, 1 << 16)
    os.close(master)
    _, said = process.communicate(timeout=20)
    assert process.returncode == 1, said
