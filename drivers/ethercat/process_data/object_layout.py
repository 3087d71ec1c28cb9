"""Where the objects of three drives lie in the process data, and what their units are."""

from __future__ import annotations

import numpy as np

from drivers.ethercat import cia402
from drivers.ethercat.cia402 import scales
from drivers.ethercat.eni import MAX_COMMANDS, MappedObject, Network, read_eni, slave_objects
from schemas.errors import RobotError
from schemas.robot import JointDrive, Robot

INPUTS = (
    cia402.STATUSWORD, cia402.POSITION_ACTUAL, cia402.VELOCITY_ACTUAL, cia402.TORQUE_ACTUAL, cia402.MODE_DISPLAY,
    cia402.DIGITAL_INPUTS,
)  # fmt: skip
OUTPUTS = (
    cia402.CONTROLWORD, cia402.TARGET_POSITION, cia402.TARGET_TORQUE, cia402.TORQUE_OFFSET, cia402.MODE_OF_OPERATION,
)  # fmt: skip
REQUIRED = (cia402.POSITION_ACTUAL, cia402.TORQUE_ACTUAL)
STATUS, POSITION, VELOCITY, TORQUE, MODE_DISPLAY, DIGITAL_INPUTS = range(len(INPUTS))
CONTROL, TARGET_POSITION, TARGET_TORQUE, TORQUE_OFFSET, MODE = range(len(OUTPUTS))
NOT_MAPPED = -1

# shapes of one cycle's values: joint, object
INPUT_SHAPE, OUTPUT_SHAPE = (3, len(INPUTS)), (3, len(OUTPUTS))


def _way(shape: tuple[int, int]) -> np.dtype:
    return np.dtype(
        [
            ("place", "i8", shape),  # logical byte address, NOT_MAPPED where there is none
            ("size", "i8", shape[1]),  # bytes
            ("signed", "i8", shape[1]),
        ],
        align=True,
    )


_COUNTER = np.dtype([("command", "i8"), ("address", "i8"), ("expected", "i8")], align=True)
LAYOUT = np.dtype(
    [
        ("inputs", _way(INPUT_SHAPE)),
        ("outputs", _way(OUTPUT_SHAPE)),
        ("counters", _COUNTER, MAX_COMMANDS),  # working counters that an ENI demands, command 0 behind the last
        ("zero_counts", "i8", 3),
        ("radians_per_count", "f8", 3),
        ("torque_nm_per_mille", "f8", 3),
        ("gripper_joint", "i8"),  # whose digital inputs tell of the gripper, NOT_MAPPED where none do
        ("gripper_bit", "i8"),
        ("gripper_closed", "i8"),  # its value there
        ("shared", "i8"),  # whether inputs and outputs share logical addresses
    ],
    align=True,
)


def make_layout(robot: Robot) -> np.ndarray:
    """(1,) record of LAYOUT that a robot description declares, itself or by the ENI file it names.

    Raises:
        RobotError: a drive, its scaling or an object is not declared, or the ENI file is wrong.
    """
    scaling = scales(robot)
    network = read_eni(robot.folder / robot.drive.eni) if robot.drive.eni else None
    layout = np.zeros(1, LAYOUT)
    inputs, outputs = (layout[side]["place"][0] for side in ("inputs", "outputs"))
    inputs[:] = outputs[:] = layout["gripper_joint"] = NOT_MAPPED
    gripper = robot.drive.gripper
    for joint, drive in enumerate(robot.drive.joint):
        key = f"{robot.origin}: drive.joint.{joint}"
        mapped_inputs, mapped_outputs = _mapped(drive, key, network)
        for row, known, mapped in ((inputs[joint], INPUTS, mapped_inputs), (outputs[joint], OUTPUTS, mapped_outputs)):
            for mapped_object in mapped:
                told = mapped_object.index != cia402.DIGITAL_INPUTS or (gripper and gripper.joint == joint + 1)
                if mapped_object.index in known and told:
                    row[known.index(mapped_object.index)] = _byte_address(mapped_object, key)
        for index in REQUIRED:
            if inputs[joint, INPUTS.index(index)] == NOT_MAPPED:
                raise RobotError(f"{key}.inputs: {index:#06x} is not mapped, a sample needs it")
    if gripper is not None:
        if inputs[gripper.joint - 1, DIGITAL_INPUTS] == NOT_MAPPED:
            raise RobotError(
                f"{robot.origin}: drive.gripper.joint: {gripper.joint}, but drive.joint.{gripper.joint - 1}.inputs "
                "maps no 0x60FD"
            )
        layout["gripper_joint"], layout["gripper_bit"] = gripper.joint - 1, gripper.bit
        layout["gripper_closed"] = gripper.closed
    for side, indexes in (("inputs", INPUTS), ("outputs", OUTPUTS)):
        types = [cia402.OBJECTS[index] for index in indexes]
        layout[side]["size"] = [kind.itemsize for kind in types]
        layout[side]["signed"] = [kind.kind == "i" for kind in types]
    commands = () if network is None else network.commands
    counters = [(c.command, c.address, c.working_counter) for c in commands if c.working_counter is not None]
    layout["counters"][0, : len(counters)] = counters
    layout["zero_counts"] = [scale.zero_counts for scale in scaling]
    layout["radians_per_count"] = [scale.radians_per_count for scale in scaling]
    layout["torque_nm_per_mille"] = [scale.torque_nm_per_mille for scale in scaling]
    layout["shared"] = bool(_bytes(layout["inputs"]) & _bytes(layout["outputs"]))
    return layout


def mapped_inputs(layout: np.ndarray) -> np.ndarray:
    """INPUT_SHAPE: whether a drive maps each of INPUTS."""
    return layout["inputs"]["place"][0] != NOT_MAPPED


def mapped_objects(layout: np.ndarray) -> list[dict[str, int | str]]:
    """The objects of a layout in the order of their addresses: joint, object, direction, logical_address."""
    places = [
        (int(place), joint + 1, f"{index:#06x}", direction)
        for side, indexes, direction in (("inputs", INPUTS, "input"), ("outputs", OUTPUTS, "output"))
        for joint, row in enumerate(layout[side]["place"][0])
        for index, place in zip(indexes, row, strict=True)
        if place != NOT_MAPPED
    ]
    return [
        {"joint": joint, "object": index, "direction": direction, "logical_address": place}
        for place, joint, index, direction in sorted(places)
    ]


def _mapped(
    drive: JointDrive, key: str, network: Network | None
) -> tuple[tuple[MappedObject, ...], tuple[MappedObject, ...]]:
    if drive.inputs_address is not None:
        return (
            _declared(drive.inputs, drive.inputs_address, f"{key}.inputs"),
            _declared(drive.outputs, drive.outputs_address or 0, f"{key}.outputs"),
        )
    if network is None:
        raise RobotError(f"{key}.inputs: missing key: say what the drive maps, or name an ENI file in drive.eni")
    slave = slave_objects(network, drive.station, f"{key}.station")
    return slave.inputs, slave.outputs


def _declared(entries: list[str], address: int, key: str) -> tuple[MappedObject, ...]:
    objects, bit = [], address * 8
    for entry in entries:
        index, bits = cia402.parse_object(entry, key)
        objects.append(MappedObject(index, bits, bit))
        bit += bits
    return tuple(objects)


def _byte_address(mapped: MappedObject, key: str) -> int:
    size = cia402.OBJECTS[mapped.index].itemsize * 8
    if mapped.address_bits % 8 or mapped.bits != size:
        raise RobotError(
            f"{key}: {mapped.index:#06x} is mapped with {mapped.bits} bits at bit "
            f"{mapped.address_bits % 8} of a byte; {size} whole bits are needed"
        )
    return mapped.address_bits // 8


def _bytes(side: np.ndarray) -> set[int]:
    """Logical addresses that the objects of one direction take."""
    (places,), (sizes,) = side["place"], side["size"]
    return {int(a) + k for row in places for a, n in zip(row, sizes, strict=True) if a != NOT_MAPPED for k in range(n)}
