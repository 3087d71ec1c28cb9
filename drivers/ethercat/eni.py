"""ENI: what an EtherCAT network configuration file says of the process data of each slave.

Source: ETG.2100. `Send` and `Recv` give a slave's place in the process image in bits, the PDO entries what lies there
in which order, and the cyclic commands which part of the image travels at which logical address.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from drivers.ethercat.frames import Command
from schemas.errors import RobotError
from schemas.files import MIB, read_bytes

MAX_BYTES = 16 * MIB  # as many as a line of 500 slaves with all their start-up commands has
MAX_COMMANDS = 256  # cyclic, logical: 380 kB of process data
MAX_ENTRIES = 1 << 16  # PDO entries of all slaves
MAX_NUMBER = 1 << 32

_READS = (Command.LRD, Command.LRW)
_WRITES = (Command.LWR, Command.LRW)


@dataclass(frozen=True)
class MappedObject:
    """One PDO entry on the wire. index 0: filler."""

    index: int
    bits: int
    address_bits: int  # logical address of its first bit, in bits


@dataclass(frozen=True)
class SlaveObjects:
    """Mapped objects of one slave, in PDO order: outputs go to it, inputs come from it."""

    station: int
    name: str
    outputs: tuple[MappedObject, ...]
    inputs: tuple[MappedObject, ...]


@dataclass(frozen=True)
class CyclicCommand:
    """One cyclic datagram with a logical address. working_counter: None where the file does not say."""

    command: int
    address: int
    length: int
    image_input: int | None
    image_output: int | None
    working_counter: int | None


@dataclass(frozen=True)
class Network:
    """What the ENI at `path` says: slaves by station address, and the cyclic logical commands."""

    path: Path
    slaves: dict[int, SlaveObjects]
    commands: tuple[CyclicCommand, ...]


def read_eni(path: Path) -> Network:
    """Read an ENI file. Entities and external references are refused, whatever they would expand to.

    Raises:
        RobotError: the file cannot be read, is no ENI, or says something that cannot be.
    """
    try:
        root = fromstring(read_bytes(path, MAX_BYTES, RobotError), forbid_dtd=True)
    except DefusedXmlException as error:
        raise RobotError(
            f"{path}: ENI refused, it declares a document type or entities ({type(error).__name__})"
        ) from error
    except (ParseError, ValueError, LookupError) as error:  # LookupError: an encoding nobody knows
        raise RobotError(f"{path}: not XML: {error}") from error
    if root is None or root.tag != "EtherCATConfig" or root.find("Config") is None:
        raise RobotError(f"{path}: no ENI: its root is <{getattr(root, 'tag', '')}>, expected <EtherCATConfig><Config>")
    commands = tuple(
        command for cmd in root.iterfind("Config/Cyclic/Frame/Cmd") if (command := _command(path, cmd)) is not None
    )
    entries = sum(1 for _ in root.iterfind("Config/Slave/ProcessData/*/Entry"))
    for what, found, limit in (("cyclic commands", len(commands), MAX_COMMANDS), ("PDO entries", entries, MAX_ENTRIES)):
        if found > limit:
            raise RobotError(f"{path}: {found} {what}, at most {limit} are read")
    slaves = [_slave(path, slave, commands) for slave in root.iterfind("Config/Slave")]
    return Network(path, {slave.station: slave for slave in slaves}, commands)


def slave_objects(network: Network, station: int | None, key: str) -> SlaveObjects:
    """What an ENI maps for one station; `key` names the declaration of the station in the error.

    Raises:
        RobotError: the file has no such slave.
    """
    if station not in network.slaves:
        known = ", ".join(map(str, network.slaves)) or "none"
        raise RobotError(f"{key}: {station} is not a slave of {network.path} (stations in decimal: {known})")
    return network.slaves[station]


def _number(path: Path, element: Element, tag: str) -> int | None:
    """A whole number under `tag`, decimal, #x or 0x; None where the tag is absent or empty."""
    text = (element.findtext(tag) or "").strip()
    return _whole(path, f"<{element.tag}><{tag}>", text) if text else None


def _whole(path: Path, where: str, text: str) -> int:
    try:
        value = int(text) if text.isdecimal() else int(text.lower().replace("#x", "0x"), 0)
    except ValueError:
        value = -1
    if not 0 <= value < MAX_NUMBER:
        raise RobotError(f"{path}: {where}: {text!r} is not a whole number below 2^32")
    return value


def _command(path: Path, cmd: Element) -> CyclicCommand | None:
    command, address = _number(path, cmd, "Cmd"), _number(path, cmd, "Addr")
    if command is None or command not in (*_READS, *_WRITES) or address is None:
        return None
    length = _number(path, cmd, "DataLength")
    if length is None:
        raise RobotError(f"{path}: a cyclic command at logical address {address:#x} has no <DataLength>")
    return CyclicCommand(
        command=command,
        address=address,
        length=length,
        image_input=_number(path, cmd, "InputOffs") if command in _READS else None,
        image_output=_number(path, cmd, "OutputOffs") if command in _WRITES else None,
        working_counter=_number(path, cmd, "Cnt"),
    )


def _slave(path: Path, slave: Element, commands: tuple[CyclicCommand, ...]) -> SlaveObjects:
    station = _number(path, slave, "Info/PhysAddr")
    name = (slave.findtext("Info/Name") or "").strip() or "?"
    if station is None:
        raise RobotError(f"{path}: slave {name!r} has no <PhysAddr>")
    return SlaveObjects(
        station,
        name,
        outputs=_objects(path, slave, "Send", "RxPdo", [(c.image_output, c) for c in commands]),
        inputs=_objects(path, slave, "Recv", "TxPdo", [(c.image_input, c) for c in commands]),
    )


def _objects(
    path: Path, slave: Element, area: str, pdo: str, places: list[tuple[int | None, CyclicCommand]]
) -> tuple[MappedObject, ...]:
    start = _number(path, slave, f"ProcessData/{area}/BitStart")
    if start is None:
        return ()
    pdos = [p for p in slave.iterfind(f"ProcessData/{pdo}") if p.get("Sm") is not None]  # without Sm: not assigned
    sm = f"Sm{_whole(path, f'<{pdo} Sm>', str(pdos[0].get('Sm')))}" if pdos else "Sm"
    assigned = [_whole(path, f"<{sm}><Pdo>", (e.text or "").strip()) for e in slave.iterfind(f"ProcessData/{sm}/Pdo")]
    if assigned:  # the sync manager's list gives the order
        pdos.sort(key=lambda p: assigned.index(i) if (i := _number(path, p, "Index")) in assigned else len(assigned))
    objects = []
    for entry in (entry for p in pdos for entry in p.iterfind("Entry")):
        bits = _number(path, entry, "BitLen")
        if bits is None:
            raise RobotError(f"{path}: a PDO entry of station {_number(path, slave, 'Info/PhysAddr')} has no <BitLen>")
        objects.append(MappedObject(_number(path, entry, "Index") or 0, bits, _logical_bits(path, start, places)))
        start += bits
    return tuple(objects)


def _logical_bits(path: Path, image_bits: int, places: list[tuple[int | None, CyclicCommand]]) -> int:
    for image_byte, command in places:
        if image_byte is not None and image_byte * 8 <= image_bits < (image_byte + command.length) * 8:
            return command.address * 8 + image_bits - image_byte * 8
    raise RobotError(f"{path}: no cyclic command carries bit {image_bits} of the process image")
