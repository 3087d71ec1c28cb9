"""The master on a real wire: SOEM at one end of a veth pair, the segment's process at the other."""

from __future__ import annotations

import dataclasses
import functools
import gc
import math
import os
import re
import select
import signal
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.ethercat import cia402
from drivers.ethercat.cia402 import Scale
from drivers.ethercat.setpoints import Answer, SetpointPlan, Setpoints
from drivers.ethercat.soem_master import (
    AHEAD_SPEED,
    BRING_UP_TIME,
    FAULTY_TIME,
    SILENCE,
    Feedforward,
    Master,
    OffsetRamp,
    PositionRamp,
    follow,
)
from drivers.motion import Planner, Trajectory
from drivers.motion_file import write_motion
from drivers.simulated.segment.wire import INPUT_DELAY_CYCLES
from drivers.trace import read_trace
from replay.clock import wait_until
from schemas.errors import BusError
from schemas.kernels import kernel
from schemas.messages import FARTHEST_AHEAD, SAMPLE, Gripper, SampleFlag
from schemas.robot import Robot, load_robot
from tests.drivers.ethercat import rig

PERIOD = 2e-3  # what a busy machine of two cores keeps up with
FAULTY_CYCLES = round(FAULTY_TIME / PERIOD)
FADE = 0.05  # s


@pytest.fixture(autouse=True)
def own_runtime_folder(bus_folder: Path) -> None:
    """For the health that a master publishes."""


@pytest.fixture(scope="module")
def space() -> Iterator[rig.Namespace]:
    with rig.namespace("deltatwin-master") as space:
        yield space


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rig")
    rig.robot(folder)
    (folder / "truth.toml").write_text(rig.TRUTH)
    return folder


@pytest.fixture(scope="module")
def robot(files: Path) -> Robot:
    plan(files)  # compiles, which is not to be done at the priority of `Namespace.call`
    return load_robot(files / "robot.toml")


def start(space: rig.Namespace, files: Path) -> rig.SegmentProcess:
    return rig.SegmentProcess(
        space, "--robot", str(files / "robot.toml"), "--truth", str(files / "truth.toml"),
        "--rate", str(1 / PERIOD), "--product", "1.5", "--out", str(files / "own.mcap"),
    )  # fmt: skip


@pytest.fixture(scope="module")
def long_running(space: rig.Namespace, files: Path) -> Iterator[rig.SegmentProcess]:
    process = start(space, files)
    yield process
    process.stop()


@pytest.fixture
def segment(long_running: rig.SegmentProcess) -> rig.SegmentProcess:
    long_running.say("mend")
    return long_running


def nothing(*_: object) -> Answer:
    return Answer(np.zeros(3), np.zeros(3))


@functools.cache
def plan(folder: Path) -> Trajectory:
    planner = Planner(load_robot(folder / "robot.toml"), PERIOD)
    return planner.pick_and_place(np.random.default_rng(1), 2.5, (1.5,), speed=0.3)


def run(
    robot: Robot,
    at_start: Callable[[], None] = lambda: None,
    change: Callable[[Setpoints], Setpoints] = lambda whole: whole,
    feedforward: Feedforward = nothing,
) -> np.ndarray:
    """Records of SAMPLE of every cycle of a short pick-and-place."""
    taken, course = [], SetpointPlan(plan(robot.folder), robot.geometry.joint_range_rad)
    with Master(rig.NEAR, robot, PERIOD, wait_until) as master:
        whole = change(course.begin(master.operate()))
        offset = OffsetRamp(master.scale, math.inf, 5000.0, FADE, PERIOD)
        at_start()
        for sample in follow(master, whole, feedforward, offset, PositionRamp(FADE, PERIOD)):
            taken.append(sample.copy())
    return np.concatenate(taken) if taken else SAMPLE.empty(0)


def test_samples_are_the_plants_own_trace(space: rig.Namespace, robot: Robot, files: Path) -> None:
    segment = start(space, files)
    try:
        samples = space.call(lambda: run(robot))
    finally:
        said = segment.stop()
    closed = samples["gripper"] == Gripper.CLOSED
    held = plan(robot.folder).payloads
    assert np.count_nonzero(closed) == pytest.approx(sum(p.release - p.pick for p in held) / PERIOD, rel=0.05)
    assert np.count_nonzero(np.diff(closed)) == 2 * len(held)
    own = read_trace(files / "own.mcap")
    assert f"{len(own)} cycles in operation" in said
    good = samples[samples["flags"] & SampleFlag.BUS_FAULT == 0]
    assert len(good) > 0.98 * len(samples)
    stamps = own.epoch_ns + np.rint(own.time * 1e9).astype(np.int64)
    rows = np.searchsorted(stamps, good["stamp_sec"].astype(np.int64) * 10**9 + good["stamp_nanosec"])
    for joint, drive in enumerate(robot.drive.joint):
        count = 2 * np.pi / drive.counts_per_turn / robot.drive.gear_ratio
        unit = drive.torque.full_scale_nm * robot.drive.gear_ratio / 1000
        for values, true, half in (
            (good["position"], own.position, count / 2),
            (good["torque"], own.torque, unit / 2),
        ):
            difference = values[:, joint] - true[rows - INPUT_DELAY_CYCLES, joint]
            assert np.abs(difference).max() < half * 1.01


def farthest_in_a_cycle(samples: np.ndarray) -> float:
    """rad, between samples that were read: where frames stay away, a sample has the position before."""
    read = samples["flags"] == 0
    return np.abs(np.diff(samples["position"], axis=0))[read[1:] & read[:-1]].max()


def test_motors_go_ahead_of_the_plan_where_the_drives_map_it(space: rig.Namespace, tmp_path: Path) -> None:
    """By what is asked and no further than gears that are whole yield; the plan's own commands stay."""
    mapped = rig.robot(tmp_path, outputs=(*rig.OUTPUTS, "0x60B0"))
    (tmp_path / "truth.toml").write_text(rig.TRUTH)
    plan(tmp_path)
    asked = np.array([0.02, -0.01, 5.0])
    segment = start(space, tmp_path)
    try:
        plain, ahead = (
            space.call(lambda answer=answer: run(mapped, feedforward=lambda *_: answer))
            for answer in (nothing(), Answer(np.zeros(3), asked))
        )
    finally:
        segment.stop()
    np.testing.assert_allclose(ahead["position_command"][-1], plain["position_command"][-1], atol=1e-6)
    gone = (ahead["position"] - plain["position"][-1])[-20:].mean(axis=0)
    np.testing.assert_allclose(gone, [0.02, -0.01, FARTHEST_AHEAD], atol=2e-3)
    assert farthest_in_a_cycle(ahead) < 1.2 * farthest_in_a_cycle(plain), "1.4 for an offset that is not ramped"


def test_nothing_is_collected_while_the_drives_wait(space: rig.Namespace) -> None:
    assert not space.call(gc.isenabled)
    assert gc.isenabled()


def test_nothing_is_compiled_while_the_drives_wait(
    space: rig.Namespace, segment: rig.SegmentProcess, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    fresh = {name: kernel(getattr(cia402, name).py_func) for name in ("joint_angle", "gripper_state")}
    for name, compiled in fresh.items():
        monkeypatch.setattr(cia402, name, compiled)

    def compiled_before_and_after() -> tuple[list, list]:
        master = Master(rig.NEAR, robot, PERIOD, wait_until)
        before = [function.signatures for function in fresh.values()]
        with master:
            master.operate()
        return before, [function.signatures for function in fresh.values()]

    before, after = space.call(compiled_before_and_after)
    assert all(before)
    assert after == before


def test_a_motion_from_a_file_is_what_the_robot_does(space: rig.Namespace, robot: Robot, files: Path) -> None:
    planner = Planner(robot, 2 * PERIOD)  # the file need not be at the bus's rate
    motion = planner.multisine(np.random.default_rng(2), 1.0)
    write_motion(motion, np.zeros_like(motion.position), planner, files / "motion.csv")
    segment = start(space, files)
    try:
        done = master_command(space, files, rig.NEAR, more=("--motion", str(files / "motion.csv")))
    finally:
        segment.stop()
    assert done.returncode == 0, done.stderr
    own, wanted = read_trace(files / "own.mcap"), motion.position
    assert np.ptp(wanted, axis=0).min() > 0.2
    last = len(own) - 2 * len(wanted)  # in cycles; from then on it has no time left for the whole motion
    off = [np.abs(own.position[at : at + 2 * len(wanted) : 2] - wanted).max() for at in range(last)]
    assert min(off) < 0.01


@pytest.mark.parametrize(
    ("joint", "target", "says"),
    [
        (2, -0.3, r"joint 2: target .* rad is .* rad from the last one, limits.joint_speed_radps allows 0.08 rad a "),
        (1, 2.3, r"joint 1: target 2.3 rad is not in geometry.joint_range_rad \[-1.6, 2.2\]; not sent$"),
        (3, math.nan, r"joint 3: target nan rad is not in geometry"),
    ],
)
def test_a_target_that_jumps_or_cannot_be_is_not_sent(
    space: rig.Namespace, robot: Robot, files: Path, joint: int, target: float, says: str
) -> None:
    segment = start(space, files)

    def jumping(whole: Setpoints) -> Setpoints:
        position = whole.position.copy()
        position[50, joint - 1] = target
        return dataclasses.replace(whole, position=position)

    try:
        with pytest.raises(BusError, match=says):
            space.call(lambda: run(robot, change=jumping))
    finally:
        segment.stop()
    own = read_trace(files / "own.mcap")
    assert own.position_command is not None
    assert np.abs(np.diff(own.position_command[:, joint - 1])).max() < 0.08
    assert np.isfinite(own.position_command).all()


def test_a_second_master_finds_the_drives_as_the_first_left_them(
    space: rig.Namespace, segment: rig.SegmentProcess, robot: Robot
) -> None:
    first = space.call(lambda: run(robot))
    descriptors = len(os.listdir("/proc/self/fd"))
    second = space.call(lambda: run(robot))
    assert len(os.listdir("/proc/self/fd")) == descriptors  # a run leaves none open
    np.testing.assert_allclose(second["position"][0], first["position"][-1], atol=2e-3)


def test_missing_drives(space: rig.Namespace, segment: rig.SegmentProcess, robot: Robot) -> None:
    segment.say("break 3")
    with pytest.raises(BusError, match=r"^bus0: 2 slaves on the bus, robot 'rig' has 3 drives$"):
        space.call(lambda: run(robot))
    segment.say("break 1")
    with pytest.raises(BusError, match=r"^bus0: no EtherCAT slave answers; check cable and power$"):
        space.call(lambda: run(robot))
    segment.say("mend")
    assert len(space.call(lambda: run(robot)))


def test_drives_that_answer_late(space: rig.Namespace, segment: rig.SegmentProcess, robot: Robot) -> None:
    segment.say("break 1")
    plugged_in = threading.Timer(0.5 * BRING_UP_TIME, segment.say, ("mend",))
    plugged_in.start()
    assert len(space.call(lambda: run(robot)))
    plugged_in.join()


def test_what_stops_a_bus_from_coming_up_is_believed_the_second_time(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames get lost: what the last try says need not be what stands in the way."""
    slaves = iter([5, 5, 1, 5, 5])

    def configure(_: Master) -> None:
        raise BusError(f"bus0: {next(slaves)} slaves on the bus")

    monkeypatch.setattr(Master, "_configure", configure)
    monkeypatch.setattr("drivers.ethercat.soem_master.select.select", lambda *_: ([],))
    master = Master(rig.NEAR, robot, PERIOD, lambda _: 0)
    times = iter([BRING_UP_TIME * tenths / 10 for tenths in (0, 0, 4, 4, 8, 8, 12, 12, 16, 16, 19)])
    monkeypatch.setattr("drivers.ethercat.soem_master.time", SimpleNamespace(monotonic=lambda: next(times)))
    with pytest.raises(BusError, match=r"^bus0: 5 slaves on the bus$"):
        master._bring_up()


def test_a_bus_that_says_another_thing_each_time_is_asked_for_longer(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Answers that come later than SOEM waits are taken for those of other questions, as where a host is overloaded."""
    said = iter(["drive 1 (atwin @) maps 0 bytes", "no slave", "drive 2 () maps 0 bytes", "1 slave", "no slave", ""])

    def configure(_: Master) -> None:
        if one := next(said):
            raise BusError(one)

    monkeypatch.setattr(Master, "_configure", configure)
    monkeypatch.setattr("drivers.ethercat.soem_master.select.select", lambda *_: ([],))
    master = Master(rig.NEAR, robot, PERIOD, lambda _: 0)
    times = iter(BRING_UP_TIME * tries for tries in range(20))
    monkeypatch.setattr("drivers.ethercat.soem_master.time", SimpleNamespace(monotonic=lambda: next(times)))
    master._bring_up()
    assert not list(said)
    said = (f"{number} slaves" for number in range(100))
    times = iter(BRING_UP_TIME * tries for tries in range(100))
    with pytest.raises(BusError, match=r"^9 slaves$"):
        master._bring_up()


def test_a_try_that_took_too_long_is_not_the_last_and_is_not_answered_by_what_came_late(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bus that stood still for longer than is waited for, and then answers all that it was asked meanwhile."""
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    near.setblocking(False)
    tries = iter(["bus0: drive 1 (?) maps 0 bytes of outputs", "bus0: no EtherCAT slave answers", ""])
    waiting: list[bool] = []

    def configure(_: Master) -> None:
        waiting.append(bool(select.select([near], [], [], 0)[0]))
        if said := next(tries):
            threading.Event().wait(5 * SILENCE)
            far.send(b"a late answer")
            raise BusError(said)

    monkeypatch.setattr("drivers.ethercat.soem_master.BRING_UP_TIME", SILENCE)
    monkeypatch.setattr(Master, "_configure", configure)
    master = Master(rig.NEAR, robot, PERIOD, lambda _: 0)
    monkeypatch.setattr(master, "_wire", near.fileno())
    with near, far:
        master._bring_up()
    assert waiting == [False, False, False]


def test_what_comes_too_late_is_read_before_anything_is_asked_anew(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    near.setblocking(False)
    waiting: list[bool] = []

    def look(_: Master) -> int:
        waiting.append(bool(select.select([near], [], [], 0)[0]))
        return 0

    monkeypatch.setattr(Master, "_configure", look)
    master = Master(rig.NEAR, robot, PERIOD, lambda _: 0)
    monkeypatch.setattr(master, "_wire", near.fileno())
    monkeypatch.setattr(master, "_pairs", list)
    monkeypatch.setattr(master, "_soem", SimpleNamespace(send_processdata=lambda: look(master)))
    monkeypatch.setattr(master, "_receive", lambda: 0)
    with near, far:
        far.send(b"a late answer")
        still_coming = threading.Timer(0.5 * SILENCE, far.send, (b"a later one",))
        still_coming.start()
        master._bring_up()
        far.send(b"of a cycle that was given up")
        master._exchange()
        still_coming.join()
    assert waiting == [False, False]


def test_a_bus_that_held_frames_up_answers_the_one_that_was_sent(
    space: rig.Namespace, segment: rig.SegmentProcess, robot: Robot
) -> None:
    """For 22 cycles, which is more than the 16 frames that SOEM tells apart: answers that wait would be of before."""

    def held_up() -> list[bool]:
        with Master(rig.NEAR, robot, PERIOD, wait_until) as master:
            master.operate()
            holding = threading.Thread(target=segment.hold, args=(22 * PERIOD,))
            holding.start()
            waiting = []
            for _ in range(100):
                master.cycle()
                waiting.append(bool(select.select([master._wire], [], [], 0)[0]))
            holding.join()
        return waiting[-20:]

    assert not any(space.call(held_up))


@pytest.mark.parametrize(
    ("switch", "says"),
    [
        ("break 1", rf"working counter 0 of 9 for {FAULTY_CYCLES} cycles: no drive answers; check cable and power$"),
        ("break 2", rf"working counter 3 of 9 for {FAULTY_CYCLES} cycles: drive 2, 3 does not answer$"),
        ("silence 3", rf"working counter 6 of 9 for {FAULTY_CYCLES} cycles: a drive does not take part"),
        ("trip 2", r"drive 2 is not in operation: fault"),
    ],
)
def test_what_fails_while_running_ends_the_run_with_its_name(
    space: rig.Namespace, segment: rig.SegmentProcess, robot: Robot, switch: str, says: str
) -> None:
    with pytest.raises(BusError, match=says):
        space.call(lambda: run(robot, lambda: segment.say(switch)))
    segment.say("mend")
    assert ran_again(space, robot)  # faults are reset


def ran_again(space: rig.Namespace, robot: Robot, tries: int = 3) -> int:
    """Cycles of a run; one that ended as the host did not let the segment run is made again."""
    try:
        return len(space.call(lambda: run(robot)))
    except BusError as error:
        if tries == 1 or "no drive answers" not in str(error):
            raise
        return ran_again(space, robot, tries - 1)


def test_drives_that_map_something_else(space: rig.Namespace, segment: rig.SegmentProcess, tmp_path: Path) -> None:
    other = rig.robot(tmp_path, outputs=rig.OUTPUTS[:-1])
    says = r"^bus0: drive 1 \(deltatwin drive 1\) maps 15 bytes of outputs, drive.joint.0.outputs declares 11$"
    with pytest.raises(BusError, match=says):
        space.call(lambda: run(other))


def test_the_estimator_inside_the_cycle_weighs_what_is_carried(
    space: rig.Namespace, segment: rig.SegmentProcess, files: Path
) -> None:
    done = master_command(space, files, rig.NEAR)
    assert done.returncode == 0, done.stderr
    found = re.search(r"payload last trusted: ([\d.]+) kg", done.stdout)
    assert found
    assert float(found[1]) == pytest.approx(1.5, abs=0.1)


def test_ctrl_c_stops_the_drives_and_says_how_far_it_came(
    space: rig.Namespace, segment: rig.SegmentProcess, robot: Robot, files: Path
) -> None:
    running = subprocess.Popen(
        space.prefix(*arguments(files, rig.NEAR)), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert running.stderr is not None
    while "drives in operation" not in (line := running.stderr.readline()):
        assert line, "the master ended before it ran"
    running.send_signal(signal.SIGINT)
    said, _ = running.communicate(timeout=20)
    assert running.returncode == 0
    done, planned = re.findall(r"\d+", said)[:2]
    assert int(done) < int(planned)
    assert len(space.call(lambda: run(robot)))


def arguments(files: Path, interface: str) -> tuple[str, ...]:
    rate, robot = str(1 / PERIOD), str(files / "robot.toml")
    return (rig.DELTATWIN, "master", interface, "--robot", robot, "--duration", "2.5", "--rate", rate)


def master_command(
    space: rig.Namespace, files: Path, interface: str, *before: str, more: tuple[str, ...] = ()
) -> subprocess.CompletedProcess[str]:
    command = space.prefix(*before, *arguments(files, interface), *more)
    return subprocess.run(command, capture_output=True, text=True, timeout=180, check=False)


def test_an_interface_that_is_not_there_or_not_up_is_one_line(space: rig.Namespace, files: Path) -> None:
    done = master_command(space, files, "bus7")
    assert done.returncode == 1
    assert done.stderr.startswith("deltatwin: bus7: no such interface (interfaces: lo, ")
    link = ["ip", "-n", space.name, "link"]
    subprocess.run([*link, "add", "dull0", "type", "veth", "peer", "name", "dull1"], check=True)
    done = master_command(space, files, "dull0")
    assert done.returncode == 1
    assert done.stderr.endswith("deltatwin: dull0: the interface is down (ip link set dull0 up)\n")


def test_without_privilege_it_says_which_is_missing(space: rig.Namespace, files: Path) -> None:
    done = master_command(space, files, rig.NEAR, "setpriv", "--bounding-set=-net_raw", "--inh-caps=-net_raw")
    assert done.returncode == 1
    assert done.stderr.endswith("deltatwin: bus0: raw Ethernet needs the capability CAP_NET_RAW (run as root)\n")


def test_motors_get_ahead_of_a_plan_at_a_bounded_speed_and_come_back_in_the_declared_time() -> None:
    ramp = PositionRamp(FADE, 1e-3)
    steps = [ramp.step(np.array([0.5, -0.002, 0.0])).copy() for _ in range(150)]
    np.testing.assert_allclose(np.diff(steps, axis=0).max(), AHEAD_SPEED * 1e-3)
    np.testing.assert_allclose(steps[-1], [FARTHEST_AHEAD, -0.002, 0.0])
    for senseless in (None, np.array([0.0, np.nan, 0.0])):
        ramp.step(senseless)
    left = [ramp.step(None).copy() for _ in range(round(FADE / 1e-3))]
    assert np.abs(np.diff(left, axis=0)).max() < 1.01 * FARTHEST_AHEAD * 1e-3 / FADE
    np.testing.assert_array_equal(left[-1], np.zeros(3))


SCALE = Scale(
    zero_counts=0,
    radians_per_count=1e-6,
    torque_nm_per_mille=np.array([0.02, -0.02, 0.03]),  # pyright: ignore[reportArgumentType]
    radians_per_s_per_unit=None,
)


def test_the_torque_offset_is_in_the_drives_unit_and_sign() -> None:
    offset = OffsetRamp(SCALE, math.inf, 1e9, FADE, 1e-3)
    assert offset.step(np.array([2.0, 2.0, -3.0])).tolist() == [100, -100, -100]


def test_the_torque_offset_is_limited_in_size() -> None:
    rated = OffsetRamp(SCALE, math.inf, 1e9, FADE, 1e-3)
    assert rated.step(np.array([500.0, 500.0, -500.0])).tolist() == [1000, -1000, -1000]
    asked = OffsetRamp(SCALE, 3.0, 1e9, FADE, 1e-3)
    assert asked.step(np.array([500.0, 1.0, -500.0])).tolist() == [150, -50, -100]


def test_the_torque_offset_is_limited_in_slope() -> None:
    offset = OffsetRamp(SCALE, math.inf, 1000.0, FADE, 1e-3)
    steps = [offset.step(np.array([5.0, -5.0, 0.0])).tolist()[0] for _ in range(7)]
    assert steps == [50, 100, 150, 200, 250, 250, 250]


@pytest.mark.parametrize("missing", [None, np.array([1.0, np.nan, 1.0]), np.array([np.inf, 0.0, 0.0])])
def test_a_missing_or_senseless_torque_fades_to_zero_in_the_declared_time(missing: np.ndarray | None) -> None:
    offset = OffsetRamp(SCALE, math.inf, 1000.0, FADE, 1e-3)
    assert offset.stale
    for _ in range(10):
        offset.step(np.array([5.0, -2.0, 0.0]))
    assert not offset.stale
    faded = []
    for _ in range(round(FADE / 1e-3)):
        offset.step(missing)
        faded.append(offset.torque)
        assert offset.stale
    expected = np.linspace(1.0, 0.0, 51)[1:, None] * np.array([5.0, -2.0, 0.0])
    np.testing.assert_allclose(faded, expected, atol=1e-12)
    assert offset.step(missing).tolist() == [0, 0, 0]
    assert offset.step(np.full(3, 5.0)).tolist() == [50, -50, 33]  # coming back is limited in slope
