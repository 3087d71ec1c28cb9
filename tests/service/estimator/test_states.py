"""What effects remember from sample to sample: holes, restarts, stiff gears, and what cannot be carried."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.signal import lsim

from schemas.messages import REFERENCE, SAMPLE, FeedforwardSource, SampleFlag, set_stamp, stamp_ns
from schemas.robot import EffectEntry, EffectParameter
from service.estimator import state
from service.estimator.bounds import bounds_of
from service.estimator.branch import MEASURED
from service.estimator.estimator import Estimator
from service.estimator.left_out import left_out, torque_left_out
from tests.known import PERIOD


def carrying(robot, name, **parameters):
    entry = EffectEntry(
        name=name, joints=[1, 2, 3], parameters={k: EffectParameter(value=v) for k, v in parameters.items()}
    )
    return robot.model_copy(update={"effect": [entry]})


def sliding(robot):
    return carrying(robot, "presliding_friction", f_1=3.0, f_2=3.0, f_3=3.0, distance=0.02)


@pytest.mark.parametrize(("lost", "anew"), [(15, False), (30, True)])
def test_a_state_survives_a_short_hole_and_says_that_it_starts_over_behind_a_longer_one(robot, make, lost, anew):
    samples = make(1.0).samples
    samples = np.delete(samples, slice(500, 500 + lost))
    answers = Estimator(sliding(robot), PERIOD).run(samples)
    behind = answers.feedforward["flags"][500:] & SampleFlag.STATE_NEW
    looked_back = answers.error["flags"][answers.error["sequence"] >= 500] & SampleFlag.STATE_NEW
    assert behind.any() == looked_back.any() == anew
    assert np.count_nonzero(looked_back) == anew, "once"


def test_without_effects_that_remember_nothing_is_said(robot, make):
    samples = np.delete(make(1.0).samples, slice(500, 530))
    answers = Estimator(robot, PERIOD).run(samples)
    assert not (answers.feedforward["flags"] & SampleFlag.STATE_NEW).any()


def test_behind_a_restart_the_torque_is_doubted_until_the_joint_has_moved(robot, make):
    """Bristles, whose place nobody knows, are worth their whole friction at first."""
    estimator, samples = Estimator(sliding(robot), PERIOD), make(0.4).samples
    doubts = []
    for sample in samples:
        estimator.step(sample.tobytes())
        if estimator.look_back() >= 0:
            doubts.append(estimator.state["branch"][MEASURED]["doubt"].copy())
    np.testing.assert_allclose(doubts[0], 9.0)
    assert (doubts[-1] < 1e-3).all()


@pytest.mark.parametrize(
    ("natural_hz", "period"), list(itertools.product((2.0, 20.0, 250.0), (1 / 250, 1e-3, 1 / 8000)))
)
def test_no_stiffness_makes_a_gear_unstable_at_any_rate(robot, make, natural_hz, period):
    """A swing that is left to itself dies out: the torque ends where the rigid robot's does."""
    springy = carrying(robot, "joint_elasticity", natural_hz=natural_hz, damping_ratio=0.2, motor_share=0.3)
    run = make(6.0, period=period, rest=(1.0, 5.9))
    torque, rigid = (Estimator(one, period).run(run.samples).feedforward["torque"] for one in (springy, robot))
    peak = float(state.settings(robot, period, 1)["peak"][0])
    assert np.isfinite(torque).all()
    assert np.abs(torque).max() <= peak
    still = slice(round(5.5 / period), round(5.8 / period))
    # the payload estimate of either, which hears the same reports, may differ by what it is sure of
    np.testing.assert_allclose(torque[still], rigid[still], atol=0.3)


def test_flanks_that_ring_are_carried_without_ringing(robot, make):
    """How they ring goes by the instant of a strike, which no sample tells: lightly damped ones answer as critical
    ones, and those that are damped more as they are."""
    samples = make(2.0).samples

    def reports(damping):
        loose = carrying(robot, "backlash", half=2e-3, contact_hz=45.0, contact_damping=damping, motor_share=0.2)
        return Estimator(loose, PERIOD).run(samples).error["full"]

    light, critical, damped = (reports(ratio) for ratio in (0.05, 1.0, 2.0))
    np.testing.assert_array_equal(light, critical)
    assert np.abs(damped - critical).max() > 0.1


@pytest.mark.parametrize("lost", [np.nan, 1e300, 2.0])
def test_a_twist_that_leads_nowhere_is_begun_anew(robot, make, lost):
    """NaN, beyond all numbers, out of the workspace: the next samples are answered, and nothing of it stays."""
    springy = carrying(robot, "joint_elasticity", natural_hz=20.0, damping_ratio=0.2, motor_share=0.3)
    estimator, samples = Estimator(springy, PERIOD), make(0.6).samples
    for number, sample in enumerate(samples):
        if number == 300:
            estimator.state["branch"]["twist"]["angle"][:] = lost
        estimator.step(sample.tobytes())
        estimator.look_back()
    assert np.isfinite(estimator.feedforward["torque"]).all()
    assert estimator.feedforward["source"][0] == FeedforwardSource.COMMAND
    assert np.isfinite(estimator.error["full"]).all()
    assert np.isfinite(estimator.payload["mass"]).all()


def test_a_delay_that_reaches_too_far_is_left_out_by_name_and_counts_as_an_error(robot):
    late = carrying(robot, "torque_delay", delay=0.02)
    late = late.model_copy(update={"effect": [late.effect[0].model_copy(update={"joints": []})]})
    assert left_out(late, PERIOD) == {}
    period = 1 / 8000
    assert list(left_out(late, period)) == ["torque_delay"]
    assert (torque_left_out(late, period) > 1.0).all()
    without, with_it = (state.settings(one, period, 1) for one in (robot, late))
    assert (with_it["variance"] > 2 * without["variance"]).all()
    assert with_it["readout"]["active"] == 0


def test_behind_a_pick_soft_gears_are_doubted_for_a_swing(robot, make):
    """By what the load pulls on a joint that moves, from the sample on that shows it."""
    soft = carrying(robot, "joint_elasticity", natural_hz=15.0, damping_ratio=0.03, motor_share=0.3)
    estimator, doubts, masses = Estimator(soft, PERIOD), [], []
    for sample in make(1.3, payload=lambda time: 2.0 * (time > 1.0), noise=0.1).samples:
        estimator.step(sample.tobytes())
        if estimator.look_back() >= 0:
            doubts.append(np.sqrt(estimator.state["branch"][MEASURED]["doubt"][0]))
            masses.append(float(estimator.payload["mass"][0]))
    found = int(np.argmax(np.array(masses) > 0.3))
    assert abs(found * PERIOD - 1.0) < 0.05
    assert max(doubts[found - 50 : found - 1]) < 0.05
    assert max(doubts[found : found + 3]) > 1.5
    assert doubts[-1] < 0.05


@pytest.mark.parametrize("load", [(3.0, 0.0), (1.0, 2.5)], ids=["release", "another"])
def test_behind_a_filter_of_the_report_a_load_is_weighed_without_what_is_left_of_the_one_before(robot, make, load):
    """To 2 % of the change within 30 ms of it. The filter is another code's, linear between samples."""
    cutoff, before, after = 50.0, *load
    made = make(1.3, payload=lambda time: np.where(time < 1.0, before, after), noise=0.0)
    lag, samples = 1 / (2 * np.pi * cutoff), made.samples.copy()
    for torque in samples["torque"].T:
        torque[:] = lsim(([1.0], [lag, 1.0]), torque, np.arange(len(torque)) * PERIOD, X0=lag * torque[:1])[1]
    samples["torque"] += 0.05 * np.random.default_rng(3).standard_normal(samples["torque"].shape)
    parameters = {"cutoff": EffectParameter(value=cutoff, unit="Hz")}
    filtered = robot.model_copy(
        update={"effect": [EffectEntry(name="torque_filter", joints=[], parameters=parameters)]}
    )
    answers = Estimator(filtered, PERIOD).run(samples).payload
    time = stamp_ns(answers) * 1e-9 - stamp_ns(samples)[0] * 1e-9
    soon, later = (time > 1.03) & (time < 1.05), time > 1.15
    assert np.abs(answers["mass"][soon] - after).max() < 0.02 * abs(after - before)
    assert answers["trusted"][later].mean() > 0.8


def planned(estimator, sequence, position, known):
    """The answer to a sample at rest at `position` (3,), with a plan to stay there if it is `known`."""
    sample = SAMPLE.empty(1)[0]
    set_stamp(sample, sequence * round(PERIOD * 1e9))
    sample["sequence"], sample["position"], sample["torque"] = sequence, position, 0.0
    sample["position_command"] = sample["torque_command"] = np.nan
    if known:
        plan = REFERENCE.empty(1)[0]
        plan["sequence"], plan["position"], plan["velocity"], plan["acceleration"] = sequence + 1, position, 0.0, 0.0
        estimator.plan(plan)
    estimator.step(sample.tobytes())
    estimator.look_back()
    return estimator.feedforward[0].copy()


def test_motors_go_before_a_plan_by_what_holds_the_links_over_the_stiffness_and_come_back_without_one(robot):
    soft = carrying(robot, "joint_elasticity", natural_hz=15.0, damping_ratio=0.03, motor_share=0.3)
    estimator, here = Estimator(soft, PERIOD), np.array([0.4, 0.5, 0.3])
    rigid = Estimator(robot, PERIOD)
    answers = [planned(estimator, n, here, n < 60) for n in range(200)]
    held = planned(rigid, 0, here, True)["torque"]
    for n in range(1, 60):
        held = planned(rigid, n, here, True)["torque"]
    stiffness = estimator._steps["settings"][0]["gears"]["stiffness"]
    np.testing.assert_allclose(answers[59]["torque"], held, atol=0.05 * np.abs(held).max())
    np.testing.assert_allclose(
        answers[59]["position_offset"], held / stiffness, atol=0.05 * np.abs(held / stiffness).max()
    )
    offsets = np.array([answer["position_offset"] for answer in answers])
    bounds = bounds_of(robot)
    assert (np.abs(np.diff(offsets, axis=0)) <= bounds.slope_nmps * PERIOD / stiffness * (1 + 1e-9)).all()
    assert not offsets[-1].any(), "back"
    assert not np.array([planned(rigid, n, here, True)["position_offset"] for n in range(60, 63)]).any()
