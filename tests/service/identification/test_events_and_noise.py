"""Events and the noise floor against signals in which they were put."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from schemas.trace import Trace
from tests.service.subject import Band, DecoupledAxes, Recording, events, noise, segments
from tests.service.world import PERIOD, course, direction, problem, sines

STEP = 5e-3  # s, rows of the analysis band


def quiet(name: str, joint: int, seed: int, seconds: float = 10.0) -> events.JointRun:
    time = np.arange(round(seconds / STEP)) * STEP
    slow = 2.0 * np.sin(2.0 * time)  # a model's own error: large and slow
    return events.JointRun(name, joint, time, slow + 0.1 * np.random.default_rng(seed).standard_normal(len(time)))


def knocked(run: events.JointRun, *moments: float, size: float = 2.0, width: float = 0.02) -> events.JointRun:
    error = run.error.copy()
    for moment in moments:
        near = np.abs(run.time - moment) <= width
        error[near] += size * np.where(np.arange(near.sum()) % 2, 1, -1)
    return replace(run, error=error)


FLOOR = np.array([0.2, 0.2])


def test_a_knock_is_an_event_and_a_slow_error_is_none():
    runs = [quiet("a", 0, 1), knocked(quiet("b", 1, 2), 3.0, 7.5)]
    found = events.events(runs, FLOOR)
    assert [(event.run, event.joint) for event in found] == [("b", 1)] * 2
    for event, moment in zip(found, (3.0, 7.5), strict=True):
        assert moment - 0.06 <= event.start < moment < event.end <= moment + 0.06
        assert 1.0 < event.level < 2.5
    assert events.events([quiet("a", 0, 1)], FLOOR) == []


def test_nothing_below_the_floor_is_an_event():
    runs = [knocked(quiet("b", 0, 2), 3.0)]
    assert len(events.events(runs, FLOOR)) == 1
    assert events.events(runs, np.array([3.0, 3.0])) == []


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [17.0, 1e3, 1e6])
def test_the_level_behind_a_strong_event_is_a_number(size: float) -> None:
    """What a running sum rounds off may be less than none."""
    time = np.arange(2000) * 2e-3
    for rows in (97, 301, 450):
        error = np.zeros(2000)
        error[200 : 200 + rows] = size * np.sin(1.3 * np.arange(rows))
        assert np.isfinite(events._level(events.JointRun("run", 0, time, error))).all()


@pytest.mark.parametrize(("above", "seen"), [(3.4, 0), (3.6, 1)])
def test_an_event_stands_three_and_a_half_times_above_the_median_of_the_level(above: float, seen: int):
    time = np.arange(2000) * STEP
    error = np.where(np.abs(time - 5.0) < 0.2, above, 1.0) * np.where(np.arange(2000) % 2, 1, -1)
    assert len(events.events([events.JointRun("a", 0, time, error)], FLOOR)) == seen


def test_near_stretches_are_one_and_the_end_of_a_stretch_of_rows_ends_it():
    assert len(events.events([knocked(quiet("b", 0, 2), 3.0, 3.1)], FLOOR)) == 1
    assert len(events.events([knocked(quiet("b", 0, 2), 3.0, 3.19)], FLOOR)) == 2  # 90 ms without
    run = quiet("b", 0, 2)
    gone = (run.time < 3.0) | (run.time > 3.3)
    # a step over a pause in the rows is two stretches with another mean, no event
    error = np.where(run.time > 3.2, 5.0, 0.0) + 0.1 * np.random.default_rng(0).standard_normal(len(run.time))
    assert events.events([events.JointRun("b", 0, run.time[gone], error[gone])], FLOOR) == []
    assert len(events.events([events.JointRun("b", 0, run.time, error)], FLOOR)) == 1


def test_events_are_told_in_the_order_of_time_and_a_run_of_one_row_is_passed_over():
    runs = [
        knocked(quiet("a", 1, 1), 5.0),
        knocked(quiet("a", 0, 2), 2.0),
        events.JointRun("c", 0, np.zeros(1), np.ones(1)),
    ]
    assert [event.joint for event in events.events(runs, FLOOR)] == [0, 1]
    assert events.events([events.JointRun("c", 0, np.zeros(1), np.ones(1))], FLOOR) == []
    assert [event.joint for event in events.events([runs[2], runs[0]], FLOOR)] == [1]


def test_what_an_event_touches_is_left_out_with_a_margin():
    event = events.Event("a", 0, 2.0, 2.5, 1.0)
    time = np.array([1.96, 1.98, 2.2, 2.52, 2.54])
    assert events.outside("a", time, [event]).tolist() == [True, False, False, False, True]
    assert events.outside("b", time, [event]).all()


def test_rows_too_far_apart_show_nothing_fast():
    """Ten a second: no level over 60 ms can be taken of them."""
    time = 0.1 * np.arange(100)
    assert events.events([events.JointRun("a", 0, time, np.where(np.arange(100) == 40, 50.0, 0.1))], FLOOR) == []


def test_a_knock_on_one_row_of_twenty_a_second_is_as_long_as_the_mean_taken_out():
    """0.12 s are two rows, 0.06 s one: the row and its neighbour stand out, no third."""
    time = 0.049 * np.arange(100)
    (event,) = events.events([events.JointRun("a", 0, time, np.where(np.arange(100) == 40, 50.0, 0.1))], FLOOR)
    assert (event.start, event.end) == pytest.approx((40 * 0.049, 41 * 0.049))


def beats(moments) -> list[events.Event]:
    return [events.Event("a", 0, float(m) - 0.01, float(m) + 0.01, 1.0) for m in moments]


def test_a_rhythm_is_its_period():
    random = np.random.default_rng(0)
    even = 1.0 + 0.8 * np.arange(12)
    assert events.rhythm(beats(even)) == pytest.approx(0.8, rel=0.01)
    assert events.rhythm(beats(even + 0.02 * random.standard_normal(12))) == pytest.approx(0.8, rel=0.02)
    missing = np.delete(even, [3, 7])
    assert events.rhythm(beats(missing)) == pytest.approx(0.8, rel=0.02)
    assert events.rhythm(beats(np.sort(random.uniform(0, 10, 12)))) is None
    assert events.rhythm(beats(even[:5])) is None
    for period in np.linspace(0.7, 0.9, 21):  # known to half a tenth of a beat over all of them
        moments = 1.0 + period * np.arange(12)
        assert events.rhythm(beats(moments)) == pytest.approx(period, rel=0.051 * period / np.ptp(moments))


def test_events_of_residuals_are_in_units_of_torque_and_noise():
    runs = [course(1, 3.0), course(2, 3.0)]
    logs = replace(problem(runs, [run.torque for run in runs]), sigma=np.array([0.1, 0.2, 0.4]))
    residuals = [np.random.default_rng(k).standard_normal(int(r.sum())) * 0.3 for k, r in enumerate(logs.rows)]
    joint = logs.joints_of_rows[1]
    mine = np.flatnonzero(joint == 2)
    residuals[1][mine[200:206]] += 20 * np.array([1, -1, 1, -1, 1, -1])
    (event,) = events.events_of(logs, residuals)
    time = logs.recordings[1].segment.time[:: logs.band.step][logs.rows[1][:, 2]]
    assert (event.run, event.joint) == ("run_1", 2)
    assert event.start - 0.05 < time[200] < time[205] < event.end + 0.05
    (burst,) = events.bursts(logs, [event])
    assert (burst.run, burst.joint) == ("run_1", 3)
    assert burst.over_noise == pytest.approx(event.level / 0.4, abs=0.01)
    assert (burst.from_s, burst.to_s) == pytest.approx((event.start, event.end), abs=1e-3)
    assert 5.0 < burst.over_noise < 20.0
    first = np.flatnonzero(logs.joints_of_rows[0] == 0)
    knock = np.array([1, -1, 1, -1, 1, -1])
    for size, count in ((2.0, 1), (20.0, 2)):  # twice the noise is none yet
        residuals[0][first[100:106]] = size * knock
        assert len(events.events_of(logs, residuals)) == count


@pytest.mark.parametrize("sigma", [[0.05, 0.3, 2.0]])
def test_the_noise_floor_is_what_was_added(sigma):
    random = np.random.default_rng(3)
    runs = [course(seed, 4.0) for seed in (1, 2)]
    torques = [run.torque + np.array(sigma) * random.standard_normal(run.torque.shape) for run in runs]
    logs = problem(runs, torques)
    # friction's jumps reach above 250 Hz, so the quiet torque itself is a little louder; the residual is not
    left = [torque - run.torque for torque, run in zip(torques, runs, strict=True)]
    np.testing.assert_allclose(noise.white_noise(logs.recordings, left), sigma, rtol=0.05)
    np.testing.assert_allclose(noise.white_noise(logs.recordings)[1:], sigma[1:], rtol=0.05)


def test_chatter_in_some_of_the_time_is_not_the_floor():
    random = np.random.default_rng(4)
    logs = problem([course(1, 4.0)], [course(1, 4.0).torque])
    values = 0.3 * random.standard_normal((4000, 3))
    values[1000:2600] += 2.0 * random.standard_normal((1600, 3))
    np.testing.assert_allclose(noise.white_noise(logs.recordings, [values]), 0.3, rtol=0.1)
    values = 0.3 * random.standard_normal((4000, 3))  # and where it is no more than half as loud again
    values[1000:2600] *= 1.5
    np.testing.assert_allclose(noise.white_noise(logs.recordings, [values]), 0.3, rtol=0.1)


def test_what_is_slow_is_no_noise():
    random = np.random.default_rng(5)
    logs = problem([course(1, 4.0)], [course(1, 4.0).torque])
    time = np.arange(4000)[:, None] * PERIOD
    values = 0.3 * random.standard_normal((4000, 3)) + 5.0 + 50 * np.sin(2 * np.pi * 20 * time)
    np.testing.assert_allclose(noise.white_noise(logs.recordings, [values]), 0.3, rtol=0.05)


def test_a_part_too_short_for_a_window_has_no_say():
    random = np.random.default_rng(6)
    logs = problem([course(1, 4.0), course(2, 0.3)], [course(1, 4.0).torque, course(2, 0.3).torque])
    values = [0.3 * random.standard_normal((4000, 3)), 9.0 * random.standard_normal((100, 3))]
    np.testing.assert_allclose(noise.white_noise(logs.recordings, values), 0.3, rtol=0.05)


def test_where_no_part_is_long_enough_no_noise_is_claimed():
    logs = problem([course(2, 0.3)], [course(2, 0.3).torque])
    assert noise.white_noise(logs.recordings, [np.ones((100, 3))]).tolist() == [0.0] * 3


def noisy(level: float, coloured: bool = False):
    """Two logs of two axes with noise of `level` N m, the noise, and the analysis band; coloured: 3 ms of memory."""
    random, made, values = np.random.default_rng(8), [], []
    for seed in (1, 2):
        time = np.arange(5000) * PERIOD
        theta, speed, acceleration = (signal[:, :2] for signal in sines(seed, 0.8)(time))
        torque = 0.5 * acceleration + 0.4 * speed + 0.6 * direction(speed)
        (part,) = segments(Trace(Path(f"run_{seed}"), time, theta, torque))
        made.append(Recording(part, DecoupledAxes(np.ones(2)), seed, f"run_{seed}"))
        values.append(level * random.standard_normal(torque.shape))
    if coloured:
        keep = np.exp(-1.0 / 3.0)
        values = [np.asarray(lfilter([np.sqrt(1 - keep**2)], [1, -keep], value, axis=0)) for value in values]
    for part, value in zip(made, values, strict=True):
        part.segment.torque[:] = part.segment.torque + value
    return made, values, Band.of(PERIOD)


@pytest.mark.parametrize("coloured", [False, True], ids=["white", "coloured"])
def test_the_floor_in_the_band_whatever_the_noises_colour(coloured):
    made, values, band = noisy(0.2, coloured)
    found = noise.floor(made, values, band)
    truth = np.concatenate([band(value)[20:-20] for value in values]).std(axis=0)
    np.testing.assert_allclose(found.band, truth, rtol=0.1)
    assert found.coloured.tolist() == [coloured] * 2
    assert not found.unknown.any()


def test_joints_of_one_kind_say_together_how_the_noise_goes_on_below():
    """Three drives at 500 Hz: what one joint's levels leave open, the corner, is that of all."""
    random, step = np.random.default_rng(5), Band.of(2e-3)
    keep = np.exp(-2.0 / 3.0)
    edges, levels, wrong = noise._edges(step), [], []
    for _ in range(20):
        white = random.standard_normal((13_000, 3))
        values = np.asarray(lfilter([np.sqrt(1 - keep**2)], [1, -keep], white, axis=0))
        power = np.abs(np.fft.rfft(values, axis=0)) ** 2 / len(values)
        frequency = np.fft.rfftfreq(len(values), 2e-3)
        inside = [(frequency >= low) & (frequency < high) for low, high in pairwise(edges)]
        levels = np.sqrt([power[rows].mean(axis=0) for rows in inside]).T
        levels = levels * (1 + 0.02 * random.standard_normal(levels.shape))  # few windows are quiet
        found, known = noise._extrapolated(levels, step)
        truth = np.sqrt(np.mean(np.abs(step(values)) ** 2, axis=0))
        assert known.all()
        wrong += list(found / truth - 1)
    assert np.quantile(np.abs(wrong), 0.9) < 0.145


def test_smooth_torque_has_no_floor_to_be_read():
    made, values, band = noisy(1e-9)
    found = noise.floor(made, values, band)
    torque = np.concatenate([band(part.segment.torque) for part in made]).std(axis=0)
    np.testing.assert_allclose(found.band, 0.01 * torque, rtol=1e-6)
    assert found.unknown.all()


def test_steps_are_a_floor():
    made, values, band = noisy(1e-9)
    for part in made:
        part.segment.torque[:] = 0.05 * np.rint(part.segment.torque / 0.05)
    found = noise.floor(made, values, band)
    np.testing.assert_allclose(found.sample, 0.05 / 12**0.5, rtol=0.2)
    assert (found.sample >= 0.05 / 12**0.5 * (1 - 1e-9)).all()
