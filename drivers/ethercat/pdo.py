"""One drive's process data in one direction: which CiA 402 objects, in which order, packed and unpacked."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from drivers.ethercat.cia402 import OBJECTS, parse_object
from drivers.ethercat.eni import MappedObject, read_eni, slave_objects
from schemas.errors import RobotError
from schemas.robot import Robot

DIGITAL_OUTPUTS = 0x60FE
GRIPPER = 1 << 16  # the first of 0x60FE's bits that CiA 402 leaves to the maker


class Pdo:
    """Objects in order. `entries`: (index, bits) each, index 0 for bits left out; `size`: bytes."""

    def __init__(self, objects: Sequence[str], key: str) -> None:
        """`objects` as `schemas.robot.JointDrive` declares them; `key` names them in errors.

        Raises:
            RobotError: an object's size is not known or not whole bytes.
        """
        self.entries = tuple(_entry(text, key) for text in objects)
        layout, self._place = "<", {}
        for index, bits in self.entries:
            if index in OBJECTS:
                self._place[index] = len(self._place)
                layout += OBJECTS[index].char
            else:
                layout += f"{bits // 8}x"
        self._struct = struct.Struct(layout)
        self.size = self._struct.size
        self._key = key

    def places(self, *indices: int) -> tuple[int, ...]:
        """Where each object is in what `unpack` gives and `pack` takes; -1 when it is not mapped."""
        return tuple(self._place.get(index, -1) for index in indices)

    def require(self, *indices: int) -> tuple[int, ...]:
        """`places` of objects that have to be there.

        Raises:
            RobotError: one of them is not mapped.
        """
        for index in indices:
            if index not in self._place:
                raise RobotError(f"{self._key}: 0x{index:04X} is not mapped")
        return self.places(*indices)

    def blank(self) -> list[int]:
        """A zero for every object."""
        return [0] * len(self._place)

    def pack(self, values: Sequence[int]) -> bytes:
        """The bytes of one value for each object."""
        return self._struct.pack(*values)

    def unpack(self, data: bytes | bytearray | memoryview) -> tuple[int, ...]:
        """One value for each object."""
        return self._struct.unpack(data)


def joint_pdos(robot: Robot) -> list[tuple[Pdo, Pdo]]:
    """(outputs, inputs) of each joint's drive, as the robot description declares them or the ENI file it names.

    Raises:
        RobotError: the robot description maps no process data, or something unknown.
    """
    drive = robot.drive
    if not drive.joint:
        raise RobotError(f"{robot.origin}: drive.joint: missing key: a master has to know what its drives map")
    pairs = []
    for number, joint in enumerate(drive.joint):
        key = f"{robot.origin}: drive.joint.{number}"
        outputs, inputs = joint.outputs, joint.inputs
        if drive.eni and not outputs and not inputs:
            slave = slave_objects(read_eni(robot.folder / drive.eni), joint.station, f"{key}.station")
            outputs, inputs = (list(map(_declaration, objects)) for objects in (slave.outputs, slave.inputs))
        if not outputs or not inputs:
            raise RobotError(f"{key}: outputs, inputs: missing key: a master has to know what its drives map")
        pairs.append((Pdo(outputs, f"{key}.outputs"), Pdo(inputs, f"{key}.inputs")))
    return pairs


def _declaration(mapped: MappedObject) -> str:
    return f"0x{mapped.index:04X}:{mapped.bits}" if mapped.index else f":{mapped.bits}"


def _entry(text: str, key: str) -> tuple[int, int]:
    index, bits = parse_object(text, key)
    if bits % 8:
        raise RobotError(f"{key}: {text}: {bits} bits are not whole bytes")
    return index, bits
