"""C in single precision: what it says of its own error, and its text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.trace import read_trace
from replay.demo import LOG, ROBOT
from schemas.robot import load_robot
from service.cli.main import app
from service.codegen.float32 import ERROR, MASS_KG, TORQUE_MOST_NM, TORQUE_RMS_NM, in_single
from tests.known import PERIOD
from tests.service.codegen.built import Built, expected, needs_compiler
from tests.service.codegen.disturbed import disturbed
from tests.service.codegen.test_twin import GROUPS, with_effects


@needs_compiler
@pytest.mark.parametrize("group", ["none", "gears"])
def test_its_stated_error_holds_on_the_demo_log(tmp_path: Path, group: str) -> None:
    described = with_effects(load_robot(ROBOT), GROUPS.get(group, ()))
    built = Built(described, PERIOD, tmp_path, "-O0", single=True)
    samples = disturbed(read_trace(LOG, described).samples()[:6000])
    assert built.init() == 0
    found, wanted = built.run(samples), expected(built, samples)
    off = np.abs(found["feedforward"]["torque"].astype(float) - wanted["feedforward"]["torque"])
    assert np.sqrt(np.mean(off**2)) <= TORQUE_RMS_NM
    assert np.quantile(off, 0.999) <= TORQUE_MOST_NM
    numbers, one, other = np.intersect1d(
        found["payload"]["sequence"], wanted["payload"]["sequence"], return_indices=True
    )
    masses = [found["payload"][one], wanted["payload"][other]]
    trusted = (masses[0]["trusted"] != 0) & (masses[1]["trusted"] != 0)
    assert len(numbers) > 4000
    assert trusted.any()
    assert np.abs(masses[0]["mass"] - masses[1]["mass"])[trusted].max() <= MASS_KG


@needs_compiler
def test_nothing_in_it_is_of_double_precision(tmp_path: Path) -> None:
    told = CliRunner().invoke(
        app, ["export", str(ROBOT), "--to", "c", "--float32", "--nominal", "--out", str(tmp_path)]
    )
    assert told.exit_code == 0, told.output
    assert ERROR in told.output
    header, source = ((tmp_path / f"deltatwin.{ending}").read_text() for ending in "hc")
    assert ERROR in header
    assert "double" not in source


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--to", "st", "--float32"), "--float32: only for --to c, not for st"),
        (("--to", "mjcf", "--rate", "500"), "--rate: only for --to c or fmu or st, not for mjcf"),
        (("--to", "c", "--log", "a.csv"), "--log: only for --to sheet, not for c"),
        (("--to", "c", "--fmi", "3"), "--fmi: only for --to fmu, not for c"),
    ],
)
def test_an_option_of_another_format_is_wrong_usage(tmp_path: Path, options: tuple[str, ...], said: str) -> None:
    told = CliRunner().invoke(app, ["export", str(ROBOT), *options, "--out", str(tmp_path / "t")])
    assert told.exit_code == 2
    assert said in told.output
    assert not (tmp_path / "t").exists()


def test_comments_names_and_whole_numbers_stay() -> None:
    text = "/* 1.5 double */ double a_1 = 2.0 * sqrt(1e-09) + rint(x2) + 3; double rint_of(double v);"
    assert in_single(text) == (
        "/* 1.5 double */ float a_1 = 2.0F * sqrtf(1e-09F) + rintf(x2) + 3; float rint_of(float v);"
    )
