"""One servo on several rigs, simulated by closed forms: what is its own and what a rig adds."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from schemas.axes_description import Axes, load_axes
from schemas.errors import RobotError
from service.cli.main import app
from service.identification.rigs import Rig, of_logs, on_rig
from tests.service.sines import sines

PERIOD, SECONDS, G = 4e-3, 10.0, 9.80665
ARMATURE, VISCOUS, COULOMB, HANGS = 0.004, 0.05, 0.12, 0.3  # kg m^2, N m s/rad, N m, rad
RIGS = ((0.5, 0.1, 0.0), (1.0, 0.15, 0.002))  # kg, m, kg m^2 about the centre


def log(path: Path, seed: int, mass: float, length: float, inertia: float, unit: str = "rad") -> Path:
    """A servo that swings a pendulum which hangs at `HANGS`."""
    time = np.arange(round(SECONDS / PERIOD)) * PERIOD
    q, v, a = (part[:, 0] for part in sines(seed, time, ((1.1, 0.2), (0.5, 0.8), (0.12, 2.3))))
    torque = (ARMATURE + mass * length**2 + inertia) * a + mass * G * length * np.sin(q - HANGS)
    torque += VISCOUS * v + COULOMB * np.sign(v) + np.random.default_rng(seed).normal(0, 0.01, len(q))
    name = "nm" if unit == "rad" else "n"
    header = f"time_s,position_1_{unit},torque_1_{name}"
    np.savetxt(path, np.column_stack([time, q, torque]), "%.10g", ",", header=header, comments="")
    return path


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rigs")
    (folder / "servo.toml").write_text('name = "servo"\nkind = "axes"\n[[axis]]\n')
    for number, rig in enumerate(RIGS):
        log(folder / f"rig_{number}.csv", number + 1, *rig)
    return folder


def identify(folder: Path, *rigs: str) -> str:
    logs = [str(folder / f"rig_{number}.csv") for number in range(len(RIGS))]
    given = [word for rig in rigs for word in ("--rig", str(folder / rig))]
    words = ["identify", *logs, *given, "--robot", str(folder / "servo.toml"), "--out", str(folder / "found.toml")]
    return CliRunner().invoke(app, words, catch_exceptions=False).output


def test_the_servo_is_told_apart_from_what_it_moves(bench: Path) -> None:
    known = [
        f"rig_{number}.csv:mass={mass},length={length},inertia={inertia},angle={HANGS}"
        for number, (mass, length, inertia) in enumerate(RIGS)
    ]
    text = identify(bench, *known)
    assert "two loads" not in text
    robot = load_axes(bench / "found.toml")
    assert isinstance(robot, Axes)
    found = robot.identified
    assert found is not None
    assert found.inertia.value[0] == pytest.approx(ARMATURE, rel=0.05)
    assert found.coulomb_friction.value[0] == pytest.approx(COULOMB, rel=0.05)
    assert found.viscous_friction.value[0] == pytest.approx(VISCOUS, rel=0.05)
    if found.gravity_sin is not None:
        assert found.gravity_sin.value[0] == pytest.approx(0.0, abs=0.01), "all weight is the rigs'"
    assert "two loads" in identify(bench), "without what is known, no one model fits both"


def test_what_a_rig_adds_is_on_its_axis_alone() -> None:
    axes = Axes.model_validate({"name": "two", "kind": "axes", "axis": [{"gear_ratio": 5.0}, {"unit": "m"}]})
    q, v, a = np.random.default_rng(0).uniform(-1, 1, (3, 20, 2))
    turning = on_rig(axes, Rig(mass=2.0, length=0.5, inertia=0.1, angle=0.2, axis=1), "a.csv")
    expected = np.stack([0.6 * a[:, 0] + 2.0 * G * 0.5 * np.sin(q[:, 0] - 0.2), 0 * a[:, 1]], axis=1)
    np.testing.assert_allclose(turning.rigid(q, v, a).known, expected)
    linear = on_rig(axes, Rig(mass=2.0, axis=2), "a.csv")
    np.testing.assert_allclose(linear.rigid(q, v, a).known, np.stack([0 * a[:, 0], 2.0 * a[:, 1]], axis=1))
    level = Axes.model_validate({"name": "level", "kind": "axes", "axis": [{"gravity": False}]})
    flat = on_rig(level, Rig(mass=2.0, length=0.5), "a.csv").rigid(q[:, :1], v[:, :1], a[:, :1])
    np.testing.assert_allclose(flat.known, 0.5 * a[:, :1])
    assert list(turning.coefficients) == list(linear.coefficients)
    np.testing.assert_array_equal(turning.gear_ratio, [5.0, 1.0])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("mass=1", "log and rig as log.csv:mass=0.5"),
        ("a.csv:weight=1", "keys: mass, length, inertia, angle, axis"),
        ("a.csv:mass=heavy", "mass: 'heavy' is not a number"),
        ("a.csv:mass=-1", "mass: -1 is not possible"),
        ("a.csv:mass=nan", "mass: nan is not possible"),
        ("a.csv:mass=1,axis=1.5", "axis: 1.5 is not the number of an axis"),
    ],
)
def test_a_rig_that_cannot_be_read_is_refused_with_what_is_wrong(text: str, said: str) -> None:
    with pytest.raises(RobotError, match="--rig") as refused:
        Rig.read(text)
    assert said in str(refused.value)


def test_a_rig_that_cannot_be_is_refused(bench: Path) -> None:
    one, two = (Axes.model_validate({"name": "m", "kind": "axes", "axis": [{}] * count}) for count in (1, 2))
    level = Axes.model_validate({"name": "m", "kind": "axes", "axis": [{"unit": "m"}]})
    for axes, rig, said in (
        (two, Rig(mass=1.0, length=1.0), "say which, such as axis=1"),
        (one, Rig(mass=1.0, length=1.0, axis=3), "axis=3: m has 1"),
        (one, Rig(mass=1.0), "give length or inertia"),
        (level, Rig(mass=1.0, length=0.1), "is linear"),
    ):
        with pytest.raises(RobotError, match=said):
            on_rig(axes, rig, "a.csv")
    with pytest.raises(RobotError, match=r"b.csv: this log is not among those to identify: a.csv"):
        of_logs([("b.csv", Rig())], ["a.csv"])
    with pytest.raises(RobotError, match="given twice"):
        of_logs([("a.csv", Rig()), ("a.csv", Rig())], ["a.csv"])
    assert Rig.read("C:\\a.csv:mass=1,angle=-0.5") == ("C:\\a.csv", Rig(mass=1.0, angle=-0.5))
    assert math.isclose(on_rig(one, Rig(mass=1.0, length=0.2), "a.csv").inertia, 0.04)
    with pytest.raises(RobotError, match="axis=2: servo has 1"):
        identify(bench, "rig_0.csv:mass=1,length=0.1,axis=2")
