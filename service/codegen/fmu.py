"""The twin as a Functional Mock-up Unit for co-simulation, FMI 3.0 or 2.0 (fmi-standard.org): one sample a step.

The FMU holds the generated C, its sources beside the library, and what FMI calls round it. As its state is static, a
process has one instance of it at a time.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import uuid
import zipfile
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from schemas.files import whole
from schemas.robot import Robot
from service.codegen import tunable
from service.codegen.source import CodegenError
from service.codegen.twin import Twin, said, template, to_c
from service.estimator import state

Fmi = Literal[2, 3]
FLAGS = ("-O2", "-std=c99", "-ffp-contract=off", "-shared")
# compiler, folder of the library by FMI version, ending, what else it takes; the first is needed, others where they are
TARGETS = (
    ("gcc", {3: "x86_64-linux", 2: "linux64"}, "so", ("-fPIC", "-fvisibility=hidden")),
    ("x86_64-w64-mingw32-gcc", {3: "x86_64-windows", 2: "win64"}, "dll", ("-static-libgcc",)),
)
UNITS = {
    "rad": 'rad="1"', "N.m": 'kg="1" m="2" s="-2"', "N.m/s": 'kg="1" m="2" s="-3"', "N.m.s/rad": 'kg="1" m="2" s="-1"',
    "kg": 'kg="1"', "s": 's="1"',
}  # fmt: skip
_UNIT_OF = {"N m": "N.m", "N m/s": "N.m/s", "N m s/rad": "N.m.s/rad", "-": ""}
# What FMI asks for and a unit without events, derivatives or states of its own answers at once.
NOTHING_TO_DO = {
    3: ("SetDebugLogging", "EnterInitializationMode", "Terminate", "EnterConfigurationMode", "ExitConfigurationMode",
        "EnterStepMode", "EnterEventMode"),
    2: ("SetDebugLogging", "SetupExperiment", "EnterInitializationMode", "Terminate"),
}  # fmt: skip
_KINDS_3 = ("Float32", "Int8", "UInt8", "Int16", "UInt16", "UInt32", "Int64", "UInt64", "Boolean", "String", "Binary")
_STATES = ("GetFMU{0}", "SetFMU{0}", "FreeFMU{0}", "SerializedFMU{0}Size", "SerializeFMU{0}", "D{1}erializeFMU{0}")
NOT_THERE = {
    3: (
        *(f"{way}{kind}" for kind in (*_KINDS_3, "Clock", "IntervalDecimal", "IntervalFraction", "ShiftDecimal",
          "ShiftFraction") for way in ("Get", "Set")),
        *(one.format("State", "es") for one in _STATES),
        "GetNumberOfVariableDependencies", "GetVariableDependencies", "GetDirectionalDerivative",
        "GetAdjointDerivative", "EvaluateDiscreteStates", "UpdateDiscreteStates", "EnterContinuousTimeMode",
        "CompletedIntegratorStep", "SetTime", "SetContinuousStates", "GetContinuousStateDerivatives",
        "GetEventIndicators", "GetContinuousStates", "GetNominalsOfContinuousStates", "GetNumberOfEventIndicators",
        "GetNumberOfContinuousStates", "GetOutputDerivatives", "ActivateModelPartition",
    ),
    2: (
        "GetBoolean", "SetBoolean", "GetString", "SetString", "GetDirectionalDerivative", "SetRealInputDerivatives",
        "GetRealOutputDerivatives", "CancelStep", "GetStatus", "GetRealStatus", "GetIntegerStatus",
        "GetBooleanStatus", "GetStringStatus", *(one.format("state", "eS") for one in _STATES),
    ),
}  # fmt: skip


class Variable(NamedTuple):
    """place: in C. low, high: of a parameter."""

    name: str
    reference: int
    causality: str
    variability: str
    place: str
    unit: str
    meaning: str
    start: str = "0"
    is_real: bool = True
    low: str | None = None
    high: str | None = None


def write_fmu(robot: Robot, period: float, fmi: Fmi, out: Path, name: str, nominal: bool = False) -> Twin:
    """Write the FMU of `robot` at a sample every `period` s.

    Raises:
        RobotError, CodegenError: as `to_c`; or there is no C compiler here. StorageError: it cannot be written.
    """
    if shutil.which(TARGETS[0][0]) is None:
        raise CodegenError(f"an FMU holds compiled code: {TARGETS[0][0]} is not installed")
    twin, found = to_c(robot, period, name, nominal), variables(robot, period)
    known: dict[str, Any] = {
        "name": name, "macro": name.upper(), "fmi": fmi, "variables": found, "time_reference": len(found),
        "settable": sum(one.causality != "output" for one in found),
        "nothing_to_do": NOTHING_TO_DO[fmi], "not_there": NOT_THERE[fmi], "units": UNITS, "period": repr(period),
        "robot": said(robot.name), "version": version("deltatwin"),
        "token": "{" + str(uuid.uuid5(uuid.NAMESPACE_URL, twin.digest)) + "}",
    }  # fmt: skip
    sources = {f"{name}.h": twin.header, f"{name}.c": twin.source, "fmu.c": template("fmu.c").render(known)}
    with tempfile.TemporaryDirectory() as folder, whole(out) as partial, zipfile.ZipFile(partial, "w", 8) as archive:
        archive.writestr("modelDescription.xml", template("fmu.xml").render(known))
        for file, text in sources.items():
            (Path(folder) / file).write_text(text, encoding="utf-8")
            archive.writestr(f"sources/{file}", text)
        for compiler, places, ending, more in TARGETS:
            if shutil.which(compiler):
                library = Path(folder) / f"{name}.{ending}"
                _compile([compiler, *FLAGS, *more, f"{name}.c", "fmu.c", "-o", library.name, "-lm"], Path(folder))
                archive.write(library, f"binaries/{places[fmi]}/{library.name}")
    return twin


def _compile(command: list[str], folder: Path) -> None:
    made = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if made.returncode:
        raise CodegenError(f"{command[0]}: {made.stderr.strip().splitlines()[0] if made.stderr else made.returncode}")


def variables(robot: Robot, period: float) -> list[Variable]:
    """Inputs, then parameters, then outputs; each joint's a variable of its own.

    Raises:
        RobotError: an effect that is not known, or not described in full.
    """
    inputs = [
        ("position", "sample.position", "rad", "joint position, positive turns the active link down", "0"),
        ("torque", "sample.torque", "N.m", "joint torque as reported", "0"),
        (
            "position_command",
            "sample.position_command",
            "rad",
            "command; a value beyond the joint's range means none",
            "1e9",
        ),
    ]
    found: list[Variable] = []

    def add(name: str, causality: str, variability: str, place: str, unit: str, meaning: str, **more: Any) -> None:
        found.append(Variable(name, len(found), causality, variability, place, unit, meaning, **more))

    for name, place, unit, meaning, start in inputs:
        for i in range(3):
            add(f"{name}_{i + 1}", "input", "continuous", f"{place}[{i}]", unit, meaning, start=start)
    if robot.fourth_axis is not None:
        add("fourth_position", "input", "continuous", "sample.fourth_position", "rad", "angle of the fourth axis")
    for name, meaning in (("gripper", "0 unknown, 1 open, 2 closed"), ("flags", "known faults of the sample, bits")):
        add(name, "input", "discrete", f"sample.{name}", "", meaning, is_real=False)
    settings = state.settings(robot, period, 1)
    for one in tunable.LOADABLE:
        for at in np.ndindex(tunable.shape(one)):
            name = "_".join([one.name, *(str(n + 1) for n in at)])
            place = f"parameters.{one.name}" + "".join(f"[{n}]" for n in at)
            value = repr(float(settings[one.name][0][at]))
            unit, low, high = _UNIT_OF.get(one.unit, one.unit), repr(one.low), repr(one.high)
            add(name, "parameter", "fixed", place, unit, one.meaning, start=value, low=low, high=high)
    for name, place, unit, meaning in (
        ("feedforward", "answer.torque", "N.m", "torque for the drive"),
        ("error", "error.full", "N.m", "reported torque minus that of the fullest model, a fixed lag ago"),
    ):
        for i in range(3):
            add(f"{name}_{i + 1}", "output", "discrete", f"{place}[{i}]", unit, meaning)
    add("mass", "output", "discrete", "payload.mass", "kg", "payload, a fixed lag ago")
    add("mass_std_dev", "output", "discrete", "payload.std_dev", "kg", "its standard deviation")
    for name, place, meaning in (
        ("source", "answer.source", "0 estimate, 1 command, 2 reference, 3 none"),
        ("answer_flags", "answer.flags", "bits of the sample's and the answer's state"),
        ("mass_trusted", "payload.trusted", "1 if the mass may be used"),
        ("mass_event", "payload.event", "1 pick, 2 release"),
    ):
        add(name, "output", "discrete", place, "", meaning, is_real=False)
    return found
