"""Data that cannot carry an answer get the honest one, never a confident name."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.trace import read_trace
from schemas.axes_description import Axes, Axis
from schemas.diagnosis import Caution, Follows
from schemas.errors import DataError, RobotError
from schemas.robot import load_robot
from service.diagnosis.documents.document import document
from service.diagnosis.evidence.cautions import base_doubts, degrees_doubted, faults_of, limits_of, noise_of
from service.diagnosis.pipeline import diagnose
from service.identification.fit import Problem
from service.identification.noise import Floor
from service.model.effects import CATALOGUE, by_name, catalogue
from service.model.mechanism import mechanism_of
from tests.service.subject import Delta, Hypothesis, Term
from tests.service.world import BASE, ROBOT, stub

EFFECTS = by_name(CATALOGUE)


def motion(*speeds: np.ndarray, held: float = 0.0) -> Any:
    """A problem of one 10 s run whose joints move at the given (N,) speeds. held: s for which a torque stands."""
    theta_dot = np.stack(speeds, axis=1)
    segment = SimpleNamespace(theta_dot=theta_dot, moving=np.abs(theta_dot) > 0.01, period=0.01, held=held)
    return SimpleNamespace(recordings=[SimpleNamespace(segment=segment, trace=0)], sigma=np.ones(theta_dot.shape[1]))


SWING = np.sin(np.arange(1000) * 0.02)


def test_a_single_moving_joint_leaves_the_robot_as_a_whole_open():
    scope = limits_of(motion(SWING, 0 * SWING, 0 * SWING))
    assert scope.allows(EFFECTS["torque_scale"], 0)
    assert not scope.allows(EFFECTS["torque_scale"], 1)
    assert not scope.allows(EFFECTS["hose_spring"], 0)
    assert [(one.code, one.joints) for one in scope.cautions] == [("joints_at_rest", [2, 3]), ("one_run", [])]


def test_without_reversals_friction_is_not_looked_for():
    scope = limits_of(motion(1.0 + 0 * SWING, SWING, SWING))
    assert not scope.allows(EFFECTS["asymmetric_friction"], 0)
    assert scope.allows(EFFECTS["asymmetric_friction"], 1)
    assert [(one.code, one.joints) for one in scope.cautions] == [("one_way", [1]), ("one_run", [])]


def test_of_a_torque_that_was_not_measured_nothing_is_said_to_be_done_to_it():
    scope = limits_of(motion(SWING, SWING, SWING), {0: (40.0, 50.0)}, ["N per m", "N m per rad", "N m per rad"])
    assert not scope.allows(EFFECTS["torque_delay"], 0)
    assert not scope.allows(EFFECTS["torque_scale"], 0)
    assert scope.allows(EFFECTS["torque_scale"], 1)
    assert scope.allows(EFFECTS["joint_spring"], 0)
    (said,) = (one for one in scope.cautions if one.code == "closed_loop")
    assert (said.joints, said.gain, said.gain_most, said.gain_unit) == ([1], 40.0, 50.0, "N per m")


def test_a_torque_that_is_held_is_said_to_be():
    *_, said = limits_of(motion(SWING, SWING, SWING, held=0.008)).cautions
    assert (said.code, said.held_s, said.advice) == ("torque_held", 0.008, "log_quicker")


def test_a_short_log_is_too_little():
    scope = limits_of(motion(*[SWING[:200]] * 3))
    assert not scope.enough
    assert [(one.code, one.advice) for one in scope.cautions] == [("too_little_motion", "record_runs")]


@pytest.mark.parametrize(
    ("back", "seconds", "one_way", "still"),
    [(0.019, 10.0, True, False), (0.021, 10.0, False, False), (0.5, 2.9, False, True), (0.5, 3.1, False, False)],
)
def test_a_joint_reverses_and_moves_if_it_does_for_some_of_the_time(back, seconds, one_way, still):
    """Two in a hundred, and three seconds."""
    count = round(seconds * 100)
    speed = np.where(np.arange(1000) < count, 1.0, 0.0)
    speed[: round(back * count)] *= -1.0
    for way in (1.0, -1.0):
        codes = [(one.code, one.joints) for one in limits_of(motion(way * speed, SWING)).cautions]
        assert (("one_way", [1]) in codes) == one_way
        assert (("joints_at_rest", [1]) in codes) == still


def test_what_is_said_of_the_noise_and_of_what_cannot_be():
    none = np.zeros(3, bool)
    floor = Floor(np.ones(3), np.ones(3), np.array([True, False, True]), none)
    assert [(one.code, one.joints) for one in noise_of(floor)] == [("noise_coloured", [1, 3])]
    floor = Floor(np.ones(3), np.ones(3), none, np.array([False, True, False]))
    assert [(one.code, one.joints) for one in noise_of(floor)] == [("noise_unknown", [2])]
    assert faults_of(stub(fault=None)) == []
    term = stub(joints=(0, 2), effect=stub(name="arm_mass"))
    (caution,) = faults_of(stub(fault=stub(term=term, quantity="", code="at_limit")))
    assert (caution.code, caution.joints, caution.effect) == ("at_limit", [1, 3], "arm_mass")
    assert (caution.quantity, caution.advice) == (None, "check_base")


@pytest.fixture(scope="module")
def logs(data):
    def of(case, robot=None):
        folder = data / "plant_logs" / case
        robot = robot or load_robot(folder / "robot.toml")
        return robot, [read_trace(path, robot) for path in sorted(folder.glob("fit_*.csv"))]

    return of


def test_commands_are_not_needed_and_one_run_is_said_to_be_one(logs):
    robot, traces = logs("case_000")
    bare = replace(traces[1], position_command=None, torque_command=None)
    result = document(diagnose(robot, [bare], CATALOGUE))
    assert result.effects == []
    assert "one_run" in [one.code for one in result.cannot_tell]


def test_nothing_moves(logs):
    robot, traces = logs("case_000")
    still = replace(traces[0], position=np.repeat(traces[0].position[:1], len(traces[0]), axis=0))
    with pytest.raises(DataError, match="no joint moves"):
        diagnose(robot, [still], CATALOGUE)


def test_effects_of_ones_own(tmp_path):
    own = tmp_path / "own.py"
    own.write_text(
        "from __future__ import annotations\n"
        "from dataclasses import dataclass\n"
        "from service.model.effects.base import Amplitude, Effect\n"
        "@dataclass(frozen=True)\n"
        "class Bump(Effect):\n"
        "    height: Amplitude = Amplitude('N m', 'height')\n"
        "    name = 'bump'\n"
        "    settles = 'a slow sweep'\n"
        "    def regressors(self, scene, joint, nonlinear):\n"
        "        return scene.segment.theta[:, [joint]] ** 2\n"
    )
    assert catalogue(own)[-1].name == "bump"
    own.write_text("x = 1\n")
    with pytest.raises(RobotError, match="no class derived"):
        catalogue(own)
    own.write_text("1 / 0\n")
    with pytest.raises(RobotError, match="ZeroDivisionError"):
        catalogue(own)


def rows_of(sigma: np.ndarray, *recordings: Any) -> Problem:
    """A problem of 50 rows a joint and recording."""
    return Problem(recordings, stub(), sigma, rows=[np.ones((50, len(sigma)), bool)] * len(recordings))


@pytest.mark.parametrize(
    ("joint", "what", "other", "share", "told"),
    [
        (1, "motion", 2, 0.60, []),  # effects take 24 to 8 of joint 1's gap above the noise: two thirds
        (1, "motion", 2, 0.63, [("other_joints", [1, 2], 0.63)]),
        (2, "sine_of_angle", None, 0.29, []),
        (2, "sine_of_angle", None, 0.31, [("sine_of_angle", [2], 0.31)]),
        (2, "position_error", None, 0.9, []),
        (3, "motion", 1, 0.9, []),  # hardly a gap
        (4, "motion", 1, 0.95, [("other_joints", [4, 1], 0.95)]),  # more of it than effects take
        (5, "sine_of_angle", None, 0.99, []),  # effects leave 0.1 noise powers of 2499, the sine 25
        (5, "sine_of_angle", None, 0.9999, [("sine_of_angle", [5], 0.9999)]),
    ],
)
def test_a_base_that_lacks_something_is_doubted(joint, what, other, share, told):
    levels = {"none": [5.0, 5.0, 1.0, 5.0, 50.0], "best": [3.0, 5.0, 1.0, 1.5, 1.05]}  # rms left, over the noise
    joints = np.repeat([0, 1, 2, 3, 4], 50)
    bare = stub(terms=())
    none, best = (stub(residuals=[np.array(level)[joints]], hypothesis=bare, loss=1.0) for level in levels.values())
    one = Follows(joint=joint, what=what, other=other, share=share)

    def doubts(before: list[Follows], after: list[Follows], closed: bool = False) -> list[tuple]:
        made = rows_of(np.array([0.5, 2.0, 1.0, 1.0, 1.0]), stub(mechanism=stub(closed=closed)))
        found = base_doubts(made, before, after, none, best)
        return [(caution.code, caution.joints, caution.share) for caution in found]

    assert doubts([one], []) == told
    assert doubts([one, one], [one])[1:] == [], "said once"
    assert doubts([one], [], closed=True) == [], "a Delta's base knows its other joints"
    left = one.model_copy(update={"share": 0.31})
    assert bool(doubts([], [left])) == (joint < 3 and what != "position_error"), "of what effects leave, 0.3 is much"
    assert doubts([], [one.model_copy(update={"share": 0.29})]) == []


def springs_of_axes(first: float, second: float, third: float = 0.0, name: str = "joint_spring") -> list[Caution]:
    """Doubts about a spring of 4 N m/rad on the first of three axes and of 20 on the second and third, of which only
    the third cannot carry a weight. They travel by 2, 0.5 and 1 rad at most. first, second, third: N m of weight
    found."""
    mechanism = mechanism_of(Axes(name="axes", kind="axes", axis=[Axis(), Axis(), Axis(gravity=False)]))
    weights = {"1": first, "2": second, "3": third}
    figures = [
        {"sin": -0.6, "cos": 0.8}[part] * weights[joint] if kind == "gravity" else 50.0
        for kind, part, joint in (f"{name}_".split("_")[:3] for name in mechanism.coefficients)
    ]
    angles = np.array([[0.0, 0.1, 0.2], [2.0, 0.6, 0.2]]), np.array([[1.0, 0.3, 0.7], [1.5, 0.0, -0.3]])
    runs = [stub(mechanism=mechanism, segment=stub(theta=theta)) for theta in angles]
    term = Term(EFFECTS[name], (0, 1, 2), np.array([[4.0, 99.0], [20.0, 99.0], [20.0, 99.0]]), ())
    best = stub(hypothesis=stub(base=stub(rigid=np.array(figures)), terms=(term,)))
    return degrees_doubted(stub(recordings=runs), best)


@pytest.mark.parametrize(
    ("first", "second", "told"),
    [
        (0.79, 0.99, [1, 2]),
        (0.81, 0.99, [2]),
        (0.79, 1.01, [1]),
        (0.81, 1.01, []),
        (0.0, 0.0, [1, 2]),
        (-9.0, 0.0, [2]),
    ],
)
def test_a_spring_of_an_axis_may_be_a_weight_by_degrees_where_a_tenth_of_it_is_no_weight(first, second, told):
    """Of its pull over its travel; only on an axis that may carry a weight."""
    said = springs_of_axes(first, second)
    assert [(one.code, one.joints, one.effect, one.advice) for one in said] == [
        ("degrees", [joint], "joint_spring", "say_degrees") for joint in told
    ]


def test_what_does_not_pull_back_and_what_is_no_axis_are_not_asked_for_degrees():
    assert springs_of_axes(0.0, 0.0, name="torque_scale") == []
    spring = Term(EFFECTS["joint_spring"], (0,), np.array([[4.0, 0.0]]), ())
    delta = stub(recordings=[stub(mechanism=Delta.of(ROBOT), segment=stub(theta=np.zeros((2, 3))))])
    best = stub(hypothesis=Hypothesis(BASE, (spring,)))
    assert degrees_doubted(delta, best) == []


def test_a_term_that_is_a_weight_is_the_bases_however_little_it_takes():
    """Told with the share of its joint's gap above the noise that effects remove, and once; by the gear, the travel of
    its joint over all runs and its own figures."""
    joints = np.repeat([0, 1, 2], 50)
    asked = []

    def is_weight(ratio: float, travel: float, nonlinear: tuple[float, ...]) -> bool:
        asked.append((ratio, travel, nonlinear))
        return ratio > 10.0

    effect = stub(is_weight=is_weight)
    terms = (stub(effect=effect, joints=(0, 2), nonlinear=(7.0,)), stub(effect=effect, joints=(1,), nonlinear=()))
    none, best = (
        stub(residuals=[np.array(level)[joints]] * 2, hypothesis=stub(terms=terms))
        for level in ([5.0, 5.0, 3.0], [3.0, 5.0, 2.0])
    )
    angles = [np.array([[0.0, 0.0, -1.0], [1.0, 0.5, 0.0]]), np.array([[2.0, 0.0, 1.0]])]
    mechanism = stub(closed=False, gear_ratio=[20.0, 5.0, 30.0])
    runs = (stub(mechanism=mechanism, segment=stub(theta=theta)) for theta in angles)
    made = rows_of(np.array([0.5, 2.0, 1.0]), *runs)
    follow = Follows(joint=3, what="sine_of_angle", other=None, share=0.9)
    other = Follows(joint=2, what="motion", other=1, share=0.9)
    for found, more in (([], []), ([follow], []), ([follow, other], [("other_joints", [2, 1], 0.9)])):
        told = base_doubts(made, found, [], none, best)
        assert [(one.code, one.joints, one.share) for one in told] == [
            ("sine_of_angle", [1], pytest.approx(16 / 24, abs=1e-4)),
            ("sine_of_angle", [3], pytest.approx(5 / 8, abs=1e-4)), *more,
        ]  # fmt: skip
    assert asked[:3] == [(20.0, 2.0, (7.0,)), (30.0, 2.0, (7.0,)), (5.0, 0.5, ())]


def test_what_is_passed_over_does_not_hide_what_follows():
    """A position error, hardly a gap, too small a share: each before one that is told."""
    joints = np.repeat([0, 1, 2], 50)
    none, best = (
        stub(residuals=[np.array(level)[joints]], hypothesis=stub(terms=()))
        for level in ([5.0, 1.0, 30.0], [5.0, 1.0, 1.05])
    )
    made = rows_of(np.ones(3), stub(mechanism=stub(closed=False)))
    told = Follows(joint=1, what="motion", other=2, share=0.9)
    passed: list[Follows] = [
        Follows(joint=1, what="position_error", other=None, share=0.9),
        Follows(joint=2, what="motion", other=None, share=0.9),
        Follows(joint=1, what="sine_of_angle", other=None, share=0.1),
        Follows(joint=3, what="sine_of_angle", other=None, share=0.96),
    ]
    for one in passed:
        assert [found.joints for found in base_doubts(made, [one, told], [], none, best)] == [[1, 2]]
