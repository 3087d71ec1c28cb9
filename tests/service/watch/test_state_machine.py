"""The watch over motion that is known exactly: it alarms when something changes, and not otherwise."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest

from schemas.fitted import JointParameter
from schemas.messages import GAP, NANOSECONDS, PAYLOAD, Gripper, WatchState, set_stamp, stamp_ns
from schemas.trace import Trace
from service.watch.state_machine import FALLEN, RISEN, Patience, Rise, Watch
from service.watch.watch_node import beyond_description
from tests.service.watch.logs import KNOWN, log, motion, rest_of, stribeck

ONSET = 30.0  # s
IMPATIENT = Patience(learn=18.0, after=12.0)


def through(trace: Trace) -> tuple[Watch, np.ndarray, Rise | None]:
    """The watch, its messages and the first case."""
    one, case = Watch(KNOWN, IMPATIENT), None
    told = []
    for messages in fed(one, trace.samples()):
        told.append(messages)
        case = case or one.rise()
    return one, np.concatenate(told), case


def fed(one: Watch, samples: np.ndarray, payload: np.ndarray | None = None) -> Iterator[np.ndarray]:
    """Messages, samples coming in half seconds and PAYLOAD records at 100 Hz with them."""
    for k in range(0, len(samples), 500):
        some = None if payload is None else payload[k // 10 : k // 10 + 50]
        yield np.concatenate([GAP.empty(0), *one.add(samples[k : k + 500], some)])


def states(told: np.ndarray) -> list[WatchState]:
    return [WatchState(int(state)) for state in told["state"]]


def test_an_unchanged_robot_raises_no_alarm() -> None:
    run = motion(45.0)
    _, told, case = through(log(run, run.torque))
    assert case is None
    assert set(states(told)) == {WatchState.LEARNING, WatchState.WATCHING}
    steady = told[told["state"] == WatchState.WATCHING]
    assert len(steady) > 20
    assert (steady["ratio"] > 1 / RISEN).all()
    assert (steady["ratio"] < FALLEN).all()
    np.testing.assert_allclose(steady["gap"], steady["floor"], rtol=0.15)
    assert (np.diff(told["sequence"].astype(int)) == 1).all()


def test_a_change_raises_the_alarm_once_says_where_and_since_when() -> None:
    run = motion(45.0)
    one, told, case = through(log(run, stribeck(run, ONSET)))
    time = told["stamp_sec"] + told["stamp_nanosec"] * 1e-9
    raised = time[told["state"] == WatchState.RAISED]
    assert ONSET < raised[0] < ONSET + 10.0
    assert (time[(told["state"] == WatchState.WATCHING)] < raised[0]).all()
    assert case is not None
    assert case.since == pytest.approx(ONSET, abs=1.5)
    assert case.joints.tolist() == [False, True, False]
    assert case.before is not None
    assert case.before.time[-1] < ONSET < case.after.time[0]
    assert one.rise() is None  # until it is told that the diagnosis is done, and for ten minutes


def test_what_comes_again_and_again_but_not_in_most_seconds_raises_the_alarm() -> None:
    run = motion(52.0)
    torque = run.torque.copy()
    torque[(run.time > ONSET) & (run.time % 3.3 < 0.25), 1] += 2.0
    _, told, case = through(log(run, torque))
    assert WatchState.RAISED in states(told)
    assert case is not None
    assert case.joints.tolist() == [False, True, False]
    assert case.since == pytest.approx(ONSET, abs=3.3)


def test_two_collisions_in_ten_seconds_raise_no_alarm() -> None:
    """Each on the seam of two looks, so that four have something of them."""
    run = motion(50.0)
    seams = np.array([35.8, 41.8])  # s; what counts of a look ends 0.2 s before the second
    strikes = (np.abs(run.time[:, None] - seams) < 0.05).any(axis=1, keepdims=True)
    _, told, case = through(log(run, run.torque + np.where(strikes, 30.0, 0.0)))
    time = told["stamp_sec"] + told["stamp_nanosec"] * 1e-9
    assert np.isin(seams, time.round(3)).all()
    assert (told["gap"][time > 43] > 10 * told["floor"][time > 43]).any()  # there was something to alarm about
    assert case is None
    assert WatchState.RAISED not in states(told)


def test_what_comes_on_in_a_motion_that_is_new_is_not_learnt_with_it() -> None:
    run, onset = motion(25.0), 8.0
    learning = Watch(KNOWN, Patience(learn=2.0))
    told = np.concatenate(list(fed(learning, log(run, stribeck(run, onset)).samples())))
    time = told["stamp_sec"] + told["stamp_nanosec"] * 1e-9
    assert told["known"][(time > 4) & (time < onset)].max() < 0.9  # and the rest comes while the effect is at work
    np.testing.assert_allclose(told["level"][time > onset, 1], told["floor"][0, 1], rtol=0.3)
    assert WatchState.RAISED in states(told)


def test_a_faster_motion_is_learnt_not_alarmed_about() -> None:
    slow, fast = motion(30.0, 3.0), motion(30.0, 12.0)
    torque = np.concatenate([run.torque + 0.05 * run.motion[2] for run in (slow, fast)])  # kg m^2 not described
    joined = dataclasses.replace(
        log(slow, slow.torque),
        time=np.arange(len(torque)) * 1e-3,
        position=np.concatenate([slow.motion[0], fast.motion[0]]),
        torque=torque + 0.3 * np.random.default_rng(0).standard_normal(torque.shape),
        position_command=None,
        flags=np.zeros(len(torque), np.uint32),
    )
    _, told, case = through(joined)
    assert case is None
    assert WatchState.RAISED not in states(told)
    time = told["stamp_sec"] + told["stamp_nanosec"] * 1e-9
    gap = told["gap"].max(axis=1)
    assert gap[time > 50].mean() > 3 * gap[(time > 20) & (time < 30)].mean()  # there was something to alarm about


def test_what_is_no_motion_of_the_robot_is_no_gap() -> None:
    run = motion(20.0)
    trace = log(run, run.torque)
    samples = trace.samples()
    samples["position"][5000:6000] = np.nan
    samples["torque"][8000] = np.inf
    samples["position"][9000] += 1.0
    told = np.concatenate(list(fed(Watch(KNOWN), samples)))
    assert len(told) > 12
    assert np.isfinite(told["gap"][8:]).all()
    np.testing.assert_allclose(told["gap"][8:], told["floor"][8:], rtol=0.2)


def test_a_robot_at_rest_is_idle_and_keeps_its_level() -> None:
    run = motion(33.0)
    trace = log(run, run.torque)
    rest = rest_of(run, 20.0)
    samples = trace.samples()
    samples["position"][20000:] = rest.motion[0][0]
    _, told, case = through(dataclasses.replace(trace, position=samples["position"]))
    assert case is None
    assert WatchState.RAISED not in states(told)
    assert states(told)[-1] == WatchState.IDLE


def test_a_robot_that_is_stopped_after_the_alarm_is_diagnosed_all_the_same() -> None:
    run, stopped = motion(45.0), 24_000
    samples = log(run, stribeck(run, 12.0)).samples()
    samples["position"][stopped:] = samples["position"][stopped]
    one, cases = Watch(KNOWN, Patience(learn=6.0, after=31.0)), []
    for _ in fed(one, samples):
        cases += [case for case in [one.rise()] if case]
    assert [case.joints.tolist() for case in cases] == [[False, True, False]]


def picked(seconds: float, first: float = 2.0) -> np.ndarray:
    """PAYLOAD records: 1 kg for one second in two, seen 0.1 s late."""
    records = PAYLOAD.empty(round(seconds * 100))
    time = np.arange(len(records)) / 100
    set_stamp(records, np.round(time * NANOSECONDS).astype(np.int64))
    records["mass"] = np.where((time > first) & ((time - 0.1) % 2.0 < 1.0), 1.0, 0.0)
    return records


@pytest.mark.parametrize("told_by", ["estimator", "gripper"])
def test_what_is_carried_is_no_gap(told_by: str) -> None:
    run = motion(30.0)
    carried = (run.time % 2.0 < 1.0) & (run.time > 2.0)
    trace = log(run, run.torque + np.where(carried[:, None], 4.0, 0.0))
    samples, payload = trace.samples(), PAYLOAD.empty(0)
    if told_by == "gripper":
        samples["gripper"] = np.where(carried, Gripper.CLOSED, Gripper.OPEN)
    else:
        payload = picked(30.0)
    told = np.concatenate(list(fed(Watch(KNOWN), samples, payload)))[8:]
    assert len(told) > 15
    np.testing.assert_allclose(told["gap"], told["floor"], rtol=0.25)
    assert (told["moving"] < 6.5).all()  # of ten seconds
    assert (told["moving"] > 2.0).all()


def test_what_the_estimator_doubts_is_no_load_and_does_not_hide_a_change() -> None:
    """A gap that weighs a little, here and there more, as a torque constant that has changed does."""
    run = motion(45.0)
    payload = picked(45.0)
    time = stamp_ns(payload) / NANOSECONDS
    later = time > ONSET
    payload["mass"] += np.where(later, 0.08 + 0.05 * np.sin(3.0 * time), 0.0)
    payload["std_dev"] = np.where(later, 0.07, 0.005)
    carried = (run.time % 2.0 < 1.0) & (run.time > 2.0)
    trace = log(run, stribeck(run, ONSET) + np.where(carried[:, None], 4.0, 0.0))
    told = np.concatenate(list(fed(Watch(KNOWN, Patience(learn=10.0)), trace.samples(), payload)))
    seen = told["stamp_sec"] + told["stamp_nanosec"] * 1e-9
    assert ONSET < seen[told["state"] == WatchState.RAISED][0] < ONSET + 10.0
    assert WatchState.NEW_MOTION not in states(told)
    np.testing.assert_allclose(
        told["moving"][seen > ONSET].mean(), told["moving"][(seen > 20) & (seen < 30)].mean(), rtol=0.1
    )


def test_a_robot_that_is_hardly_ever_empty_is_not_taken_for_empty() -> None:
    run = motion(45.0)
    period = 2.0
    carried = (run.time % period < 1.7) & (run.time > period)
    trace = log(run, run.torque + np.where(carried[:, None] & (run.time[:, None] > ONSET), 4.0, 0.0))
    payload = picked(45.0)
    time = stamp_ns(payload) / NANOSECONDS
    payload["mass"] = np.where((time - 0.1) % period < 1.7, 1.0, 0.0)
    told = np.concatenate(list(fed(Watch(KNOWN, Patience(learn=2.0)), trace.samples(), payload)))
    assert not {WatchState.RAISED, WatchState.NEW_MOTION} & set(states(told))
    assert (told["moving"] < 1.5).all()  # of ten seconds


def test_what_is_picked_with_a_tool_left_on_is_no_gap() -> None:
    run, onset, tool = motion(45.0), 20.0, 1.5  # s, N m
    carried = (run.time % 2.0 < 1.0) & (run.time > 2.0)
    torque = np.where(carried, 4.0, 0.0) + np.where(run.time > onset, tool, 0.0)
    payload = picked(45.0)
    payload["mass"] += np.where(stamp_ns(payload) > onset * NANOSECONDS, 0.3, 0.0)
    samples = log(run, run.torque + torque[:, None]).samples()
    one = Watch(KNOWN, Patience(learn=8.0, after=20.0))
    told = np.concatenate(list(fed(one, samples, payload)))
    assert told["state"][-1] == WatchState.RAISED
    np.testing.assert_allclose(told["gap"][-1], tool, rtol=0.2)
    case = one.rise()
    assert case is not None
    assert case.since == pytest.approx(onset, abs=1.5)


def test_a_payload_of_another_clock_or_without_a_number_changes_nothing() -> None:
    run = motion(25.0)
    carried = (run.time % 2.0 < 1.0) & (run.time > 2.0)
    samples = log(run, run.torque + np.where(carried[:, None], 4.0, 0.0)).samples()
    payload = picked(25.0)
    payload["stamp_sec"][[549, 1249]] = 2**31 - 1, 0  # the newest of what came together
    payload["mass"][830:880] = payload["std_dev"][1430:1480] = np.nan
    told = np.concatenate(list(fed(Watch(KNOWN), samples, payload)))[8:]
    np.testing.assert_allclose(told["gap"], told["floor"], rtol=0.25)


def test_a_mass_that_stays_is_the_robots_own_and_raises_the_alarm() -> None:
    run = motion(45.0)
    trace = log(run, run.torque + np.where(run.time[:, None] > ONSET, 2.0, 0.0))
    payload = picked(45.0, first=ONSET)
    payload["mass"] = np.where(stamp_ns(payload) > ONSET * NANOSECONDS, 1.0, 0.0)
    told = np.concatenate(list(fed(Watch(KNOWN, IMPATIENT), trace.samples(), payload)))
    assert WatchState.RAISED in states(told)


def test_the_level_comes_from_a_reference_log_and_what_differs_on_the_bus_raises_the_alarm_at_once() -> None:
    run = motion(30.0)
    one = Watch(KNOWN)
    one.learn(log(run, run.torque), PAYLOAD.empty(0))
    one.settle()
    assert one.state == WatchState.WATCHING
    worn = log(run, stribeck(run, 0.0)).samples()
    told = np.concatenate(list(fed(one, worn[:12_000])))
    assert WatchState.RAISED in states(told)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_reference_whose_torque_is_turned_round_is_told(sign: int) -> None:
    assert KNOWN.identified is not None
    left = JointParameter(value=[0.02] * 3)
    described = KNOWN.model_copy(update={"identified": KNOWN.identified.model_copy(update={"model_error_nm": left})})
    run, one = motion(20.0), Watch(described)
    one.learn(log(run, sign * run.torque), PAYLOAD.empty(0))
    one.settle()
    assert ("times the residual of the description" in beyond_description(one)) == (sign < 0)


def test_stamps_of_another_clock_and_a_clock_that_begins_anew() -> None:
    run = motion(30.0)
    samples = log(run, run.torque).samples()
    samples["stamp_sec"][[4000, 12000, 12499]] = 2**31 - 1
    one = Watch(KNOWN, Patience(learn=15.0))
    first = np.concatenate(list(fed(one, samples)))
    again = np.concatenate(list(fed(one, samples[:12_000])))
    assert len(first) > 25
    assert first["state"][-1] == WatchState.WATCHING
    assert again["stamp_sec"][-1] < 12
    np.testing.assert_allclose(again["gap"][8:], again["floor"][8:], rtol=0.3)
    assert WatchState.LEARNING not in states(again)
