"""The exported code as the master loads it, in place of the estimator."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.ethercat.setpoints import Setpoints
from schemas.errors import DataError, RobotError, StorageError
from schemas.messages import FeedforwardSource
from schemas.robot import load_robot, save_robot
from service.codegen.library import Library
from service.estimator.estimator import Estimator
from service.feedforward_source import InCycle
from tests.known import PERIOD, make, robot
from tests.service.codegen.built import needs_compiler
from tests.service.codegen.compiled import compiled
from tests.service.codegen.disturbed import disturbed
from tests.service.codegen.test_twin import GROUPS, picked, with_effects

__all__ = ["make", "robot"]
pytestmark = needs_compiler


@pytest.fixture(scope="module")
def described(robot, tmp_path_factory):
    """A robot with gears and friction states, as a file."""
    path = tmp_path_factory.mktemp("robot") / "r.toml"
    save_robot(with_effects(robot, GROUPS["gears"]), path)
    return load_robot(path)


@pytest.fixture(scope="module")
def library(described, tmp_path_factory) -> Path:
    return compiled(described.folder / "r.toml", tmp_path_factory.mktemp("twin"), 1 / PERIOD, optimised="-O0")


def test_in_the_cycle_it_answers_as_the_estimator_to_the_bit(described, library, make) -> None:
    known = make(2.4, payload=picked, noise=0.25)
    samples = disturbed(known.samples)
    whole = (known.theta, known.theta_dot, known.theta_ddot)
    setpoints = Setpoints(*whole, np.zeros(len(known.theta), np.int64), begin=0)
    one, other = InCycle(Library(library, described, PERIOD)), InCycle(Estimator(described, PERIOD))
    answers = 0
    for n in range(len(samples)):
        number = min(n + 1, len(known.theta) - 1)
        found, wanted = (each(samples[n : n + 1], setpoints, number) for each in (one, other))
        np.testing.assert_array_equal(found, wanted)
        answers += found is not None
    assert answers > 1500
    assert one.summary() == other.summary()


def test_code_of_another_cycle_robot_or_file_is_refused(described, library, robot, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"libtwin\.so: made for a sample every 1000 us, not 500 us: .* --rate 2000"):
        Library(library, described, PERIOD / 2)
    with pytest.raises(RobotError, match=r"exported from another description than .*: export it again"):
        Library(library, robot, PERIOD)
    other = compiled(described.folder / "r.toml", tmp_path / "other", 1 / PERIOD, "--nominal", optimised="-O0")
    source = other.with_name("deltatwin.c")
    source.write_text(source.read_text().replace("1e-09", "2e-09"))
    with pytest.raises(StorageError, match=r"deltatwin\.c was changed after the export"):
        Library(other, described, PERIOD)
    text = tmp_path / "other" / "libtext.so"
    compiled(described.folder / "r.toml", tmp_path / "other", 1 / PERIOD, optimised="-O0")
    text.write_text("no library")
    with pytest.raises(StorageError, match=r"libtext\.so: not a library that this machine can load"):
        Library(text, described, PERIOD)
    compiled(described.folder / "r.toml", tmp_path / "slow", 100.0, optimised="-O0")
    stale = tmp_path / "other" / "libstale.so"
    stale.write_bytes((tmp_path / "slow" / "libtwin.so").read_bytes())
    with pytest.raises(StorageError, match=r"libstale\.so: compiled from other code than"):
        Library(stale, described, PERIOD)
    with pytest.raises(StorageError, match=r"twin\.json"):
        Library(described.folder / "libtwin.so", described, PERIOD)


def test_in_single_precision_it_is_near(described, make, tmp_path: Path) -> None:
    path = compiled(described.folder / "r.toml", tmp_path / "single", 1 / PERIOD, "--float32", optimised="-O0")
    samples = make(0.5).samples
    one, other = Library(path, described, PERIOD), Estimator(described, PERIOD)
    for n in range(len(samples)):
        one.step(samples[n : n + 1].tobytes())
        other.step(samples[n : n + 1].tobytes())
    assert one.feedforward["source"][0] == FeedforwardSource.COMMAND
    np.testing.assert_allclose(one.feedforward["torque"], other.feedforward["torque"], atol=0.5)
