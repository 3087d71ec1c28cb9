"""A bus with more on it than the robot's drives: what the description gives no place is passed over."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.ethercat.cia402 import scales
from drivers.ethercat.pdo import Pdo, joint_pdos
from drivers.ethercat.soem_master import Master
from drivers.simulated.plant.plant import Plant
from drivers.simulated.plant.truth import PlantTruth
from drivers.simulated.segment.esc import SlaveController
from drivers.simulated.segment.sii import build_sii
from drivers.simulated.segment.wire import EthercatSegment, serve
from replay.clock import wait_until
from replay.realtime import go_realtime
from schemas.errors import BusError, RobotError
from schemas.messages import SampleFlag
from schemas.robot import Robot, load_robot
from tests.drivers.ethercat import rig

PERIOD = 10e-3


class WithTerminals(EthercatSegment):
    """A digital terminal before the drives, and one between the first and the second."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(joint_pdos(robot), scales(robot), Plant(robot, PlantTruth.nominal(robot), period=PERIOD))
        byte = Pdo([":8"], "terminal")
        self.terminals = [
            SimpleNamespace(
                controller=SlaveController(
                    build_sii("terminal", 1, 1, serial, byte, byte), 1, 1, lambda: self._clock_ns, True
                )
            )
            for serial in (1, 2)
        ]

    def _wire(self) -> list:
        first, *others = super()._wire()
        return [self.terminals[0], first, self.terminals[1], *others]


def be_the_bus(robot: Robot) -> None:
    """Until standard input ends; then the joints' last positions and what the terminals' outputs are."""
    bus, over = WithTerminals(robot), threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), over.set())).start()
    go_realtime("segment")  # as `deltatwin segment` does: SOEM waits 20 ms for an EEPROM
    print("ready", flush=True)
    serve(rig.FAR, bus, over.is_set)
    outputs = [list(terminal.controller.outputs) for terminal in bus.terminals]
    print(json.dumps({"position": bus.trace["position"][-1].tolist(), "outputs": outputs}))


@pytest.fixture
def segment(tmp_path: Path) -> Iterator[tuple[rig.Namespace, subprocess.Popen[str]]]:
    rig.robot(tmp_path)
    with rig.namespace("deltatwin-terminals") as space:  # SOEM holds the interpreter: the bus is a process of its own
        command = space.prefix(sys.executable, "-m", __name__, str(tmp_path / "robot.toml"))
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield space, process
        process.kill()
        process.wait()


def placed(folder: Path, *places: int) -> Robot:
    path, text = folder / "robot.toml", rig.description()
    for number, place in enumerate(places):
        station = f"station = {0x1001 + number}\n"
        text = text.replace(station, f"{station}place = {place}\n")
    path.write_text(text)
    return load_robot(path)


def test_terminals_are_passed_over_by_declaration(
    segment: tuple[rig.Namespace, subprocess.Popen[str]], tmp_path: Path, bus_folder: Path
) -> None:
    space, bus = segment

    def operate(robot: Robot) -> tuple[np.ndarray, int]:
        with Master(rig.NEAR, robot, PERIOD, wait_until) as master:
            master.operate()
            samples = [master.cycle().copy() for _ in range(300)]
        good = [s["position"][0] for s in samples if not s["flags"][0] & SampleFlag.BUS_FAULT]
        return good[-1], len(good)

    with pytest.raises(
        BusError, match=r"^bus0: 5 slaves on the bus, robot 'rig' has 3 drives; drive.joint.N.place says"
    ):
        space.call(lambda: operate(rig.robot(tmp_path)))
    with pytest.raises(BusError, match=r"^bus0: 5 slaves on the bus, a drive is declared at 6$"):
        space.call(lambda: operate(placed(tmp_path, 2, 4, 6)))
    with pytest.raises(BusError, match=r"^bus0: drive 1 \(terminal\) maps 1 bytes of outputs, drive.joint.0.outputs"):
        space.call(lambda: operate(placed(tmp_path, 1, 4, 5)))
    position, good = space.call(lambda: operate(placed(tmp_path, 2, 4, 5)))
    assert good > 150, "whatever the machine is busy with, most frames come back"
    told = json.loads(bus.communicate(timeout=20)[0])
    np.testing.assert_allclose(position, told["position"], atol=0.01)
    assert told["outputs"] == [[0], [0]]


def test_places_are_all_declared_or_none(tmp_path: Path) -> None:
    for places in ((2,), (2, 2, 3)):
        with pytest.raises(RobotError, match="place"):
            placed(tmp_path, *places)


if __name__ == "__main__":
    be_the_bus(load_robot(sys.argv[1]))
