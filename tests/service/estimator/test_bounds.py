"""The feed-forward torque is safe whatever comes in: bounded, never from a command that is no motion, faded on loss."""

import numpy as np
import pytest

from schemas.messages import REFERENCE, FeedforwardSource, SampleFlag
from service.estimator.bounds import bounds_of
from service.estimator.estimator import Estimator
from tests.hostile import hostile, not_finite, reference
from tests.known import PERIOD

FADE = 0.05  # s, the default


def limited(robot, **limits):
    return robot.model_copy(update={"limits": robot.limits.model_copy(update=limits)})


def within(robot, torque, period=PERIOD):
    bounds = bounds_of(robot)
    assert np.isfinite(torque).all()
    assert np.abs(torque).max() <= bounds.peak_nm
    assert (np.abs(np.diff(torque, axis=0)) <= bounds.slope_nmps * period * (1 + 1e-9)).all()


def test_default_bounds_carry_a_hard_move_and_no_more(robot, make):
    bounds = bounds_of(robot)
    assert 200 < bounds.peak_nm < 600, "a robot of 0.36 m arms with 6 kg at 10 g"
    assert bounds.slope_nmps * 0.02 == pytest.approx(2 * bounds.peak_nm)
    light = bounds_of(limited(robot, max_payload_kg=1.0))
    assert light.peak_nm < 0.6 * bounds.peak_nm
    assert bounds_of(limited(robot, peak_torque_nm=80.0, torque_slope_nmps=5e3)) == (80.0, 5e3)


def test_a_healthy_move_is_not_touched_not_even_where_friction_turns(robot, make):
    """Slope as low as the move's own without friction: reversals of 10 N m go through in their cycle."""
    known = make(2.0)
    plain = Estimator(robot, PERIOD).run(known.samples).feedforward["torque"]
    smooth = np.abs(np.diff(plain, axis=0))
    assert smooth.max() > 3.0, "there are reversals"
    slope = 1.3 * np.quantile(smooth[100:], 0.97) / PERIOD
    assert slope * PERIOD < 0.2 * smooth.max()
    bound = limited(robot, torque_slope_nmps=float(slope), peak_torque_nm=float(1.01 * np.abs(plain).max()))
    out = Estimator(bound, PERIOD).run(known.samples).feedforward
    begun = 200
    assert np.abs(out["torque"] - plain)[begun:].max() < 0.3 * smooth.max()
    assert np.sqrt(np.mean((out["torque"] - plain)[begun:] ** 2)) < 0.02


def test_peak_and_slope_hold_the_torque_and_say_so(robot, make):
    known = make(2.0)
    plain = Estimator(robot, PERIOD).run(known.samples).feedforward["torque"]
    bound = limited(robot, peak_torque_nm=20.0, torque_slope_nmps=15e3)
    out = Estimator(bound, PERIOD).run(known.samples).feedforward
    within(bound, out["torque"])
    assert np.abs(plain).max() > 40
    over = (np.abs(plain) > 20.0).any(axis=1) & (np.arange(2000) > 20)
    assert (out["flags"][over] & SampleFlag.LIMITED != 0).all()
    assert (out["flags"][100:] & SampleFlag.LIMITED == 0).any()


@pytest.mark.parametrize(
    ("rows", "value", "flag"),
    [
        (slice(1000, 1001), 0.0, SampleFlag.COMMAND_JUMP),
        (slice(1000, 1001), 9.0, SampleFlag.COMMAND_OUT_OF_RANGE),
        (slice(1000, 1001), 1e308, SampleFlag.COMMAND_OUT_OF_RANGE),
        (slice(1000, 1001), np.inf, SampleFlag.COMMAND_OUT_OF_RANGE),
        (slice(1000, 1005), np.nan, SampleFlag.NO_COMMAND),
    ],
    ids=["zero", "out of range", "huge", "infinite", "missing"],
)
def test_a_broken_command_is_flagged_and_bridged(robot, make, rows, value, flag):
    known = make(2.0)
    expected = Estimator(robot, PERIOD).run(known.samples).feedforward["torque"]
    known.samples["position_command"][rows, 0] = value
    out = Estimator(robot, PERIOD).run(known.samples).feedforward
    assert (out["flags"][rows] == flag).all()
    assert (np.delete(out["flags"], np.r_[20, rows]) == 0).all()
    assert (out["source"][20:] == FeedforwardSource.COMMAND).all()
    assert np.abs(out["torque"] - expected).max() < 0.1 * np.abs(expected).max()


def test_a_command_that_stays_away_gives_way_to_the_estimate_and_comes_back_settled(robot, make):
    """Bridged for 20 ms; 60 ms later its filter starts anew."""
    known = make(1.0)
    known.samples["position_command"][400:460, 1] = np.nan
    out = Estimator(robot, PERIOD).run(known.samples).feedforward
    expected = np.full(1000, FeedforwardSource.COMMAND)
    expected[420:480] = FeedforwardSource.ESTIMATE
    np.testing.assert_array_equal(out["source"][40:], expected[40:])
    assert (out["flags"][400:460] == SampleFlag.NO_COMMAND).all()
    assert (out["flags"][460:] == 0).all()
    plain = Estimator(robot, PERIOD).run(make(1.0).samples).feedforward["torque"]
    assert np.abs(out["torque"] - plain)[400:].max() < 0.05 * np.abs(plain).max()


def test_a_step_of_the_command_is_not_differentiated(robot, make):
    """0.3 rad at once, and on from there: the torque is that of the estimate until the new commands have settled."""
    known = make(2.0)
    plain = Estimator(robot, PERIOD).run(known.samples).feedforward["torque"]
    known.samples["position_command"][1000:] += 0.3
    out = Estimator(robot, PERIOD).run(known.samples).feedforward
    within(robot, out["torque"])
    assert (out["flags"][1000:1003] & SampleFlag.COMMAND_JUMP != 0).all()
    assert (out["flags"][1003:] == 0).all()
    assert np.abs(out["torque"] - plain)[1000:].max() < 0.5 * np.abs(plain).max(), "no more than another pose asks for"


def test_the_seam_of_a_loop_gives_no_blow(robot, make):
    known = make(1.3)
    looped = np.concatenate([known.samples, known.samples, known.samples])
    out = Estimator(robot, PERIOD).run(looped).feedforward
    within(robot, out["torque"])
    assert np.abs(out["torque"]).max() < 1.2 * np.abs(known.torque).max()


@pytest.mark.parametrize("how", ["not a number", "repeated for ever", "late for ever"])
def test_without_usable_motion_the_torque_fades(robot, make, how):
    """From the last torque to zero in a straight line, in the declared time, and back when samples are good again."""
    known = make(1.5)
    samples = known.samples
    samples["position_command"] = np.nan
    plain = Estimator(robot, PERIOD).run(samples).feedforward["torque"]
    lost = slice(600, 800)
    if how == "not a number":
        samples["position"][lost] = np.nan
    elif how == "repeated for ever":
        samples[lost] = samples[599]
    else:
        samples[lost] = samples[300]
    out = Estimator(robot, PERIOD).run(samples).feedforward
    torque, fading = out["torque"], out["flags"] & SampleFlag.FADING != 0
    first = int(np.flatnonzero(fading)[0])
    assert 600 + 15 <= first <= 600 + 25, "a few broken samples are bridged"
    assert (out["source"][fading] == FeedforwardSource.NONE).all()
    steps = np.diff(torque[first - 1 : first + 49], axis=0)
    np.testing.assert_allclose(steps, -torque[first - 1] * PERIOD / FADE * np.ones((49, 1)), atol=1e-9)
    assert (torque[first + 50 : 800] == 0).all()
    within(robot, torque)
    assert np.abs(torque - plain)[850:].max() < 0.02 * np.abs(plain).max(), "back within 50 ms"


def test_a_fade_as_long_as_declared(robot, make):
    known = make(1.0)
    known.samples["position_command"] = np.nan
    known.samples["position"][500:] = np.nan
    out = Estimator(limited(robot, torque_fade_s=0.2), PERIOD).run(known.samples).feedforward
    assert np.count_nonzero(out["flags"] & SampleFlag.FADING) in (199, 200)


@pytest.mark.parametrize(
    ("field", "value", "flag"),
    [
        ("position", np.nan, SampleFlag.COMMAND_OUT_OF_RANGE),
        ("position", 2.5, SampleFlag.COMMAND_OUT_OF_RANGE),
        ("position", -1.4, SampleFlag.COMMAND_JUMP),
        ("velocity", 50.0, SampleFlag.COMMAND_JUMP),
        ("velocity", np.inf, SampleFlag.COMMAND_JUMP),
        ("acceleration", 1e308, SampleFlag.COMMAND_JUMP),
    ],
)
def test_a_plan_that_no_joint_could_follow_is_refused(robot, make, field, value, flag):
    known = make(1.0)
    estimator = Estimator(robot, PERIOD)
    estimator.run(known.samples[:500])
    plan = REFERENCE.empty(1)[0]
    plan["sequence"], plan["position"] = 501, known.theta[501]
    plan["velocity"], plan["acceleration"] = known.theta_dot[501], known.theta_ddot[501]
    plan[field][1] = value
    estimator.plan(plan)
    out = estimator.run(known.samples[500:502]).feedforward
    assert (out["source"] == FeedforwardSource.COMMAND).all()
    assert out["flags"].tolist() == [flag, 0]


def test_hostile_streams_leave_the_torque_bounded_and_the_state_whole(robot, make):
    """Also a bench of millions: tests/bench/bench_hostile_step.py."""
    strike(robot, make(1.0, noise=0.25).samples, np.random.default_rng(11), rounds=150)


def strike(robot, good, random, rounds, left=0.05):
    """Rounds of a hostile stream and a good one, 50 ms into which at most `left` of the largest torque is wrong; returns
    how many samples that were."""
    estimator, expected = Estimator(robot, PERIOD), Estimator(robot, PERIOD).run(good).feedforward["torque"]
    count = 0
    last = np.zeros((1, 3))
    for _ in range(rounds):
        bad = hostile(random, good, int(random.integers(50, 1000)))
        begin = int(random.integers(0, max(1, len(good) - 400)))
        well = good[begin : begin + 400].copy()
        well["sequence"] += random.integers(2**64, dtype=np.uint64)
        well["stamp_sec"] += random.integers(0, 2**20, dtype=np.int32)
        for samples in np.split(bad, [len(bad) // 2]):
            out = estimator.run(samples).feedforward
            assert np.isfinite(out["torque"]).all()
            assert np.abs(out["torque"]).max() <= bounds_of(robot).peak_nm
            jump = np.abs(np.diff(np.concatenate([last, out["torque"]]), axis=0)).max(axis=1)
            # within a cycle only as far as the slope goes; over a hole in stamps or sequence further
            unbroken = out["flags"] & SampleFlag.GAP_BEFORE == 0
            assert (jump[unbroken] <= bounds_of(robot).slope_nmps * PERIOD * 1.001).all()
            last = out["torque"][-1:]
            estimator.plan(reference(random, int(samples["sequence"][-1])))
            assert not_finite(estimator.state) == []
        out = estimator.run(well)
        last = out.feedforward["torque"][-1:]
        assert np.isfinite(out.payload["mass"]).all()
        off = np.abs(out.feedforward["torque"] - expected[begin : begin + 400])
        assert off[50:].max() < left * np.abs(expected).max(), "recovered in 50 ms"
        count += len(bad) + len(well)
    return count
