"""A planned run: what it is expected to show comes true in other code's torque, and it stays within the limits."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.motion import MotionLimits, Planner, Trajectory
from schemas.diagnosis import Diagnosis, Gap, Rival, Where
from schemas.errors import DataError
from schemas.robot import Robot, load_robot, save_robot
from service.cli.main import app
from service.model.description import described, entry, terms_of
from service.planning import plan as planning
from service.planning.question import PERIOD, Apart, Figures, View, expected
from tests.service.injected import INJECTED, reports
from tests.service.rollout.test_kernel import effect
from tests.service.subject import Hypothesis, Term, fit
from tests.service.world import BASE, ROBOT, course, problem

_carrying = described(ROBOT, Hypothesis(BASE), np.zeros(11), np.full(3, 0.3))
assert isinstance(_carrying, Robot)
KNOWN: Robot = _carrying
SIGMA = np.full(3, 0.1)
LIMITS = MotionLimits(speed=6.0, acceleration=120.0, torque=60.0)
STRIBECK, VISCOUS = (INJECTED[name].term(name) for name in ("stribeck_friction", "nonlinear_viscous_friction"))


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "MEMBERS", 6)
    monkeypatch.setattr(planning, "GENERATIONS", 1)
    monkeypatch.setattr(planning, "ROUNDS", 1)


def test_rivals_differ_by_what_the_wrong_one_leaves_after_its_fit() -> None:
    run = course(5, 5.0)
    recorded = problem([run], [reports("stribeck_friction", 5, 5.0)], sigma=0.3)
    wrong = fit(recorded, Hypothesis(BASE, (VISCOUS,)))
    right = fit(recorded, Hypothesis(BASE, (STRIBECK,)))
    band = recorded.band
    left = (wrong.cost - right.cost) * band.white_share * band.step
    question = Apart(View.of(KNOWN, recorded.sigma), [(STRIBECK,), (VISCOUS,)])
    squares = question.squares(question.shown(Trajectory(PERIOD, *run.motion), whole=True))
    assert squares[question.pairs.index((0, 1))] == pytest.approx(left, rel=0.15)


def test_every_other_sample_shows_as_much_as_all() -> None:
    motion = Planner(ROBOT, PERIOD, LIMITS).multisine(np.random.default_rng(1), 5.0)
    names = ("stribeck_friction", "presliding_friction", "joint_elasticity")
    rivals = [terms_of(KNOWN.model_copy(update={"effect": [effect(name)]})) for name in names]
    question = Apart(View.of(KNOWN, SIGMA), rivals)
    sparse, whole = (question.squares(question.shown(motion, whole)) for whole in (False, True))
    np.testing.assert_allclose(sparse, whole, rtol=0.1)


def test_a_plan_keeps_every_limit_and_shows_more_than_a_random_run(short: None) -> None:
    planner = Planner(ROBOT, PERIOD, LIMITS)
    rivals = [(INJECTED[name].term(name),) for name in ("arm_mass", "rotor_inertia")]
    question = Apart(View.of(KNOWN, SIGMA), rivals)
    motion = planning.plan(planner, question, 5.0)
    assert motion.duration == pytest.approx(5.0, abs=0.01)
    speed = np.gradient(motion.position, PERIOD, axis=0)
    np.testing.assert_allclose(speed[2:-2], motion.velocity[2:-2], atol=1e-3)
    acceleration = np.gradient(speed, PERIOD, axis=0)
    assert np.abs(speed).max() <= LIMITS.speed
    assert np.abs(acceleration).max() <= 1.02 * LIMITS.acceleration
    assert not np.ptp(motion.position[:50], axis=0).any()
    assert not np.ptp(motion.position[-50:], axis=0).any()
    random = planner.multisine(np.random.default_rng(1), 5.0)
    errors = [question.learned(question.shown(run, whole=True))[0].errors for run in (motion, random)]
    assert errors[0] > 1.3 * errors[1]


def test_no_rival_is_asked_for_more_torque_than_the_drives_give(short: None) -> None:
    planner, view = Planner(ROBOT, PERIOD, LIMITS), View.of(KNOWN, SIGMA)

    def most(view: View) -> float:
        motion = planning.plan(planner, Apart(view, [(STRIBECK,), (VISCOUS,)]), 5.0)
        entries = [
            entry(term, np.zeros(20)[: term.amplitude.size + len(term.nonlinear)], ROBOT)
            for term in (STRIBECK, VISCOUS)
        ]
        return max(float(np.abs(expected(KNOWN, [one], motion)).max()) for one in entries)

    free = most(view)
    assert most(dataclasses.replace(view, peak=0.8 * free)) < 0.82 * free


class Travel:
    """A question that is answered by how far joint 1 moves: what was worth how much, try by try."""

    def __init__(self) -> None:
        self.tries, self.worths = 0, []

    def shown(self, motion: Trajectory, whole: bool = False) -> np.ndarray:
        return np.array([np.ptp(motion.position[:, 0])])

    def worth(self, shown: np.ndarray) -> float:
        self.worths.append((self.tries, float(shown[0])))
        return float(shown[0])

    def tried(self) -> None:
        self.tries += 1


def test_a_stretch_is_sought_beside_what_the_others_show_and_the_best_one_is_tried_again(
    short: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(planning, "ROUNDS", 2)
    question = Travel()
    planning.plan(Planner(ROBOT, PERIOD, LIMITS), question, 5.0, question.tried)
    assert question.tries == planning.evaluations(5.0)
    each = question.tries // 4  # two rounds of two stretches
    one, other, one_again, other_again = (
        np.array([worth for at, worth in question.worths if at // each == part]) for part in range(4)
    )
    first, second = one.max(), other.max() - one.max()
    assert first > 0.2
    assert second > 0.2
    assert other.min() >= first
    assert np.isclose(one_again, first + second).any()
    assert other_again.min() >= one_again.max() - second - 1e-9
    assert np.isclose(other_again, one_again.max()).any()


def test_what_no_motion_tells_apart_is_not_asked() -> None:
    offset, direction = (INJECTED[name].term(name) for name in ("torque_offset", "asymmetric_friction"))
    question = Apart(View.of(KNOWN, SIGMA), [(offset,), (direction,), (STRIBECK,)])
    assert question.pairs == [(0, 2), (1, 2), (2, 0), (2, 1)]


def test_a_run_for_identification_leaves_the_errors_that_a_fit_has() -> None:
    run = course(6, 5.0)
    question = Figures(View.of(KNOWN, SIGMA))
    learned = question.learned(question.shown(Trajectory(PERIOD, *run.motion), whole=True))
    rng, found = np.random.default_rng(0), []
    for _ in range(30):
        noisy = run.torque + rng.normal(0.0, 0.3, run.torque.shape)
        recorded = problem([run], [noisy], sigma=0.3)
        found.append(fit(recorded, Hypothesis(BASE, timed=False), iterations=1).hypothesis.base.rigid)
    spread = np.std(found, axis=0, ddof=1)
    scale = float(problem([run], [run.torque], sigma=0.3).sigma[0] / SIGMA[0])
    for name, seen in zip(("rho_1", "rho_2", "forearm_inertia_kg"), spread, strict=True):
        assert learned[name][0] * scale == pytest.approx(float(seen), rel=0.35)


def test_a_robot_that_was_never_identified_has_figures_to_find() -> None:
    motion = Planner(ROBOT, PERIOD, LIMITS).multisine(np.random.default_rng(1), 5.0)
    question = Figures(View.of(ROBOT, SIGMA))
    with np.errstate(all="raise", under="ignore"):
        learned = question.learned(question.shown(motion))
    assert 1e-5 < learned["f_c_1"][0] < 0.05


def folder_of(path: Path, rivals: list[Term], robot: str = ROBOT.name) -> list[str]:
    """A diagnosis with these rivals, and the command that plans from it."""
    found = [
        Rival(
            effects=[entry(term, np.zeros(20)[: term.amplitude.size + len(term.nonlinear)], ROBOT)],
            probability=0.5,
            shrink=0.3,
        )
        for term in rivals
    ]
    three = [1.0] * 3
    where = Where(joints=[], left_out_at_rest_and_ends=0.0, worst_runs=[], bursts=[], bursts_rhythm_s=None)
    gap = Gap(
        unit="N m", before_nm=three, after_nm=three, noise_floor_nm=[0.1] * 3, reversal_nm=[0.0] * 3, shrink=0.0,
        shrink_ci95=(0.0, 0.0), shrink_of_explainable=None, band_hz=40.0,
    )  # fmt: skip
    document = Diagnosis(
        schema="deltatwin.diagnosis/2", robot=robot, traces=["a"], verdict="unexplained", effects=[], cannot_tell=[],
        ranking=[], probability_none=0.0, probability_unknown=0.0, plain={}, base={}, where=where, gap=gap, given=[],
        rivals=found,
    )  # fmt: skip
    (path / "diagnosis.json").write_text(document.model_dump_json(by_alias=True))
    save_robot(KNOWN, path / "corrected.toml")
    save_robot(ROBOT, path / "robot.toml")
    return [
        "plan-motion",
        "--robot",
        str(path / "robot.toml"),
        "--diagnosis",
        str(path),
        "--out",
        str(path / "m.csv"),
        "--duration",
        "5",
        "--assume-limits",
    ]


def test_the_command_says_what_the_run_will_show_and_the_simulated_robot_runs_it(short: None, tmp_path: Path) -> None:
    arguments = folder_of(tmp_path, [STRIBECK, VISCOUS])
    done = CliRunner().invoke(app, [*arguments, "--rate", "500"])
    assert done.exit_code == 0, done.output
    assert (
        "stribeck friction in joints 1, 2 and 3 and nonlinear viscous friction in joints 1, 2 and 3 differ by"
        in done.output
    )
    run = ["simulate", "--robot", arguments[2], "--motion", str(tmp_path / "m.csv"), "--out", str(tmp_path / "log.csv")]
    done = CliRunner().invoke(app, [*run, "--rate", "500"])
    assert done.exit_code == 0, done.output
    assert "5.000 s" in done.output


def test_what_cannot_be_planned_is_said_in_a_line(short: None, tmp_path: Path) -> None:
    arguments = folder_of(tmp_path, [STRIBECK, VISCOUS])

    def refused(*more: str) -> str:
        done = CliRunner().invoke(app, [*arguments, *more])
        assert isinstance(done.exception, DataError), done.output
        return str(done.exception)

    assert "holding the robot needs" in refused("--max-torque", "5")
    assert "0.01 rad/s, " in refused("--max-speed", "0.01")
    folder_of(tmp_path, [STRIBECK])
    assert "(1 candidate)" in refused()
    folder_of(tmp_path, [STRIBECK, VISCOUS], robot="other")
    assert "a diagnosis of robot 'other', not of 'known'" in refused()
    folder_of(tmp_path, [STRIBECK, VISCOUS])
    heavier = KNOWN.model_copy(update={"mass": load_robot("d3-1200").mass})
    save_robot(heavier, tmp_path / "corrected.toml")
    assert "its [mass] differs from that of robot 'known'" in refused()
    (tmp_path / "diagnosis.json").write_text("{}")
    assert "not written by `deltatwin diagnose`" in refused()


def test_limits_that_nobody_has_given_are_asked_for_or_said(short: None, tmp_path: Path) -> None:
    arguments = [one for one in folder_of(tmp_path, [STRIBECK, VISCOUS]) if one != "--assume-limits"]
    done = CliRunner().invoke(app, arguments)
    assert isinstance(done.exception, DataError), done.output
    said = str(done.exception)
    assert said.startswith(f"{tmp_path / 'robot.toml'}: no limit is given for ")
    for option in ("--max-speed", "--max-acceleration", "--max-torque", "--assume-limits"):
        assert option in said
    assert not (tmp_path / "m.csv").exists()
    done = CliRunner().invoke(app, [*arguments, "--assume-limits"])
    assert "assumed, as not given: the limit of joint_speed_radps (--max-speed): 10 rad/s" in done.output
    given = ROBOT.limits.model_copy(update={"joint_acceleration_radps2": 90.0, "joint_speed_radps": 5.0})
    save_robot(ROBOT.model_copy(update={"limits": given}), tmp_path / "robot.toml")
    done = CliRunner().invoke(app, [*arguments, "--max-torque", "60"])
    assert done.exit_code == 0, done.output
    assert "assumed" not in done.output
    assert "of 5 rad/s" in done.output
    assert "of 90 rad/s^2" in done.output
