"""The simulated segment, frame by frame, in this process: against the rig's own capture, and against physics."""

from __future__ import annotations

import struct
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.ethercat import cia402
from drivers.ethercat.capture import Capture
from drivers.ethercat.cia402 import Control, DriveState, Mode, drive_state
from drivers.ethercat.frames import AL_CONTROL, AL_STATUS, DC_SYSTEM_TIME, FMMU, AlState, Command
from drivers.ethercat.pdo import GRIPPER, Pdo, joint_pdos
from drivers.ethercat.process_data.assembly import Assembler
from drivers.ethercat.process_data.object_layout import make_layout
from drivers.simulated.plant.plant import Plant
from drivers.simulated.segment.esc import AL_STATUS_CODE, DL_STATUS, STATION_ADDRESS, SYNC_MANAGER, Code
from drivers.simulated.segment.sii import INPUT_ADDRESS, INPUT_CONTROL, OUTPUT_ADDRESS, OUTPUT_CONTROL
from drivers.simulated.segment.wire import INPUT_DELAY_CYCLES, EthercatSegment
from schemas.errors import RobotError
from schemas.kernels import kernel
from schemas.messages import Gripper, SampleFlag, stamp_ns
from schemas.robot import GripperInput
from service.model import kinematics
from service.model.nominal import pack
from tests.drivers.ethercat import rig
from tests.drivers.ethercat.wire import datagram, frame, pcap

PERIOD = 1e-3
STATIONS = (0x1001, 0x1002, 0x1003)


class Bench:
    """A segment and the least a master has to do to run it."""

    def __init__(self, folder: Path) -> None:
        robot = rig.robot(folder)
        self.scales = cia402.scales(robot)
        self.pdos = joint_pdos(robot)
        self.plant = Plant(robot, period=PERIOD)
        self.segment = EthercatSegment(self.pdos, self.scales, self.plant)
        self.outputs = [rx.blank() for rx, _ in self.pdos]
        self.passed: list[tuple[int, bytes]] = []  # frames as an analyzer would see them, both ways, and when, ns
        for number, address in enumerate(STATIONS):
            self.access(Command.APWR, -number & 0xFFFF, STATION_ADDRESS, struct.pack("<H", address))

    def access(self, command: int, station: int, register: int, data: bytes) -> tuple[bytes, int]:
        """(data, working counter) of one register datagram."""
        return self.exchange(datagram(command, station | register << 16, data))[0]

    def read(self, station: int, register: int, layout: str = "<H") -> int:
        """A register of one station."""
        data, counter = self.access(Command.FPRD, station, register, bytes(struct.calcsize(layout)))
        assert counter == 1
        return struct.unpack(layout, data)[0]

    def exchange(self, *datagrams: tuple[bytes, int]) -> list[tuple[bytes, int]]:
        """(data, working counter) of each datagram of a frame that came back."""
        buffer = bytearray(frame(*datagrams))
        assert self.segment.exchange(buffer, len(buffer))
        now = len(self.passed) // 2 * round(PERIOD * 1e9)
        self.passed += [(now, frame(*datagrams)), (now + 20_000, bytes(buffer))]
        self.segment.proceed()
        answers, at = [], 16
        for content, _ in datagrams:
            end = at + len(content)
            answers.append((bytes(buffer[at + 10 : end]), struct.unpack_from("<H", buffer, end)[0]))
            at = end + 2
        return answers

    def request(self, state: int) -> tuple[int, int]:
        """(AL status, AL status code) of the second drive after all were asked for `state`."""
        self.access(Command.BWR, 0, AL_CONTROL, struct.pack("<H", state))
        return self.read(STATIONS[1], AL_STATUS), self.read(STATIONS[1], AL_STATUS_CODE)

    def configure(self, output_bytes: int | None = None) -> None:
        """Sync managers and FMMUs, outputs first, then inputs."""
        logical = 0
        for direction, (start, control) in enumerate(
            ((OUTPUT_ADDRESS, OUTPUT_CONTROL), (INPUT_ADDRESS, INPUT_CONTROL))
        ):
            for station, pdos in zip(STATIONS, self.pdos, strict=True):
                size = pdos[direction].size
                length = output_bytes if output_bytes is not None and direction == 0 else size
                manager = struct.pack("<HHBBBB", start, length, control, 0, 1, 0)
                self.access(Command.FPWR, station, SYNC_MANAGER + 8 * direction, manager)
                mapping = struct.pack("<IHBBHBBB3x", logical, size, 0, 7, start, 0, 2 - direction, 1)
                self.access(Command.FPWR, station, FMMU + 16 * direction, mapping)
                logical += size

    def cycle(self) -> tuple[list[tuple[int, ...]], int, int]:
        """One cyclic frame: each drive's inputs, the working counter, the distributed clock."""
        out = b"".join(rx.pack(values) for (rx, _), values in zip(self.pdos, self.outputs, strict=True))
        size = sum(tx.size for _, tx in self.pdos)
        (data, counter), (clock, _) = self.exchange(
            datagram(Command.LRW, 0, out + bytes(size)),
            datagram(Command.FRMW, STATIONS[0] | DC_SYSTEM_TIME << 16, bytes(8)),
        )
        inputs, at = [], len(out)
        for _, tx in self.pdos:
            inputs.append(tx.unpack(data[at : at + tx.size]))
            at += tx.size
        return inputs, counter, struct.unpack("<Q", clock)[0]

    def put(self, index: int, values: list[int]) -> None:
        """Set an output of every drive."""
        for (rx, _), outputs, value in zip(self.pdos, self.outputs, values, strict=True):
            outputs[rx.places(index)[0]] = value

    def control(self, word: int) -> list[DriveState]:
        """Send a control word to all; their states once they had a cycle to answer."""
        self.put(cia402.CONTROLWORD, [word] * 3)
        self.cycle()
        inputs, _, _ = self.cycle()
        return [DriveState(int(drive_state(values[0]))) for values in inputs]

    def operate(self, mode: Mode = Mode.CSP) -> None:
        """To OP, every drive in operation where it stands."""
        assert self.request(AlState.PREOP) == (AlState.PREOP, Code.OK)
        self.configure()
        assert self.request(AlState.SAFEOP) == (AlState.SAFEOP, Code.OK)
        inputs, counter, _ = self.cycle()
        assert counter == 9
        assert self.request(AlState.OP) == (AlState.OP, Code.OK)
        self.put(cia402.TARGET_POSITION, [values[1] for values in inputs])
        self.put(cia402.MODE_OF_OPERATION, [mode] * 3)
        for word in (Control.SHUTDOWN, Control.SWITCH_ON, Control.ENABLE_OPERATION):
            states = self.control(word)
        assert states == [DriveState.OPERATION_ENABLED] * 3


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def test_every_frame_of_the_rigs_master_counts_as_it_did_on_the_rig(data: Path, tmp_path: Path) -> None:
    inputs = ("0x6041", "0x6064", "0x606C", "0x6077", "0x6061")
    robot = rig.robot(tmp_path, outputs=("0x6040", "0x607A", "0x6071", "0x6060"), inputs=inputs)
    plant = Plant(robot, period=250e-6)
    segment = EthercatSegment(joint_pdos(robot), cia402.scales(robot), plant)
    (frames,) = Capture(data / "captures" / "own_three_drives_4khz.pcap").blocks()
    packets = [frames.data[at : at + size].tobytes() for at, size in zip(frames.offset, frames.length, strict=True)]
    compared = 0
    for sent, returned in zip(packets[:2000:2], packets[1:2000:2], strict=True):
        assert not sent[6] & 2
        assert returned[6] & 2
        buffer = bytearray(sent)
        assert segment.exchange(buffer, len(buffer))
        segment.proceed()
        assert _skeleton(buffer) == _skeleton(returned)
        compared += 1
    assert compared == 1000


def _skeleton(packet: bytes | bytearray) -> list[tuple[int, ...]]:
    """Everything of a frame but the data: command, index, addresses, flags, working counter of each datagram."""
    found, at, more = [tuple(packet[:16])], 16, True
    while more:
        head = struct.unpack_from("<BBHHHH", packet, at)
        size, more = head[4] & 0x7FF, bool(head[4] & 0x8000)
        found.append((*head, struct.unpack_from("<H", packet, at + 10 + size)[0]))
        at += 12 + size
    return found


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (AlState.OP, Code.INVALID_STATE_CHANGE),
        (AlState.SAFEOP, Code.INVALID_STATE_CHANGE),
        (AlState.BOOT, Code.BOOT_NOT_SUPPORTED),
        (7, Code.UNKNOWN_STATE),
    ],
)
def test_a_state_that_cannot_be_is_refused_until_acknowledged(bench: Bench, request_: int, code: Code) -> None:
    assert bench.request(request_) == (AlState.INIT | 0x10, code)
    assert bench.request(AlState.PREOP) == (AlState.INIT | 0x10, code)
    assert bench.request(AlState.INIT | 0x10) == (AlState.INIT, Code.OK)
    assert bench.request(AlState.PREOP) == (AlState.PREOP, Code.OK)


def test_a_sync_manager_of_the_wrong_length_keeps_the_drive_out_of_safeop(bench: Bench) -> None:
    bench.request(AlState.PREOP)
    bench.configure(output_bytes=12)
    assert bench.request(AlState.SAFEOP) == (AlState.PREOP | 0x10, Code.INVALID_OUTPUT_CONFIGURATION)


def test_no_operation_before_outputs(bench: Bench) -> None:
    bench.request(AlState.PREOP)
    bench.configure()
    bench.request(AlState.SAFEOP)
    assert bench.request(AlState.OP) == (AlState.SAFEOP | 0x10, Code.NO_VALID_OUTPUTS)


def test_the_state_machine_of_the_drive(bench: Bench) -> None:
    """IEC 61800-7-201, state machine: transitions by their numbers there."""
    bench.operate()
    walk = [
        (Control.SWITCH_ON, DriveState.SWITCHED_ON),  # 5
        (Control.SHUTDOWN, DriveState.READY_TO_SWITCH_ON),  # 6
        (Control.QUICK_STOP, DriveState.SWITCH_ON_DISABLED),  # 7
        (Control.ENABLE_OPERATION, DriveState.SWITCH_ON_DISABLED),  # none
        (Control.SHUTDOWN, DriveState.READY_TO_SWITCH_ON),  # 2
        (Control.SWITCH_ON, DriveState.SWITCHED_ON),  # 3
        (Control.DISABLE_VOLTAGE, DriveState.SWITCH_ON_DISABLED),  # 10
        (Control.SHUTDOWN, DriveState.READY_TO_SWITCH_ON),  # 2
        (Control.SWITCH_ON, DriveState.SWITCHED_ON),  # 3
        (Control.ENABLE_OPERATION, DriveState.OPERATION_ENABLED),  # 4
        (Control.SHUTDOWN, DriveState.READY_TO_SWITCH_ON),  # 8
        (Control.SWITCH_ON, DriveState.SWITCHED_ON),  # 3
        (Control.ENABLE_OPERATION, DriveState.OPERATION_ENABLED),  # 4
        (Control.QUICK_STOP, DriveState.QUICK_STOP_ACTIVE),  # 11
        (Control.ENABLE_OPERATION, DriveState.OPERATION_ENABLED),  # 16
        (Control.DISABLE_VOLTAGE, DriveState.SWITCH_ON_DISABLED),  # 9
    ]
    for word, state in walk:
        assert bench.control(word) == [state] * 3, f"{word.name} to {state.name}"


def test_nothing_is_compiled_while_a_frame_waits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fresh = kernel(cia402.joint_angle.py_func)
    monkeypatch.setattr("drivers.simulated.segment.drive.joint_angle", fresh)
    bench = Bench(tmp_path)
    compiled = fresh.signatures
    bench.operate()
    assert compiled
    assert fresh.signatures == compiled


def test_a_tripped_drive_stays_in_fault_until_reset_and_the_others_run_on(bench: Bench) -> None:
    bench.operate()
    bench.segment.switches.trip = 0b010
    assert bench.control(Control.ENABLE_OPERATION)[0::2] == [DriveState.OPERATION_ENABLED] * 2
    assert bench.control(Control.ENABLE_OPERATION)[1] is DriveState.FAULT
    assert bench.control(Control.DISABLE_VOLTAGE)[1] is DriveState.FAULT
    assert bench.control(Control.FAULT_RESET)[1] is DriveState.SWITCH_ON_DISABLED


def test_a_target_too_far_off_trips_the_drive(bench: Bench) -> None:
    bench.operate()
    beyond = float(bench.plant.reading[2]) + 1.0
    bench.outputs[2][bench.pdos[2][0].places(cia402.TARGET_POSITION)[0]] = int(bench.scales[2].counts(beyond))
    states = bench.control(Control.ENABLE_OPERATION)
    assert states[:2] == [DriveState.OPERATION_ENABLED] * 2
    assert states[2] in (DriveState.FAULT_REACTION_ACTIVE, DriveState.FAULT)


def test_position_mode_takes_the_joints_where_they_are_told(bench: Bench) -> None:
    bench.operate()
    start, inputs = bench.plant.reading.copy(), []
    goal = start + [0.2, 0.15, -0.1]
    for k in range(1, 801):
        at = start + (goal - start) * min(1.0, k / 400)
        bench.put(cia402.TARGET_POSITION, [int(s.counts(a)) for s, a in zip(bench.scales, at, strict=True)])
        inputs, counter, _ = bench.cycle()
        assert counter == 9
    np.testing.assert_allclose(bench.plant.theta, goal, atol=1e-4)
    told = [float(scale.position(values[1])) for scale, values in zip(bench.scales, inputs, strict=True)]
    np.testing.assert_allclose(told, goal, atol=1e-4)


def test_inputs_are_the_plants_sensors_one_cycle_ago_to_half_a_unit(bench: Bench) -> None:
    bench.operate()
    start, seen = bench.plant.reading.copy(), []
    first = bench.segment.cycles
    for k in range(300):
        at = start + 0.1 * (1 - np.cos(2 * np.pi * k / 200))
        bench.put(cia402.TARGET_POSITION, [int(s.counts(a)) for s, a in zip(bench.scales, at, strict=True)])
        inputs, _, clock = bench.cycle()
        seen.append((clock, inputs))
    own = bench.segment.trace[first:]
    assert [clock for clock, _ in seen] == stamp_ns(own).tolist()
    assert np.unique(np.diff(stamp_ns(own))).tolist() == [1_000_000]
    for joint, scale in enumerate(bench.scales):
        position = scale.position(np.array([inputs[joint][1] for _, inputs in seen]))
        torque = scale.torque(np.array([inputs[joint][3] for _, inputs in seen]))
        delayed = own[: len(own) - INPUT_DELAY_CYCLES]
        half = 0.5 * abs(scale.radians_per_count), 0.5 * abs(scale.torque_nm_per_mille)
        assert np.abs(position[INPUT_DELAY_CYCLES:] - delayed["position"][:, joint]).max() <= half[0] * 1.001
        assert np.abs(torque[INPUT_DELAY_CYCLES:] - delayed["torque"][:, joint]).max() <= half[1] * 1.001


def test_the_torque_offset_is_added_at_once(bench: Bench) -> None:
    bench.operate()
    for _ in range(50):
        bench.cycle()
    bench.put(cia402.TORQUE_OFFSET, [50, -20, 100])
    bench.cycle()
    before, after = bench.segment.trace["torque"][-2:]
    units = np.array([scale.torque_nm_per_mille for scale in bench.scales])
    np.testing.assert_allclose(after - before, units * [50, -20, 100], atol=0.02)


def test_torque_mode_gives_the_torque_it_is_told_and_hands_back_without_a_bump(bench: Bench) -> None:
    bench.operate()
    for _ in range(50):
        bench.cycle()
    holding = bench.segment.trace["torque"][-1]
    told = [int(s.per_mille(t)) for s, t in zip(bench.scales, holding, strict=True)]
    exactly = np.array([s.torque(word) for s, word in zip(bench.scales, told, strict=True)])
    bench.put(cia402.MODE_OF_OPERATION, [Mode.CST] * 3)
    bench.put(cia402.TARGET_TORQUE, [told[0] - 10, told[1], told[2]])
    bench.put(cia402.TORQUE_OFFSET, [10, 0, 0])
    inputs = []
    for _ in range(50):
        inputs, _, _ = bench.cycle()
        np.testing.assert_allclose(bench.segment.trace["torque"][-1], exactly, atol=1e-9)
    assert [values[4] for values in inputs] == [Mode.CST] * 3

    bench.put(cia402.TARGET_POSITION, [values[1] for values in inputs])
    bench.put(cia402.TORQUE_OFFSET, [0, 0, 0])
    bench.put(cia402.MODE_OF_OPERATION, [Mode.CSP] * 3)
    for _ in range(50):
        bench.cycle()
        assert np.abs(bench.segment.trace["torque"][-1] - exactly).max() < 0.5

    bench.put(cia402.MODE_OF_OPERATION, [Mode.CST] * 3)
    bench.put(cia402.TARGET_TORQUE, [told[0] + 30, told[1], told[2]])
    start = bench.plant.theta.copy()
    for _ in range(100):
        bench.cycle()
    assert bench.plant.theta[0] - start[0] > 2e-3  # positive torque turns the active link down


def test_the_watchdog_takes_the_drives_out_of_operation_and_the_brakes_hold(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.operate()
    now = [time.monotonic_ns()]
    monkeypatch.setattr("drivers.simulated.segment.wire.time", SimpleNamespace(monotonic_ns=lambda: now[0]))
    bench.cycle()
    now[0] += 50_000_000
    bench.segment.idle()
    assert bench.read(STATIONS[0], AL_STATUS) == AlState.OP
    now[0] += 80_000_000
    bench.segment.idle()
    assert bench.read(STATIONS[0], AL_STATUS) == AlState.SAFEOP | 0x10
    assert bench.read(STATIONS[0], AL_STATUS_CODE) == Code.WATCHDOG
    flags = bench.segment.trace["flags"]
    assert flags[-1] == SampleFlag.BUS_FAULT
    inputs, counter, _ = bench.cycle()
    assert counter == 9
    states = [DriveState(int(drive_state(values[0]))) for values in inputs]
    assert set(states) <= {DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE}
    assert [values[3] for values in inputs] == [0, 0, 0]
    assert np.abs(bench.plant.theta_dot).max() < 1e-3


def test_a_drive_that_misses_the_process_data_shows_in_the_working_counter(bench: Bench) -> None:
    bench.operate()
    bench.segment.switches.silent = 0b101
    assert bench.cycle()[1] == 3
    bench.segment.switches.silent = 0
    assert bench.cycle()[1] == 9


@pytest.mark.parametrize(("broken_before", "counter"), [(3, 6), (2, 3)])
def test_behind_a_broken_cable_nobody_answers(bench: Bench, broken_before: int, counter: int) -> None:
    bench.operate()
    bench.segment.switches.broken_before = broken_before
    assert bench.cycle()[1] == counter
    assert bench.access(Command.BRD, 0, 0, bytes(2))[1] == broken_before - 1
    last = STATIONS[broken_before - 2]
    assert bench.read(last, DL_STATUS) & 0x0C00 == 0x0400  # port 1: loop closed, no communication
    bench.segment.switches.broken_before = 0
    assert bench.cycle()[1] == 9
    assert bench.read(last, DL_STATUS) & 0x0C00 == 0x0800


def test_before_the_first_drive_no_frame_comes_back(bench: Bench) -> None:
    bench.segment.switches.broken_before = 1
    buffer = bytearray(frame(datagram(Command.BRD, 0, bytes(2))))
    assert not bench.segment.exchange(buffer, len(buffer))


def test_the_gripper_lifts_the_product(bench: Bench, tmp_path: Path) -> None:
    bench.operate()
    for _ in range(300):
        bench.cycle()
    empty = bench.segment.trace["torque"][-1]
    bench.segment.switches.product = 1.5
    bench.put(0x60FE, [GRIPPER, 0, 0])
    for _ in range(400):
        bench.cycle()
    loaded = bench.segment.trace["torque"][-1]
    bench.put(0x60FE, [0, 0, 0])
    bench.cycle()
    assert bench.plant.payload == 0.0
    # virtual work: the motors lift the product when all joints turn alike (J from the model's own geometry)
    geometry = pack(rig.robot(tmp_path))
    along = kinematics.jacobian(geometry, bench.plant.theta)[2] @ np.ones(3)
    np.testing.assert_allclose((loaded - empty).sum(), 1.5 * 9.81 * along, rtol=0.01)


@pytest.mark.parametrize("closed", [0, 1])
def test_the_tap_reads_the_gripper_off_a_digital_input(bench: Bench, tmp_path: Path, closed: int) -> None:
    """From the frames alone: the switch follows the valve, a cycle of the drive behind."""
    bench.operate()
    bench.passed.clear()
    for grip in (0, GRIPPER, 0):
        bench.put(0x60FE, [grip, 0, 0])
        for _ in range(50):
            bench.cycle()
    path = pcap(tmp_path / "a.pcap", bench.passed, nanoseconds=True)
    robot = rig.robot(tmp_path)
    gripper = GripperInput.model_validate({"joint": 1, "bit": 16, "closed": closed})
    drive = robot.drive.model_copy(update={"gripper": gripper})
    assembler = Assembler(make_layout(robot.model_copy(update={"drive": drive})))
    samples = np.concatenate([assembler.samples(frames)[0] for frames in Capture(path).blocks()])
    is_closed = samples["gripper"] == (Gripper.CLOSED if closed else Gripper.OPEN)
    assert len(samples) == 150
    assert (samples["gripper"] != Gripper.UNKNOWN).all()
    np.testing.assert_allclose(np.flatnonzero(np.diff(is_closed)) + 1, [50, 100], atol=INPUT_DELAY_CYCLES + 1)
    unsaid = Assembler(make_layout(robot.model_copy(update={"drive": drive.model_copy(update={"gripper": None})})))
    blind = np.concatenate([unsaid.samples(frames)[0] for frames in Capture(path).blocks()])
    assert (blind["gripper"] == Gripper.UNKNOWN).all()


def test_a_gripper_on_a_drive_that_maps_no_digital_inputs(tmp_path: Path) -> None:
    says = r"^\S*robot.toml: drive.gripper.joint: 1, but drive.joint.0.inputs maps no 0x60FD$"
    with pytest.raises(RobotError, match=says):
        make_layout(rig.robot(tmp_path, inputs=rig.INPUTS[:-1]))


def test_damaged_frames_do_no_harm(bench: Bench) -> None:
    bench.operate()
    random = np.random.default_rng(5)
    good = frame(datagram(Command.LRW, 0, bytes(96)), datagram(Command.FRMW, 0x0910_1001, bytes(8)))
    for _ in range(3000):
        size = int(random.integers(14, len(good) + 1))
        buffer = bytearray(good[:size])
        for at in random.integers(14, size + 1, 3):
            if at < size:
                buffer[at] = int(random.integers(256))
        bench.segment.exchange(buffer, size)
        assert len(buffer) == size


def test_pdo_entries_skip_what_cia_402_does_not_know() -> None:
    pdo = Pdo(["0x6041", ":8", "0x2010:16", "0x6064"], "drive.joint.0.inputs")
    assert pdo.size == 2 + 1 + 2 + 4
    assert pdo.unpack(bytes.fromhex("3702 ff aabb 01000000")) == (0x237, 1)
