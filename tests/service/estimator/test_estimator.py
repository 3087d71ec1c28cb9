"""The whole step on motion with a known answer, and on samples that no bus should send."""

import numpy as np
import pytest

from schemas.messages import REFERENCE, FeedforwardSource, PayloadEvent, SampleFlag, stamp_ns
from service.estimator.estimator import Estimator, compile_all, rate_of
from tests.known import PERIOD


def faults(feedforward):
    """Flags of the samples alone: what was done to the torque (held at a bound as it sets in, faded) left out."""
    return feedforward["flags"] & ~np.uint32(SampleFlag.LIMITED | SampleFlag.FADING)


def concatenated(results):
    return [np.concatenate([getattr(r, name) for r in results]) for name in ("feedforward", "payload", "error")]


def test_one_by_one_in_batches_and_all_at_once_give_the_same_bits(robot, make):
    samples = make(1.0, payload=lambda t: 2.0 * (t > 0.5), noise=0.25).samples
    whole = Estimator(robot, PERIOD).run(samples)
    single, batches = Estimator(robot, PERIOD), Estimator(robot, PERIOD)
    one_by_one = concatenated([single.run(samples[n : n + 1]) for n in range(len(samples))])
    in_batches = concatenated([batches.run(part) for part in np.split(samples, [1, 8, 9, 400, 730])])
    for name, a, b in zip(("feedforward", "payload", "error"), one_by_one, in_batches, strict=True):
        expected = getattr(whole, name).tobytes()
        assert a.tobytes() == expected
        assert b.tobytes() == expected


def test_a_message_at_a_time_gives_the_same_bits_and_says_when_the_lag_line_is_full(robot, make):
    samples = make(1.0, payload=lambda t: 2.0 * (t > 0.5), noise=0.25).samples
    samples["position"][700] = np.nan
    whole, single = Estimator(robot, PERIOD).run(samples), Estimator(robot, PERIOD)
    told, flags, events = {"feedforward": b"", "payload": b"", "error": b""}, [], []
    for n in range(len(samples)):
        flags.append(single.step(samples[n : n + 1].tobytes()))
        told["feedforward"] += single.feedforward.tobytes()
        if n < 800 and (event := single.look_back()) >= 0:  # left out, it is done all the same
            events.append(event)
            told["payload"] += single.payload.tobytes()
            told["error"] += single.error.tobytes()
    for name, answers in told.items():
        assert answers == getattr(whole, name).tobytes()[: len(answers)]
    assert (len(told["feedforward"]), flags) == (whole.feedforward.nbytes, whole.feedforward["flags"].tolist())
    assert events == whole.payload["event"][: len(events)].tolist()
    assert len(events) > 700
    assert single.run(samples[:0]).feedforward.size == 0
    assert single.payload.tobytes() == whole.payload[-1:].tobytes()
    with pytest.raises(ValueError, match="different"):
        single.step(samples[:1].tobytes()[:-1])


def test_feedforward_is_the_torque_of_the_commanded_motion(robot, make):
    known = make(2.0)
    out = Estimator(robot, PERIOD).run(known.samples).feedforward
    assert (out["source"][40:] == FeedforwardSource.COMMAND).all()
    moving = np.abs(known.theta_dot) > 0.05
    error = np.where(moving, out["torque"] - known.torque, 0)[100:]
    assert np.sqrt(np.mean(error**2)) < 0.005 * np.sqrt(np.mean(known.torque**2))


def test_feedforward_without_commands_follows_the_estimate(robot, make):
    known = make(2.0)
    known.samples["position_command"] = np.nan
    out = Estimator(robot, PERIOD).run(known.samples).feedforward
    assert (out["source"][40:] == FeedforwardSource.ESTIMATE).all()
    assert (faults(out) == SampleFlag.NO_COMMAND).all()
    error = np.where(np.abs(known.theta_dot) > 0.05, out["torque"] - known.torque, 0)[100:]
    assert np.sqrt(np.mean(error**2)) < 0.01 * np.sqrt(np.mean(known.torque**2))


def test_feedforward_for_the_planned_motion_is_for_its_cycle(robot, make):
    known = make(1.0)
    estimator = Estimator(robot, PERIOD)
    plan = REFERENCE.empty(1)[0]
    for n in range(200, 220):
        plan["sequence"], plan["position"] = n + 1, known.theta[n + 1]
        plan["velocity"], plan["acceleration"] = known.theta_dot[n + 1], known.theta_ddot[n + 1]
        estimator.plan(plan)
        out = estimator.run(known.samples[n : n + 1]).feedforward[0]
        assert (out["source"], out["target_sequence"]) == (FeedforwardSource.REFERENCE, n + 1)
        assert np.abs(out["torque"] - known.torque[n + 1]).max() < 1e-9
    stale = estimator.run(known.samples[220:222]).feedforward
    assert (stale["source"] != FeedforwardSource.REFERENCE).all()


def test_errors_of_the_models_are_what_each_leaves_out(robot, make):
    known = make(2.0)
    error = Estimator(robot, PERIOD).run(known.samples).error
    rows = error["sequence"].astype(int)
    assert (np.diff(rows) == 1).all()
    assert (stamp_ns(error) == stamp_ns(known.samples)[rows]).all()
    settled = (rows > 100)[:, None] & (np.abs(known.theta_dot[rows]) > 0.05)
    assert np.abs(error["full"][settled]).max() < 0.25, "less than the noise of a torque sample"
    friction = known.theta_dot * robot.identified.viscous_friction_nms.value + np.sign(known.theta_dot) * np.array(
        robot.identified.coulomb_friction_nm.value
    )
    difference = error["id"] - error["id_friction"]
    assert np.abs((difference - friction[rows])[settled]).max() < 0.01
    assert np.std(error["kh"][settled]) > np.std(error["id"][settled]) > np.std(error["id_friction"][settled])


@pytest.mark.parametrize("mass", [0.3, 1.0, 3.8])
def test_picks_and_releases_are_found_and_weighed(robot, make, mass):
    picks = [(1.0, 1.8), (2.5, 3.3), (4.0, 4.8)]
    known = make(5.5, payload=lambda t: mass * sum((t >= a) & (t < b) for a, b in picks), noise=0.25)
    payload = Estimator(robot, PERIOD).run(known.samples).payload
    time = stamp_ns(payload) * 1e-9
    events = [(PayloadEvent(int(payload["event"][n])), time[n]) for n in np.flatnonzero(payload["event"])]
    assert [kind for kind, _ in events] == [PayloadEvent.PICK, PayloadEvent.RELEASE] * len(picks)
    for (_, found), (_, lost), (on, off) in zip(events[::2], events[1::2], picks, strict=True):
        assert on <= found < on + 0.15
        assert off <= lost < off + 0.15
    for on, off in picks:
        held = (time > on + 0.15) & (time < off)
        assert np.abs(payload["mass"][held] - mass).max() < max(0.05 * mass, 0.05)
        assert payload["trusted"][held].mean() > 0.9
        last = np.flatnonzero(held)[-1]
        assert abs(payload["mass"][last] - mass) < 5 * payload["std_dev"][last] + 0.005


def test_feedforward_carries_the_payload(robot, make):
    known = make(3.0, payload=lambda t: 3.0 * (t >= 1.0), noise=0.25)
    out = Estimator(robot, PERIOD).run(known.samples).feedforward
    error = np.where(np.abs(known.theta_dot) > 0.05, out["torque"] - known.torque, 0)[1500:]
    assert np.sqrt(np.mean(error**2)) < 0.01 * np.sqrt(np.mean(known.torque**2))


def test_nothing_is_trusted_and_nothing_winds_up_at_rest(robot, make):
    """Ten minutes at standstill: no information, no event, a bounded covariance; then the first motion is used."""
    moving = make(1.0, payload=lambda t: 2.0 + 0 * t, noise=0.25)
    rest = np.repeat(moving.samples[:1], 600_000)
    rest["sequence"] = np.arange(len(rest))
    rest["stamp_sec"], rest["stamp_nanosec"] = np.divmod(np.arange(len(rest), dtype=np.int64) * 1_000_000, 10**9)
    estimator = Estimator(robot, PERIOD)
    still = estimator.run(rest).payload
    assert not still["trusted"].any()
    assert not still["event"].any()
    assert np.isfinite(still["mass"]).all()
    assert (still["std_dev"] <= 2.0 + 1e-12).all()
    moving.samples["sequence"] += np.uint64(len(rest))
    moving.samples["stamp_sec"] += 600
    after = estimator.run(moving.samples).payload
    assert abs(after["mass"][-1] - 2.0) < 0.05


def test_ten_minutes_of_free_motion_hold_no_pick(robot, make):
    payload = Estimator(robot, PERIOD).run(make(600.0, noise=0.25).samples).payload
    assert not payload["event"].any()
    assert np.abs(payload["mass"][2000:]).max() < 0.1


def broken(known, row, field, value):
    samples = known.samples.copy()
    samples[field][row] = value
    return samples


@pytest.mark.parametrize(
    ("field", "value", "flag"),
    [
        ("position", [np.nan, 0.4, 0.4], SampleFlag.NOT_A_NUMBER),
        ("torque", [1.0, np.inf, 1.0], SampleFlag.NOT_A_NUMBER),
        ("position", [25.0, 30.0, 12.0], SampleFlag.OUT_OF_RANGE),
        ("position", [1.2, 1.2, -0.4], SampleFlag.JUMP),
    ],
    ids=["nan position", "inf torque", "degrees", "jump"],
)
def test_a_bad_sample_is_flagged_and_coasted_over(robot, make, field, value, flag):
    known = make(2.0, noise=0.25)
    good = Estimator(robot, PERIOD).run(known.samples)
    bad = Estimator(robot, PERIOD).run(broken(known, 1000, field, value))
    assert bad.feedforward["flags"][1000] & flag
    assert (np.delete(faults(bad.feedforward), 1000) == 0).all()
    assert np.isfinite(bad.feedforward["torque"]).all()
    assert np.abs(bad.feedforward["torque"] - good.feedforward["torque"])[1000:].max() < 0.6
    at = bad.error["sequence"] == 1000
    assert np.isnan(bad.error["full"][at]).all()
    assert np.isfinite(bad.error["full"][~at]).all()
    assert abs(bad.payload["mass"][-1] - good.payload["mass"][-1]) < 0.02
    assert not bad.payload["event"].any()


def test_repeated_and_late_samples_are_answered_but_not_used(robot, make):
    known = make(2.0, noise=0.25)
    order = np.r_[0:1000, 999, 1000:1200, 1150, 1200:2000]
    result = Estimator(robot, PERIOD).run(known.samples[order])
    assert len(result.feedforward) == len(order)
    flags = faults(result.feedforward)
    assert np.flatnonzero(flags).tolist() == [1000, 1201]
    assert flags[1000] == SampleFlag.REPEATED
    assert flags[1201] == SampleFlag.TIME_BACKWARDS
    assert (result.feedforward["torque"][1000] == result.feedforward["torque"][999]).all()
    clean = Estimator(robot, PERIOD).run(known.samples)
    assert np.delete(result.feedforward, [1000, 1201]).tobytes() == clean.feedforward.tobytes()
    assert result.error.tobytes() == clean.error.tobytes()


@pytest.mark.parametrize("missing", [1, 10, 200])
def test_a_gap_is_flagged_and_survived(robot, make, missing):
    known = make(2.0, noise=0.25)
    kept = np.r_[0:1000, 1000 + missing : 2000]
    result = Estimator(robot, PERIOD).run(known.samples[kept])
    assert np.flatnonzero(faults(result.feedforward)).tolist() == [1000]
    assert faults(result.feedforward)[1000] == SampleFlag.GAP_BEFORE
    after = result.error["sequence"] > 1000 + missing + 60
    assert np.abs(result.error["full"][after]).std() < 1.1 * 0.25
    assert not result.payload["event"].any()


def test_a_hole_in_time_without_one_in_the_sequence_is_a_gap(robot, make):
    """A CSV with rows cut out counts its rows without a hole; the stamps tell."""
    known = make(2.0)
    samples = known.samples[np.r_[0:1000, 1100:2000]].copy()
    samples["sequence"] = np.arange(len(samples))
    flags = faults(Estimator(robot, PERIOD).run(samples).feedforward)
    assert np.flatnonzero(flags).tolist() == [1000]


def test_a_source_that_starts_over_is_followed(robot, make):
    known = make(2.0, noise=0.25)
    twice = np.concatenate([known.samples, known.samples])
    result = Estimator(robot, PERIOD).run(twice)
    second = result.feedforward[2000:]
    assert (faults(second)[3:] == 0).all()
    assert (second["source"][60:] == FeedforwardSource.COMMAND).all()
    error = result.error[result.error["sequence"] > 100]
    assert np.abs(error["full"]).std() < 1.2 * 0.25


def test_a_dead_source_ends_in_zero_torque(robot, make):
    known = make(1.0)
    known.samples["position"][500:] = np.nan
    known.samples["position_command"] = np.nan
    out = Estimator(robot, PERIOD).run(known.samples).feedforward
    assert (out["source"][600:] == FeedforwardSource.NONE).all()
    assert (out["torque"][600:] == 0).all()


def test_garbage_never_gives_a_number_that_is_none(robot):
    """Random bytes in every field: flagged, answered with finite torque."""
    random = np.random.default_rng(0)
    from schemas.messages import SAMPLE

    samples = np.frombuffer(random.bytes(SAMPLE.dtype.itemsize * 5000), SAMPLE.dtype)
    out = Estimator(robot, PERIOD).run(samples).feedforward
    assert np.isfinite(out["torque"]).all()
    assert (out["flags"] != 0).all()


def test_the_period_comes_from_the_stamps(make):
    samples = make(0.1, period=2.5e-4).samples
    assert rate_of(samples) == (pytest.approx(2.5e-4), 1)
    assert rate_of(samples[[0, 1, 2, 5, 6, 9]]) == (pytest.approx(2.5e-4), 1)


def test_once_all_is_compiled_no_second_process_is_started(robot, monkeypatch):
    """One that had nothing to do took a second of a processor at every start."""
    compile_all(robot)
    monkeypatch.setattr("service.estimator.estimator.subprocess", None)
    compile_all(robot)
