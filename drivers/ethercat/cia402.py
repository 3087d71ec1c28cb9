"""CiA 402 (IEC 61800-7-201): the objects a drive maps, its state machine, and its units to joint-side SI and back."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

import numpy as np

from schemas.errors import RobotError
from schemas.kernels import kernel
from schemas.messages import Gripper
from schemas.robot import Robot

CONTROLWORD = 0x6040
STATUSWORD = 0x6041
MODE_OF_OPERATION = 0x6060
MODE_DISPLAY = 0x6061
POSITION_ACTUAL = 0x6064
VELOCITY_ACTUAL = 0x606C
TARGET_TORQUE = 0x6071
TORQUE_ACTUAL = 0x6077
TARGET_POSITION = 0x607A
POSITION_OFFSET = 0x60B0
TORQUE_OFFSET = 0x60B2
DIGITAL_INPUTS = 0x60FD

OBJECTS = {
    0x603F: np.dtype("<u2"),  # error code
    CONTROLWORD: np.dtype("<u2"),
    STATUSWORD: np.dtype("<u2"),
    MODE_OF_OPERATION: np.dtype("i1"),
    MODE_DISPLAY: np.dtype("i1"),
    POSITION_ACTUAL: np.dtype("<i4"),
    VELOCITY_ACTUAL: np.dtype("<i4"),
    TARGET_TORQUE: np.dtype("<i2"),
    0x6072: np.dtype("<u2"),  # max torque
    TORQUE_ACTUAL: np.dtype("<i2"),
    0x6078: np.dtype("<i2"),  # current actual
    0x6079: np.dtype("<u4"),  # DC link voltage
    TARGET_POSITION: np.dtype("<i4"),
    POSITION_OFFSET: np.dtype("<i4"),
    0x60B1: np.dtype("<i4"),  # velocity offset
    TORQUE_OFFSET: np.dtype("<i2"),
    0x60B8: np.dtype("<u2"),  # touch probe function
    0x60B9: np.dtype("<u2"),  # touch probe status
    0x60BA: np.dtype("<i4"),  # touch probe 1 positive edge
    0x60E0: np.dtype("<u2"),  # positive torque limit
    0x60E1: np.dtype("<u2"),  # negative torque limit
    0x60F4: np.dtype("<i4"),  # following error
    DIGITAL_INPUTS: np.dtype("<u4"),
    0x60FE: np.dtype("<u4"),  # digital outputs
    0x60FF: np.dtype("<i4"),  # target velocity
}
"""Objects whose size CiA 402 fixes."""


def parse_object(entry: str, key: str) -> tuple[int, int]:
    """(index, bits) of a mapped object as a robot description writes it: "0x6064", "0x2010:16", ":8" (index 0).

    Raises:
        RobotError: naming `key`, where it is none, or its size is not known or not CiA 402's.
    """
    name, _, size = entry.partition(":")
    try:
        index, bits = int(name, 16) if name else 0, int(size) if size else 0
    except ValueError:
        index, bits = -1, 0
    known = OBJECTS[index].itemsize * 8 if index in OBJECTS else 0
    bits = bits or known
    if index < 0 or bits < 0 or (not name and bits == 0):
        raise RobotError(f'{key}: {entry!r} is not an object: write "0x6064", "0x2010:16" or ":8"')
    if bits == 0:
        raise RobotError(f'{key}: the size of {entry} is not known: write "{name}:bits"')
    if known and bits != known:
        raise RobotError(f"{key}: {entry}: {name} has {known} bits in CiA 402")
    return index, bits


class Mode(enum.IntEnum):
    """Modes of operation, 0x6060 and 0x6061."""

    NONE = 0
    CSP = 8  # cyclic synchronous position
    CSV = 9  # cyclic synchronous velocity
    CST = 10  # cyclic synchronous torque


class Control(enum.IntEnum):
    """Control words, 0x6040, that walk the state machine."""

    DISABLE_VOLTAGE = 0x0000
    SHUTDOWN = 0x0006
    SWITCH_ON = 0x0007
    ENABLE_OPERATION = 0x000F
    QUICK_STOP = 0x0002
    FAULT_RESET = 0x0080


class DriveState(enum.IntEnum):
    """States of the drive; the value is the status word's pattern in the bits that carry the state."""

    UNKNOWN = 0xFFFF
    NOT_READY_TO_SWITCH_ON = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08


_LOOSE = (
    DriveState.NOT_READY_TO_SWITCH_ON,
    DriveState.SWITCH_ON_DISABLED,
    DriveState.FAULT_REACTION_ACTIVE,
    DriveState.FAULT,
)  # bit 5, quick stop, is free in these: mask 0x4F instead of 0x6F


def _state_table() -> np.ndarray:
    table = np.full(128, DriveState.UNKNOWN, np.uint16)
    for bits in range(128):
        for state in DriveState:
            mask = 0x4F if state in _LOOSE else 0x6F
            if state is not DriveState.UNKNOWN and bits & mask == state:
                table[bits] = state
    return table


STATE_OF_BITS = _state_table()
"""(128,) uint16: the `DriveState` of the status word's low seven bits."""


def drive_state(statusword: np.ndarray | int) -> np.ndarray:
    """`DriveState` values of status words, 0x6041, uint16, same shape (IEC 61800-7-201, state coding)."""
    return STATE_OF_BITS[np.asarray(statusword, np.int64) & 0x7F]


@kernel
def joint_angle(counts, zero_counts, radians_per_count):
    """Joint angle, rad, of 0x6064 or 0x607A, one int64 or an array. The object wraps at 2^32, and so does this."""
    return (((counts - zero_counts + 2**31) & 0xFFFFFFFF) - 2**31) * radians_per_count


@kernel
def gripper_state(digital_inputs, bit, closed):
    """`Gripper` that 0x60FD says."""
    return Gripper.CLOSED.value if (digital_inputs >> bit) & 1 == closed else Gripper.OPEN.value


@dataclass(frozen=True)
class Scale:
    """One drive's units against its joint. Arrays of any shape go in and come out with that shape.

    radians_per_count and torque_nm_per_mille are signed and joint side, the gear ratio is in them.
    """

    zero_counts: int
    radians_per_count: float
    torque_nm_per_mille: float
    radians_per_s_per_unit: float | None  # of 0x606C; None: not declared

    def position(self, counts: np.ndarray | int) -> np.ndarray:
        """Joint angle, rad, of 0x6064 or 0x607A."""
        return joint_angle(np.asarray(counts, np.int64), self.zero_counts, self.radians_per_count)

    def counts(self, position: np.ndarray | float) -> np.ndarray:
        """0x607A, int32, nearest to a joint angle in rad."""
        counts = np.rint(np.asarray(position, np.float64) / self.radians_per_count).astype(np.int64) + self.zero_counts
        return (((counts + 2**31) & 0xFFFFFFFF) - 2**31).astype(np.int32)

    def torque(self, per_mille: np.ndarray | int) -> np.ndarray:
        """Joint torque, N m, of 0x6077, 0x6071 or 0x60B2."""
        return np.asarray(per_mille, np.float64) * self.torque_nm_per_mille

    def per_mille(self, torque: np.ndarray | float) -> np.ndarray:
        """0x6071 or 0x60B2, int16, nearest to a joint torque in N m, held at the object's limits."""
        units = np.rint(np.asarray(torque, np.float64) / self.torque_nm_per_mille)
        return np.clip(units, -32768, 32767).astype(np.int16)


def scales(robot: Robot) -> tuple[Scale, Scale, Scale]:
    """The three joints' scaling from the `[drive]` section of a robot description.

    Raises:
        RobotError: no drive is declared.
    """
    drive = robot.drive
    if not drive.joint:
        raise RobotError(
            f"{robot.origin}: drive.joint: missing key: the scaling of each drive has to be declared to read its bus"
        )

    def scale(index: int) -> Scale:
        joint = drive.joint[index]
        gear_ratio = joint.gear_ratio or drive.gear_ratio
        radians_per_count = joint.sign * math.tau / joint.counts_per_turn / gear_ratio
        unit = joint.velocity_unit_counts_per_s
        if joint.velocity_unit_rpm is not None:
            unit = joint.velocity_unit_rpm * joint.counts_per_turn / 60
        return Scale(
            zero_counts=joint.zero_counts,
            radians_per_count=radians_per_count,
            torque_nm_per_mille=(joint.torque_sign or joint.sign) * joint.torque.full_scale_nm * gear_ratio / 1000,
            radians_per_s_per_unit=None if unit is None else unit * radians_per_count,
        )

    return scale(0), scale(1), scale(2)
