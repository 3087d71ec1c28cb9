"""What goes into the document, from findings put together by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from schemas.fitted import Parameter
from schemas.robot import Identified
from service.diagnosis.documents import document
from service.diagnosis.evidence.rivals import ModelComparison
from service.diagnosis.fit.selection import Standing
from service.model.description import digits
from tests.service.diagnosis.toy import split_of
from tests.service.subject import EFFECTS, Delta, Hypothesis, Parameters, Term
from tests.service.world import BASE, ROBOT, course, problem, stub

ROWS = 400


def ripple(joint: int, order: float) -> Term:
    return Term(EFFECTS["cogging"], (joint,), np.array([[0.5 + joint, order]]), (order,))


SPRING = Term(EFFECTS["joint_spring"], (0,), np.array([[3.0, 1.0]]), ())
OFFSET = Term(EFFECTS["torque_offset"], (2,), np.array([[0.9]]), ())


def told(*terms: Term, given: tuple[Term, ...] = ()):
    """The named effects; errors are a tenth of each value. The gap is 600 above the noise: without the ripple half of
    it is left, without the offset a twentieth."""
    hypothesis = Hypothesis(BASE, (*given, *terms))
    worse = {"cogging": 300.0, "torque_offset": 30.0}
    return document._effects(
        stub(
            robot=ROBOT, given=given, errors=0.1 * np.abs(Parameters(hypothesis).values), problem=stub(count=ROWS),
            best=stub(hypothesis=hypothesis, loss=ROWS),
            selection=stub(
                none=stub(loss=ROWS + 600.0), rounds=list,
                standings={
                    term.effect: Standing(stub(loss=ROWS + worse[term.effect.name]), 0.91234, ["air_drag"], 1.0)  # pyright: ignore[reportArgumentType]
                    for term in terms
                },
            ),
        )
    )  # fmt: skip


def test_each_quantity_of_an_effect_has_a_name_of_its_own():
    """By joint where it sits on several, by order where it is there twice; what the description says is not named."""
    cogging, offset = told(OFFSET, ripple(0, 2.0), ripple(0, 7.0), ripple(1, 2.0), given=(SPRING,))
    assert (cogging.name, cogging.joints, cogging.gap_share) == ("cogging", [1, 2], 0.5)
    assert (cogging.probability, cogging.confusable_with) == (0.9123, ["air_drag"])
    assert (offset.name, offset.joints, offset.gap_share) == ("torque_offset", [3], 0.05)
    assert {key: one.value for key, one in cogging.parameters.items()} == {
        "cosine_1_2": 0.5, "sine_1_2": 2.0, "order_1_2": 2.0,
        "cosine_1_7": 0.5, "sine_1_7": 7.0, "order_1_7": 7.0,
        "cosine_2": 1.5, "sine_2": 2.0, "order_2": 2.0,
    }  # fmt: skip
    assert cogging.parameters["cosine_1_7"].meaning == "cosine part of the amplitude, joint side, joint 1, order 7"
    assert cogging.parameters["order_2"].meaning == "periods per motor turn, joint 2"
    (only,) = offset.parameters.values()
    assert (only.value, only.unit) == (0.9, "N m")
    assert only.ci95 == pytest.approx((0.9 * (1 - 0.196), 0.9 * (1 + 0.196)))
    assert ", joint" not in only.meaning.removesuffix("joint side")
    (twice,) = told(ripple(1, 2.0), ripple(1, 7.0))
    assert twice.parameters["sine_7"].meaning == "sine part of the amplitude, joint side, order 7"
    assert list(twice.parameters) == ["cosine_2", "sine_2", "order_2", "cosine_7", "sine_7", "order_7"]
    (two,) = told(ripple(0, 2.0), ripple(1, 7.0))
    assert [key for key in two.parameters if key.startswith("order")] == ["order_1", "order_2"]


def rival(loss: float, *terms: Term):
    return stub(hypothesis=Hypothesis(BASE, terms), loss=loss)


def rounds() -> list[ModelComparison]:
    """A spring is taken before a ripple, which stands before it in the model; an offset is as unlikely twice."""
    first = [
        (rival(0.49 * 900, SPRING), 0.7),
        (rival(0.64 * 900 + 0.05, OFFSET), 0.20004),
        (rival(1000.0, ripple(1, 2.0)), 0.1),
    ]
    second = [(rival(400.0, SPRING, OFFSET), 0.3), (rival(0.25 * 441, ripple(1, 2.0), SPRING), 0.6)]
    return [
        ModelComparison(rival(900.0), first, 0.0),
        ModelComparison(rival(441.0, SPRING), second, 0.1),
    ]


def test_the_ranking_tells_each_effect_in_the_round_that_speaks_for_it_most():
    """Named ones where they won, as likely as they are in the end, the others where the first of them won."""
    likely = {SPRING.effect: stub(probability=0.9), ripple(1, 2.0).effect: stub(probability=0.55)}
    findings = stub(problem=stub(count=100, sigma=np.array([1.0, 2.0, 2.0])), selection=stub(standings=likely))
    found = document._ranking(findings, rounds())
    assert [(one.name, one.joints, one.probability, one.shrink) for one in found] == [
        ("joint_spring", [1], 0.9, 0.3),
        ("cogging", [2], 0.55, 0.5),
        ("torque_offset", [3], 0.2, 0.2),
    ]
    assert found[0].after_nm == pytest.approx(3**0.5 * 4.41**0.5, rel=1e-3)


def test_rivals_are_those_of_the_open_round_that_shrink_the_gap():
    comparisons = rounds()
    findings = stub(robot=ROBOT, selection=stub(path=[([], None), ([], None)], standings={}))
    found = document._rivals(findings, comparisons)
    assert [(one.effects[0].name, one.probability, one.shrink) for one in found] == [
        ("joint_spring", 0.7, 0.3),
        ("torque_offset", 0.2, 0.2),
    ]
    assert document._none(comparisons) == 0.0
    assert document._none(comparisons[1:]) == 0.1
    assert document._none([]) == 1.0


@pytest.mark.parametrize(
    ("name", "carried", "reason"),
    [
        ("cogging", True, "present_sample"),
        ("torque_scale", True, "settings"),
        ("torque_delay", True, "report"),
        ("backlash", True, "state"),
        ("presliding_friction", True, "state"),
        ("angle_scale", True, "present_sample"),
    ],
)
def test_it_is_said_whether_the_estimator_has_the_effect(name, carried, reason):
    found = document._online(EFFECTS[name])
    assert (found.carried, found.reason) == (carried, reason)


def test_the_torque_is_that_of_the_rows_that_are_compared():
    run = course(1, 1.0)
    logs = problem([run], [run.torque])
    kept = [run.torque[:: logs.band.step][mask, joint] for joint, mask in enumerate(logs.rows[0].T)]
    np.testing.assert_allclose(document._torque(stub(problem=logs)), [np.sqrt(np.mean(t**2)) for t in kept])


def test_more_than_noise_is_left_in_the_draws_that_hold_the_block_where_it_is():
    """The first of ten, drawn ten times: in 1 - 0.9^10 of the draws."""
    left = np.ones(100)
    left[:10] = 5.0
    findings = stub(after=[left], split=split_of(1, 100, 10), limit=1.5)
    assert document._unknown(findings) == pytest.approx(1 - 0.9**10, abs=0.05)


def test_what_can_be_explained_is_above_noise_and_reversals(findings):
    """(N m)^2 summed by hand over all rows: before, after, and the floor of each joint."""
    reversal, after = np.array([0.05, 0.1, 0.15]), [2.0 * r for r in findings.after]
    found = document.document(replace(findings, reversal=reversal, after=after)).gap
    joints, sigma = np.concatenate(findings.problem.joints_of_rows), findings.problem.sigma
    before, left = (np.sum((np.concatenate(r) * sigma[joints]) ** 2) for r in (findings.before, after))
    floor = np.sum(sigma[joints] ** 2 + reversal[joints] ** 2)
    assert found.shrink_of_explainable == pytest.approx((before - left) / (before - floor))
    assert found.reversal_nm == [digits(value) for value in reversal]
    for above, worth_telling in ((0.04, False), (0.06, True)):
        little = [(1 + above) ** 0.5 * np.ones_like(r) for r in findings.before]
        found = document.document(replace(findings, before=little, reversal=np.zeros(3))).gap
        assert (found.shrink_of_explainable is not None) == worth_telling


def test_the_shrink_is_that_of_runs_at_work_and_slow_ones_are_named(findings, monkeypatch):
    """Of the first and the third run, (N m)^2 summed by hand; all count where none is slow."""
    problem = findings.problem
    assert document.document(findings).gap.slow_runs == document.document(findings).gap.work_before_nm == []
    after = [(0.5 + 0.1 * number) * r for number, r in enumerate(findings.before)]
    monkeypatch.setattr(document.statistics, "runs_at_work", lambda problem: np.array([0, 2]))
    found = document.document(replace(findings, after=after)).gap
    assert found.slow_runs == [problem.recordings[1].name]
    squares = [
        sum(float(np.sum((parts[k] * problem.sigma[problem.joints_of_rows[k]]) ** 2)) for k in (0, 2))
        for parts in (findings.before, after)
    ]
    assert found.shrink == pytest.approx(1.0 - (squares[1] / squares[0]) ** 0.5)
    assert found.shrink_ci95[0] < found.shrink < found.shrink_ci95[1]
    for joint, (before, left) in enumerate(zip(found.work_before_nm, found.work_after_nm, strict=True)):
        parts = [findings.before[k][problem.joints_of_rows[k] == joint] for k in (0, 2)]
        mine = np.concatenate(parts) * problem.sigma[joint]
        assert before == pytest.approx(np.sqrt(np.mean(mine**2)), rel=1e-3)
        assert left < before
    assert found.before_nm == document.document(findings).gap.before_nm, "of all runs"


def test_what_moved_stands_beside_the_baselines_with_its_errors():
    identified = Identified(rho_1=Parameter(value=1.0, std_error=0.01), rho_2=Parameter(value=1.0, std_error=0.02))
    moved = replace(BASE, rigid=BASE.rigid * [1.1, 1.2, 1.3])
    findings = stub(
        robot=ROBOT, baseline=ROBOT.model_copy(update={"identified": identified}),
        problem=stub(recordings=[stub(mechanism=Delta.of(ROBOT))]),
        reference=Hypothesis(BASE), best=stub(hypothesis=Hypothesis(moved)), errors=np.arange(1.0, 99.0),
    )  # fmt: skip
    found = document._moved(findings)
    assert len(found) == 9
    assert [one.before_error for one in found.values()][:2] == [0.01, 0.02]
    assert [one.after_error for one in found.values()] == list(range(1, 10))
    ratio = [one.after / one.before for one in found.values()]
    assert ratio == pytest.approx([1.1, 1.2, 1.3] + 6 * [1.0], rel=1e-5)
    assert document._moved(stub(baseline=None)) == {}
