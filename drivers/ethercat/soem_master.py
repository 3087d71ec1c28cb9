"""EtherCAT master of one Delta robot: SOEM carries the frames, this brings three CiA 402 drives into operation and runs
them in cyclic synchronous position mode, one frame a cycle, with a torque offset beside each position.

A cycle: wait for the deadline, send the outputs made ready in the cycle before, take the inputs, hand them out as a
sample, make the next outputs ready. What an estimator does therefore falls between two frames and delays none.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import stat
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import numpy as np
import pysoem

from drivers.ethercat import cia402
from drivers.ethercat.bus_clock import BusClock
from drivers.ethercat.cia402 import Control, DriveState, Mode, Scale, drive_state
from drivers.ethercat.interface import check_interface, claim
from drivers.ethercat.pdo import DIGITAL_OUTPUTS, GRIPPER, Pdo, joint_pdos
from drivers.ethercat.setpoints import Answer, Setpoints
from schemas.errors import BusError
from schemas.messages import FARTHEST_AHEAD, NANOSECONDS, SAMPLE, SampleFlag, set_stamp
from schemas.robot import Robot
from schemas.words import counted

BRING_UP_TIME = 2.0  # s in which drives that do not answer, or not in full, are asked again: frames get lost
FAULTY_TIME = 0.08  # s of working-counter faults in a row that end the run: sooner than the drives' watchdogs, 0.1 s
LEFT_CYCLES = 3  # in a row with a drive out of operation that end the run: one status word may be corrupted
STOP_TIME = 0.5  # s at most for the drives' quick stop before they are switched off
STILL_CYCLES = 10  # without motion in which a quick stop is over
ENABLE_TIME = 2.0  # s for all drives to get into operation
RECEIVE_SHARE = 0.8  # of a cycle to wait for the frame to come back
SILENCE = 0.02  # s, SOEM's longest wait for an answer: what has not come by then is not on its way
AHEAD_SPEED = 1.0  # rad/s, of motors that get ahead of a plan: torque of 5000 N m/s on a gear of 5000 N m/rad
_LATE_FRAMES = 1024  # read at once at most
_MOST_TRIES = 10  # of a bus that says another thing each time: answers that come too late, not what it is

_NEXT_CONTROL = {
    DriveState.FAULT: Control.FAULT_RESET,
    DriveState.SWITCH_ON_DISABLED: Control.SHUTDOWN,
    DriveState.READY_TO_SWITCH_ON: Control.SWITCH_ON,
    DriveState.SWITCHED_ON: Control.ENABLE_OPERATION,
    DriveState.OPERATION_ENABLED: Control.ENABLE_OPERATION,
}


@dataclass
class Counts:
    """What happened to the cycles: all; their frame did not come back; it came with a wrong working counter; skipped
    because this host was too late; with a bus clock that cannot be right."""

    cycles: int = 0
    lost: int = 0
    faulty: int = 0
    missed: int = 0
    clock: int = 0


class _Axis:
    """One drive's process data: values to send, and where in what comes back the three that matter are."""

    def __init__(self, rx: Pdo, tx: Pdo) -> None:
        rx.require(cia402.CONTROLWORD, cia402.TARGET_POSITION)
        self.rx, self.tx = rx, tx
        self.outputs = rx.blank()
        self.places = tx.require(cia402.STATUSWORD, cia402.POSITION_ACTUAL, cia402.TORQUE_ACTUAL)
        self.put(cia402.MODE_OF_OPERATION, Mode.CSP)

    def put(self, index: int, value: int) -> None:
        """Set an object, if it is mapped."""
        (place,) = self.rx.places(index)
        if place >= 0:
            self.outputs[place] = value

    def get(self, index: int) -> int:
        """The value last put, 0 for an object that is not mapped."""
        (place,) = self.rx.places(index)
        return self.outputs[place] if place >= 0 else 0


Feedforward = Callable[[np.ndarray, Setpoints, int], Answer | None]
"""(1,) record of SAMPLE, setpoints, the number of the coming cycle; gives what to feed forward, None where it has
nothing."""


class OffsetRamp:
    """tau_FF to 0x60B2 of three drives: rounded to the drive's unit, limited in size and slope, faded to zero where
    there is none.

    Attributes: torque: (3,) N m, what the drives have. stale: whether there was none to give them.
    """

    def __init__(self, scale: Scale, limit: float, slope: float, fade: float, period: float) -> None:
        """`scale`: of three drives, each field (3,). `limit`: N m, or what a drive calls 1000 per mille, if that is
        less. `slope`: N m/s. `fade`: s from any torque to none. `period`: s."""
        self._scale = scale
        self._limit = np.minimum(1000 * np.abs(scale.torque_nm_per_mille), limit)
        self._step = slope * period
        self._fade_cycles = max(1, round(fade / period))
        self._fall = np.zeros(3)
        self.torque = np.zeros(3)
        self.stale = True

    def step(self, torque: np.ndarray | None) -> np.ndarray:
        """(3,) int16 to write for (3,) N m. None, and what is not finite, fades: what is not known to be right must
        not push, and a step would push too."""
        if torque is None or not np.isfinite(torque).all():
            if not self.stale:
                self._fall = np.abs(self.torque) / self._fade_cycles
            self.stale = True
            self.torque = self.torque - np.clip(self.torque, -self._fall, self._fall)
        else:
            self.stale = False
            wanted = np.clip(torque, -self._limit, self._limit)
            self.torque = self.torque + np.clip(wanted - self.torque, -self._step, self._step)
        return self._scale.per_mille(self.torque)


class PositionRamp:
    """How far motors go before planned positions, to 0x60B0 of three drives: limited in size and speed, back to none
    where nothing is known.

    Attributes: ahead: (3,) rad, what is asked of the drives.
    """

    def __init__(self, fade: float, period: float) -> None:
        """`fade`: s from the farthest to none. `period`: s."""
        self._step, self._fall = AHEAD_SPEED * period, FARTHEST_AHEAD * period / fade
        self.ahead = np.zeros(3)

    def step(self, offset: np.ndarray | None) -> np.ndarray:
        """(3,) rad for an offset (3,) rad that is wanted. None, and what is not finite, is none."""
        if offset is None or not np.isfinite(offset).all():
            self.ahead = self.ahead - np.clip(self.ahead, -self._fall, self._fall)
        else:
            wanted = np.clip(offset, -FARTHEST_AHEAD, FARTHEST_AHEAD)
            self.ahead = self.ahead + np.clip(wanted - self.ahead, -self._step, self._step)
        return self.ahead


class Master:
    """The drives of one robot on one interface. Use as a context manager: leaving it stops the drives and the bus.

    Other stations, which the description passes over by giving each drive its `place`, go into operation with the bus;
    their outputs stay 0.

    Attributes: goes_ahead: whether all drives map 0x60B0, by which motors go before planned positions.
    """

    def __init__(self, interface: str, robot: Robot, period: float, wait_until: Callable[[int], int]) -> None:
        """`period`: s. `wait_until`: sleeps to a CLOCK_MONOTONIC time in ns, gives back how late it is, ns.

        Raises:
            RobotError: the robot description does not say what the drives map or how they count.
        """
        pdos = joint_pdos(robot)
        self.scale = _side_by_side(cia402.scales(robot))
        self._axes = [_Axis(rx, tx) for rx, tx in pdos]
        self.goes_ahead = all(rx.places(cia402.POSITION_OFFSET)[0] >= 0 for rx, _ in pdos)
        places = [joint.place for joint in robot.drive.joint if joint.place is not None]
        self._declared, self._places = bool(places), places or [1, 2, 3]
        self._gripper = robot.drive.gripper
        if self._gripper is not None:
            self._axes[self._gripper.joint - 1].tx.require(cia402.DIGITAL_INPUTS)
        self._interface, self._robot = interface, robot.name
        self._limits, self._range = robot.limits, robot.geometry.joint_range_rad
        self._period_ns = round(period * NANOSECONDS)
        self._timeout = max(200e-6, period * RECEIVE_SHARE)
        self._faulty_limit = max(1, round(FAULTY_TIME / period))
        self._wire = -1  # descriptor of SOEM's socket
        self._wait_until = wait_until
        self._deadline = 0
        self._clock, self._has_clock = BusClock(self._period_ns), False
        self.sent_ns = 0  # CLOCK_MONOTONIC of the last cycle's frame
        self._faulty_run = self._left_run = 0
        self._sample = SAMPLE.empty(1)
        self._commanded = np.full(3, np.nan), np.full(3, np.nan)
        self._ahead = np.zeros(3)
        self._soem = pysoem.Master()
        self._states = [DriveState.UNKNOWN] * 3
        self.counts = Counts()
        self._compile()

    def __enter__(self) -> Master:
        check_interface(self._interface)
        self._claim = claim(self._interface)
        before = _packet_sockets()
        try:
            self._soem.open(self._interface)
        except ConnectionError as error:
            self._claim.close()
            raise BusError(f"{self._interface}: {error}") from error
        try:
            (self._wire,) = _packet_sockets() - before
            os.set_blocking(self._wire, False)
            self._bring_up()
        except BaseException:
            self._soem.close()
            self._claim.close()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._soem.state == pysoem.OP_STATE and not self._faulty_run:
            self._stop()
        self._soem.state = pysoem.INIT_STATE
        self._soem.write_state()
        self._soem.close()
        self._claim.close()

    def _compile(self) -> None:
        """What a cycle needs: where it takes longer than the drives' watchdogs wait, they trip."""
        self.scale.position(np.zeros(3, np.int64))
        if self._gripper is not None:
            cia402.gripper_state(0, self._gripper.bit, self._gripper.closed)

    def _stop(self) -> None:
        """Quick stop, the torque offset fading meanwhile, then power off."""
        fade = max(1, round(self._limits.torque_fade_s * NANOSECONDS / self._period_ns))
        offsets, still, before = [axis.get(cia402.TORQUE_OFFSET) for axis in self._axes], 0, None
        for number in range(max(fade, round(STOP_TIME * NANOSECONDS / self._period_ns))):
            for axis, offset in zip(self._axes, offsets, strict=True):
                axis.put(cia402.CONTROLWORD, Control.QUICK_STOP)
                axis.put(cia402.TORQUE_OFFSET, round(offset * max(0.0, 1 - (number + 1) / fade)))
            self._wait_until(self._deadline)
            self._deadline = max(self._deadline, time.monotonic_ns() - self._period_ns) + self._period_ns
            good = self._exchange() == self._soem.expected_wkc
            self._faulty_run = 0 if good else self._faulty_run + 1
            if self._faulty_run >= self._faulty_limit:
                break
            if not good:
                continue
            now = [axis.tx.unpack(slave.input)[axis.places[1]] for axis, slave in self._pairs()]
            still = still + 1 if now == before else 0
            before = now
            if number >= fade and still >= STILL_CYCLES:
                break
        for axis in self._axes:
            axis.put(cia402.CONTROLWORD, Control.DISABLE_VOLTAGE)
            axis.put(cia402.TORQUE_OFFSET, 0)
        self._exchange()

    def cycle(self) -> np.ndarray:
        """Wait for the next deadline and exchange one frame; (1,) record of SAMPLE, good until the next call.

        The sample holds the inputs and the commands of one frame. Its stamp is the distributed clock in that frame, and
        its sequence goes with the stamp; drives without a clock leave counting cycles.

        Raises:
            BusError: the working counter stays wrong, or a drive left operation.
        """
        late = self._wait_until(self._deadline)
        behind = late // self._period_ns
        self.counts.missed += behind
        self._deadline += (1 + behind) * self._period_ns
        self.sent_ns = time.monotonic_ns()
        counter = self._exchange()
        self.counts.cycles += 1
        sample, good = self._sample, counter == self._soem.expected_wkc
        clock, before = self._clock, self._clock.stamp
        steps = clock.step(1 + behind, self._soem.dc_time if good and self._has_clock else None)
        self.counts.clock = clock.odd_ever
        flags = SampleFlag.GAP_BEFORE if steps > 1 else SampleFlag(0)
        if clock.stamp < before:
            flags |= SampleFlag.TIME_BACKWARDS
        set_stamp(sample, clock.stamp)
        sample["sequence"] += np.uint64(steps)
        sample["position_command"], sample["torque_command"] = self._commanded
        if good:
            self._faulty_run = 0
            self._read(sample[0])
        else:
            self.counts.lost += counter < 0
            self.counts.faulty += counter >= 0
            self._faulty_run += 1
            flags |= SampleFlag.BUS_FAULT
        sample["flags"] = flags
        if self._faulty_run >= self._faulty_limit:
            raise BusError(self._explain_counter(counter))
        return sample

    def operate(self) -> np.ndarray:
        """Bring the bus to OP and every drive into operation, holding where its joint is; (3,) rad that they hold.

        Raises:
            BusError: naming the drive that does not follow.
        """
        self._deadline = time.monotonic_ns()
        self._exchange()
        self._adopt_positions()
        self._soem.state = pysoem.OP_STATE
        self._soem.write_state()
        for _ in self._for(ENABLE_TIME):
            self.cycle()
            if self._soem.state_check(pysoem.OP_STATE, 0) == pysoem.OP_STATE:
                break
        else:
            raise BusError(self._explain_states("OP"))
        for _ in self._for(ENABLE_TIME):
            self.cycle()
            if all(state is DriveState.OPERATION_ENABLED for state in self._states):
                break
            self._adopt_positions()
            for axis, state in zip(self._axes, self._states, strict=True):
                axis.put(cia402.CONTROLWORD, self._walk(axis, state))
        else:
            raise BusError(self._explain_drives())
        return self._commanded[0].copy()  # a joint that has moved since is not to be commanded after by a jump

    def check_operation(self) -> None:
        """Raise when a drive was not in operation in the last `LEFT_CYCLES` cycles that this was asked for.

        Raises:
            BusError: naming the drive that was not.
        """
        left = any(state is not DriveState.OPERATION_ENABLED for state in self._states)
        self._left_run = self._left_run + 1 if left else 0
        if self._left_run >= LEFT_CYCLES:
            raise BusError(self._explain_drives())

    @property
    def in_trouble(self) -> bool:
        """Whether the last frame was lost or faulty, its clock could not be right, or a drive was out of operation."""
        return bool(self._faulty_run or self._left_run or self._clock.odd)

    def command(
        self, position: np.ndarray, offset: np.ndarray, grip: bool = False, ahead: np.ndarray | None = None
    ) -> None:
        """Make ready for the next frame.

        position: (3,) rad to be at when the cycle that the frame starts is over. offset: (3,) int16 for 0x60B2.
        grip: whether the gripper is to hold, the `GRIPPER` bit of 0x60FE where that is mapped. ahead: (3,) rad for
        0x60B0 where that is mapped, less where motors would leave the joint range or move faster than joints may.

        Raises:
            BusError: a target outside the joint range, or further from the last one than a joint moves in a cycle.
        """
        self._check_target(position)
        self._go_ahead(position, np.zeros(3) if ahead is None else ahead)
        counts = self.scale.counts(position)
        for axis, target, torque in zip(self._axes, counts.tolist(), offset.tolist(), strict=True):
            axis.put(cia402.TARGET_POSITION, target)
            axis.put(cia402.TORQUE_OFFSET, torque)
            axis.put(DIGITAL_OUTPUTS, GRIPPER if grip else 0)
        self._commanded = self.scale.position(counts), self.scale.torque(offset)

    def _go_ahead(self, position: np.ndarray, ahead: np.ndarray) -> None:
        if not self.goes_ahead:
            return
        (low, high), before, most = self._range, self._commanded[0] + self._ahead, self._most
        motors = np.clip(np.clip(position + ahead, low, high), before - most, before + most)
        units = np.rint((motors - position) / self.scale.radians_per_count).astype(np.int64)
        for axis, counts in zip(self._axes, units.tolist(), strict=True):
            axis.put(cia402.POSITION_OFFSET, counts)
        self._ahead = units * self.scale.radians_per_count

    @property
    def _most(self) -> float:
        """rad that a joint moves in a cycle at most."""
        return self._limits.joint_speed_radps * self._period_ns / NANOSECONDS

    def _check_target(self, position: np.ndarray) -> None:
        """The last line of defence: nothing behind this looks at a target again."""
        (low, high), most = self._range, self._most
        for joint, (target, last) in enumerate(zip(position.tolist(), self._commanded[0].tolist(), strict=True), 1):
            if not low <= target <= high:
                raise BusError(
                    f"{self._interface}: joint {joint}: target {target:.4g} rad is not in "
                    f"geometry.joint_range_rad [{low:g}, {high:g}]; not sent"
                )
            if (far := abs(target - last)) > most:
                raise BusError(
                    f"{self._interface}: joint {joint}: target {target:.4g} rad is {far:.3g} rad from the last one, "
                    f"limits.joint_speed_radps allows {most:.3g} rad a cycle; not sent"
                )

    def _pairs(self) -> Iterator[tuple[_Axis, Any]]:
        """Each axis and SOEM's slave."""
        slaves = self._soem.slaves
        return zip(self._axes, [slaves[place - 1] for place in self._places], strict=True)

    def _bring_up(self) -> None:
        give_up, said = time.monotonic() + BRING_UP_TIME, [""]
        while True:
            self._wait_for_silence()
            try:
                return self._configure()
            except BusError as error:
                late = time.monotonic() - give_up
                said.append(str(error))
                alike = said[-1] == said[-2]  # one alone may be a frame that was lost, however long its try took
                if late > 0 and (alike or len(said) > _MOST_TRIES):
                    raise

    def _wait_for_silence(self) -> None:
        """Read what is still on its way, before every try: one that begins among late answers is answered by them to
        its end."""
        give_up = time.monotonic() + BRING_UP_TIME
        while select.select([self._wire], [], [], SILENCE)[0] and time.monotonic() < give_up:
            self._drop_late()

    def _configure(self) -> None:
        found = self._soem.config_init()
        if found <= 0:
            raise BusError(f"{self._interface}: no EtherCAT slave answers; check cable and power")
        if self._declared:
            if found < max(self._places):
                raise BusError(
                    f"{self._interface}: {counted(found, 'slave')} on the bus, a drive is declared at "
                    f"{max(self._places)}"
                )
        elif found != 3:
            raise BusError(
                f"{self._interface}: {counted(found, 'slave')} on the bus, robot {self._robot!r} has 3 drives"
                + ("; drive.joint.N.place says which they are" if found > 3 else "")
            )
        if self._soem.state_check(pysoem.PREOP_STATE, 2_000_000) != pysoem.PREOP_STATE:
            raise BusError(self._explain_states("PREOP"))
        self._soem.config_map()
        for number, (axis, slave) in enumerate(self._pairs(), start=1):
            for name, pdo, size in (("outputs", axis.rx, len(slave.output)), ("inputs", axis.tx, len(slave.input))):
                if pdo.size != size:  # written all the same, it would go over the edge of SOEM's process image
                    raise BusError(
                        f"{self._interface}: drive {number} ({slave.name}) maps {size} bytes of {name}, "
                        f"drive.joint.{number - 1}.{name} declares {pdo.size}"
                    )
        self._has_clock = bool(self._soem.config_dc())
        if self._soem.state_check(pysoem.SAFEOP_STATE, 2_000_000) != pysoem.SAFEOP_STATE:
            raise BusError(self._explain_states("SAFEOP"))

    def _exchange(self) -> int:
        for axis, slave in self._pairs():
            slave.output = axis.rx.pack(axis.outputs)
        self._drop_late()
        self._soem.send_processdata()
        return self._receive()

    def _drop_late(self) -> None:
        """Read what came too late: SOEM counts its frames modulo 16, and where a bus held up so many, each frame would
        be answered by the one 16 before it from then on."""
        for _ in range(_LATE_FRAMES):
            if not select.select([self._wire], [], [], 0)[0]:
                break
            with contextlib.suppress(OSError):  # of a dead interface nothing comes back, which is told
                os.read(self._wire, 2048)

    def _receive(self) -> int:
        """Working counter of the frame that was sent, -1 where it does not come back in time.

        SOEM's own waiting counts in ticks of the kernel, so that a frame that is late or lost would cost two of them,
        8 ms at 250 Hz. Its socket is therefore set not to block, and waited for here.
        """
        give_up = time.monotonic() + self._timeout
        select.select([self._wire], [], [], self._timeout)
        return self._soem.receive_processdata(max(0, round((give_up - time.monotonic()) * 1e6)))

    def _read(self, sample: np.void) -> None:
        counts, torques = [], []
        for number, (axis, slave) in enumerate(self._pairs()):
            values = axis.tx.unpack(slave.input)
            status, position, torque = axis.places
            self._states[number] = _STATES[values[status] & 0x7F]
            counts.append(values[position])
            torques.append(values[torque])
            if self._gripper is not None and number == self._gripper.joint - 1:
                (place,) = axis.tx.places(cia402.DIGITAL_INPUTS)
                sample["gripper"] = cia402.gripper_state(values[place], self._gripper.bit, self._gripper.closed)
        sample["position"] = self.scale.position(np.array(counts))
        sample["torque"] = self.scale.torque(np.array(torques))

    def _adopt_positions(self) -> None:
        targets = []
        for axis, slave in self._pairs():
            targets.append(axis.tx.unpack(slave.input)[axis.places[1]])
            axis.put(cia402.TARGET_POSITION, targets[-1])
        self._commanded = self.scale.position(np.array(targets)), np.zeros(3)

    def _walk(self, axis: _Axis, state: DriveState) -> int:
        control = _NEXT_CONTROL.get(state, Control.DISABLE_VOLTAGE)
        (place,) = axis.rx.places(cia402.CONTROLWORD)
        if control is Control.FAULT_RESET and axis.outputs[place] == Control.FAULT_RESET:
            return Control.DISABLE_VOLTAGE  # the reset is the rising edge
        return control

    def _for(self, duration: float) -> Iterator[int]:
        return iter(range(round(duration * NANOSECONDS / self._period_ns)))

    def _name(self, place: int) -> str:
        return f"drive {self._places.index(place) + 1}" if place in self._places else f"station {place}"

    def _explain_counter(self, counter: int) -> str:
        expected, cycles = self._soem.expected_wkc, self._faulty_run
        if counter <= 0:
            return (
                f"{self._interface}: working counter 0 of {expected} for {cycles} cycles: no drive answers; "
                "check cable and power"
            )
        self._soem.read_state()
        silent = [place for place, slave in enumerate(self._soem.slaves, start=1) if slave.state == 0]
        drives = [str(number) for number, place in enumerate(self._places, start=1) if place in silent]
        gone = [f"drive {', '.join(drives)}"] * bool(drives) + [self._name(p) for p in silent if p not in self._places]
        cause = f"{', '.join(gone)} does not answer" if gone else "a drive does not take part in the process data"
        return f"{self._interface}: working counter {counter} of {expected} for {cycles} cycles: {cause}"

    def _explain_states(self, wanted: str) -> str:
        self._soem.read_state()
        target = getattr(pysoem, f"{wanted}_STATE")
        for place, slave in enumerate(self._soem.slaves, start=1):
            if slave.state != target:
                reason = pysoem.al_status_code_to_string(slave.al_status) if slave.al_status else "no reason given"
                return f"{self._interface}: {self._name(place)} ({slave.name}) does not reach {wanted}: {reason}"
        return f"{self._interface}: the bus does not reach {wanted}"

    def _explain_drives(self) -> str:
        for number, state in enumerate(self._states, start=1):
            if state is not DriveState.OPERATION_ENABLED:
                words = state.name.lower().replace("_", " ")
                return f"{self._interface}: drive {number} is not in operation: {words}"
        return f"{self._interface}: the drives are not in operation"


def follow(
    master: Master, setpoints: Setpoints, feedforward: Feedforward, offset: OffsetRamp, ahead: PositionRamp
) -> Iterator[np.ndarray]:
    """Take drives in operation through `setpoints`.

    Yields the (1,) record of SAMPLE of each cycle, good until the next one, once the next command is ready.

    Raises:
        BusError: the bus failed or a drive left operation.
    """
    for number, (position, grip) in enumerate(zip(setpoints.position, setpoints.grip.tolist(), strict=True)):
        sample = master.cycle()
        master.check_operation()
        torque, before = feedforward(sample, setpoints, number) or (None, None)
        master.command(position, offset.step(torque), grip, ahead.step(before))
        yield sample


def _packet_sockets() -> set[int]:
    """Descriptors of this process's raw Ethernet sockets; Zenoh's threads open and close others meanwhile."""
    sockets = set()
    for name in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError):  # what has been closed since is passed over
            if not stat.S_ISSOCK(os.fstat(int(name)).st_mode):
                continue  # `fromfd` would leave a copy of it open
            with socket.fromfd(int(name), socket.AF_UNSPEC, 0) as found:
                if found.getsockopt(socket.SOL_SOCKET, socket.SO_DOMAIN) == socket.AF_PACKET:
                    sockets.add(int(name))
    return sockets


_STATES = [DriveState(int(drive_state(bits))) for bits in range(128)]


def _side_by_side(scales: tuple[Scale, ...]) -> Scale:
    """One scale whose fields are (3,), so that one call converts all joints."""
    return Scale(
        zero_counts=np.array([scale.zero_counts for scale in scales]),  # pyright: ignore[reportArgumentType]
        radians_per_count=np.array([scale.radians_per_count for scale in scales]),  # pyright: ignore[reportArgumentType]
        torque_nm_per_mille=np.array([scale.torque_nm_per_mille for scale in scales]),  # pyright: ignore[reportArgumentType]
        radians_per_s_per_unit=None,
    )
