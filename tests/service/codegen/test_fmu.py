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
from schemas.messages import Gripper, SampleFlag, set_stamp
from schemas.robot import FourthAxis, Robot, load_robot, save_robot
from service.cli.main import app
from service.estimator.estimator import Estimator
from tests.known import PERIOD
from tests.service.codegen.built import needs_compiler

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

    def set_whole(self, values: dict[str, int]) -> None:
        references, given = [self.references[name] for name in values], [int(value) for value in values.values()]
        (self.unit.setInt32 if self.is_3 else self.unit.setInteger)(references, given)

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


@pytest.fixture(scope="module")
def described() -> Robot:
    return load_robot(ROBOT).model_copy(update={"fourth_axis": FourthAxis(shaft_mass_kg=0.2)})


@pytest.fixture(scope="module")
def paths(described, tmp_path_factory) -> dict[int, Path]:
    """The FMU by version of the standard, as the command writes it."""
    folder = tmp_path_factory.mktemp("fmu")
    save_robot(described, folder / "r.toml")
    for fmi in (2, 3):
        options = ["--to", "fmu", "--fmi", str(fmi), "--nominal", "--out", str(folder / f"{fmi}.fmu")]
        told = CliRunner().invoke(app, ["export", str(folder / "r.toml"), *options])
        assert told.exit_code == 0, told.output
    return {fmi: folder / f"{fmi}.fmu" for fmi in (2, 3)}


def faulty(samples: np.ndarray) -> np.ndarray:
    """With what an FMU can be told of faults, a gripper that is heard, and a fourth axis that turns."""
    made = samples.copy()
    made["fourth_position"] = np.sin(4e-3 * np.arange(len(made)))
    made["position"][400:403], made["torque"][500, 1] = np.nan, np.inf
    made["position"][600] += 0.4
    made["position_command"][700:740], made["position_command"][800:805, 2] = np.nan, 9.0
    made["flags"][900:904], made["flags"][1000:1100] = SampleFlag.BUS_FAULT, SampleFlag.BUS_FAULT
    made["torque"][1200, 0] = 1e7
    made["gripper"][1400:1600], made["gripper"][1600:] = Gripper.OPEN, Gripper.CLOSED
    return made


def recorded(robot: Robot, steps: int | None = None) -> np.ndarray:
    """Samples along the demo log with faults, counted and stamped as an FMU does."""
    samples = faulty(read_trace(LOG, robot).samples()[:steps])
    samples["sequence"], samples["torque_command"] = np.arange(len(samples)), np.nan
    set_stamp(samples, np.arange(len(samples)) * 1_000_000)
    return samples


def in_fmpy(path: Path, fmi: int, samples: np.ndarray, folder: Path) -> tuple[np.ndarray, np.ndarray, set[int]]:
    """Feed-forward torques (N, 3) N m, masses (N,) kg, and the sources that there were."""
    unit = Unit(path, fmi, folder)
    unit.begin()
    torque, mass, sources = np.zeros((len(samples), 3)), np.zeros(len(samples)), set()
    for k, sample in enumerate(samples):
        for name in ("position", "torque", "position_command"):
            unit.set(dict(zip(joints(name), sample[name], strict=True)))
        unit.set({"fourth_position": sample["fourth_position"]})
        unit.set_whole({"gripper": sample["gripper"], "flags": sample["flags"]})
        unit.step(k * PERIOD)
        torque[k], (mass[k],) = unit.get(*joints("feedforward")), unit.get("mass")
        sources.add(unit.whole("source"))
    unit.end()
    return torque, mass, sources


@pytest.mark.parametrize("fmi", [3, 2])
def test_the_demo_log_with_faults_comes_out_as_in_the_service(described, paths, tmp_path: Path, fmi: Any) -> None:
    assert validate_fmu(str(paths[fmi])) == []
    samples = recorded(described, STEPS)
    wanted = Estimator(described, PERIOD).run(samples)
    torque, mass, sources = in_fmpy(paths[fmi], fmi, samples, tmp_path / "unpacked")
    np.testing.assert_array_equal(torque, wanted.feedforward["torque"])
    assert mass[-1] == wanted.payload["mass"][-1]
    assert set(mass) == {0.0, *wanted.payload["mass"]}
    assert mass.max() > 0.5
    assert sources == {0, 1, 3}


def test_parameters_are_taken_and_checked_and_the_step_is_the_one_it_was_made_for(
    described, paths, tmp_path: Path
) -> None:
    unit = Unit(paths[3], 3, tmp_path / "unpacked")
    assert unit.get("coulomb_2") == [described.identified.coulomb_friction_nm.value[1]]
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


def test_what_was_never_identified_is_refused(described, tmp_path: Path) -> None:
    save_robot(described.model_copy(update={"identified": None}), tmp_path / "r.toml")
    told = CliRunner().invoke(
        app, ["export", str(tmp_path / "r.toml"), "--to", "fmu", "--out", str(tmp_path / "r.fmu")]
    )
    assert "r.toml: identified: missing" in str(told.exception)
    assert not (tmp_path / "r.fmu").exists()


def test_the_command_writes_sources_beside_the_library(paths) -> None:
    with zipfile.ZipFile(paths[2]) as archive:
        names = set(archive.namelist())
        if shutil.which("x86_64-w64-mingw32-gcc"):
            library = archive.read("binaries/win64/deltatwin.dll")
            assert library[:2] == b"MZ"
            assert b"fmi2DoStep" in library
    assert {"modelDescription.xml", "sources/deltatwin.c", "binaries/linux64/deltatwin.so"} <= names
