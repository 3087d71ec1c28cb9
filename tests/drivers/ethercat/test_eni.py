"""ENI files: the same layout as the declared one, and everything a file can do wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.ethercat.capture import Capture
from drivers.ethercat.pdo import joint_pdos
from drivers.ethercat.process_data.assembly import Assembler
from drivers.ethercat.process_data.object_layout import make_layout
from schemas.errors import RobotError
from schemas.messages import SampleFlag
from schemas.robot import Robot
from tests.drivers.ethercat.wire import (
    INPUT_BYTES,
    INPUTS,
    OUTPUT_BYTES,
    OUTPUTS,
    cycle,
    datagram,
    frame,
    of_cycles,
    pcap,
    robot,
)

BITS = {"0x6041": 16, "0x6064": 32, "0x606C": 32, "0x6077": 16, "0x6061": 8, ":8": 8,
        "0x6040": 16, "0x607A": 32, "0x6071": 16, "0x60B2": 16, "0x6060": 8}  # fmt: skip


def entries(objects: list[str]) -> str:
    return "".join(
        f"<Entry>{f'<Index>#x{o[2:]}</Index><SubIndex>0</SubIndex>' if o[0] == '0' else '<Index>0</Index>'}"
        f"<BitLen>{BITS[o]}</BitLen></Entry>"
        for o in objects
    )


def slave(number: int, outputs_at: int = 4, inputs_at: int = 100) -> str:
    """A drive, the first with its outputs and inputs at these bytes of the process image; each in two PDOs whose order
    Sm3 turns round."""
    return f"""<Slave><Info><Name>Drive {number}</Name><PhysAddr>{0x1001 + number}</PhysAddr></Info><ProcessData>
      <Send><BitStart>{(outputs_at + OUTPUT_BYTES * number) * 8}</BitStart><BitLength>96</BitLength></Send>
      <Recv><BitStart>{(inputs_at + INPUT_BYTES * number) * 8}</BitStart><BitLength>112</BitLength></Recv>
      <Sm2><Pdo>5632</Pdo></Sm2><Sm3><Pdo>6657</Pdo><Pdo>6656</Pdo></Sm3>
      <RxPdo Sm="2"><Index>#x1600</Index>{entries(OUTPUTS)}</RxPdo>
      <TxPdo Sm="3"><Index>#x1a00</Index>{entries(INPUTS[2:])}</TxPdo>
      <TxPdo Sm="3"><Index>#x1a01</Index>{entries(INPUTS[:2])}</TxPdo>
      <TxPdo><Index>#x1a02</Index>{entries(["0x6077"])}</TxPdo></ProcessData></Slave>"""


COMMANDS = f"""<Cyclic><CycleTime>1000</CycleTime><Frame>
  <Cmd><Cmd>12</Cmd><Addr>4096</Addr><DataLength>{3 * OUTPUT_BYTES}</DataLength><Cnt>9</Cnt>
    <InputOffs>0</InputOffs><OutputOffs>4</OutputOffs></Cmd>
  <Cmd><Cmd>10</Cmd><Addr>#x1024</Addr><DataLength>{3 * INPUT_BYTES}</DataLength><InputOffs>100</InputOffs></Cmd>
  <Cmd><Cmd>7</Cmd><Adp>0</Adp><Ado>304</Ado><DataLength>2</DataLength></Cmd></Frame></Cyclic>"""
ENI = f"<EtherCATConfig><Config>{''.join(slave(k) for k in range(3))}{COMMANDS}</Config></EtherCATConfig>"


def with_eni(folder: Path, text: str | bytes) -> Robot:
    path = folder / "machine.xml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    unmapped = {"inputs": [], "inputs_address": None, "outputs": [], "outputs_address": None}
    return robot(drive={"eni": str(path)}, **unmapped)


def test_an_eni_gives_the_layout_that_the_declaration_gives(tmp_path: Path) -> None:
    found, declared = make_layout(with_eni(tmp_path, ENI)), make_layout(robot())

    np.testing.assert_array_equal(found["inputs"], declared["inputs"])
    np.testing.assert_array_equal(found["outputs"], declared["outputs"])
    assert found["counters"][0, :2].tolist() == [(12, 4096, 9), (0, 0, 0)]
    assert not found["shared"]


def test_a_master_maps_by_the_eni_what_it_maps_by_the_declaration(tmp_path: Path) -> None:
    def entries_of(description: Robot) -> list[tuple]:
        return [(rx.entries, tx.entries) for rx, tx in joint_pdos(description)]

    assert entries_of(with_eni(tmp_path, ENI)) == entries_of(robot())
    with pytest.raises(RobotError, match=r"drive\.joint\.0\.station: 4097 is not a slave of .*machine\.xml"):
        joint_pdos(with_eni(tmp_path, "<EtherCATConfig><Config/></EtherCATConfig>"))


def terminal(station: int, area: str, pdo: str, byte: int) -> str:
    return f"""<Slave><Info><Name>Terminal</Name><PhysAddr>{station}</PhysAddr></Info><ProcessData>
      <{area}><BitStart>{byte * 8}</BitStart><BitLength>8</BitLength></{area}>
      <{pdo} Sm="0"><Index>#x1a00</Index>{"<Entry><Index>#x6000</Index><BitLen>1</BitLen></Entry>" * 8}</{pdo}>
      </ProcessData></Slave>"""


def test_stations_that_are_no_drives_are_passed_over(tmp_path: Path) -> None:
    """A coupler before the drives, digital outputs and inputs between the first two, on the line and in the image."""
    line = [
        "<Slave><Info><Name>Coupler</Name><PhysAddr>4096</PhysAddr></Info></Slave>",
        slave(0, 0, 37),
        terminal(0x1101, "Send", "RxPdo", 12),
        terminal(0x1102, "Recv", "TxPdo", 51),
        slave(1, 1, 38),
        slave(2, 1, 38),
    ]
    command = """<Cyclic><Frame><Cmd><Cmd>12</Cmd><Addr>4096</Addr><DataLength>80</DataLength><Cnt>12</Cnt>
      <InputOffs>0</InputOffs><OutputOffs>0</OutputOffs></Cmd></Frame></Cyclic>"""
    description = with_eni(tmp_path, f"<EtherCATConfig><Config>{''.join(line)}{command}</Config></EtherCATConfig>")
    packets = []
    for number in range(40):
        first, *others = cycle(number)
        data = first.outputs + b"\xa5" + b"".join(drive.outputs for drive in others)
        data += first.inputs + b"\x5a" + b"".join(drive.inputs for drive in others)
        answered = 12 if number else 9  # both terminals are missing in the first cycle
        for delay, counter, returned in ((0, 0, False), (20_000, answered, True)):
            content = frame(datagram(12, 0x1000, data, counter, number), returned=returned)
            packets.append((number * 1_000_000 + delay, content))
    capture = Capture(pcap(tmp_path / "line.pcap", packets, nanoseconds=True))
    assembler = Assembler(make_layout(description))
    samples = np.concatenate([assembler.samples(frames)[0] for frames in capture.blocks()])

    of_cycles(samples, range(40))
    assert np.flatnonzero(samples["flags"] & np.uint32(SampleFlag.BUS_FAULT)).tolist() == [0]


def test_a_declared_mapping_wins_over_the_eni(tmp_path: Path) -> None:
    (tmp_path / "machine.xml").write_text(ENI)
    layout = make_layout(robot(drive={"eni": str(tmp_path / "machine.xml")}, inputs=["0x6064", "0x6077"]))
    assert layout["inputs"]["place"][0, 0].tolist() == [-1, 0x1000 + 36, -1, 0x1000 + 40, -1, -1]


BOMB = (
    '<!DOCTYPE b [<!ENTITY a "aaaaaaaaaa">'
    + "".join(f'<!ENTITY {chr(98 + k)} "{f"&{chr(97 + k)};" * 10}">' for k in range(10))
    + "]><EtherCATConfig><Config>&k;</Config></EtherCATConfig>"
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BOMB, "document type or entities"),
        ('<!DOCTYPE b SYSTEM "file:///etc/hostname"><EtherCATConfig/>', "document type or entities"),
        ("", "not XML"),
        ("<EtherCATConfig><Config>", "not XML"),
        (b"\xff\xfe\x00broken", "not XML"),
        ('<?xml version="1.0" encoding="nonsense"?><a/>', "not XML"),
        ("<EtherCATInfo/>", "no ENI: its root is <EtherCATInfo>"),
        ("<EtherCATConfig><Config/></EtherCATConfig>", "4097 is not a slave"),
        (ENI.replace(">4097<", ">four<"), "PhysAddr>: 'four' is not a whole number"),
        (ENI.replace(">4097<", "><"), "has no <PhysAddr>"),
        (ENI.replace("<BitLen>32</BitLen>", ""), "no <BitLen>"),
        (ENI.replace("<Addr>4096<", "<Addr>-5<"), "not a whole number"),
        (ENI.replace("<Addr>4096<", "<Addr>4294967296<"), "not a whole number below 2\\^32"),
        (ENI.replace('Sm="2"', 'Sm="a:b"'), "RxPdo Sm>: 'a:b' is not a whole number"),
        (ENI.replace('Sm="2"', 'Sm="2["'), "RxPdo Sm>: '2\\[' is not a whole number"),
        (ENI.replace(f"<DataLength>{3 * OUTPUT_BYTES}</DataLength>", ""), "no <DataLength>"),
        (ENI.replace("<InputOffs>100<", "<InputOffs>200<"), "no cyclic command carries bit 800"),
        (ENI.replace("#x6077", "#x2077"), "0x6077 is not mapped"),
        (ENI.replace("<BitLen>32</BitLen>", "<BitLen>31</BitLen>"), "whole bits are needed"),
        (ENI.replace("<Pdo>6657</Pdo>", "<Pdo>x</Pdo>"), "not a whole number"),
    ],
)
def test_a_wrong_eni_is_one_error(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(RobotError, match=message):
        make_layout(with_eni(tmp_path, text))


def test_an_eni_that_is_not_there_is_one_error(tmp_path: Path) -> None:
    description = with_eni(tmp_path, ENI)
    (tmp_path / "machine.xml").unlink()
    with pytest.raises(RobotError, match=r"machine\.xml: No such file"):
        make_layout(description)
