"""`deltatwin rollout` on logs whose robot is known, and on logs and descriptions that are wrong."""

from __future__ import annotations

import itertools
import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.data_frames import pl
from drivers.trace import read_trace
from schemas.diagnosis import named_joints
from schemas.errors import DataError
from schemas.fitted import JointParameter
from schemas.robot import Robot, save_robot
from service.cli.main import app
from service.rollout.gap import PLAIN, Rollout, check_sign, cut_up, plain, rollout
from service.rollout.rollout_page import document, sentences
from tests.service.rollout.test_kernel import effect, identified, recorded
from tests.service.subject import Band
from tests.service.world import PERIOD, ROBOT

NOISE, ENCODER = 0.3, 2e-5  # N m, rad
runner = CliRunner()


def log(folder: Path, robot: Robot, turned: tuple[int, ...] = (), seconds: float = 3.0, hole: bool = False) -> Path:
    """A CSV of a motion in closed form; `turned`: joints whose torque has the wrong sign."""
    part = recorded(robot, seconds)
    random = np.random.default_rng(5)
    torque = part.torque + NOISE * random.standard_normal(part.torque.shape)
    torque[:, list(turned)] *= -1.0
    position = part.theta + ENCODER * random.standard_normal(part.theta.shape)
    columns = {"time_s": part.time}
    columns |= {f"position_{j + 1}_rad": position[:, j] for j in range(3)}
    columns |= {f"torque_{j + 1}_nm": torque[:, j] for j in range(3)}
    table = pl.DataFrame(columns)
    if hole:
        table = pl.concat([table[:1200], table[1500:]])
    path = folder / "log.csv"
    table.write_csv(path)
    return path


def run(path: Path, **robots: Robot) -> Rollout:
    return rollout(robots, cut_up(robots, [read_trace(path, ROBOT)]))


def test_the_right_model_comes_down_to_the_floor_and_the_wrong_one_does_not(tmp_path: Path) -> None:
    truth = identified(effect("stribeck_friction"))
    found = run(log(tmp_path, truth), plain=plain(ROBOT), identified=identified(), corrected=truth)
    drawn, known, corrected = found.deviations
    assert drawn.platform_mm > known.platform_mm > 5 * corrected.platform_mm
    assert corrected.platform_mm < 1.3 * found.floor.platform_mm
    assert (corrected.joint_mrad < 1.5 * found.floor.joint_mrad).all()
    assert corrected.growth_mm[0] < 0.1 * corrected.growth_mm[-1]
    assert len(found.cuts.runs) == 13
    assert found.floor.path_mm > 100


def test_no_window_spans_a_gap(tmp_path: Path) -> None:
    whole, broken = (run(log(tmp_path, identified(), hole=hole), identified=identified()) for hole in (False, True))
    assert len(whole.cuts.runs) == 13
    assert len(broken.cuts.runs) == 10  # 4 of 1 s and 6 of 1.3 s; in one piece it would be 12
    assert broken.deviations[0].platform_mm < 1.5 * broken.floor.platform_mm
    assert whole.cuts.interruptions == []
    assert (whole.cuts.lost, broken.cuts.lost) == (0, 3)
    said = sentences(document(broken, {"identified": identified()}, ["log"]))
    assert "3 windows lost for this reason: log at 1.199 to 1.500 s." in " ".join(said)


def test_where_the_model_runs_away_without_noise_there_is_no_floor_and_no_error(tmp_path: Path) -> None:
    robots = {"identified": identified()}
    path = log(tmp_path, identified(), (0, 1, 2))
    found = rollout(robots, cut_up(robots, [read_trace(path, ROBOT)], horizon=1.0))
    assert not found.deviations[0].good.all()
    assert not found.floor.good.all()


@pytest.mark.parametrize("commands", [[], ["--commands"]])
@pytest.mark.parametrize(("turned", "said"), [((0, 1, 2), "joints 1, 2 and 3"), ((1,), "joint 2")])
def test_a_torque_of_the_wrong_sign_is_named(
    tmp_path: Path, turned: tuple[int, ...], said: str, commands: list[str]
) -> None:
    path = log(tmp_path, identified(), turned)
    save_robot(identified(), tmp_path / "r.toml")
    told = runner.invoke(app, ["rollout", str(path), "--robot", str(tmp_path / "r.toml"), *commands])
    assert isinstance(told.exception, DataError)
    assert f"{path}: the sign of the torque of " in str(told.exception)
    assert f"the sign of the torque of {said} is wrong: the simulated robot runs away" in str(told.exception)


@pytest.mark.parametrize(
    "turned", [turned for many in (1, 2, 3) for turned in itertools.combinations(range(3), many)], ids=str
)
def test_whichever_torque_is_turned_round_the_rest_is_as_it_should_be(tmp_path: Path, turned: tuple[int, ...]) -> None:
    robots = {"known": identified()}
    cuts = cut_up(robots, [read_trace(log(tmp_path, identified(), turned), ROBOT)])
    with pytest.raises(DataError, match=f"torque of {named_joints([j + 1 for j in turned])} is wrong") as told:
        check_sign(identified(), cuts, rollout(robots, cuts))
    off = re.search(r"does not \(off by ([\d.]+) mm\)", str(told.value))
    assert off is not None
    assert float(off[1]) < 2.0  # with the right signs it is at the floor, 1 mm


def test_the_command_writes_what_it_says(tmp_path: Path) -> None:
    truth = identified(effect("tool_mass"))
    names = {"identified": identified(), "corrected": truth}
    for name, robot in names.items():
        save_robot(robot, tmp_path / f"{name}.toml")
    trace = log(tmp_path, truth)
    given = [argument for name in names for argument in ("--robot", str(tmp_path / f"{name}.toml"))]
    own = tmp_path / "own.py"
    own.write_text(
        "from service.model.effects.base import Effect\n"
        "class Own(Effect):\n    name, settles, regressors = 'own', 'another log', None\n"
    )
    given += ["--effects", str(own), "--out", str(tmp_path / "out")]
    told = runner.invoke(app, ["rollout", str(trace), *given])
    assert told.exit_code == 0, told.output
    export = f"deltatwin export {tmp_path / 'corrected.toml'} --effects {own} --to mjcf --out robot.xml"
    assert f"next: {export}\n" in told.output
    written = json.loads((tmp_path / "out" / "rollout.json").read_text())
    assert written["schema"] == "deltatwin.rollout/1"
    assert [entry["robot"] for entry in written["robots"]] == [PLAIN, "identified", "corrected"]
    off = [entry["platform_mm"] for entry in written["robots"]]
    assert f"from {off[1]:.3g} mm (identified) to {off[2]:.3g} mm (corrected)" in told.output
    assert sum(entry["windows"] for entry in written["regimes"] if entry["joint"] == 1) == written["windows"]
    page = (tmp_path / "out" / "rollout.html").read_text()
    assert f"{off[2]:.3f}" in page
    assert "corrected" in page


def made_on_logs(robot: Robot, noise: float = NOISE, left: float = 0.05) -> Robot:
    """With what `identify` writes beside the figures. noise: N m a sample; left: N m rms above it, in the band."""
    assert robot.identified is not None
    told = {"torque_noise_nm": JointParameter(value=[noise] * 3), "model_error_nm": JointParameter(value=[left] * 3)}
    return robot.model_copy(update={"identified": robot.identified.model_copy(update=told)})


def test_a_log_of_another_robot_is_told(tmp_path: Path) -> None:
    known = made_on_logs(identified())

    def said(truth: Robot, **robots: Robot) -> tuple[str, list]:
        result = document(run(log(tmp_path, truth), **robots), robots, ["log"])
        return " ".join(sentences(result)), result.over_identified or []

    words, own = said(identified(), plain=plain(ROBOT), known=known)
    assert "another robot" not in words
    assert "not identified on logs" not in words
    usual = np.hypot(NOISE * Band.of(PERIOD).white_share ** 0.5, 0.05)
    pushed = said(identified(effect("torque_offset")), known=known)[1]
    np.testing.assert_allclose(np.square(pushed) - np.square(own), [0.0, 0.0, (1.3 / usual) ** 2], rtol=0.05, atol=0.1)
    heavier = ROBOT.mass.model_copy(update={"active_link": 1.2 * ROBOT.mass.active_link})
    words = said(identified().model_copy(update={"mass": heavier}), known=known)[0]
    assert words.startswith("known leaves ")
    assert "in another unit, or the robot has changed since. In the simulator" in words
    words, none = said(identified(), known=identified())
    assert none == []
    assert "known was not identified on logs: these logs may be of another robot." in words


def test_what_figures_do_not_say_of_a_robot_is_told(tmp_path: Path) -> None:
    known = identified()
    result = document(run(log(tmp_path, known), known=known), {"known": known}, ["log"])

    def said(**changed: object) -> list[str]:
        return sentences(result.model_copy(update={"robots": [result.robots[0].model_copy(update=changed)]}))

    still, away = (
        "known predicts the motion no better than a robot at rest.",
        "known leaves the workspace in 2 of 13 windows",
    )
    for changed, told in (
        ({}, False),
        ({"platform_mm": result.path_mm}, False),
        ({"platform_mm": result.path_mm + 1.0}, True),
        ({"platform_mm": None}, False),
        ({"platform_mm": result.path_mm + 1.0, "ran_away": 2}, False),
    ):
        assert (still in said(**changed)) == told, changed
        assert any(line.startswith(away) for line in said(**changed)) == ("ran_away" in changed)
    assert "known: the simulation leaves out thunder, lightning." in said(left_out=["thunder", "lightning"])
    assert not any("leaves out" in line for line in said())


def test_what_cannot_be_simulated_is_told_in_one_line(tmp_path: Path) -> None:
    trace = log(tmp_path, identified(), seconds=0.6)
    save_robot(identified(), tmp_path / "r.toml")
    other = ROBOT.model_copy(update={"mass": ROBOT.mass.model_copy(update={"platform": 2.0})})
    save_robot(other, tmp_path / "other.toml")
    (tmp_path / "axes.toml").write_text('name = "a"\nkind = "axes"\n[[axis]]\ngear_ratio = 1.0\n')

    def said(*arguments: str) -> str:
        result = runner.invoke(app, ["rollout", str(trace), *arguments])
        assert isinstance(result.exception, Exception), result.output
        return str(result.exception)

    mine = ["--robot", str(tmp_path / "r.toml")]
    assert "horizon of 9 s: must be 0.01 to 5 s" in said(*mine, "--horizon", "9")
    assert "log.csv: no window of 1 s between faults" in said(*mine, "--horizon", "1")
    assert "other.toml: its [mass] differs from that of" in said(*mine, "--robot", str(tmp_path / "other.toml"))
    assert "log.csv: 3 joints, a is described with 1" in said("--robot", str(tmp_path / "axes.toml"))
