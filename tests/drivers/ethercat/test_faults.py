"""Every line of the table of faults (docs/how-to/faults.md), on a wire at 1 kHz: who tells, how soon, what drives get.

Segment, middle box, tap, estimator and master are processes of their own, one `forkserver` away from this one so that
they start in a second; an observer on their bus keeps all `health` and `sample` messages with their times of arrival.
"""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing import forkserver
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.bus import Bus, open_bus
from drivers.health import CHANGE_NS
from drivers.inbox import Inbox
from schemas.messages import FEEDFORWARD, FeedforwardSource, HealthFlag, Role, StopReason
from tests.drivers.ethercat import rig

RATE = 500.0  # Hz, what five processes on the wire keep up with beside other tests
SOON = 0.5  # s; what is declared is 20 ms, what is said once a second would come too late, this host is loaded
READY = 180.0  # s for a process to get ready: the first start of all compiles
FLICKER = 1.5e-9 * CHANGE_NS  # s
FADE = 0.05  # s, `limits.torque_fade_s`
STEP_NM = 25.0  # N m a cycle that no torque offset exceeds on its way to zero: far below the torques in use here
NO_ANSWER = "no drive answers; check cable and power"  # how a master ends whose segment the host does not let run
MID_NEAR, MID_FAR = "mid0", "mid1"

MODULES = ["service.cli.master", "service.cli.tap", "service.cli.estimate", "service.cli.segment", "pysoem", "mujoco",
           "zenoh", "numba", "scipy.signal", "service.feedforward_source", "drivers.motion"]  # fmt: skip


def _inside(name: str, runtime: str, log: str, arguments: list[str]) -> None:
    """Run one command of this program in a network namespace; its words go to `log`. runtime: folder of its sockets,
    which is not that of the server that this comes from where another module's tests started it.

    As ordinary work: what has to be prompt says so itself, and planning or compiling before that at real-time priority
    would have the kernel hold all of them up for 50 ms a second.
    """
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.environ["XDG_RUNTIME_DIR"] = runtime
    with open(f"/run/netns/{name}") as handle:
        if ctypes.CDLL(None, use_errno=True).setns(handle.fileno(), 0x40000000) != 0:
            raise OSError(ctypes.get_errno(), "setns")
    target = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(target, 1)
    os.dup2(target, 2)
    sys.argv = ["deltatwin", *arguments]
    from service.cli.main import main

    main()


class Process:
    """A command of this program on the wire."""

    def __init__(self, wire: Wire, name: str, *arguments: str) -> None:
        self._log = wire.folder / f"{name}-{time.monotonic_ns()}.log"
        context = multiprocessing.get_context("forkserver")
        self.process: ForkServerProcess = context.Process(
            target=_inside,
            args=(wire.space.name, os.environ["XDG_RUNTIME_DIR"], str(self._log), [name, *arguments]),
            daemon=True,
        )
        self.process.start()

    @property
    def said(self) -> str:
        """Everything it said so far."""
        return self._log.read_text() if self._log.exists() else ""

    def wait_for(self, words: str) -> None:
        """Until it says so."""
        give_up = time.monotonic() + READY
        while words not in self.said:
            assert self.process.is_alive(), self.said
            assert time.monotonic() < give_up, self.said
            time.sleep(0.02)

    def signal(self, number: int) -> float:
        """Send a signal; when, s of CLOCK_MONOTONIC."""
        assert self.process.pid is not None
        os.kill(self.process.pid, number)
        return time.monotonic()

    def ends(self, timeout: float = 20.0) -> int:
        """Its exit code."""
        self.process.join(timeout)
        assert self.process.exitcode is not None, self.said
        return self.process.exitcode

    def stop(self) -> None:
        """End it, whatever it does."""
        if self.process.is_alive():
            self.signal(signal.SIGCONT)
            self.signal(signal.SIGTERM)
            self.process.join(10)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


class Heard:
    """What an observer has heard, each record with its time of arrival, s of CLOCK_MONOTONIC."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self._kept: dict[str, list[tuple[float, np.void]]] = {"health": [], "sample": []}
        self._stopped = False
        self._threads = [
            threading.Thread(target=self._listen, args=(name, bus.subscribe(name)), daemon=True) for name in self._kept
        ]
        for thread in self._threads:
            thread.start()

    def _listen(self, name: str, inbox: Inbox) -> None:
        while not self._stopped:
            if inbox.wait(0.2):
                records, arrival = inbox.take()
                self._kept[name].extend(zip((arrival * 1e-9).tolist(), records, strict=True))

    @property
    def newest(self) -> np.void:
        """The last sample."""
        return self._kept["sample"][-1][1]

    def stop(self) -> None:
        self._stopped = True
        for thread in self._threads:
            thread.join()

    def health(self, role: Role, since: float) -> list[tuple[float, np.void]]:
        """Messages of a role, from `since` on."""
        return [(at, record) for at, record in self._kept["health"].copy() if at >= since and record["role"] == role]

    def told(self, role: Role, flag: HealthFlag, since: float, within: float = SOON) -> np.void:
        """The first message of a role with `flag`, which has to come `within` s after `since`.

        Or the last one before, no older than changes are apart: on a busy host a flag flickers, and one that came
        behind `loaded` or `calm` and stands when the fault begins is not told a second time.
        """
        before = [(at, record) for at, record in self.health(role, since - FLICKER) if at < since]
        if before and before[-1][1]["flags"] & flag:
            return before[-1][1]
        return self._first(role, since, within, lambda record: bool(record["flags"] & flag), repr(flag))

    def cleared(self, role: Role, flag: HealthFlag, since: float, within: float = 60.0) -> np.void:
        """The first message without it: BUS_FAULT stands for a second, and a busy host loses frames of its own."""
        return self._first(role, since, within, lambda record: not record["flags"] & flag, f"no {flag!r}")

    def _first(self, role: Role, since: float, within: float, wanted: Callable[[Any], bool], what: str) -> np.void:
        give_up = time.monotonic() + max(15.0, within)
        while time.monotonic() < give_up:
            for at, record in self.health(role, since):
                if wanted(record):
                    assert at - since <= within, f"{role.name} said {what} after {at - since:.3f} s"
                    return record
            time.sleep(0.01)
        raise AssertionError(f"{role.name} never said {what}: {self.health(role, since)[-3:]}")

    def samples(self, since: float, until: float) -> tuple[np.ndarray, np.ndarray]:
        """(N,) times and (N,) records of what the tap saw on the wire."""
        found = [(at, record) for at, record in self._kept["sample"].copy() if since <= at < until]
        return np.array([at for at, _ in found]), np.array([record for _, record in found])


class Wire:
    """Segment, middle box, tap and estimator on one wire, and an observer of their bus."""

    def __init__(self, folder: Path, space: rig.Namespace, bus: Bus, stack: contextlib.ExitStack) -> None:
        """stack: ends what is started here."""
        self.folder, self.space = folder, space
        self.robot = str(folder / "robot.toml")
        self.heard = Heard(bus)
        stack.callback(self.heard.stop)
        self.bus, self._stack = bus, stack
        self.segment = rig.SegmentProcess(space, "--robot", self.robot, "--rate", str(RATE))
        stack.callback(self.segment.stop)
        self._box = subprocess.Popen(
            space.prefix(sys.executable, "-m", "tests.drivers.ethercat.middle_box", MID_NEAR, MID_FAR),
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[3],
        )  # fmt: skip
        stack.callback(self._box.kill)
        assert self._box.stdout is not None
        assert self._box.stdout.readline() == "ready\n"
        self.tap = self.start("tap", rig.NEAR, "--robot", self.robot)
        self.estimator = self.estimate()
        self.survivor: Process | None = None

    def start(self, *arguments: str) -> Process:
        """One command of this program."""
        process = Process(self, *arguments)
        self._stack.callback(process.stop)
        return process

    def estimate(self) -> Process:
        """An estimator that is ready."""
        estimator = self.start("estimate", "--robot", self.robot)
        estimator.wait_for("estimating for")
        return estimator

    def spoil(self, line: str) -> float:
        """Change what the middle box does; when it was in force, s of CLOCK_MONOTONIC."""
        assert self._box.stdin is not None
        assert self._box.stdout is not None
        self._box.stdin.write(line + "\n")
        self._box.stdin.flush()
        assert self._box.stdout.readline() == line + "\n"
        return time.monotonic()

    def master(self, feedforward: str = "bus", duration: int = 90, tries: int = 3) -> Process:
        """A master whose drives are in operation for `duration` s and, over the bus, get a torque. One that has ended
        before, as the host held its segment up, is started again."""
        self.spoil("whole")
        self.segment.say("mend")
        since = time.monotonic()
        master = self.start(
            "master", rig.NEAR, "--robot", self.robot, "--rate", str(RATE), "--duration", str(duration),
            "--speed", "0.3", "--feedforward", feedforward,
        )  # fmt: skip
        master.wait_for("drives in operation")
        self.heard.cleared(Role.MASTER, HealthFlag.STOPPED, since, READY)  # heard at all: the link is up
        if feedforward == "bus":
            while master.process.is_alive() and time.monotonic() < since + READY and not self._fed(since):
                time.sleep(0.01)
            if not master.process.is_alive() and not self._fed(since) and tries > 1:
                return self.master(feedforward, duration, tries - 1)
            self.heard.cleared(Role.MASTER, HealthFlag.STALE_FEEDFORWARD, since, READY)
            time.sleep(0.3)  # in which the torque rises
        return master

    def _fed(self, since: float) -> bool:
        records = self.heard.health(Role.MASTER, since)
        return any(not record["flags"] & HealthFlag.STALE_FEEDFORWARD for _, record in records)


@contextlib.contextmanager
def prompt() -> Iterator[None]:
    """Run this process, and the threads it starts meanwhile, before other work: what it times is what the roles do."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(55))
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)


@pytest.fixture(scope="module")
def wire(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Wire]:
    folder = tmp_path_factory.mktemp("faults")
    rig.robot(folder)
    with pytest.MonkeyPatch.context() as patch, contextlib.ExitStack() as stack:
        runtime = tmp_path_factory.mktemp("r")
        patch.setenv("XDG_RUNTIME_DIR", str(runtime))
        multiprocessing.set_forkserver_preload(MODULES)
        forkserver.ensure_running()  # as ordinary work: it imports seconds of modules
        stack.enter_context(prompt())
        space = stack.enter_context(rig.namespace("faults", middle=(MID_NEAR, MID_FAR)))
        bus = stack.enter_context(open_bus("rig", Role.OBSERVER))
        yield Wire(folder, space, bus, stack)


@pytest.fixture
def running(wire: Wire) -> Process:
    """A master that the faults below are to leave running: one for all of them, as long as it does."""
    if wire.survivor is None or not wire.survivor.process.is_alive():
        wire.survivor = wire.master(duration=300)
    return wire.survivor


@pytest.mark.parametrize(
    ("name", "says"),
    [("rig", "robot 'rig': another master is running"), ("other", f"{rig.NEAR}: already has a master running")],
)
def test_a_second_master_does_not_start(wire: Wire, running: Process, tmp_path: Path, name: str, says: str) -> None:
    robot = tmp_path / "robot.toml"
    robot.write_text(Path(wire.robot).read_text().replace('name = "rig"', f'name = "{name}"'))
    tries = 3
    while True:
        second = wire.start("master", rig.NEAR, "--robot", str(robot), "--feedforward", "off", "--duration", "5")
        code = second.ends(READY)
        tries -= 1
        if NO_ANSWER not in running.said or not tries:
            break
        running = wire.survivor = wire.master(duration=300)  # the host held the segment up: there was no first
    assert code == 1, f"{second.said}\nthe first: {running.said}"
    assert says in second.said.splitlines()[-1], f"{second.said}\nthe first: {running.said}"
    assert running.process.is_alive(), running.said


def offsets(wire: Wire, since: float, until: float) -> tuple[np.ndarray, np.ndarray]:
    """(N,) times and (N, 3) N m of the torque offset in the frames."""
    times, samples = wire.heard.samples(since, until)
    assert len(samples) > 50
    return times, samples["torque_command"]


def loaded(wire: Wire) -> None:
    """Wait until the drives have had a torque throughout the last fifth of a second, so that there is one to fade, and
    no STALE_FEEDFORWARD of before stands."""
    give_up = time.monotonic() + 30.0
    while True:
        now = time.monotonic()
        _, torque = wire.heard.samples(now - 0.2, now)
        stale = wire.heard.health(Role.MASTER, 0.0)[-1][1]["flags"] & HealthFlag.STALE_FEEDFORWARD
        if not stale and len(torque) > 50 and np.abs(torque["torque_command"]).max(axis=1).min() > 1.0:
            return
        assert now < give_up, "the drives get no torque"
        time.sleep(0.05)


def calm(wire: Wire) -> None:
    """Wait until no BUS_FAULT of before stands: one that does is told again only with the next regular message."""
    give_up = time.monotonic() + 60.0
    while wire.heard.health(Role.MASTER, 0.0)[-1][1]["flags"] & HealthFlag.BUS_FAULT:
        assert time.monotonic() < give_up, "BUS_FAULT stands"
        time.sleep(0.01)


def fades(wire: Wire, since: float) -> None:
    """The drives' torque goes to zero soon after `since`, and by no step."""
    time.sleep(SOON + 0.3)
    times, torque = offsets(wire, since - 0.2, since + SOON + 0.3)
    assert np.abs(torque[times < since]).max() > 1.0, "there was no torque to fade"
    assert (torque[times > since + SOON] == 0).all()
    known = torque[np.isfinite(torque).all(axis=1)]
    assert np.abs(np.diff(known, axis=0)).max() < STEP_NM


def stands_still(wire: Wire) -> float:
    """The estimator does, until that is told and the torque has gone. Monotonic time, s, when it goes on."""
    since = wire.estimator.signal(signal.SIGSTOP)
    try:
        wire.heard.told(Role.MASTER, HealthFlag.STALE_FEEDFORWARD, since)
        fades(wire, since)
    finally:
        since = wire.estimator.signal(signal.SIGCONT)
    return since


def test_an_estimator_that_stops_and_goes_on(wire: Wire, running: Process) -> None:
    loaded(wire)
    since = stands_still(wire)
    wire.heard.cleared(Role.MASTER, HealthFlag.STALE_FEEDFORWARD, since)


def test_an_estimator_that_is_killed(wire: Wire, running: Process, until: Callable[..., None]) -> None:
    loaded(wire)
    since = wire.estimator.signal(signal.SIGKILL)
    try:
        wire.heard.told(Role.MASTER, HealthFlag.STALE_FEEDFORWARD, since)
        fades(wire, since)
        until(lambda: Role.ESTIMATOR not in wire.bus.alive)  # its memory, a gigabyte, is given back before its sockets
    finally:
        since = time.monotonic()
        wire.estimator = wire.estimate()
    if running.process.is_alive():
        wire.heard.cleared(Role.MASTER, HealthFlag.STALE_FEEDFORWARD, since, READY)
    else:  # the host held its segment up while the estimator compiled
        assert NO_ANSWER in running.said, running.said
        wire.survivor = wire.master(duration=300)  # which waits for the same


@contextlib.contextmanager
def answering(wire: Wire, torque: float, ahead: int) -> Iterator[None]:
    """Somebody else publishes a feed-forward of `torque` N m, `ahead` cycles of the newest sample, 1000 a second."""
    put, stopped = wire.bus.publisher("feedforward").put, threading.Event()
    answer = FEEDFORWARD.empty(1)
    answer["source"], answer["torque"] = FeedforwardSource.REFERENCE, torque

    def answer_all() -> None:
        while not stopped.wait(0.001):
            answer["sequence"] = wire.heard.newest["sequence"]
            answer["target_sequence"] = answer["sequence"] + np.uint64(ahead)
            put(answer.tobytes())

    thread = threading.Thread(target=answer_all)
    thread.start()
    yield
    stopped.set()
    thread.join()


@pytest.mark.parametrize(
    ("torque", "ahead"), [(np.nan, 5), (np.inf, 5), (1e6, 5), (5.0, 1 << 40)], ids=["NaN", "inf", "peak", "another run"]
)
def test_a_feedforward_that_is_no_answer(wire: Wire, running: Process, torque: float, ahead: int) -> None:
    """The estimator stands still meanwhile, so that nothing else comes."""
    loaded(wire)
    before = wire.heard.health(Role.MASTER, 0.0)[-1][1]
    with answering(wire, torque, ahead):
        since = stands_still(wire)
    after = wire.heard.cleared(Role.MASTER, HealthFlag.STALE_FEEDFORWARD, since)
    assert after["rejected"] - before["rejected"] > 100


@pytest.mark.parametrize("share", [0.01, 0.05])
def test_frames_that_are_lost(wire: Wire, running: Process, share: float) -> None:
    calm(wire)
    before = wire.heard.health(Role.MASTER, 0.0)[-1][1]
    since = wire.spoil(f"loss {share}")
    wire.heard.told(Role.MASTER, HealthFlag.BUS_FAULT, since, 1.0)  # the first one is lost after some cycles
    wire.heard.told(Role.TAP, HealthFlag.BUS_FAULT, since, 1.0)
    time.sleep(1.5)
    wire.spoil("whole")
    after = wire.heard.cleared(Role.MASTER, HealthFlag.BUS_FAULT, time.monotonic())
    assert after["lost"] - before["lost"] > RATE * share  # in a second and a half
    assert running.process.is_alive(), running.said


def test_a_cable_that_is_cut_for_some_cycles(wire: Wire, running: Process) -> None:
    """Told while it lasts: the count of what is missing rises during the cut."""
    calm(wire)
    since = wire.spoil("cut")
    time.sleep(0.03)
    end = wire.spoil("whole")
    for role in (Role.TAP, Role.MASTER):
        record = wire.heard.told(role, HealthFlag.BUS_FAULT, since)
        assert record["flags"] & HealthFlag.BUS_FAULT
    during = [record for at, record in wire.heard.health(Role.TAP, since) if at < end + SOON]
    assert int(during[0]["lost"]) > 0
    wire.heard.cleared(Role.MASTER, HealthFlag.BUS_FAULT, end)
    assert running.process.is_alive(), running.said


def test_frames_that_come_twice(wire: Wire, running: Process) -> None:
    before = wire.heard.health(Role.TAP, 0.0)[-1][1]
    wire.spoil("duplicate 0.05")
    time.sleep(2.0)
    end = wire.spoil("whole")
    after = wire.heard.cleared(Role.TAP, HealthFlag.STOPPED, end, 2.0)
    assert after["repeated"] - before["repeated"] > 10
    assert running.process.is_alive(), running.said


def test_frames_that_overtake_each_other(wire: Wire, running: Process) -> None:
    calm(wire)
    since = wire.spoil("reorder 0.02")
    wire.heard.told(Role.MASTER, HealthFlag.BUS_FAULT, since, 2.0)  # too late for its cycle is lost to the master
    time.sleep(0.5)
    end = wire.spoil("whole")
    wire.heard.cleared(Role.MASTER, HealthFlag.BUS_FAULT, end)
    assert running.process.is_alive(), running.said


def test_frames_that_are_held_up(wire: Wire, running: Process) -> None:
    calm(wire)
    before = wire.heard.health(Role.MASTER, 0.0)[-1][1]
    since = time.monotonic()
    held = 0.05  # s
    wire.segment.hold(held)
    wire.heard.told(Role.MASTER, HealthFlag.BUS_FAULT, since)
    after = wire.heard.cleared(Role.MASTER, HealthFlag.BUS_FAULT, time.monotonic())
    assert after["lost"] - before["lost"] > 0.4 * held * RATE
    assert running.process.is_alive(), running.said


def test_frames_that_are_late_by_less_than_a_cycle(wire: Wire, running: Process) -> None:
    wire.spoil("delay 0.0001")
    time.sleep(1.0)
    wire.spoil("whole")
    assert running.process.is_alive(), running.said


@pytest.mark.parametrize("slip", ["3600000000000", "-3600000000000"])
def test_a_clock_that_slips(wire: Wire, running: Process, slip: str) -> None:
    calm(wire)
    since = wire.spoil(f"clock {slip}")
    wire.heard.told(Role.MASTER, HealthFlag.BUS_FAULT, since)
    time.sleep(0.5)
    end = wire.spoil("whole")  # which slips it back
    wire.heard.cleared(Role.MASTER, HealthFlag.BUS_FAULT, end)
    wire.heard.cleared(Role.MASTER, HealthFlag.STALE_FEEDFORWARD, end)
    assert running.process.is_alive(), running.said


def test_ctrl_c_is_said_with_its_reason_and_the_torque_fades(wire: Wire, running: Process) -> None:
    since = running.signal(signal.SIGINT)
    last = wire.heard.told(Role.MASTER, HealthFlag.STOPPED, since, 5.0)
    assert last["reason"] == StopReason.INTERRUPTED
    assert running.ends() == 0
    _, torque = offsets(wire, since, time.monotonic())
    known = torque[np.isfinite(torque).all(axis=1)]
    assert np.abs(np.diff(known, axis=0)).max() < STEP_NM


def ends_in_a_fault(wire: Wire, master: Process, since: float, says: str, within: float = SOON) -> None:
    """BUS_FAULT within `within` s, the last word with its reason, one line on stderr."""
    wire.heard.told(Role.MASTER, HealthFlag.BUS_FAULT, since, within)
    last = wire.heard.told(Role.MASTER, HealthFlag.STOPPED, since, 5.0)
    assert last["reason"] == StopReason.BUS_FAULT
    assert master.ends() == 1
    assert "Traceback" not in master.said
    assert says in master.said.splitlines()[-1], master.said


def test_a_cable_that_stays_cut(wire: Wire) -> None:
    master = wire.master()
    since = wire.spoil("cut")
    wire.heard.told(Role.TAP, HealthFlag.BUS_FAULT, since)
    ends_in_a_fault(wire, master, since, NO_ANSWER)
    wire.heard.told(Role.TAP, HealthFlag.STALE_INPUT, since)


@pytest.mark.parametrize(
    ("switch", "says"),
    [("silence 3", "a drive does not take part in the process data"), ("trip 2", "drive 2 is not in operation")],
)
def test_a_drive_that_fails(wire: Wire, switch: str, says: str) -> None:
    master = wire.master("cycle")
    since = time.monotonic()
    wire.segment.say(switch)  # thrown some time between the two
    within = time.monotonic() - since + SOON
    wire.heard.told(Role.TAP, HealthFlag.BUS_FAULT, since, within)
    ends_in_a_fault(wire, master, since, says, within)


def test_a_master_that_is_stopped_is_no_loss(wire: Wire) -> None:
    master = wire.master("off")
    before = wire.heard.health(Role.TAP, 0.0)[-1][1]
    since = master.signal(signal.SIGSTOP)
    told = wire.heard.told(Role.TAP, HealthFlag.STALE_INPUT, since)
    assert told["lost"] - before["lost"] < 20
    time.sleep(0.3)
    since = master.signal(signal.SIGCONT)
    ends_in_a_fault(wire, master, since, "is not in operation: fault")  # the drives' watchdogs


def test_a_master_that_is_killed(wire: Wire) -> None:
    master = wire.master("off")
    since = master.signal(signal.SIGKILL)
    wire.heard.told(Role.TAP, HealthFlag.STALE_INPUT, since)
    give_up = time.monotonic() + 5.0
    while Role.MASTER in wire.bus.alive:
        assert time.monotonic() < give_up
        time.sleep(0.01)


def ends_in_no_traceback(wire: Wire, master: Process) -> None:
    """A master whose frames are corrupted goes on, or ends with its one line."""
    since = wire.spoil("corrupt 0.05")
    wire.heard.told(Role.MASTER, HealthFlag.BUS_FAULT, since, 2.0)
    time.sleep(1.5)
    wire.spoil("whole")
    if not master.process.is_alive():
        assert master.said.splitlines()[-1].startswith("deltatwin: ")
    assert "Traceback" not in master.said


def test_frames_that_are_corrupted(wire: Wire) -> None:
    """A wire drops them by their check sum; here they come through, and nothing may end in a traceback."""
    master = wire.master()
    ends_in_no_traceback(wire, master)
    assert "Traceback" not in wire.tap.said + wire.estimator.said
    master.stop()


def test_an_interface_that_goes_down(wire: Wire) -> None:
    master = wire.master()
    since = time.monotonic()
    subprocess.run(["ip", "-n", wire.space.name, "link", "set", rig.NEAR, "down"], check=True)
    ends_in_a_fault(wire, master, since, f"{rig.NEAR}: ")
    last = wire.heard.told(Role.TAP, HealthFlag.STOPPED, since, 5.0)
    assert last["reason"] == StopReason.BUS_FAULT
    assert wire.tap.ends() == 1
    assert wire.tap.said.splitlines()[-1] == f"deltatwin: {rig.NEAR}: Network is down"
