"""The EtherCAT chain on one wire: the commands of this program side by side, and what they recorded compared."""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.ethercat.capture import Capture
from drivers.simulated.plant.truth import TRUTHS
from drivers.simulated.segment.wire import INPUT_DELAY_CYCLES
from schemas.errors import BusError, StorageError, TraceError
from schemas.files import make_folder, write_text
from schemas.messages import PayloadEvent, SampleFlag, stamp_ns
from schemas.robot import SHIPPED, Robot, load_robot
from schemas.words import percent
from service.monitor.readback import read_recording
from service.supervisor import Process, Supervisor

MODEL = "d3-1200"
MASTER_END, SEGMENT_END = "bus0", "seg0"
SETTLED = 1.5  # s at the start of a run that belong to the approach
CATCH_UP = 20.0  # s for the capture to take what has passed on the wire
CAPTURE_MIB = 64  # of kernel buffer for the capture: minutes of this bus, however busy the host
FRAMELESS = 0.1  # s before and after a cycle without a frame that are left out of the tracking error
PAYLOAD_SHARE = 0.05
OUTPUTS = ("0x6040", "0x607A", "0x6071", "0x6060", "0x60B2", "0x60FE")  # 15 bytes
INPUTS = ("0x6041", "0x6064", "0x606C", "0x6077", "0x6061")  # 13 bytes
TOOLS = {"ip": "iproute2", "dumpcap": "wireshark-common"}  # what it runs that is no part of this program: its package

_CLONE_NEWNET = 0x40000000


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
    write_text(robot, description())
    common = ["--rate", str(rate), "--duration", str(duration), "--speed", "0.5", "--seed", "3"]
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="deltatwin-"))
        crew = stack.enter_context(Supervisor(out, folder))
        say("starting segment, tap and capture")
        truth = str(TRUTHS / f"{MODEL}.toml")
        segment = crew.start(
            "segment: 3 drives", "segment", SEGMENT_END, "--robot", str(robot), "--truth", truth, "--rate", str(rate),
            "--out", str(out / "own.mcap"),
        )  # fmt: skip
        tap = crew.start(
            Path(folder, "deltatwin", f"{MODEL}.tap.sock"), "tap", MASTER_END, "--robot", str(robot), "--wait", "60"
        )
        dumpcap = ("dumpcap", "-q", "-B", str(CAPTURE_MIB), "-i", MASTER_END, "-w", str(out / "wire.pcapng"))
        capture = crew.launch("capture", dumpcap, "File: ")
        monitor = _monitor(crew, robot, out / "first.mcap")
        for process in (segment, tap, capture, monitor):
            process.wait_ready()
        before = _frames_on_wire()
        say(f"first run, {duration:g} s: empty gripper, no feed-forward")
        crew.run("master", MASTER_END, "--robot", str(robot), "--feedforward", "off", *common)
        _let_catch_up(out / "wire.pcapng", before)
        monitor.stop()
        say("identifying the robot from the samples of the tap")
        crew.run("identify", str(out / "first.mcap"), "--robot", str(robot), "--out", str(identified))
        estimator = crew.start("estimating for", "estimate", "--robot", str(identified))
        monitor = _monitor(crew, robot, out / "second.mcap")
        segment.tell(f"product {product}")
        for process in (estimator, monitor):
            process.wait_ready()
        say(f"second run, {duration:g} s: the same motion with {product:g} kg, tau_FF over Zenoh")
        crew.run("master", MASTER_END, "--robot", str(identified), "--feedforward", "bus", *common, name="master-2")
        missing = _let_catch_up(out / "wire.pcapng", before)
        for process in (tap, capture, estimator, monitor, segment):
            process.stop()
        say("converting the capture offline")
        crew.run("convert", str(out / "wire.pcapng"), "--robot", str(robot), str(out / "offline.mcap"))
    return compare(out, product, missing)


def description() -> str:
    """The shipped robot with three drives on a bus, which differ in sign and zero."""
    text = (SHIPPED / f"{MODEL}.toml").read_text(encoding="utf-8")
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


def compare(out: Path, product: float, missing: int) -> list[Check]:
    """Hold what `demonstrate` left in `out` against each other. missing: frames on the wire that were not captured."""
    robot = load_robot(out / "robot.toml")
    recordings = {name: read_recording(out / f"{name}.mcap") for name in ("own", "first", "second", "offline")}
    own, first, second, offline = (recording["sample"].records for recording in recordings.values())
    pause = int(np.argmax(np.diff(stamp_ns(own)))) + 1
    runs = slice(0, pause), slice(pause, len(own))
    return [
        _same_as_own("tap, first run", first, own, runs[0], robot),
        _same_as_own("tap, second run", second, own, runs[1], robot),
        _same_as_own("capture converted offline", offline, own, slice(0, len(own)), robot),
        _same_as_tap(offline, np.concatenate((first, second)), missing),
        _payload(recordings["second"]["payload"].records, product),
        _tracking(own, runs),
    ]


def _same_as_own(name: str, heard: np.ndarray, own: np.ndarray, run: slice, robot: Robot) -> Check:
    """Samples in operation against the plant's own, `INPUT_DELAY_CYCLES` earlier, in units of the drives.

    On a host that is too busy Zenoh passes over a stuck monitor, whose log then lacks cycles. What is there has to be
    right, and each hole told: by the tap's sequence where the log has it, by GAP_BEFORE where the tap has.
    """
    stamps, true = stamp_ns(heard), stamp_ns(own)
    row = np.searchsorted(true, stamps)
    known = (row >= 2) & (row < len(true)) & (heard["flags"] & SampleFlag.BUS_FAULT == 0)
    known[known] = true[row[known]] == stamps[known]
    drives = robot.drive.joint
    count = np.array([2 * np.pi / drive.counts_per_turn for drive in drives]) / robot.drive.gear_ratio
    unit = np.array([drive.torque.full_scale_nm for drive in drives]) * robot.drive.gear_ratio / 1000

    def worst(delay: int) -> tuple[float, float]:
        at = row[known] - delay
        position = np.abs(heard["position"][known] - own["position"][at]) / count
        torque = np.abs(heard["torque"][known] - own["torque"][at]) / unit
        return float(position.max()), float(torque.max())

    position, torque = worst(INPUT_DELAY_CYCLES)
    others = min(worst(INPUT_DELAY_CYCLES - 1)[0], worst(INPUT_DELAY_CYCLES + 1)[0])
    missing = np.setdiff1d(true[run][own["flags"][run] == 0], stamps)
    told = (np.diff(heard["sequence"], prepend=heard["sequence"][:1]) > 1) | (
        heard["flags"] & SampleFlag.GAP_BEFORE != 0
    )
    before = np.searchsorted(stamps, missing)  # the sample behind the hole; the end of a log tells of none behind it
    untold = int((~told[before[before < len(told)]]).sum())
    return Check(
        f"{name}: the plant's own log, {INPUT_DELAY_CYCLES} cycle later",
        f"{known.sum()} cycles in operation; off by {position:.3f} counts, {torque:.3f} per mille "
        f"({others:.0f} counts one cycle earlier or later); {len(missing)} missing, {untold} of them unexplained",
        "0.501 counts and per mille; 0 unexplained",
        bool(position <= 0.501 and torque <= 0.501 < others and untold == 0 and known.sum() > len(missing)),
    )


def _same_as_tap(offline: np.ndarray, heard: np.ndarray, missing: int) -> Check:
    """The samples of all cycles that tap and capture both saw, bit for bit. A whole capture has all that the tap has.

    What a loss before a sample does to it, GAP_BEFORE, is each recorder's own.
    """
    stamps = stamp_ns(offline)
    row = np.searchsorted(stamps, stamp_ns(heard)).clip(max=len(stamps) - 1)
    both = stamps[row] == stamp_ns(heard)
    ours, theirs = heard[both], offline[row[both]]
    same = (ours["flags"] ^ theirs["flags"]) & ~np.uint32(SampleFlag.GAP_BEFORE) == 0
    for name in ("position", "torque", "position_command", "torque_command"):
        same &= ((ours[name] == theirs[name]) | (np.isnan(ours[name]) & np.isnan(theirs[name]))).all(axis=1)
    different, only_tap = int((~same).sum()), int((~both).sum())
    return Check(
        "capture converted offline: the same samples as the tap's",
        f"{len(same)} samples compared, {different} different; {only_tap} of the tap's are not in the capture, "
        f"which lacks {missing} frames of the wire",
        "0 different; none lacking unless frames are",
        different == 0 and len(same) > only_tap and (only_tap == 0 or missing > 0),
    )


def _payload(payload: np.ndarray, product: float) -> Check:
    picks = int((payload["event"] == PayloadEvent.PICK).sum())
    carried = payload["mass"][(payload["trusted"] == 1) & (payload["mass"] > product / 2)]
    mass = float(np.median(carried)) if len(carried) else float("nan")
    return Check(
        f"payload of {product:g} kg is found",
        f"{mass:.3f} kg, median of {len(carried)} trusted estimates; {picks} picks",
        f"within {percent(PAYLOAD_SHARE)}",
        picks > 0 and abs(mass - product) <= PAYLOAD_SHARE * product,
    )


def _tracking(own: np.ndarray, runs: tuple[slice, slice]) -> Check:
    """Where the plant was against where its drives were told to be, while neither run is approaching."""
    time_s = (stamp_ns(own) - stamp_ns(own)[0]) * 1e-9
    frameless = time_s[own["flags"] != 0]
    errors = []
    for run in runs:
        used = time_s[run] > time_s[run][0] + SETTLED
        for moment in frameless:  # a drive that hears nothing stops where it is, whatever the feed-forward
            used &= np.abs(time_s[run] - moment) > FRAMELESS
        errors.append((own["position_command"][run] - own["position"][run])[used])
    before, after = (1e3 * float(np.sqrt((error**2).mean())) for error in errors)
    return Check(
        "tracking error is smaller with tau_FF",
        f"{before:.3f} to {after:.3f} mrad rms, though the second run carries the product",
        "to half or less",
        after <= before / 2,
    )


def _monitor(crew: Supervisor, robot: Path, path: Path) -> Process:
    return crew.start(path, "monitor", "--robot", robot, "--out", path, name=f"monitor-{path.stem}")


def _frames_on_wire() -> int:
    """Frames that have passed the master's end, both ways."""
    for line in Path("/proc/self/net/dev").read_text().splitlines():
        name, _, counts = line.partition(":")
        if name.strip() == MASTER_END:
            received, sent = (int(counts.split()[column]) for column in (1, 9))
            return received + sent
    raise BusError(f"{MASTER_END}: no such interface")


def _let_catch_up(capture: Path, before: int) -> int:
    """Wait until the file holds all frames that passed since there were `before`; how many it still lacks.

    A capture that is stopped at once loses what the kernel still holds for it.
    """
    give_up, passed = time.monotonic() + CATCH_UP, _frames_on_wire() - before
    while (missing := passed - _captured(capture)) > 0 and time.monotonic() < give_up:
        time.sleep(0.2)
    return max(missing, 0)


def _captured(path: Path) -> int:
    capture = Capture(path)
    with contextlib.suppress(TraceError):  # before its header is written it is no capture
        for _ in capture.blocks():
            pass
    return capture.frames


def _make_folder(out: Path) -> None:
    make_folder(out)
    if any(out.iterdir()):
        raise StorageError(f"{out}: is not empty; give another folder with --out")


def _enter_namespace() -> None:
    """Move this process, and all it starts, into a network namespace with a veth pair; it goes when they end.

    The right to do so is asked for before the tools: whoever lacks it would install them for nothing.
    """
    if ctypes.CDLL(None, use_errno=True).unshare(_CLONE_NEWNET) != 0:
        raise BusError(
            f"network namespace: {os.strerror(ctypes.get_errno())}; needs the capability CAP_SYS_ADMIN (run as root)"
        )
    if missing := [tool for tool in TOOLS if shutil.which(tool) is None]:
        packages = " ".join(TOOLS[tool] for tool in missing)
        raise BusError(f"ethercat-demo needs {' and '.join(missing)}, not found on PATH; install {packages}")
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
