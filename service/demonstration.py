"""The EtherCAT chain on one wire: the commands of this program side by side, and what they recorded compared."""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import IO

import numpy as np

from drivers.ethercat.segment.wire import INPUT_DELAY_CYCLES
from drivers.trace import read_trace
from schemas.errors import BusError, StorageError
from schemas.messages import PAYLOAD, PayloadEvent, SampleFlag, stamp_ns
from schemas.robot import Robot, load_robot
from schemas.trace import Trace

MODEL = "d3-1200"
MASTER_END, SEGMENT_END = "bus0", "seg0"
READY_TIME = 90.0  # s for a process to say that it is ready: the first start of all compiles
SETTLED = 1.5  # s at the start of a run that belong to the approach
FRAMELESS = 0.1  # s before and after a cycle without a frame that are left out of the tracking error
PAYLOAD_SHARE = 0.05
OUTPUTS = ("0x6040", "0x607A", "0x6071", "0x6060", "0x60B2", "0x60FE")  # 15 bytes
INPUTS = ("0x6041", "0x6064", "0x606C", "0x6077", "0x6061")  # 13 bytes

_CLONE_NEWNET = 0x40000000
_PROGRAM = (sys.executable, "-c", "from service.cli.main import main; main()")


@dataclass(frozen=True)
class Check:
    """One claim, what was measured, and what bound it has to keep."""

    claim: str
    measured: str
    bound: str
    holds: bool


def demonstrate(out: Path, rate: float, duration: float, product: float, say: Callable[[str], None]) -> list[Check]:
    """Run the demonstration and check it; `say` is told each step.

    Raises:
        BusError: no privilege, a tool is missing, or a process failed.
        StorageError: `out` cannot be used.
    """
    _enter_namespace()
    _make_folder(out)
    robot, identified = out / "robot.toml", out / "identified.toml"
    robot.write_text(description())
    common = ["--rate", str(rate), "--duration", str(duration), "--speed", "0.5", "--seed", "3"]
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="deltatwin-"))
        crew = stack.enter_context(_crew(out, folder))
        say("segment, tap and capture start")
        truth = str(resources.files("drivers.plant") / "truths" / f"{MODEL}.toml")
        segment = crew.start(
            "segment: 3 drives", "segment", SEGMENT_END, "--robot", str(robot), "--truth", truth, "--rate", str(rate),
            "--trace", str(out / "own.mcap"),
        )  # fmt: skip
        tap = crew.start(
            Path(folder, "deltatwin", f"{MODEL}.tap.sock"), "tap", MASTER_END, "--robot", str(robot), "--wait", "60"
        )
        capture = crew.capture(out / "wire.pcapng")
        monitor = crew.monitor(robot, out / "first.mcap")
        for process in (segment, tap, capture, monitor):
            process.wait_ready()
        say(f"first run, {duration:g} s: empty gripper, no feed-forward")
        crew.run("master", MASTER_END, "--robot", str(robot), "--feedforward", "off", *common)
        monitor.stop()
        say("the robot is identified from what the tap heard")
        crew.run("identify", str(out / "first.mcap"), "--robot", str(robot), "--out", str(identified))
        estimator = crew.start("estimating for", "estimate", "--robot", str(identified))
        monitor = crew.monitor(robot, out / "second.mcap")
        segment.tell(f"product {product}")
        for process in (estimator, monitor):
            process.wait_ready()
        say(f"second run, {duration:g} s: the same motion with {product:g} kg, tau_FF over Zenoh")
        crew.run("master", MASTER_END, "--robot", str(identified), "--feedforward", "bus", *common, log="master-2")
        for process in (tap, capture, estimator, monitor, segment):
            process.stop()
        say("the capture is converted offline")
        crew.run("convert", str(out / "wire.pcapng"), "--robot", str(robot), str(out / "offline.mcap"))
    return compare(out, product)


def description() -> str:
    """The shipped robot with three drives on a bus, which differ in sign and zero."""
    text = (resources.files("schemas") / "robots" / f"{MODEL}.toml").read_text(encoding="utf-8")
    for joint, (sign, zero) in enumerate(((1, 12_000), (-1, -3_400_000), (1, 0))):
        text += f"""
[[drive.joint]]
station = {0x1001 + joint}
counts_per_turn = 1048576
sign = {sign}
zero_counts = {zero}
torque = {{ reference = "rated_torque", rated_torque_nm = 10.0 }}
velocity_unit_counts_per_s = 1000.0
outputs_address = {15 * joint}
outputs = {list(OUTPUTS)}
inputs_address = {45 + 13 * joint}
inputs = {list(INPUTS)}
"""
    return text


def compare(out: Path, product: float) -> list[Check]:
    """Hold what `demonstrate` left in `out` against each other."""
    robot = load_robot(out / "robot.toml")
    own = read_trace(out / "own.mcap")
    first, second = read_trace(out / "first.mcap", robot), read_trace(out / "second.mcap", robot)
    offline = read_trace(out / "offline.mcap", robot)
    return [
        _same_as_own("tap, first run", first, own, robot),
        _same_as_own("tap, second run", second, own, robot),
        _same_as_own("capture converted offline", offline, own, robot),
        _offline(offline, (first, second)),
        _payload(out / "second.mcap", product),
        _tracking(own),
    ]


def _same_as_own(name: str, heard: Trace, own: Trace, robot: Robot) -> Check:
    """Samples in operation against the plant's own, `INPUT_DELAY_CYCLES` earlier, in units of the drives.

    On a host that is too busy Zenoh may pass over a stuck monitor, so that some cycles are missing from its log; what
    is there has to be right.
    """
    stamps, true = _stamps(heard), _stamps(own)
    row = np.searchsorted(true, stamps)
    known = (row >= 2) & (row < len(true)) & (heard.flags & SampleFlag.BUS_FAULT == 0)
    known[known] = true[row[known]] == stamps[known]
    drives = robot.drive.joint
    count = np.array([2 * np.pi / drive.counts_per_turn for drive in drives]) / robot.drive.gear_ratio
    unit = np.array([drive.torque.full_scale_nm for drive in drives]) * robot.drive.gear_ratio / 1000

    def worst(delay: int) -> tuple[float, float]:
        at = row[known] - delay
        position = np.abs(heard.position[known] - own.position[at]) / count
        torque = np.abs(heard.torque[known] - own.torque[at]) / unit
        return float(position.max()), float(torque.max())

    position, torque = worst(INPUT_DELAY_CYCLES)
    others = min(worst(INPUT_DELAY_CYCLES - 1)[0], worst(INPUT_DELAY_CYCLES + 1)[0])
    in_run = (true >= stamps[known][0]) & (true <= stamps[known][-1]) & (own.flags == 0)
    missing = int(in_run.sum() - known.sum())
    return Check(
        f"{name}: the plant's own trace, {INPUT_DELAY_CYCLES} cycle later",
        f"{known.sum()} cycles, {missing} missing; off by {position:.3f} counts, {torque:.3f} per mille "
        f"({others:.0f} counts a cycle earlier or later)",
        "0.501 counts and per mille",
        bool(position <= 0.501 and torque <= 0.501 < others and known.sum() > 0.9 * in_run.sum()),
    )


def _offline(offline: Trace, heard: tuple[Trace, ...]) -> Check:
    stamps = _stamps(offline)
    compared = different = 0
    for trace in heard:
        row = np.searchsorted(stamps, _stamps(trace)).clip(max=len(stamps) - 1)
        both = stamps[row] == _stamps(trace)
        compared += int(both.sum())
        different += int(len(trace) - both.sum())
        for ours, theirs in ((trace.position, offline.position), (trace.torque, offline.torque)):
            different += int((ours[both] != theirs[row[both]]).any(axis=1).sum())
    return Check(
        "capture converted offline: the same samples as the tap's",
        f"{compared} samples compared, {different} different",
        "0 different",
        different == 0 < compared,
    )


def _payload(path: Path, product: float) -> Check:
    payload = _messages(path)
    picks = int((payload["event"] == PayloadEvent.PICK).sum())
    carried = payload["mass"][(payload["trusted"] == 1) & (payload["mass"] > product / 2)]
    mass = float(np.median(carried)) if len(carried) else float("nan")
    return Check(
        f"payload of {product:g} kg is found",
        f"{mass:.3f} kg, median of {len(carried)} trusted estimates; {picks} picks",
        f"within {PAYLOAD_SHARE:.0%}",
        picks > 0 and abs(mass - product) <= PAYLOAD_SHARE * product,
    )


def _tracking(own: Trace) -> Check:
    """Where the plant was against where its drives were told to be, while neither run is approaching."""
    assert own.position_command is not None
    gap = int(np.argmax(np.diff(own.time))) + 1
    frameless = np.flatnonzero(own.flags)
    errors = []
    for start, stop in ((0, gap), (gap, len(own))):
        used = own.time > own.time[start] + SETTLED
        used[:start] = used[stop:] = False
        for row in frameless:  # a drive that hears nothing stops where it is, whatever the feed-forward
            used &= np.abs(own.time - own.time[row]) > FRAMELESS
        errors.append((own.position_command - own.position)[used])
    before, after = (1e3 * float(np.sqrt((error**2).mean())) for error in errors)
    return Check(
        "tracking error falls with tau_FF",
        f"{before:.3f} to {after:.3f} mrad rms, though the second run carries the product",
        "to half or less",
        after <= before / 2,
    )


def _stamps(trace: Trace) -> np.ndarray:
    """Bus time of every row, ns."""
    return stamp_ns(trace.samples())


def _messages(path: Path) -> np.ndarray:
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        found = [
            message.data
            for schema, _, message in make_reader(stream).iter_messages()
            if schema is not None and schema.name == PAYLOAD.schema_name
        ]
    return np.frombuffer(b"".join(found), PAYLOAD.dtype)


class _Process:
    """One process of the demonstration, what it says going to a file."""

    def __init__(
        self, name: str, command: list[str], log: Path, environment: dict[str, str], ready: str | Path
    ) -> None:
        """`ready`: what it says, or the file it makes, when it is ready."""
        self.name, self._log, self._ready = name, log, ready
        self._file: IO[str] = log.open("w")
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=self._file, stderr=subprocess.STDOUT, env=environment, text=True
        )

    def wait_ready(self) -> None:
        """Raise unless it says that it is ready.

        Raises:
            BusError: it ended, or said nothing for `READY_TIME`.
        """
        give_up = time.monotonic() + READY_TIME
        while not self._is_ready():
            if self._process.poll() is not None or time.monotonic() > give_up:
                raise BusError(f"{self.name} did not start: {self.last_words()}")
            time.sleep(0.05)

    def _is_ready(self) -> bool:
        if isinstance(self._ready, Path):
            return self._ready.exists()
        return self._ready in self._log.read_text()

    def tell(self, line: str) -> None:
        """Write to its standard input."""
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def wait(self, timeout: float) -> None:
        """Wait for it to end by itself.

        Raises:
            BusError: it failed or does not end.
        """
        try:
            code = self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            raise BusError(f"{self.name} does not end: {self.last_words()}") from None
        if code != 0:
            raise BusError(f"{self.name} failed: {self.last_words()}")

    def stop(self) -> None:
        """End it as Ctrl-C does, and by force if that does not help."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(20)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._file.close()

    def last_words(self) -> str:
        """The last line it said."""
        lines = self._log.read_text().strip().splitlines()
        return lines[-1].removeprefix("deltatwin: ") if lines else "it said nothing"


class _Crew:
    """Starts processes and ends those that are left."""

    def __init__(self, out: Path, runtime_folder: str) -> None:
        self._out = out
        self._environment = os.environ | {"XDG_RUNTIME_DIR": runtime_folder}
        self._started: list[_Process] = []

    def start(self, ready: str | Path, *arguments: str, log: str = "") -> _Process:
        """One command of this program, in the background; `ready` is what tells that it is."""
        return self._launch(log or arguments[0], [*_PROGRAM, *arguments], ready)

    def capture(self, path: Path) -> _Process:
        """Everything on the master's end of the wire to `path`."""
        return self._launch("capture", ["dumpcap", "-q", "-i", MASTER_END, "-w", str(path)], "File: ")

    def monitor(self, robot: Path, path: Path) -> _Process:
        """`deltatwin monitor` of `robot`, to `path`."""
        return self.start(path, "monitor", "--robot", str(robot), "--output", str(path), log=f"monitor-{path.stem}")

    def run(self, *arguments: str, log: str = "") -> None:
        """One command of this program, to its end."""
        self._launch(log or arguments[0], [*_PROGRAM, *arguments], "").wait(600)

    def stop(self) -> None:
        """End whatever runs."""
        for process in self._started:
            process.stop()

    def _launch(self, name: str, command: list[str], ready: str | Path) -> _Process:
        process = _Process(name, command, self._out / f"{name}.log", self._environment, ready)
        self._started.append(process)
        return process


@contextlib.contextmanager
def _crew(out: Path, runtime_folder: str) -> Iterator[_Crew]:
    crew = _Crew(out, runtime_folder)
    try:
        yield crew
    finally:
        crew.stop()


def _make_folder(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()):
            raise StorageError(f"{out}: is not empty; give another folder with --out")
    except OSError as error:
        raise StorageError(f"{out}: {error.strerror}") from error


def _enter_namespace() -> None:
    """Move this process, and all it starts, into a network namespace with a veth pair; it goes when they end."""
    for tool, package in (("ip", "iproute2"), ("dumpcap", "wireshark-common")):
        if shutil.which(tool) is None:
            raise BusError(f"{tool} not found; install {package}")
    if ctypes.CDLL(None, use_errno=True).unshare(_CLONE_NEWNET) != 0:
        raise BusError(
            f"network namespace: {os.strerror(ctypes.get_errno())}; needs the capability CAP_SYS_ADMIN (run as root)"
        )
    with contextlib.suppress(OSError):  # nothing else is to be on the wire
        Path("/proc/sys/net/ipv6/conf/default/disable_ipv6").write_text("1")
    for arguments in (
        ("link", "add", MASTER_END, "type", "veth", "peer", "name", SEGMENT_END),
        ("link", "set", MASTER_END, "up"),
        ("link", "set", SEGMENT_END, "up"),
        ("link", "set", "lo", "up"),
    ):
        done = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)
        if done.returncode:
            raise BusError(f"ip {' '.join(arguments)}: {done.stderr.strip()}")
