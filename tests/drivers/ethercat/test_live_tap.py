"""The tap on a real interface and on a capture played as if live."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers.bus import Bus, open_bus
from drivers.ethercat.live_tap import FileSource, InterfaceSource, Tap
from drivers.health import Health
from drivers.inbox import Inbox
from drivers.trace.capture_trace import CaptureReader
from replay.clock import wait_until
from schemas.errors import BusError
from schemas.messages import HealthFlag, Role, SampleFlag
from schemas.robot import load_robot, save_robot
from tests.drivers.ethercat.rig import DELTATWIN, FAR, NEAR, Namespace, namespace
from tests.drivers.ethercat.wire import cycle, of_cycles, passes, robot

CYCLES = 1500
FAULTY, IN_FAULT, LOST = 400, 500, range(700, 703)


@pytest.fixture
def space() -> Iterator[Namespace]:
    with namespace("tap") as made:
        yield made


@pytest.fixture
def observer(bus_folder: Path) -> Iterator[Bus]:
    with open_bus("wired", Role.OBSERVER) as bus:
        yield bus


@pytest.fixture
def robot_file(tmp_path: Path) -> Path:
    save_robot(robot(), tmp_path / "wired.toml")
    return tmp_path / "wired.toml"


def send() -> None:
    """Both passes of a kilohertz of cycles, with every kind of trouble, onto the far end."""
    with socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0) as wire:
        wire.bind((FAR, 0))
        begin = time.monotonic_ns()
        for number in range(CYCLES):
            drives = cycle(number)
            if number == IN_FAULT:
                drives[1] = type(drives[1])(**{**drives[1].__dict__, "status": 8})
            out, back = passes(
                drives, cycle(number - 1), working_counter=6 if number == FAULTY else 9, index=number % 256
            )
            wait_until(begin + 1_000_000 * number)
            if number not in LOST:
                wire.send(out)
                wire.send(back)


def start(space: Namespace, robot_file: Path, *arguments: str) -> subprocess.Popen[str]:
    command = space.prefix(DELTATWIN, "tap", NEAR, "--robot", str(robot_file), *arguments)
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def until_ready(health: Inbox, tap: subprocess.Popen[str]) -> None:
    """Wait for the first health message: the tap listens."""
    give_up = time.monotonic() + 120
    while not health.wait(0.1):
        assert tap.poll() is None, tap.communicate()
        assert time.monotonic() < give_up


def taken(inbox: Inbox, count: int) -> np.ndarray:
    got: list[np.ndarray] = []
    give_up = time.monotonic() + 30
    while sum(map(len, got)) < count and time.monotonic() < give_up:
        inbox.wait(0.5)
        got.append(inbox.take()[0])
    return np.concatenate(got)


def test_every_cycle_on_the_wire_is_one_sample_and_nothing_is_sent(
    space: Namespace, observer: Bus, robot_file: Path
) -> None:
    samples, health = observer.subscribe("sample"), observer.subscribe("health")
    sound = CYCLES - len(LOST)
    tap = start(space, robot_file, "--count", str(sound), "--wait", "10")
    until_ready(health, tap)
    space.call(send)
    got = taken(samples, sound)
    out, said = tap.communicate(timeout=30)
    transmitted = subprocess.run(
        space.prefix("cat", f"/sys/class/net/{NEAR}/statistics/tx_packets"), capture_output=True, text=True, check=True
    )

    assert tap.returncode == 0, said
    of_cycles(got, [k for k in range(CYCLES) if k not in LOST])
    np.testing.assert_array_equal(got["sequence"], np.arange(sound))
    assert np.flatnonzero(got["flags"] & SampleFlag.BUS_FAULT).tolist() == [FAULTY, IN_FAULT]
    assert LOST[0] in np.flatnonzero(got["flags"] & SampleFlag.GAP_BEFORE)
    assert transmitted.stdout.strip() == "0"
    told = taken(health, 3)
    assert (told["role"] == Role.TAP).all()
    assert (told["flags"] & HealthFlag.BUS_FAULT).any()
    assert told["published"].max() == sound
    assert f"published {sound} samples" in out
    for words in ("working counter too low", "cycles lost", "joint 1: operation enabled"):
        assert words in said


def test_ctrl_c_ends_it_with_its_counts(space: Namespace, observer: Bus, robot_file: Path) -> None:
    health = observer.subscribe("health")
    tap = start(space, robot_file)
    until_ready(health, tap)
    tap.send_signal(signal.SIGINT)
    out, _ = tap.communicate(timeout=30)

    assert "published 0 samples" in out
    assert tap.returncode == 0


def test_an_interface_that_goes_down_is_one_error(space: Namespace, observer: Bus, robot_file: Path) -> None:
    health = observer.subscribe("health")
    tap = start(space, robot_file)
    until_ready(health, tap)
    subprocess.run(["ip", "-n", space.name, "link", "set", NEAR, "down"], check=True)
    _, said = tap.communicate(timeout=30)

    assert tap.returncode == 1
    assert said.splitlines()[-1] == f"deltatwin: {NEAR}: Network is down"


def test_interfaces_that_cannot_be_tapped_are_one_error_each(space: Namespace) -> None:
    with pytest.raises(BusError, match=r"nowhere0: no such interface \(interfaces: .*lo"):
        InterfaceSource("nowhere0")
    subprocess.run(["ip", "-n", space.name, "link", "set", NEAR, "down"], check=True)
    with pytest.raises(BusError, match=f"{NEAR}: the interface is down"):
        space.call(lambda: InterfaceSource(NEAR))


def test_without_the_privilege_it_says_which(space: Namespace) -> None:
    code = (
        "import os\nfrom drivers.ethercat import live_tap as tap\nos.setgid(65534); os.setuid(65534)\n"
        f"try: tap.InterfaceSource({NEAR!r})\n"
        "except tap.BusError as error: print(error)"
    )
    done = subprocess.run(space.prefix(sys.executable, "-c", code), capture_output=True, text=True, check=False)
    assert "raw Ethernet needs the capability CAP_NET_RAW (run as root)" in done.stdout, done.stderr


def test_a_capture_played_as_live_gives_what_converting_it_gives(data: Path, bus_folder: Path) -> None:
    path = data / "captures" / "own_three_drives_4khz.pcap"
    description = load_robot(Path(__file__).parent / "robots" / "own_three_drives.toml")
    published: list[bytes] = []
    said: list[str] = []
    tap = Tap(FileSource(path, wait_until, speed=20.0), description, said.append)
    with open_bus(description.name, Role.TAP) as bus:
        tap.run(published.append, Health(bus))
    whole = np.concatenate([samples for samples, _ in CaptureReader(path, description).blocks()])

    assert b"".join(published) == whole.tobytes()
    assert "joint 3: operation enabled" in said


def test_a_tap_ends_with_the_last_sample_out_when_it_is_told_to_stop(data: Path, bus_folder: Path) -> None:
    description = load_robot(Path(__file__).parent / "robots" / "own_three_drives.toml")
    published: list[bytes] = []
    source = FileSource(data / "captures" / "own_three_drives_4khz.pcap", wait_until, speed=20.0)
    with open_bus(description.name, Role.TAP) as bus:
        Tap(source, description, lambda _: None).run(published.append, Health(bus), stopped=lambda: len(published) == 7)

    assert len(published) == 7
    assert not source.ended
