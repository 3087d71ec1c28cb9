"""The FMU: valid by FMPy's checker, and run there on the demo log to the service's bits."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from typer.testing import CliRunner

from drivers.trace import read_trace
from replay.demo import LOG, ROBOT
from schemas.messages import set_stamp
from schemas.robot import load_robot, save_robot
from service.cli.main import app
from service.codegen.fmu import write_fmu
from service.estimator.estimator import Estimator
from tests.known import PERIOD, robot
from tests.service.codegen.built import needs_compiler

__all__ = ["robot"]
pytestmark = needs_compiler
STEPS = 2500  # through the first pick


class Unit:
    """An FMU as a co-simulation has it."""

    def __init__(self, path: Path, fmi: int, folder: Path) -> None:
        self.described: Any = fmpy.read_model_description(str(path))
        self.references = {one.name: one.valueReference for one in self.described.modelVariables}
        kind: Any = FMU3Slave if fmi == 3 else FMU2Slave
        self.unit = kind(
            guid=self.described.guid, unzipDirectory=fmpy.extract(str(path), str(folder)),
            modelIdentifier=self.described.coSimulation.modelIdentifier, instanceName="twin",
        )  # fmt: skip
        self.is_3 = fmi == 3
        self.unit.instantiate()

    def begin(self, **parameters: float) -> None:
        if not self.is_3:
            self.unit.setupExperiment(startTime=0.0)
        self.unit.enterInitializationMode()
        self.set(parameters)
        self.unit.exitInitializationMode()

    def set(self, values: dict[str, float]) -> None:
        references, given = [self.references[name] for name in values], [float(value) for value in values.values()]
        (self.unit.setFloat64 if self.is_3 else self.unit.setReal)(references, given)

    def get(self, *names: str) -> list[float]:
        return (self.unit.getFloat64 if self.is_3 else self.unit.getReal)([self.references[name] for name in names])

    def whole(self, name: str) -> int:
        return (self.unit.getInt32 if self.is_3 else self.unit.getInteger)([self.references[name]])[0]

    def step(self, time: float, length: float = PERIOD) -> None:
        self.unit.doStep(currentCommunicationPoint=time, communicationStepSize=length)

    def end(self) -> None:
        self.unit.terminate()
        self.unit.freeInstance()


def joints(name: str) -> list[str]:
    return [f"{name}_{number}" for number in (1, 2, 3)]


@pytest.mark.parametrize("fmi", [3, 2])
def test_the_demo_log_comes_out_as_in_the_service(tmp_path: Path, fmi: Any) -> None:
    robot = load_robot(ROBOT)
    write_fmu(robot, PERIOD, fmi, tmp_path / "twin.fmu", "twin")
    assert validate_fmu(str(tmp_path / "twin.fmu")) == []
    samples = read_trace(LOG, robot).samples()[:STEPS]
    samples["sequence"], samples["torque_command"] = np.arange(STEPS), np.nan
    set_stamp(samples, np.arange(STEPS) * 1_000_000)
    wanted = Estimator(robot, PERIOD).run(samples)
    unit = Unit(tmp_path / "twin.fmu", fmi, tmp_path / "unpacked")
    unit.begin()
    torque, mass, sources = np.zeros((STEPS, 3)), np.zeros(STEPS), set()
    for k, sample in enumerate(samples):
        unit.set(dict(zip(joints("position"), sample["position"], strict=True)))
        unit.set(dict(zip(joints("torque"), sample["torque"], strict=True)))
        unit.set(dict(zip(joints("position_command"), sample["position_command"], strict=True)))
        unit.step(k * PERIOD)
        torque[k], (mass[k],) = unit.get(*joints("feedforward")), unit.get("mass")
        sources.add(unit.whole("source"))
    unit.end()
    np.testing.assert_array_equal(torque, wanted.feedforward["torque"])
    assert mass[-1] == wanted.payload["mass"][-1]
    assert mass[-1] != 0.0
    assert sources >= {1, 3}


def test_parameters_are_taken_and_checked_and_the_step_is_the_one_it_was_made_for(robot, tmp_path: Path) -> None:
    write_fmu(robot, PERIOD, 3, tmp_path / "twin.fmu", "twin")
    unit = Unit(tmp_path / "twin.fmu", 3, tmp_path / "unpacked")
    assert unit.get("coulomb_2") == [robot.identified.coulomb_friction_nm.value[1]]
    with pytest.raises(Exception, match="fmi3ExitInitializationMode"):
        unit.begin(peak=-1.0)
    unit.unit.reset()
    unit.begin(peak=50.0)
    assert unit.get("peak") == [50.0]
    with pytest.raises(Exception, match="fmi3SetFloat64"):
        unit.set({"feedforward_1": 3.0})
    with pytest.raises(Exception, match="fmi3DoStep"):
        unit.step(0.0, 2 * PERIOD)
    assert unit.get(*joints("feedforward")) == [0.0, 0.0, 0.0]
    unit.end()


def test_the_command_writes_sources_beside_the_library(robot, tmp_path: Path) -> None:
    save_robot(robot, tmp_path / "r.toml")
    options = ["--to", "fmu", "--fmi", "2", "--rate", "500", "--out", str(tmp_path / "r.fmu")]
    told = CliRunner().invoke(app, ["export", str(tmp_path / "r.toml"), *options])
    assert told.exit_code == 0, told.output
    with zipfile.ZipFile(tmp_path / "r.fmu") as archive:
        names = set(archive.namelist())
        if shutil.which("x86_64-w64-mingw32-gcc"):
            library = archive.read("binaries/win64/deltatwin.dll")
            assert library[:2] == b"MZ"
            assert b"fmi2DoStep" in library
    assert {"modelDescription.xml", "sources/deltatwin.c", "binaries/linux64/deltatwin.so"} <= names
