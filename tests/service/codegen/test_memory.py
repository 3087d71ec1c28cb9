"""Static memory of the generated C: at most 64 KiB of every robot that comes along, as a controller has it."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from replay.demo import ROBOT
from schemas.robot import SHIPPED, EffectEntry, EffectParameter, FourthAxis, Robot, load_robot, save_robot
from service.cli.main import app
from service.codegen.layout import layout_of
from service.codegen.twin import in_c
from service.estimator import state
from service.estimator.named_effects import MAX_EFFECTS, pack_effects
from service.model.description import terms_of
from tests.service.codegen.built import COMPILER, FLAGS, needs_compiler
from tests.service.codegen.test_twin import with_effects
from tests.service.estimator.test_named_effects import FOUND

MOST = 65_536  # bytes
# Of the file beside its step: whether it is ready, and whether a look back is due; rounded up by the linker.
FLAGS_OF_ITS_OWN = 32
OF_THE_COMPILER = {"memcpy", "memset"}  # what gcc calls to assign a struct, on a machine without a C library too
ROBOTS = [*sorted(SHIPPED.glob("*.toml")), ROBOT]
AXES = {"three axes": None, "a fourth axis": FourthAxis(shaft_mass_kg=0.2)}
PERIODS = [1e-3, 0.125e-3]  # what is remembered grows with the rate


@cache
def all_at_once() -> tuple[str, ...]:
    """The whole catalogue, less what the online model has no record left for."""
    robot, kept = load_robot(ROBOT), list(FOUND)
    recorded = [name for name in kept if (_records(robot, [name]) >= 0).any()]
    for name in recorded[: len(recorded) - MAX_EFFECTS]:
        kept.remove(name)
    assert (_records(robot, kept) >= 0).all(), "not one more would fit"
    return tuple(kept)


def _records(robot: Robot, names: list[str]) -> np.ndarray:
    return pack_effects(terms_of(with_effects(robot, names)))["number"]


def laden(robot: Robot) -> Robot:
    return with_effects(robot, all_at_once())


def bytes_of(robot: Robot, period: float, single: bool = False) -> int:
    layout = layout_of(robot, state.settings(robot, period, 1))
    return in_c(layout, state.STEP, single=single).itemsize + FLAGS_OF_ITS_OWN


@pytest.mark.parametrize("effects", ["no effect", "all effects"])
@pytest.mark.parametrize("period", PERIODS)
@pytest.mark.parametrize("axes", AXES)
@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_every_robot_that_comes_along_fits(path: Path, axes: str, period: float, effects: str) -> None:
    robot = load_robot(path).model_copy(update={"fourth_axis": AXES[axes]})
    robot = robot if effects == "no effect" else laden(robot)
    assert bytes_of(robot, period) <= MOST
    assert bytes_of(robot, period, single=True) <= MOST


def late(robot: Robot, delay_s: float = 0.015) -> Robot:
    """With a torque that is reported late: 15 ms are 120 samples at 8 kHz."""
    delay = EffectEntry(name="torque_delay", joints=[1, 2, 3], parameters={"delay": EffectParameter(value=delay_s)})
    others = [one for one in robot.effect if one.name != delay.name]
    return robot.model_copy(update={"effect": [*others, delay]})


@pytest.mark.parametrize("delay_s", [0.007, -0.001])
def test_a_torque_that_is_reported_late_or_early_fits_at_8_khz_too(delay_s: float) -> None:
    robot = load_robot(ROBOT).model_copy(update={"fourth_axis": AXES["a fourth axis"]})
    assert bytes_of(late(laden(robot), delay_s), 0.125e-3) <= MOST


@needs_compiler
@pytest.mark.skipif(shutil.which("size") is None, reason="no size of binutils on this machine")
@pytest.mark.parametrize("axes", AXES)
@pytest.mark.parametrize("change", [laden, late])
def test_it_is_as_much_as_the_export_says_and_needs_math_alone(change, axes: str, tmp_path: Path) -> None:
    robot = change(load_robot(ROBOT).model_copy(update={"fourth_axis": AXES[axes]}))
    save_robot(robot, tmp_path / "robot.toml")
    arguments = ["export", str(tmp_path / "robot.toml"), "--to", "c", "--rate", "8000", "--out", str(tmp_path)]
    told = CliRunner().invoke(app, arguments)
    assert told.exit_code == 0, told.output
    subprocess.run([COMPILER or "gcc", "-O0", *FLAGS, "-c", "deltatwin.c", "-o", "t.o"], check=True, cwd=tmp_path)
    size = subprocess.run(["size", "t.o"], check=True, cwd=tmp_path, capture_output=True, text=True).stdout
    _, data, bss, *_ = map(int, size.splitlines()[1].split()[:3])
    names = subprocess.run(["nm", "-u", "t.o"], check=True, cwd=tmp_path, capture_output=True, text=True).stdout
    assert set(re.findall(r"U (\w+)", names)) - {"_GLOBAL_OFFSET_TABLE_"} <= OF_THE_COMPILER | set(dir(math)) | {"rint"}
    (said,) = re.findall(r"Static memory: (\d+) bytes", (tmp_path / "deltatwin.h").read_text())
    assert 0 <= data + bss - int(said) <= FLAGS_OF_ITS_OWN
    assert (data + bss > MOST) == (change is late)
    assert ("120 samples for a torque that is reported late" in told.stderr) == (change is late)
