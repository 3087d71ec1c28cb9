"""How a diagnosis judges: each rule just inside and just outside of it, on searches set by hand."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from schemas.axes_description import Axes
from schemas.diagnosis import Caution
from schemas.errors import DataError, RobotError
from schemas.trace import Trace
from service.identification.fit import Problem
from tests.service.diagnosis.said import sentences
from tests.service.diagnosis.toy import split_of
from tests.service.subject import (
    EFFECTS,
    Hypothesis,
    Parameters,
    Term,
    described,
    diagnose,
    document,
    statistics,
)
from tests.service.world import BASE, ROBOT, course, stub

SPRING = Term(EFFECTS["joint_spring"], (0,), np.array([[3.0, 1.0]]), ())
OFFSET = Term(EFFECTS["torque_offset"], (2,), np.array([[0.9]]), ())


def log(seed: int, noise: np.ndarray | float = 0.3, seconds: float = 2.0) -> Trace:
    made, random = course(seed, seconds), np.random.default_rng([seed, 5])
    white = random.standard_normal(made.torque.shape)
    return Trace(Path(f"run_{seed}.csv"), made.time, made.motion[0] + 1e-7 * white[::-1], made.torque + noise * white)


def still(seed: int) -> Trace:
    trace = log(seed)
    return replace(trace, position=np.zeros_like(trace.position) + 0.45)


def test_a_log_in_which_nothing_moves_is_of_no_use_alone_and_does_no_harm_beside_others() -> None:
    def go_on(saying: str) -> None:
        if saying == "fitting the base model":
            raise StopIteration

    for traces in ([log(1), still(2)], [still(2), log(1)]):
        with pytest.raises(StopIteration):
            diagnose.diagnose(ROBOT, traces, (), go_on)
    with pytest.raises(DataError, match=r"^run_2\.csv: no joint moves$"):
        diagnose.diagnose(ROBOT, [still(2)], (), go_on)


@pytest.mark.parametrize(
    ("turned", "said"),
    [
        (np.diag([-1.0, -1.0, -1.0]), "run_1.csv, run_2.csv: the torque of joints 1, 2 and 3 has the wrong sign"),
        (np.eye(3)[[1, 0, 2]], "run_1.csv, run_2.csv: the torques of joints 1 and 2 are swapped"),
    ],
)
def test_a_torque_that_makes_sense_only_otherwise_is_refused_and_blamed_on_nothing(
    turned: np.ndarray, said: str
) -> None:
    logs = [log(1, seconds=6.0), log(2, seconds=6.0)]
    with pytest.raises(DataError, match=f"^{said}"):
        diagnose.diagnose(ROBOT, [replace(one, torque=one.torque @ turned) for one in logs], ())


def test_what_is_left_is_noise_up_to_6_percent_above_its_floor_and_25_where_that_was_guessed() -> None:
    """As little as reversals leave belongs to the floor. Torque that shows no noise has a floor that is guessed, and
    so is one that is read from the colour of the noise; one joint is enough."""
    smooth = [log(seed, 0.0, 4.0) for seed in (1, 2)]
    random = np.random.default_rng(0)
    memory = np.exp(-1.0 / 3.0)  # samples
    coloured = [
        replace(one, torque=one.torque + lfilter([1.0], [1.0, -memory], 0.3 * random.standard_normal((4000, 3)), 0))
        for one in smooth
    ]
    for traces, above, code in (
        ([log(1, 0.3, 4.0), log(2, 0.3, 4.0)], 1.06, None), (smooth, 1.25, "noise_unknown"),
        (coloured, 1.25, "noise_coloured"),
        ([log(seed, np.array([0.0, 0.3, 0.3]), 4.0) for seed in (1, 2)], 1.25, "noise_unknown"),
    ):  # fmt: skip
        found = diagnose.diagnose(ROBOT, traces, ())
        counts = np.sum([rows.sum(axis=0) for rows in found.problem.rows], axis=0)
        floor = np.repeat((found.reversal**2 + found.problem.sigma**2) / found.problem.sigma**2, counts)
        read = found.limit / (above * np.sqrt(floor.mean()))  # the floor as it is read in the band, over what is taken
        assert 1.0 - 1e-9 <= read <= diagnose.WITHIN_NOISE
        codes = [one.code for one in found.cannot_tell if one.code.startswith("noise")]
        assert codes == ([code] if code else [])
        assert found.verdict == "within_noise"


@pytest.mark.parametrize(("noise", "unknown"), [([0.3, 0.3, 0.3], False), ([0.0, 0.3, 0.3], True)])
def test_names_are_asked_for_more_where_the_noise_of_a_joint_is_not_known(
    monkeypatch: pytest.MonkeyPatch, noise: list[float], unknown: bool
) -> None:
    asked, judged = [], diagnose._judged

    def listening(*arguments: Any) -> diagnose.Judged:
        asked.append(arguments[5])
        return judged(*arguments)

    monkeypatch.setattr(diagnose, "_judged", listening)
    diagnose.diagnose(ROBOT, [log(seed, np.array(noise)) for seed in (1, 2)], ())
    assert asked == [unknown]


def test_positions_in_another_unit_are_refused_by_the_names_of_their_files() -> None:
    traces = [replace(one, position=0.45 + 0.02 * (one.position - 0.45)) for one in (log(1), log(2))]
    with pytest.raises(DataError, match=r"^run_1\.csv, run_2\.csv: no joint moves further than"):
        diagnose.diagnose(ROBOT, traces, ())


def test_the_floor_is_that_of_all_rows_with_what_reversals_leave_of_each_joint() -> None:
    rows = [np.array([[True, True], [True, False], [True, False]]), np.array([[False, True], [True, False]])]
    made: Any = stub(rows=rows, sigma=np.array([2.0, 0.5]))
    square = [1.0 + (0.3 / 2.0) ** 2] * 4 + [1.0 + (0.4 / 0.5) ** 2] * 2
    assert diagnose._floor(made, np.array([0.3, 0.4])) == pytest.approx(np.sqrt(np.mean(square)))


@pytest.mark.parametrize(
    ("terms", "left", "verdict"),
    [
        (1, 1.09, "within_noise"), (1, 1.11, "unexplained"), (2, 1.09, "explained"), (2, 1.11, "partly_explained"),
    ],
)  # fmt: skip
def test_a_verdict_says_whether_something_was_found_and_whether_more_than_noise_is_left(
    terms: int, left: float, verdict: str
) -> None:
    """A spring was known before."""
    found: Any = stub(best=stub(hypothesis=stub(terms=(SPRING, OFFSET)[:terms])))
    after = [left * np.ones(30), left * np.ones(70)]
    assert diagnose._verdict(problem(), found, (SPRING,), after, 1.1) == verdict


def problem() -> Any:
    """Of a hundred rows."""
    made = stub(count=100, most=1.0)
    made.over_noise = partial(Problem.over_noise, made)
    return made


def carrying(*terms: Term) -> Any:
    hypothesis = Hypothesis(BASE, terms)
    return described(ROBOT, hypothesis, 0.1 * np.abs(Parameters(hypothesis).values), np.full(3, 0.3))


def test_effects_of_the_description_and_of_the_baseline_are_known_each_once() -> None:
    other = replace(SPRING, amplitude=2.0 * SPRING.amplitude)
    assert diagnose._given(carrying(), None) == ()
    for robot, baseline, expected in (
        (carrying(SPRING), None, [SPRING]), (carrying(SPRING), carrying(OFFSET), [SPRING, OFFSET]),
        (carrying(SPRING), carrying(OFFSET, other), [SPRING, OFFSET]), (carrying(), carrying(other), [other]),
    ):  # fmt: skip
        found = diagnose._given(robot, baseline)
        assert [(one.effect.name, one.joints) for one in found] == [(one.effect.name, one.joints) for one in expected]
        for one, term in zip(found, expected, strict=True):
            np.testing.assert_allclose(one.amplitude, term.amplitude)


@pytest.mark.parametrize("key", ["geometry", "mass"])
def test_a_baseline_of_another_robot_is_refused_by_what_is_not_the_same(key: str) -> None:
    part = getattr(ROBOT, key)
    first = next(iter(type(part).model_fields))
    changed = ROBOT.model_copy(update={key: part.model_copy(update={first: 1.1 * getattr(part, first)}), "name": "b"})
    with pytest.raises(RobotError, match=f"^baseline b: its {key} differs from that of robot known$"):
        diagnose._given(ROBOT, changed)
    arm = Axes.model_validate({"name": "arm", "kind": "axes", "axis": [{}, {}]})
    with pytest.raises(RobotError, match=r"^baseline arm: its kind differs from that of robot known$"):
        diagnose._given(ROBOT, arm)
    with pytest.raises(RobotError, match=r"^baseline other: its axis differs from that of robot arm$"):
        diagnose._given(arm, Axes.model_validate({"name": "other", "kind": "axes", "axis": [{}]}))


class Judging:
    """A search that took one effect, and what the rules for names are asked."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, fell: bool = False, left: float = 1.0):
        self.none: Any = stub(hypothesis=stub(terms=()), loss=900.0)
        self.best: Any = stub(hypothesis=stub(terms=(SPRING,)), loss=100.0)
        self.found: Any = selected(self.none, self.best)
        self.fault, self.too_weak, self.by_chance = (
            Caution(code=code, advice="record_runs") for code in ("one_run", "too_little_motion", "one_way")
        )
        self.asked: dict[str, Any] = {}
        self.split = split_of(4, 25, 2)

        def earned(regressors: Any, found: Any, tests: Any, allows: Any, limit: float, progress: Any) -> Any:
            self.asked |= {"earned": found, "tests": tests, "allows": allows, "limit": limit, "progress": progress}
            return found, [self.too_weak]

        def together(problem: Any, split: Any, found: Any, after: Any, given: int, guessed: bool) -> Any:
            self.asked |= {"together": found, "after": after, "guessed": guessed}
            return found, [self.by_chance] if fell else []

        monkeypatch.setattr(diagnose, "faults_of", lambda found: [self.fault])
        monkeypatch.setattr(diagnose, "earned", earned)
        monkeypatch.setattr(diagnose, "together", together)
        monkeypatch.setattr(statistics, "walked", lambda found, split, count, most: [found.best] * split.folds)
        monkeypatch.setattr(statistics, "by_fold", lambda chosen, split: [left * np.ones(100)])

    def __call__(self, *doubts: Caution, unknown: bool = False) -> Any:
        made: Any = stub(problem=problem(), split=self.split)
        return diagnose._judged(made, self.found, list(doubts), 1, ["kept"], unknown, 1.2, all, print)  # pyright: ignore[reportArgumentType]


def selected(none: Any, best: Any) -> Any:
    tried = [best, stub()]
    return diagnose.Selection(none, best, [(tried, best), ([stub()], None)], {}, None, {})


def test_names_are_asked_whether_they_are_earned_one_by_one_and_together(monkeypatch: pytest.MonkeyPatch) -> None:
    judging = Judging(monkeypatch)
    found = judging()
    assert found.selection is judging.found is judging.asked["earned"] is judging.asked["together"]
    assert found.chosen == [judging.best] * 4
    assert found.cautions == [judging.fault, judging.too_weak]
    assert (judging.asked["tests"], judging.asked["allows"], judging.asked["limit"]) == (["kept"], all, 1.2)
    assert judging.asked["progress"] is print
    chance = Judging(monkeypatch, fell=True)
    found = chance()
    assert found.chosen == [chance.none] * 4
    assert found.cautions == [chance.fault, chance.too_weak, chance.by_chance]


def test_where_there_is_doubt_none_is_named_and_what_came_nearest_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    judging, doubt = Judging(monkeypatch), Caution(code="gravity", advice="check_description")
    found = judging(doubt)
    assert "earned" not in judging.asked
    assert found.selection.best is judging.none
    (((tried, taken)),) = found.selection.path
    assert tried is judging.found.path[0][0]
    assert taken is None
    assert found.chosen == [judging.none] * 4
    assert found.cautions == [doubt, judging.fault]


@pytest.mark.parametrize(("left", "more"), [(1.19, False), (1.21, True)])
def test_beside_a_noise_that_is_not_known_what_is_left_above_it_counts(
    monkeypatch: pytest.MonkeyPatch, left: float, more: bool
) -> None:
    judging = Judging(monkeypatch, left=left)
    judging(unknown=True)
    assert judging.asked["guessed"] is more
    judging()
    assert judging.asked["guessed"] is False


@pytest.mark.parametrize(("fault", "left", "gone_on"), [("at its limit", 1.09, True), ("at its limit", 1.11, False),
                                                       (None, 1.0, False)])  # fmt: skip
def test_what_cannot_be_gives_way_to_what_can_where_that_explains_all(monkeypatch, fault, left, gone_on):
    """left: rms without it, of noise that may leave 1.1."""
    ended, again = stub(fault=fault), stub(best=stub(residuals=[np.full(100, left)]))
    asked: list[Any] = []
    monkeypatch.setattr(diagnose, "search", lambda *arguments: asked.append(arguments[-1]) or again)
    found = diagnose._past_fault(stub(problem=problem()), ended, 1.1, lambda effect, joint: True, print)
    assert found is (again if gone_on else ended)
    assert asked == ([ended] if fault else [])


def test_it_is_asked_of_every_search_before_effects_are_exchanged(monkeypatch):
    asked: list[tuple[str, Any]] = []
    for name in ("_past_fault", "exchanged"):
        monkeypatch.setattr(
            diagnose, name, lambda regressors, found, limit, *_, name=name: asked.append((name, limit)) or found
        )
    found = diagnose.diagnose(ROBOT, [log(1), log(2)], [SPRING.effect])
    assert asked == [("_past_fault", found.limit), ("exchanged", found.limit)]


def test_the_text_on_held_out_runs_says_what_is_done(monkeypatch):
    """The search sees all runs; what predicts a run is fitted to the others, by slopes."""
    seen: list[set[int]] = []
    searched = diagnose.search

    def listening(regressors: Any, *rest: Any) -> Any:
        seen.append({recording.trace for recording in regressors.problem.recordings})
        return searched(regressors, *rest)

    monkeypatch.setattr(diagnose, "search", listening)
    runs = [log(seed, seconds=4.0) for seed in (1, 2, 3)]
    pulled = [replace(one, torque=one.torque + (3.0 + one.position[:, :1]) * [1.0, 0.0, 0.0]) for one in runs]
    found = diagnose.diagnose(ROBOT, pulled, [SPRING.effect])
    assert found.selection.names == ("joint_spring",)
    assert seen
    assert all(traces == {0, 1, 2} for traces in seen)
    fitted, fold = found.best.fitted, np.concatenate(found.split.fold)
    slopes, left = (np.concatenate(parts) for parts in (fitted.moving, fitted.residuals))
    for run in range(3):
        step = np.linalg.lstsq(slopes[fold != run], left[fold != run], rcond=None)[0]
        predicted = left[fold == run] - slopes[fold == run] @ step
        np.testing.assert_allclose(np.concatenate(found.after)[fold == run], predicted, atol=0.05)
    (line,) = (line for line in sentences(document.document(found)) if line.startswith("On held-out"))
    assert "(predicted with parameters fitted to the others; effects were found and accepted on all data)" in line
