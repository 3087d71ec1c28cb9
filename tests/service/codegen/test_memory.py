"""Static memory of the generated C: at most 64 KiB of every robot that comes along, as a controller has it."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from replay.demo import ROBOT
from schemas.robot import SHIPPED, FourthAxis, load_robot
from service.codegen.layout import layout_of
from service.codegen.twin import in_c, to_c
from service.estimator import state
from tests.service.codegen.built import COMPILER, FLAGS, needs_compiler

MOST = 65_536  # bytes
# Of the file beside its step: whether it is ready, and whether a look back is due; rounded up by the linker.
FLAGS_OF_ITS_OWN = 32
ROBOTS = [*sorted(SHIPPED.glob("*.toml")), ROBOT]
AXES = {"three axes": None, "a fourth axis": FourthAxis(shaft_mass_kg=0.2)}


@pytest.mark.parametrize("period", [4e-3, 1e-3, 0.25e-3])
@pytest.mark.parametrize("axes", AXES)
@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_every_robot_that_comes_along_fits(path: Path, axes: str, period: float) -> None:
    robot = load_robot(path).model_copy(update={"fourth_axis": AXES[axes]})
    layout = layout_of(robot, state.settings(robot, period, 1))
    assert in_c(layout, state.STEP).itemsize + FLAGS_OF_ITS_OWN <= MOST
    assert in_c(layout, state.STEP, single=True).itemsize + FLAGS_OF_ITS_OWN <= MOST


@needs_compiler
@pytest.mark.skipif(shutil.which("size") is None, reason="no size of binutils on this machine")
@pytest.mark.parametrize("axes", AXES)
def test_it_is_as_much_as_the_export_says(axes: str, tmp_path: Path) -> None:
    robot = load_robot(ROBOT).model_copy(update={"fourth_axis": AXES[axes]})
    twin = to_c(robot, 0.25e-3, nominal=True)
    (tmp_path / "deltatwin.h").write_text(twin.header)
    (tmp_path / "deltatwin.c").write_text(twin.source)
    subprocess.run([COMPILER or "gcc", "-O0", *FLAGS, "-c", "deltatwin.c", "-o", "t.o"], check=True, cwd=tmp_path)
    told = subprocess.run(["size", "t.o"], check=True, cwd=tmp_path, capture_output=True, text=True).stdout
    _, data, bss, *_ = map(int, told.splitlines()[1].split()[:3])
    assert 0 <= data + bss - twin.static_bytes <= FLAGS_OF_ITS_OWN
