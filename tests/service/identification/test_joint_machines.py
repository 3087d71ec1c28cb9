"""Axes of known truth: weight, motors that turn with two axes, friction that turns over slowly."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from schemas.axes_description import Axes, load_axes
from schemas.errors import DataError, RobotError
from schemas.words import percent
from service.cli.main import app
from service.identification import joint_machines
from tests.service.sines import sines
from tests.service.world import stub

run = CliRunner().invoke

PERIOD, SECONDS = 2e-3, 8.0
# axis 1 swings like a pendulum, its friction turns over 0.25 rad/s; motor 3 turns with axes 2 and 3; axis 3 may weigh
# something, and does not
DESCRIPTION = """name = "bench"
kind = "axes"
coupling = [[1, 0, 0], [0, 1, 0], [0, 1, 1]]
[[axis]]
[[axis]]
gravity = false
[[axis]]
"""
INERTIA, OFFSET = (0.4, 0.25, 0.06), (0.3, -0.2, 0.1)
SIN, COS = 3.0, -1.2
VISCOUS, COULOMB, WIDTH = (0.8, 0.5, 0.1), (1.5, 1.0, 0.2), 0.25
MOTOR_INERTIA, MOTOR_VISCOUS, MOTOR_COULOMB = 0.02, 0.3, 0.9
NOISE = 0.02
TOGETHER = "the model fits each log alone, but not all together"


def motion(seed: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """(N,) s and angle, speed, acceleration (N, 3) of sums of sines."""
    time = np.arange(round(SECONDS / PERIOD)) * PERIOD
    return time, sines(seed, time, ((1.1, 0.2), (0.35, 0.7), (0.1, 1.9)))


def torque_of(signals: list[np.ndarray]) -> np.ndarray:
    """(N, 3) N m at the joints, term by term."""
    q, v, a = signals
    torque = a * INERTIA + OFFSET + v * VISCOUS
    torque[:, 0] += SIN * np.sin(q[:, 0]) + COS * np.cos(q[:, 0]) + COULOMB[0] * np.tanh(v[:, 0] / WIDTH)
    torque[:, 1:] += COULOMB[1:] * np.sign(v[:, 1:])
    both, harder = v[:, 1] + v[:, 2], a[:, 1] + a[:, 2]
    shared = MOTOR_INERTIA * harder + MOTOR_VISCOUS * both + MOTOR_COULOMB * np.sign(both)
    torque[:, 1:] += shared[:, None]
    return torque


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the description and three logs, on the motors' side."""
    folder = tmp_path_factory.mktemp("bench")
    (folder / "bench.toml").write_text(DESCRIPTION)
    (folder / "columns.toml").write_text(
        'joints = 3\ntime = "t"\nposition = { name = "m{joint}", side = "motor", gear_ratio = 10 }\n'
        'torque = { name = "y{joint}", side = "motor", gear_ratio = 10 }\n'
    )
    for number in range(3):
        time, signals = motion(number)
        torque = torque_of(signals) + np.random.default_rng(9 + number).normal(0, NOISE, signals[0].shape)
        turned = signals[0] @ np.array([[1.0, 0, 0], [0, 1, 1], [0, 0, 1]])  # motor 3: axis 2 + axis 3
        at_motor = torque @ np.array([[1.0, 0, 0], [0, 1, 0], [0, -1, 1]])  # axis 2 feels motors 2 and 3
        table = np.column_stack([time, 10 * turned, at_motor / 10])
        header = "t," + ",".join(f"{name}{axis}" for name in "my" for axis in (1, 2, 3))
        np.savetxt(folder / f"log_{number}.csv", table, "%.10g", ",", header=header, comments="")
    return folder


@pytest.fixture(scope="module")
def found(bench: Path) -> Axes:
    """What `identify` writes of two of the logs."""
    arguments = ["identify", bench / "log_0.csv", bench / "log_1.csv", "--robot", bench / "bench.toml"]
    arguments += ["--columns", bench / "columns.toml", "--out", bench / "identified.toml"]
    result = run(app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert "gravity_si" in result.output
    axes = load_axes(bench / "identified.toml")
    assert isinstance(axes, Axes)
    return axes


def test_every_part_is_recovered(found: Axes) -> None:
    known = found.identified
    assert known is not None
    assert known.gravity_sin is not None
    assert known.gravity_cos is not None
    assert known.gravity_sin.value == pytest.approx([SIN, 0, 0], rel=0.01)
    assert known.gravity_cos.value == pytest.approx([COS, 0, 0], rel=0.01)
    assert known.gravity_sin.verdict == ["identifiable", "identifiable", "not identifiable"]
    assert known.inertia.value == pytest.approx(INERTIA, rel=0.02)
    assert known.offset.value == pytest.approx(OFFSET, abs=0.01)
    assert known.viscous_friction.value == pytest.approx(VISCOUS, rel=0.05)
    assert known.coulomb_friction.value == pytest.approx(COULOMB, rel=0.05)


def test_a_motor_of_two_axes_has_its_own_inertia_and_friction(found: Axes) -> None:
    known = found.identified
    assert known is not None
    for values, expected in (
        (known.motor_inertia, MOTOR_INERTIA),
        (known.motor_viscous_friction, MOTOR_VISCOUS),
        (known.motor_coulomb_friction, MOTOR_COULOMB),
    ):
        assert values is not None
        assert values.value == pytest.approx([0, 0, expected], rel=0.05)


def test_each_friction_turns_over_its_own_width(found: Axes) -> None:
    assert found.identified is not None
    widths = found.identified.friction_transition
    assert isinstance(widths, list)
    assert widths[0] == pytest.approx(WIDTH, rel=0.05)
    assert max(widths[1:]) < 0.02


def test_the_spread_shows_the_log_of_another_machine(bench: Path, tmp_path: Path) -> None:
    """One whose drives report half as much again: each of its parameters is."""
    header, *rows = (bench / "log_1.csv").read_text().splitlines()
    table = np.array([row.split(",") for row in rows], float)
    table[:, 4:] *= 1.5
    np.savetxt(tmp_path / "other.csv", table, "%.10g", ",", header=header, comments="")
    arguments = ["identify", bench / "log_0.csv", tmp_path / "other.csv", "--robot", bench / "bench.toml", "--spread"]
    arguments += ["--columns", bench / "columns.toml", "--out", tmp_path / "out.toml"]
    shown = run(app, [*map(str, arguments), "--json"], catch_exceptions=False)
    first, second = (one["parameters"] for one in json.loads(shown.stdout)["runs"])
    for name, value in (("inertia_1", INERTIA[0]), ("gravity_sin_1", SIN), ("f_c_2", COULOMB[1])):
        assert first[name] == pytest.approx(value, rel=0.05), name
        assert second[name] == pytest.approx(1.5 * value, rel=0.05), name
    told = run(app, list(map(str, arguments)), catch_exceptions=False).output
    assert "highest - lowest" in " ".join(told.split())


def test_evaluate_and_diagnose_take_what_was_found(bench: Path, found: Axes, tmp_path: Path) -> None:
    log = ["--columns", str(bench / "columns.toml")]
    shown = run(app, ["evaluate", str(bench / "log_2.csv"), "--robot", str(bench / "identified.toml"), "--json", *log])
    errors = json.loads(shown.stdout)["models"]["full"]["rms_nm"]
    assert max(errors) < 0.05, "torque of 1 to 4 N m, none of it seen by the fit"
    logs = [str(path) for path in sorted(bench.glob("log_*.csv"))]
    arguments = ["diagnose", *logs, "--robot", str(bench / "bench.toml"), "--out", str(tmp_path), *log]
    assert run(app, arguments, catch_exceptions=False).exit_code == 0
    document = json.loads((tmp_path / "diagnosis.json").read_text())
    assert document["effects"] == [], "the base model has it all"
    assert document["base"]["gravity_sin_1"]["value"] == pytest.approx(SIN, rel=0.01)
    assert document["base"]["transition_1"]["value"] == pytest.approx(WIDTH, rel=0.05)
    assert document["base"]["f_c_motor_3"]["value"] == pytest.approx(MOTOR_COULOMB, rel=0.05)


def test_a_part_of_a_log_is_no_second_log(bench: Path, tmp_path: Path) -> None:
    part = tmp_path / "part.csv"
    part.write_text("".join((bench / "log_0.csv").read_text().splitlines(keepends=True)[:2000]))
    arguments = ["identify", bench / "log_0.csv", part, "--robot", bench / "bench.toml", "--columns"]
    told = run(app, [str(given) for given in (*arguments, bench / "columns.toml", "--out", tmp_path / "out.toml")])
    assert isinstance(told.exception, DataError)
    assert str(told.exception) == f"{part}: the same motion and torque as {bench / 'log_0.csv'}; give it only once"
    assert not (tmp_path / "out.toml").exists()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("coupling = [[1, 0], [0, 1], [0, 1]]", "coupling: 3 rows of 3 numbers are needed"),
        ("coupling = [[1, 0, 0], [0, 1, 1], [0, 1, 1]]", "the motor angles do not determine every joint angle"),
        ('axis = [{ unit = "m", gravity = true }]', "the weight of a linear axis is constant"),
    ],
)
def test_what_cannot_be_is_one_line(tmp_path: Path, line: str, words: str) -> None:
    path = tmp_path / "axes.toml"
    path.write_text(f'name = "a"\nkind = "axes"\n{line}\n' + ("" if "axis" in line else "[[axis]]\n" * 3))
    with pytest.raises(RobotError, match=words) as told:
        load_axes(path)
    assert "\n" not in str(told.value)
    assert str(path) in str(told.value)


@pytest.mark.parametrize(
    ("noise", "alone", "worst", "told"),
    [
        (0.5, 1.5, 0.49, [f"{TOGETHER}; a.csv differs most (with each log fitted alone, the residual is 44 %"]),
        (0.5, 1.5, 0.51, ["b.csv: the model leaves 51 % of the torque of axis 1", "the model fits each log alone"]),
        (1.2, 1.85, 0.49, [f"{TOGETHER}; b.csv differs most (with each log fitted alone, the residual is 54 %"]),
        (1.2, 2.25, 0.49, []),  # 70 % of what is above the noise
        (1.7, 1.5, 0.49, []),  # hardly twice the noise
        (0.5, 1.95, 0.49, []),  # alone they leave much of it too
    ],
)
def test_logs_of_two_machines_and_a_model_that_is_none_are_told(monkeypatch, noise, alone, worst, told):
    """Two logs of two axes; what each sheds alone is summed over its axes."""
    monkeypatch.setattr(joint_machines, "_described_better", lambda fit: [])
    monkeypatch.setattr(joint_machines, "_much_left", lambda fit: [])
    residual = np.array([[3.1, 3.1], [4.0, 0.5]])
    fit = stub(
        residual=residual, torque=np.array([[10.0, 10.0], [4.0 / worst, 10.0]]), noise_floor=np.full(2, noise),
        alone=np.array([[alone, alone], [alone, 0.5]]),
    )  # fmt: skip
    found = joint_machines._warnings(fit, [stub(path=Path(name)) for name in ("a.csv", "b.csv")])
    assert len(found) == len(told)
    for line, words in zip(found, told, strict=True):
        assert line.startswith(words)


@pytest.mark.parametrize(("second", "told"), [(4.2, "axis 2"), (3.8, None)])
def test_an_axis_of_which_all_logs_leave_a_fifth_is_told(second: float, told: str | None) -> None:
    """One log alone may leave more: too little motion of it is no wrong model."""
    residual = np.array([[5.0, second], [1.0, second]])
    fit = stub(residual=residual, torque=np.array([[10.0, 20.0], [40.0, 20.0]]))
    found = joint_machines._much_left(fit)
    assert len(found) == (told is not None)
    assert all(line.startswith(f"the model leaves 21 % of the torque of {told} unexplained. ") for line in found)


def test_many_times_the_torque_is_no_percentage() -> None:
    fit = stub(residual=np.array([[13.4]]), torque=np.array([[1e-6]]))
    (found,) = joint_machines._much_left(fit)
    assert found.startswith("the model leaves 13000000 times the torque of axis 1 unexplained. ")


@pytest.mark.parametrize(("seconds", "enough"), [(3.9, False), (4.1, True)])
def test_two_blocks_a_parameter_and_axis_are_enough(monkeypatch, seconds, enough):
    """Half a second each, of the axis that moves most, over all logs; an axis without weight has four."""
    moving = np.stack([np.arange(100) < 10 * seconds, np.arange(100) < 3], axis=1)
    part = stub(period=0.05, moving=moving, torque=np.arange(200.0).reshape(100, 2))
    monkeypatch.setattr(joint_machines, "segments_of", lambda traces: [[part] for _ in traces])
    monkeypatch.setattr(joint_machines, "thin", lambda segment: segment)
    monkeypatch.setattr(joint_machines, "written", lambda *parts: parts[1])
    monkeypatch.setattr(joint_machines, "_commanded", lambda axes, fit, traces: [])
    monkeypatch.setattr(joint_machines, "_warnings", lambda fit, traces: [])
    made = Axes.model_validate({"name": "two", "kind": "axes", "axis": [{"gravity": False}] * 2})
    logs: list[Any] = [stub(name="a", path=Path("a.csv")), stub(name="b", path=Path("b.csv"))]
    found = stub(fitted=stub(hypothesis=stub(base=None)))
    asked = []
    monkeypatch.setattr(
        joint_machines, "fit_to", lambda robot, recordings, names: asked.append((recordings, names)) or found
    )
    if enough:
        assert joint_machines.identify_axes(made, logs) is found
        ((recordings, names),) = asked
        assert [(one.trace, one.name) for one in recordings] == [(0, "a"), (1, "b")]
        assert names == ["a.csv", "b.csv"]
    else:
        with pytest.raises(
            DataError, match=r"^a\.csv, b\.csv: too little motion, at most 3\.9 s per axis; at least 4 s"
        ):
            joint_machines.identify_axes(made, logs)


@pytest.mark.parametrize(("described", "better"), [(0.55, True), (0.65, False)])
def test_the_masses_of_a_description_are_told_to_be_better_where_they_are(monkeypatch, described, better):
    """By what both leave of stretches left out, of the torque: a twentieth less."""

    class Arm:
        start = np.array([9.0, 2.0, 3.0])

        def __init__(self, *links: bool) -> None:
            self.links = np.array(links)

    asked = []

    def holding(columns, values):
        asked.append((columns.tolist(), values.tolist()))
        return "described"

    monkeypatch.setattr(joint_machines, "Split", stub(of=lambda problem: "split"))
    monkeypatch.setattr(joint_machines, "held_out", lambda fitted, split: fitted)
    loss = {"described": np.array([described, 3.0]), "found": np.array([1.0, 3.0])}
    monkeypatch.setattr(
        joint_machines, "block_loss", lambda fitted, split: loss["found" if fitted != "described" else fitted]
    )
    target = [np.array([10.0]), np.array([10.0, 10.0, 10.0])]

    def told(mechanism):
        problem = stub(recordings=[stub(mechanism=mechanism)], target=target, select=lambda number, values: values)
        return joint_machines._described_better(stub(problem=problem, fitted=stub(holding=holding)))

    assert told(Arm(False, False, False)) == []
    found = told(Arm(False, True, True))
    assert asked == [([1, 2], [2.0, 3.0])]
    assert len(found) == better
    if better:
        share = np.sqrt((3 + described) / 400)
        assert found[0].startswith("on held-out stretches the masses of the URDF")
        assert f"leave {percent(share, 1)} of the torque unexplained, the identified ones 10.0 %" in found[0]


def test_a_single_log_is_said_to_be_one(monkeypatch):
    monkeypatch.setattr(joint_machines, "_described_better", lambda fit: ["better"])
    fit = stub(residual=np.ones((1, 2)), torque=np.full((1, 2), 9.0), noise_floor=np.ones(2), alone=np.ones((1, 2)))
    assert [line[:8] for line in joint_machines._warnings(fit, [stub(path=Path("a.csv"))])] == ["better", "a.csv: a"]
