"""A figure is an effect's own where far more than noise is left: not what is given to its torque elsewhere as well."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np
import pytest

from service.diagnosis.evidence.aside import _by_place
from service.diagnosis.evidence.wave import Wave
from service.diagnosis.fit import signature as own
from service.diagnosis.fit.signature import Signature
from tests.service.diagnosis.test_aside import SIGMA, pulled, stranger
from tests.service.injected import reports
from tests.service.subject import EFFECTS, Hypothesis, Parameters, Problem, Split, Term, evaluate, fit
from tests.service.world import BASE, PERIOD, ROBOT, course, problem

SECONDS, SEEDS = 3.0, (1, 2, 3)
SPRING = Term(EFFECTS["joint_spring"], (0,), np.zeros((1, 2)), ())
RIPPLE = Term(EFFECTS["cogging"], (0,), np.zeros((1, 2)), (2.0,))


def forgetful(angle: np.ndarray, seconds: float = 0.3) -> np.ndarray:
    """(N,) N m of a spring of 8 N m/rad whose rest creeps after the joint."""
    rest, torque = angle[0], np.zeros(len(angle))
    for row, now in enumerate(angle):
        torque[row] = -8.0 * (now - rest)
        rest += (now - rest) * PERIOD / seconds
    return torque


def logs(name: str = "", add=lambda run, seed: 0.0) -> Problem:
    """Three runs, with an effect put in by other code and what `add` gives."""
    runs, torques = [course(seed, SECONDS) for seed in SEEDS], []
    for run, seed in zip(runs, SEEDS, strict=True):
        torque = reports(name, seed, SECONDS) if name else run.torque
        noise = SIGMA * np.random.default_rng(seed).standard_normal(torque.shape)
        torques.append(torque + noise + add(run, seed))
    return problem(runs, torques, SIGMA)


def on(joint: int, torque: np.ndarray) -> np.ndarray:
    return torque[:, None] * (np.arange(3) == joint)


def waves(joint: int):
    return lambda run, seed: on(joint, stranger(seed, len(run.torque)))


def seen(made: Problem, *terms: Term) -> Signature:
    return Signature(made, fit(made, Hypothesis(BASE, terms)).hypothesis)


def test_what_an_effect_takes_is_its_own_beside_a_stranger_on_another_joint():
    assert seen(logs("joint_spring", waves(2)), SPRING).elsewhere(SPRING.effect) < 0.05


def test_what_does_nothing_is_not_its_own():
    """A spring that was found to have no stiffness."""
    made = logs("", waves(2))
    assert Signature(made, Hypothesis(BASE, (SPRING,))).elsewhere(SPRING.effect) == 1.0


def test_a_stand_in_takes_what_is_given_to_its_torque_at_other_times_as_well():
    def creeps(run, seed):
        return on(0, forgetful(run.motion[0][:, 0]))

    found = seen(logs(add=creeps), SPRING)
    assert own.OWN * found.elsewhere(SPRING.effect) > 1.0
    assert own.OWN * seen(logs(add=waves(0)), RIPPLE).elsewhere(RIPPLE.effect) > 1.0


def test_a_figure_that_one_run_has_otherwise_is_none_of_its_own():
    shares = [
        seen(logs(add=lambda run, seed, last=last: on(0, np.full(len(run.torque), last if seed == 3 else 2.0))),
             Term(EFFECTS["torque_offset"], (0,), np.zeros((1, 1)), ())).elsewhere(EFFECTS["torque_offset"])
        for last in (2.0, -2.0)
    ]  # fmt: skip
    assert shares[0] < 0.05
    assert shares[1] > 0.5


def test_a_bump_at_one_place_is_no_ripple_of_every_turn():
    """A contact within a part of a motor's turn, which the joint passes again and again."""

    def bump(run, seed):
        angle = run.motion[0][:, 1]
        return on(1, 3.0 * np.exp(-0.5 * ((angle - np.median(angle)) / 0.05) ** 2))

    def share(made, order):
        ripple = Term(EFFECTS["cogging"], (1,), np.zeros((1, 2)), (order,))
        return own.OWN * seen(made, ripple).elsewhere(ripple.effect)

    assert share(logs(add=bump), 1.0) > 1.0
    assert share(logs("cogging"), 2.0) < 1.0


def test_a_bell_of_energy_at_one_place_has_ripples_next_to_the_one_that_stands_in_for_it():
    """A cable carrier that climbs over an edge: one period of a wave, as long as that of half a motor's turn. A ripple
    beside it, on the same joint, is a line all the same."""
    ripple = Term(EFFECTS["cogging"], (1,), np.zeros((1, 2)), (2.0,))

    def edge(run, seed):
        angle = (run.motion[0][:, 1] - np.median(run.motion[0][:, 1])) * 2.0 * ROBOT.drive.gear_ratio
        return on(1, 3.0 * angle * np.exp(-0.5 * angle**2))

    alone, beside = seen(logs(add=edge), ripple), seen(logs("cogging", edge), ripple)
    assert alone.next_to(ripple.effect) > own.ALONE
    assert beside.next_to(ripple.effect) < own.ALONE
    assert alone.next_to(SPRING.effect) == 0.0
    every = seen(logs("cogging", edge), Term(EFFECTS["cogging"], (0, 1, 2), np.zeros((3, 2)), (2.0,)))
    assert every.next_to(ripple.effect) == pytest.approx(beside.next_to(ripple.effect), rel=0.02), "as drives of a kind"
    wobble = Term(EFFECTS["encoder_eccentricity"], (1,), np.zeros((1, 2)), (2.0,))
    assert seen(logs(add=edge), wobble).next_to(wobble.effect) > 0.0


@pytest.mark.parametrize("term", [SPRING, RIPPLE])
def test_a_share_by_hand(term):
    """The torque's neighbours one by one, each beside all that the hypothesis can tell. An order is no torque."""
    made = logs("joint_spring", waves(0))
    found = seen(made, term)
    every = evaluate(made, found.hypothesis)
    joints = np.concatenate(made.joints_of_rows)
    residual, tangents = np.concatenate(every.residuals), np.concatenate(every.tangents)
    for joint in range(3):
        level = max(1.0, np.sqrt(np.mean(residual[joints == joint] ** 2)))
        residual[joints == joint] /= level
        tangents[joints == joint] /= level
    values = Parameters(found.hypothesis)
    mine = np.zeros(len(values.values), bool)
    mine[values.terms[0]] = True
    mine = mine[values.free]
    torque = tangents[:, mine][:, :2] @ found.hypothesis.terms[0].amplitude[0]
    run = np.concatenate([np.full(len(r), number) for number, r in enumerate(every.residuals)])
    place = [made.band(recording.arms.position) for recording in made.recordings]
    place = np.concatenate([made.pick(i, np.repeat(p[:, None], 3, axis=1)) for i, p in enumerate(place)])
    neighbours = [torque * side for side in (place - place.mean(axis=0)).T]
    neighbours += [torque * (run == number) for number in (1, 2)]
    ways = [made.band(recording.segment.theta) for recording in made.recordings]
    angle = np.concatenate([made.pick(i, way) for i, way in enumerate(ways)])
    quarter = np.zeros(len(angle), int)
    for joint in range(3):
        way = angle[joints == joint]
        quarter[joints == joint] = np.digitize(way, np.linspace(way.min(), way.max(), own.PARTS + 1)[1:-1])
    neighbours += [torque * (quarter == number) for number in range(own.PARTS)]
    period = made.band.period * made.band.step
    for steps in (round(shift / period) for shift in own.SHIFTS):
        late, early = [], []
        for number, rows in enumerate(made.rows):
            for joint in range(3):
                along = np.zeros(len(rows))
                along[rows[:, joint]] = torque[(run == number) & (joints == joint)]
                late.append(np.r_[np.zeros(steps), along[:-steps]][rows[:, joint]])
                early.append(np.r_[along[steps:], np.zeros(steps)][rows[:, joint]])
        neighbours += [np.concatenate(late), np.concatenate(early)]

    def beside(known, column):
        known = known / np.maximum(np.linalg.norm(known, axis=0), 1e-300)
        return column - known @ np.linalg.lstsq(known, column, rcond=1e-10)[0]

    given = [(residual @ (b := beside(tangents, n))) ** 2 / (b @ b) for n in neighbours]
    taken = beside(tangents[:, ~mine], torque)
    assert found.elsewhere(term.effect) == pytest.approx(np.sqrt(np.mean(given) / (taken @ taken)), rel=1e-4)


def test_rows_count_alike_however_little_they_weigh():
    made = logs("joint_spring", waves(0))
    few = [np.where(np.arange(len(rows))[:, None] % 2, 1e-3, np.ones(rows.shape)) for rows in made.rows]
    hypothesis = fit(made, Hypothesis(BASE, (SPRING,))).hypothesis
    shares = [Signature(one, hypothesis).elsewhere(SPRING.effect) for one in (made, replace(made, weights=few))]
    assert shares[0] == pytest.approx(shares[1], rel=1e-9)


def test_what_a_field_leaves_open_counts_for_nothing():
    """A torque by the joint's angle, left open, on the joint that the effect sits on."""
    made = logs("cogging", lambda run, seed: on(0, 30.0 * run.motion[0][:, 0] ** 3))
    fields = []
    for recording in made.recordings:
        angle = recording.segment.theta[:, :1]
        columns = made.band(np.concatenate([angle**power for power in range(4)], axis=1))
        fields.append(made.pick(len(fields), np.repeat(columns[:, None], 3, axis=1)))
    place = EFFECTS["cogging"]
    ripple = replace(RIPPLE, joints=(1,))
    with_field = replace(made, fields=fields)
    assert seen(with_field, ripple).elsewhere(place) < seen(made, ripple).elsewhere(place) + 1e-3
    assert np.mean(seen(with_field, ripple).residual ** 2) < 1.1


def test_a_pull_at_the_platform_goes_by_its_place_and_a_spring_with_it_but_no_friction():
    def hose(run, seed):
        return pulled(run.motion[0])

    made = logs(add=hose)
    drag = Term(EFFECTS["air_drag"], (), np.zeros((1, 1)), ())
    found = seen(made, SPRING, drag)
    assert own.pulled(made, found.hypothesis)
    assert found.goes_by_place() > 0.8
    assert found.by_place(SPRING.effect) > 0.99
    assert found.by_place(drag.effect) < 0.2


def test_what_is_left_open_holds_an_effect_that_goes_by_it_and_no_other():
    """A wave holds neither."""
    made, drag = logs("joint_spring"), Term(EFFECTS["air_drag"], (), np.zeros((1, 1)), ())
    found = Signature(made, fit(made, Hypothesis(BASE, (SPRING, drag))).hypothesis)
    place, wave = _by_place(made, Split.of(made)), Wave(np.array([0.0, 16.0])).fields(made)
    assert found.left_open(SPRING.effect, place) > 0.95
    assert found.left_open(drag.effect, place) < 0.5  # in a run of three seconds
    assert found.left_open(SPRING.effect, wave) < 0.2
    assert found.left_open(drag.effect, wave) < 0.2


def test_a_torque_constant_that_does_not_keep_goes_by_scale_and_masses_with_it_but_no_spring():
    """Joint 2's grows by 2 % a second, from another value in each run. Of all torque by the same share more, base
    parameters take all but what weighs as it is known to: a mass."""

    def warm(run, seed):
        return on(1, run.torque[:, 1] * 0.02 * (np.arange(len(run.torque)) * PERIOD + seed))

    scale, mass = (
        Term(EFFECTS["torque_scale"], (1,), np.zeros((1, 1)), ()),
        Term(EFFECTS["tool_mass"], (), np.zeros((1, 1)), ()),
    )
    made = logs("joint_spring", warm)
    found = seen(made, SPRING, scale, mass)
    assert found.goes_by_scale() > 0.8
    assert found.by_scale(scale.effect) > 0.99
    assert found.by_scale(mass.effect) > 0.95
    assert found.by_scale(SPRING.effect) < 0.7 < own.OWN_ELSEWHERE
    assert abs(found.goes_by_place()) < 0.5
    assert (np.count_nonzero(found._scales(), axis=1) <= 2).all(), "a run's and a joint's own"
    assert abs(seen(logs("joint_spring", waves(0)), SPRING).goes_by_scale()) < 0.1
    assert seen(logs()).goes_by_scale() == 0.0
    assert abs(seen(logs("tool_mass")).goes_by_scale()) < 0.1, "a mass keeps"


def test_what_goes_by_nothing_does_not_go_by_place():
    found = seen(logs("joint_spring", waves(0)), SPRING)
    assert abs(found.goes_by_place()) < 0.3
    assert not own.pulled(found.problem, found.hypothesis)


def test_a_field_is_of_the_second_order_on_each_joint():
    made = logs()
    found = seen(made)
    field = found._places()
    position = np.concatenate([recording.arms.position for recording in made.recordings])
    random = np.random.default_rng(1).standard_normal((3, 10))
    parts = []
    for number, recording in enumerate(made.recordings):
        place = np.c_[np.ones(len(recording.arms.position)), recording.arms.position - position.mean(axis=0)]
        terms = np.stack([place[:, chosen].prod(axis=1) for chosen in combinations_with_replacement(range(4), 2)], 1)
        parts.append(made.pick(number, made.band(terms @ random.T)))
    target = np.concatenate(parts)
    left = target - field @ np.linalg.lstsq(field, target, rcond=None)[0]
    assert np.abs(left).max() < 1e-6 * np.abs(target).max()


def test_where_next_to_nothing_is_left_it_goes_by_nothing():
    assert seen(logs()).goes_by_place() == 0.0
    weak = seen(logs(add=lambda run, seed: 0.008 * pulled(run.motion[0])))
    assert weak.goes_by_place() == 0.0
