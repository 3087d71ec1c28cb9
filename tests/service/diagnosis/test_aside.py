"""What the catalogue explains is named beside something that it does not hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.trace import read_trace
from service.diagnosis.diagnose import diagnose
from service.diagnosis.evidence.aside import WEIGHED, WIDTH, Quiet
from tests.service.diagnosis.logs import ROBOT, record, swing
from tests.service.subject import EFFECTS, Hypothesis, Split, fit, selection
from tests.service.world import BASE, PERIOD, course, problem, stub

JOINT = 2  # that the stranger sits on


def stranger(seed: int, rows: int) -> np.ndarray:
    """(rows,) N m, 6 rms: a torque that nothing in the motion tells, of 1 to 5 Hz."""
    rng = np.random.default_rng(seed)
    time = np.arange(rows) * PERIOD
    wave = np.sin(time[:, None] * 2 * np.pi * rng.uniform(1, 5, 6) + rng.uniform(0, 6, 6))
    return 6.0 * (2 / 6) ** 0.5 * wave.sum(axis=1)


@pytest.fixture(scope="module")
def quiet():
    courses = [course(seed, 2.0) for seed in (1, 2, 3)]
    torques = []
    for seed, run in enumerate(courses):
        torque = run.torque + 0.2 * np.random.default_rng(seed).standard_normal(run.torque.shape)
        torque[:, JOINT] += stranger(seed, len(torque))
        torques.append(torque)
    logs = problem(courses, torques, 0.2)
    none = selection.score(fit(logs, Hypothesis(BASE)), Split.of(logs))
    return logs, none, Quiet.of(logs, Split.of(logs), none.residuals)


def test_a_joint_of_which_far_more_than_noise_is_left_is_set_aside_and_asked_for_nothing(quiet):
    logs, _, found = quiet
    assert found.kept[JOINT] == pytest.approx(0.2, abs=0.01)  # enough to tell its friction
    assert (np.delete(found.kept, JOINT) == 1.0).all()
    allowed = [found.allows(EFFECTS["joint_spring"], joint) for joint in range(3)]
    assert allowed == [joint != JOINT for joint in range(3)]
    assert found.allows(EFFECTS["hose_spring"], JOINT)
    said = found.caution()
    assert (said.code, said.joints) == ("set_aside", [JOINT + 1])
    assert said.share == pytest.approx(1 - found.problem.count / logs.count, abs=1e-3)


def test_of_a_joint_without_rows_nothing_is_set_aside(quiet):
    logs, _, _ = quiet
    still = replace(logs, rows=[rows & [False, True, True] for rows in logs.rows])
    none = selection.score(fit(still, Hypothesis(BASE)), Split.of(still))
    found = Quiet.of(still, Split.of(still), none.residuals)
    assert found.caution().joints == [JOINT + 1]
    assert not any(rows[:, 0].any() for rows in found.problem.rows)


def noisy(shares, hot):
    """Residuals of three runs in units of the noise, +-1, above that in the first `hot` of each: joint by joint so much
    more in the mean square of all."""
    runs = [course(seed, 2.0) for seed in (1, 2, 3)]
    logs, residuals = problem(runs, [run.torque for run in runs]), []
    for mask, joints in zip(logs.rows, logs.joints_of_rows, strict=True):
        early = np.concatenate([np.flatnonzero(mask[:, j]) < hot * len(mask) for j in range(3)])
        more = 1.0 + early * np.array(shares)[joints] / hot
        residuals.append(np.sqrt(more) * (-1.0) ** np.arange(len(joints)))
    return logs, Quiet.of(logs, Split.of(logs), residuals)


@pytest.mark.parametrize("share", [0.55, 0.65])
def test_it_is_a_matter_of_one_joint_where_most_of_what_is_left_is_on_it(share):
    """Now and then: rows that are hot are set aside, on that joint or on all."""
    logs, found = noisy(600.0 * np.array([share, 0.6 * (1 - share), 0.4 * (1 - share)]), 0.3)
    edge = round(0.5 * WIDTH / (logs.band.period * logs.band.step)) + 1
    for joint in range(3):
        for mask, part in zip(logs.rows, found.problem.rows, strict=True):
            rows = np.flatnonzero(mask[:, joint])
            apart, hot = ~part[rows, joint], rows < 0.3 * len(mask)
            far = np.abs(rows - 0.3 * len(mask)) > edge
            assert (apart == (hot & (share < 0.6 or joint == 0)))[far].all()
    assert (found.kept[1:] == 1.0).all() == (share > 0.6)
    assert [found.allows(EFFECTS["joint_spring"], joint) for joint in range(3)] == [True] * 3, "most of it is quiet"


def test_most_rows_stay_where_it_is_everywhere(quiet):
    logs, _, _ = quiet
    random = np.random.default_rng(4)
    rising = [20.0 * np.linspace(1, 2, len(j)) * random.choice([-1.0, 1.0], len(j)) for j in logs.joints_of_rows]
    found = Quiet.of(logs, Split.of(logs), rising)
    assert found.problem.count / logs.count == pytest.approx(0.6, abs=0.01)


def test_a_joint_is_asked_for_effects_of_its_own_where_half_of_it_is_quiet(quiet):
    _, _, found = quiet
    halves = replace(found, kept=np.array([0.49, 0.51, 1.0]))
    assert [halves.allows(EFFECTS["joint_spring"], joint) for joint in range(3)] == [False, True, True]
    assert halves.caution().joints == [1, 2]


def test_what_the_quiet_rows_tell_is_held_against_all_rows(quiet):
    """On quiet rows nothing changes; on the others the stranger is left, as it was not fitted to."""
    logs, _, found = quiet
    scored = selection.score(fit(found.problem, Hypothesis(BASE)), found.split)
    seen = found.on_all(scored)
    for number, (mask, part) in enumerate(zip(logs.rows, found.problem.rows, strict=True)):
        kept = np.concatenate([part[mask[:, joint], joint] for joint in range(3)])
        np.testing.assert_allclose(seen.residuals[number][kept], scored.residuals[number], atol=1e-6)
        mine = logs.joints_of_rows[number] == JOINT
        true = logs.band(stranger(number, 2000)[:, None])[:, 0][mask[:, JOINT]] / logs.sigma[JOINT]
        assert np.corrcoef(seen.residuals[number][mine], true)[0, 1] > 0.99
    assert seen.loss / logs.count > 5 * scored.loss / found.problem.count


def test_where_the_quiet_rows_are_explained_a_stranger_weighs_no_more_for_being_violent(quiet):
    _, _, found = quiet
    scored = selection.score(fit(found.problem, Hypothesis(BASE)), found.split)
    raw, weighed = (replace(found, explained=told, _seen={}).on_all(scored) for told in (False, True))
    assert raw.blocks.sum() == pytest.approx(raw.loss)
    assert weighed.loss == raw.loss  # what is told of it is all of it
    by_hand = 0.0
    for residual, joints in zip(raw.residuals, found.whole.joints_of_rows, strict=True):
        least = np.where(joints == JOINT, np.minimum(np.abs(residual), WEIGHED * found.limit[JOINT]), residual)
        by_hand += float(least @ least)
    assert weighed.blocks.sum() == pytest.approx(by_hand)
    assert by_hand < 0.9 * raw.loss


def test_where_much_is_left_one_force_on_the_platform_goes_before_one_on_every_arm():
    def of(name, joints, loss):
        return stub(hypothesis=stub(terms=(stub(effect=EFFECTS[name], joints=joints),)), loss=loss)

    arms, hose, none = of("joint_spring", (0, 1, 2), 40.0), of("hose_spring", (), 42.0), stub(loss=100.0)
    assert selection.one_cause_first([arms, hose], none, 5) == [hose, arms]
    assert selection.one_cause_first([arms, hose], none, 20) == [arms, hose]  # only 1.4 times the noise is left
    far = of("hose_spring", (), 44.0)  # gains 7 % less
    assert selection.one_cause_first([arms, far], none, 5) == [arms, far]
    rubs = of("stribeck_friction", (0, 1, 2), 40.0)  # may be in every gear
    assert selection.one_cause_first([rubs, hose], none, 5) == [rubs, hose]


def test_an_effect_is_named_beside_a_stranger_on_another_joint(tmp_path):
    traces = []
    for seed in (1, 2, 3):
        trace = read_trace(record(tmp_path / f"run_{seed}.csv", ROBOT, swing(seed), 5.0, seed, 2.5), ROBOT)
        torque = trace.torque.copy()
        torque[:, JOINT] += stranger(seed, len(torque))
        traces.append(replace(trace, torque=torque))
    found = diagnose(ROBOT, traces, [EFFECTS[name] for name in ("stribeck_friction", "torque_scale", "hose_spring")])
    assert found.verdict == "partly_explained"
    assert set(found.selection.names) == {"stribeck_friction"}
    assert {joint for term in found.best.hypothesis.terms for joint in term.joints} == {0, 1}
    assert ("set_aside", [JOINT + 1]) in [(one.code, one.joints) for one in found.cannot_tell]
    # the gap that is told is that of all rows
    assert sum(len(r) for r in found.after) == found.problem.count == sum(len(r) for r in found.before)
