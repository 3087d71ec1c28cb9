"""A robot on a wire for tests: its description, a namespace with a veth pair, the segment process at the far end."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from schemas.robot import Robot, load_robot

DELTATWIN = str(Path(sys.executable).with_name("deltatwin"))
NEAR, FAR = "bus0", "seg0"
OUTPUTS = ("0x6040", "0x607A", "0x6071", "0x6060", "0x60B2", "0x60FE")
INPUTS = ("0x6041", "0x6064", "0x606C", "0x6077", "0x6061", "0x60FD")
_CLONE_NEWNET = 0x40000000

_BODY = """
name = "rig"
[geometry]
active_link_length = 0.4
passive_link_length = 0.9
base_radius = 0.2
platform_radius = 0.05
[mass]
active_link = 2.0
passive_link = 0.5
platform = 1.0
[drive]
gear_ratio = 10.0
gripper = { joint = 1, bit = 16 }
[identified]
viscous_friction_nms = { value = [1.0, 1.2, 0.8] }
coulomb_friction_nm = { value = [2.0, 1.5, 2.5] }
forearm_inertia_kg = { value = 0.5 }
"""
TRUTH = """
viscous_friction_nms = [1.0, 1.2, 0.8]
coulomb_friction_nm = [2.0, 1.5, 2.5]
torque_noise_nm = [0.1, 0.1, 0.1]
"""


def description(outputs: tuple[str, ...] = OUTPUTS, inputs: tuple[str, ...] = INPUTS) -> str:
    """A robot description whose drives differ in sign, zero and torque unit."""
    sizes = {"0x6040": 2, "0x607A": 4, "0x6071": 2, "0x6060": 1, "0x60B2": 2, "0x60B0": 4, "0x60FE": 4}
    sizes |= {"0x6041": 2, "0x6064": 4, "0x606C": 4, "0x6077": 2, "0x6061": 1, "0x60FD": 4}
    out, back = sum(sizes[name] for name in outputs), sum(sizes[name] for name in inputs)
    text = _BODY
    for number, (sign, zero, rated) in enumerate(((1, 1000, 2.4), (-1, -70_000, 2.4), (1, 2_147_000_000, 3.0))):
        text += f"""
[[drive.joint]]
station = {0x1001 + number}
counts_per_turn = 1048576
sign = {sign}
zero_counts = {zero}
torque = {{ reference = "rated_torque", rated_torque_nm = {rated} }}
velocity_unit_counts_per_s = 100.0
outputs_address = {number * out}
outputs = {list(outputs)}
inputs_address = {3 * out + number * back}
inputs = {list(inputs)}
"""
    return text


def robot(folder: Path, **mapping: tuple[str, ...]) -> Robot:
    """The description of `description` as its reader sees it."""
    path = folder / "robot.toml"
    path.write_text(description(**mapping))
    return load_robot(path)


def require_namespaces() -> None:
    """Skip where no network namespace can be made."""
    allowed = shutil.which("ip") and shutil.which("unshare")
    if not allowed or subprocess.run(["unshare", "--net", "true"], capture_output=True, check=False).returncode:
        pytest.skip("needs iproute2 and the right to make a network namespace, for a veth pair")


class Namespace:
    """A network namespace with both ends of a veth pair, `NEAR` and `FAR`, up."""

    def __init__(self, name: str) -> None:
        self.name = name

    def prefix(self, *command: str) -> list[str]:
        """`command` to be run in here, as ordinary work whatever this process is: what has to be prompt says so itself,
        and starting at real-time priority would hold up what runs already."""
        return ["chrt", "--other", "0", "ip", "netns", "exec", self.name, *command]

    def call(self, function: Callable[[], Any]) -> Any:
        """What `function` gives when it runs, on a thread of its own, in here.

        Without garbage collection, as the roles are (`go_realtime`): one over all that a process of tests holds takes
        longer than the drives' watchdogs.
        """
        outcome: list[Any] = []

        def enter() -> None:
            with open(f"/run/netns/{self.name}") as handle:
                if ctypes.CDLL(None, use_errno=True).setns(handle.fileno(), _CLONE_NEWNET) != 0:
                    outcome.append(OSError(ctypes.get_errno(), "setns"))
                    return
            with contextlib.suppress(OSError):  # a master among other work of this machine needs it
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
            try:
                outcome.append(function())
            except BaseException as error:
                outcome.append(error)

        thread = threading.Thread(target=enter)
        gc.disable()
        try:
            thread.start()
            thread.join()
        finally:
            gc.enable()
        if isinstance(outcome[0], BaseException):
            raise outcome[0]
        return outcome[0]


@contextlib.contextmanager
def namespace(name: str, middle: tuple[str, str] | None = None) -> Iterator[Namespace]:
    """Make a namespace and take it away again. middle: the ends of what stands between `NEAR` and `FAR`."""
    require_namespaces()
    name = f"{name}-{os.getpid()}"
    run = lambda *command: subprocess.run(command, check=True, capture_output=True)  # noqa: E731
    run("ip", "netns", "add", name)
    try:
        space = Namespace(name)
        run(*space.prefix("sysctl", "-qw", "net.ipv6.conf.all.disable_ipv6=1", "net.ipv6.conf.default.disable_ipv6=1"))
        for one, other in [(NEAR, middle[0]), (middle[1], FAR)] if middle else [(NEAR, FAR)]:
            run("ip", "-n", name, "link", "add", one, "type", "veth", "peer", "name", other)
        for interface in (NEAR, FAR, *(middle or ()), "lo"):
            run("ip", "-n", name, "link", "set", interface, "up")
        yield space
    finally:
        subprocess.run(["ip", "netns", "del", name], check=False)


class SegmentProcess:
    """`deltatwin segment` on `FAR`, with its switches."""

    def __init__(self, space: Namespace, *arguments: str) -> None:
        self._process = subprocess.Popen(
            space.prefix(DELTATWIN, "segment", FAR, *arguments),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdin is not None
        assert self._process.stderr is not None
        while "segment: 3 drives" not in (line := self._process.stderr.readline()):
            assert line, f"segment ended with {self._process.wait()}"

    def say(self, line: str) -> None:
        """Throw a switch, and wait until it is thrown."""
        assert self._process.stdin is not None
        assert self._process.stderr is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()
        while "segment: switched" not in self._process.stderr.readline():
            pass

    def hold(self, seconds: float) -> None:
        """Let it stand still; the frames that come meanwhile wait."""
        self._process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        self._process.send_signal(signal.SIGCONT)

    def stop(self) -> str:
        """End it; what it said of itself."""
        self._process.terminate()
        return self._process.communicate(timeout=20)[0]
