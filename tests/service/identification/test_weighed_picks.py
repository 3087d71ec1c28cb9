"""Payload within one pick: on logs of another plant and on our own, each identified on its own free motion."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.trace import read_trace, write_trace
from schemas.errors import TraceError
from schemas.messages import Gripper, PayloadEvent, SampleFlag
from schemas.robot import Identified, load_robot, save_robot
from service.cli.main import app
from service.estimator.payload.payload_state import SMALLEST_CHANGE
from service.estimator.recursion import fixed_forgetting
from service.identification import evaluation, weighed_picks
from service.identification.evaluation import WITH_PAYLOAD, evaluate
from service.identification.from_traces import identify
from service.identification.regression import summarise
from service.identification.weighed_picks import (
    PayloadHistory,
    Pick,
    Weighed,
    levels,
    payload_history,
    picks,
    read_truth,
    score,
    settled,
    unseen,
)
from service.model.dynamics import PAYLOAD, torque_terms
from service.model.nominal import pack
from service.model.prediction import FULL, motion
from service.model.signals import moving
from tests.service.identification.test_calibration import logs as loaded_logs


@pytest.fixture(scope="module")
def cases(data):
    """(robot as identified, its pick traces with their truth) of both reference robots."""
    result = []
    for case in json.loads((data / "payload_logs/key.json").read_text()):
        folder = data / "payload_logs" / case["case"]
        plain = load_robot(folder / "robot.toml")
        fits = [read_trace(path, plain) for path in sorted(folder.glob("fit_*.csv"))]
        robot = identified(plain, fits)
        logs = [
            (read_trace(folder / f"{name}.csv", robot), [Pick(*row) for row in rows])
            for name, rows in case["picks"].items()
        ]
        result.append((robot, fits, logs))
    return result


def identified(plain, fits):
    return identify(plain, [summarise(pack(plain), trace) for trace in fits]).robot


@pytest.fixture(scope="module")
def histories(cases):
    """The payload over each pick trace, with its truth."""
    return [(payload_history(robot, trace), truth) for robot, _, logs in cases for trace, truth in logs]


@pytest.fixture(scope="module")
def scores(histories):
    return [score(found, pick) for found, truth in histories for pick in truth]


def test_payload_is_found_within_the_same_move(scores):
    assert len(scores) == 28
    assert np.mean([s.settled <= 0.15 for s in scores]) >= 0.95
    assert all(s.released <= 0.15 for s in scores)
    heavy = np.array([abs(s.mass / s.truth.mass - 1) for s in scores if s.truth.mass >= 1.0])
    assert np.median(heavy) <= 0.015
    assert np.mean(heavy <= 0.04) >= 0.95


def test_every_pick_is_seen_once_and_free_motion_holds_none(cases, histories):
    for found, truth in histories:
        assert len(picks(found)) == len(truth)
        assert np.count_nonzero(found.event == PayloadEvent.RELEASE) == len(truth)
    for robot, fits, _ in cases:
        for trace in fits:
            assert not payload_history(robot, trace).event.any()


def test_the_estimator_beats_the_papers_recursion(scores):
    ours = np.median([abs(s.mass - s.truth.mass) for s in scores])
    papers = np.median([abs(s.mass_recursion - s.truth.mass) for s in scores])
    assert ours < 0.1 * papers


def test_prediction_with_the_payload_is_closer(cases):
    for robot, _, logs in cases:
        for trace, _ in logs:
            errors = evaluate(robot, trace).errors
            assert (errors[WITH_PAYLOAD].rms < 0.5 * errors[FULL].rms).all()


def test_the_papers_recursion_finds_a_constant_mass():
    """Against ordinary least squares, to which it comes down when nothing is forgotten."""
    random = np.random.default_rng(0)
    x = random.normal(0, 10, (4000, 3)) + [0, 0, 9.81]
    y = 2.5 * x + random.normal(0, 5, x.shape)
    assert fixed_forgetting(y, x, 1.0)[-1] == pytest.approx((x * y).sum() / (x * x).sum(), abs=1e-5)
    assert fixed_forgetting(y, x, 0.99)[-1] == pytest.approx(2.5, abs=0.1)


def test_the_recursion_takes_rows_that_were_measured_and_those_at_rest_if_they_vote(robot, record):
    """Two kilograms but for rows that are no measurement, and those in which a joint rests."""
    trace, row = record(3, seconds=3.0), np.arange(3000)
    trace = replace(trace, flags=np.where(row % 1000 > 980, np.uint32(SampleFlag.NOT_A_NUMBER), np.uint32(0)))
    along = motion(trace)
    a_kilogram = torque_terms(pack(robot), along.theta, along.theta_dot, along.theta_ddot)[:, PAYLOAD]
    rests = ~along.moving.all(axis=1)

    def weighed(wrong: np.ndarray, **asked: Any) -> float:
        torque = np.where(wrong[:, None], 70.0, 2.0 * a_kilogram) + 1.0
        return weighed_picks.recursion(robot, replace(trace, torque=torque), along, np.ones((3000, 3)), **asked)[-1]

    faulty = ~along.measured
    assert weighed(faulty, forgetting=1.0) == pytest.approx(2.0, abs=1e-3)
    assert weighed(faulty | rests, forgetting=1.0, rest_votes=False) == pytest.approx(2.0, abs=1e-3)
    assert weighed(faulty | rests, forgetting=1.0) != pytest.approx(2.0, abs=0.1)
    early = faulty | (row < 2500)
    assert weighed(early, forgetting=0.9) == pytest.approx(2.0, abs=1e-3), "long forgotten"
    assert weighed(early, forgetting=1.0) != pytest.approx(2.0, abs=0.1)


def test_what_is_carried_has_been_trusted_once_and_was_no_lighter_since(robot, record, monkeypatch):
    trace = record(3, seconds=0.5)
    event, trusted = np.zeros(500, int), np.zeros(500, bool)
    mass = np.repeat([0.5, 2.0, 3.0, 1.0, 2.5], 100)
    trusted[100:200] = trusted[450:] = True

    def carried():
        monkeypatch.setattr(
            weighed_picks, "weighed", lambda *_: Weighed(trace.time, mass, 0 * mass, 0 * mass, 0 * mass, trusted, event)
        )
        return evaluation._carried(robot, trace, motion(trace))

    event[20] = PayloadEvent.RELEASE
    assert carried() is None, "nothing was picked"
    event[120] = PayloadEvent.PICK
    along = motion(trace)
    a_kilogram = torque_terms(pack(robot), along.theta, along.theta_dot, along.theta_ddot)[:, PAYLOAD]
    held = np.repeat([0.0, 2.0, 2.0, 1.0, 2.0, 2.5], [100, 100, 100, 100, 50, 50])
    found = carried()
    assert found is not None
    np.testing.assert_allclose(found, held[:, None] * a_kilogram)
    mass[:], trusted[:] = 2.0, np.arange(500) == 0
    found = carried()
    assert found is not None
    np.testing.assert_allclose(found, 2.0 * a_kilogram, err_msg="trusted at once")


def test_events_are_those_of_the_fullest_model_and_calm_is_what_they_leave(robot, record, monkeypatch):
    """Of a robot without friction every reversal would be one."""
    trace = record(3, seconds=4.0)
    knock = np.where(np.abs(trace.time - 2.0) < 0.05, 40.0 * (-1.0) ** (np.arange(4000) // 10), 0.0)
    trace = replace(trace, torque=trace.torque + knock[:, None] * [0.0, 1.0, 0.0])
    assert (evaluate(robot, trace).events, evaluate(robot, trace).calm_share) == ([], 1.0)
    known = identified(robot, [record(seed) for seed in (4, 5)])
    found = evaluate(known, trace)
    (event,) = found.events
    assert event.joint == 1
    assert 1.85 < event.start < 2.0 < event.end < 2.15
    quiet = found.calm[FULL].count / found.errors[FULL].count
    assert found.calm_share == pytest.approx(float(np.average(quiet, weights=found.errors[FULL].count)))
    assert 0.9 < found.calm_share < 0.97
    assert found.calm[FULL].rms[1] < 0.3 * found.errors[FULL].rms[1]
    monkeypatch.setattr(evaluation, "_carried", lambda *_: knock[:, None] * [0.0, 1.0, 0.0])
    assert evaluate(known, trace).events == []


@pytest.mark.parametrize(("std_dev", "trusted", "mass"), [(0.99, True, 2.0), (1.01, True, 0.0), (0.1, False, np.nan)])
def test_what_hangs_is_one_mass_from_event_to_event_and_unknown_before_the_next(
    robot, record, monkeypatch, std_dev, trusted, mass
):
    """Up to a quarter of a second of motion before it; what is not twice its error is none."""
    trace = record(3, seconds=2.0)
    trace = replace(trace, flags=np.where(np.arange(2000) < 5, np.uint32(SampleFlag.LOADED), np.uint32(0)))
    robot = robot.model_copy(update={"identified": Identified()})
    event = np.zeros(2000, int)
    spread = np.full(2000, std_dev)
    found = Weighed(trace.time, np.full(2000, 2.0), spread, spread, spread, np.full(2000, trusted), event)
    monkeypatch.setattr(weighed_picks, "weighed", lambda *_: found)
    expected = np.where(np.arange(2000) < 5, np.nan, 0.0)
    np.testing.assert_array_equal(weighed_picks.carried(robot, trace), expected)
    event[1000] = PayloadEvent.PICK
    moves = np.any(moving(trace.position, trace.period), axis=1)
    expected[1000:] = mass
    for end in (1000, 2000):
        expected[np.flatnonzero(moves[:end])[-249] : end] = np.nan
    np.testing.assert_array_equal(weighed_picks.carried(robot, trace), expected)


TIME = np.arange(1000) * 0.01
TRUTH = Pick(2.0, 4.0, 2.0)


def seen() -> PayloadHistory:
    """A pick of 2 kg seen 50 ms late, off by 0.3 kg for 200 ms and by 90 g after; one of 1 kg that never ends."""
    mass, event, trusted = np.zeros(1000), np.zeros(1000, int), np.zeros(1000, bool)
    mass[205:410], mass[205:220], mass[700:] = 2.09, 2.3, 1.0
    event[[205, 410, 700]] = PayloadEvent.PICK, PayloadEvent.RELEASE, PayloadEvent.PICK
    trusted[300:410] = True
    recursion = np.where((TIME >= 2.0) & (TIME < 4.0), 2.0 + 0.05 * (TIME - 3.0), 0.0)
    return PayloadHistory(
        TIME, mass, np.full(1000, 0.02), np.full(1000, 0.01), np.full(1000, 0.01), trusted, event, recursion
    )


def test_picks_and_levels_are_what_lies_between_events():
    first, last = picks(seen())
    assert (first.begin, first.end, first.mass) == pytest.approx((2.05, 4.09, 2.09))
    assert (last.begin, last.end, last.mass) == pytest.approx((7.0, 9.99, 1.0))
    one, empty, two = levels(seen())
    assert (one.begin, one.end, one.mass, one.std_dev) == pytest.approx((2.05, 4.09, 2.09, 0.02))
    assert (one.event, empty.event, two.event) == (PayloadEvent.PICK, PayloadEvent.RELEASE, PayloadEvent.PICK)
    assert one.trusted == pytest.approx(110 / 205)
    assert (empty.begin, empty.end, empty.mass, empty.trusted) == pytest.approx((4.1, 6.99, 0.0, 0.0))
    nothing = replace(seen(), event=np.zeros(1000, int), trusted=np.zeros(1000, bool))
    assert (picks(nothing), levels(nothing)) == ([], [])
    rising = PayloadHistory(TIME, TIME, TIME, TIME, TIME, TIME > 0, seen().event, TIME)
    assert levels(rising)[0].mass == pytest.approx(np.median(TIME[205 + 102 : 410])), "the later half counts"


@pytest.mark.parametrize(
    ("mass", "std_dev", "event", "changed"),
    [
        (0.5, 0.02, False, True),
        (0.13, 0.02, False, True),
        (0.11, 0.02, False, False),
        (0.5, 0.13, False, False),
        (0.5, 0.11, False, True),
        (0.5, 0.02, True, False),
    ],
)
def test_a_mass_that_is_another_when_it_is_trusted_again_is_a_level_that_nobody_saw_begin(
    mass, std_dev, event, changed
):
    """By more than any gripper is asked for, and by three standard deviations of before and after."""
    row = np.arange(1000)
    found = replace(
        seen(),
        mass=np.where(row < 450, 0.0, mass),
        std_dev=np.full(1000, std_dev),
        trusted=(row < 400) | ((row >= 500) & (row < 800)) | (row >= 900),
        event=np.where(row == 450, PayloadEvent.PICK * event, PayloadEvent.NONE),
    )
    assert unseen(found) == [(399, 500)] * changed
    assert [(one.begin, one.mass, one.event) for one in levels(found)] == (
        [(5.0, mass, PayloadEvent.NONE)] * changed + [(4.5, mass, PayloadEvent.PICK)] * event
    )
    begun = replace(found, trusted=row >= 500, event=np.zeros(1000, int))
    assert unseen(begun) == [(0, 500)] * (mass > max(SMALLEST_CHANGE, 3 * std_dev)), "nothing hung there before"


def test_of_a_change_that_nobody_saw_it_is_not_told_what_hangs_there_until_the_mass_is_trusted(
    robot, record, monkeypatch
):
    trace, row = record(3, seconds=2.0), np.arange(2000)
    robot = robot.model_copy(update={"identified": Identified()})
    trusted = (row < 500) | (row >= 1000)
    spread = np.full(2000, 0.1)
    found = Weighed(trace.time, np.where(row < 800, 0.0, 2.0), spread, spread, spread, trusted, np.zeros(2000, int))
    monkeypatch.setattr(weighed_picks, "weighed", lambda *_: found)
    hangs = weighed_picks.carried(robot, trace)
    assert not hangs[:499].any()
    assert np.isnan(hangs[499:1000]).all()
    assert (hangs[1000:1700] == 2.0).all()


def test_a_pick_is_scored_by_its_delays_and_its_last_mass():
    found = score(seen(), TRUTH)
    assert (found.seen, found.released, found.settled) == pytest.approx((0.05, 0.1, 0.2))
    assert (found.mass, found.mass_recursion) == pytest.approx((2.09, 2.0495))
    assert found.settled_recursion == 0.0
    missed = score(seen(), Pick(4.5, 5.5, 2.0))
    assert np.isnan([missed.seen, missed.released, missed.settled]).all()
    late = score(seen(), Pick(3.0, 3.9, 2.09))  # the release comes within as long as the pick lasted, no later
    assert late.released == pytest.approx(0.2)
    assert np.isnan(score(seen(), Pick(3.8, 3.9, 2.09)).released)


@pytest.mark.parametrize(("mass", "bound"), [(4.0, 0.2), (1.0, 0.05), (0.3, 0.05)])
def test_settled_is_within_the_larger_bound_to_the_end(mass, bound):
    """5 % or 50 g."""
    truth = Pick(2.0, 4.0, mass)
    off = np.where(TIME < 2.5, 1.0, 0.0)
    assert settled(TIME, mass + 0.99 * bound + off, truth) == pytest.approx(0.5)
    assert settled(TIME, mass - 0.99 * bound - off, truth) == pytest.approx(0.5)
    assert np.isnan(settled(TIME, mass + 1.01 * bound + off, truth))
    assert settled(TIME, np.full(1000, mass), truth) == 0.0
    at_the_end = np.where(TIME > 3.985, mass + 1.0, mass)
    assert np.isnan(settled(TIME, at_the_end, truth))


def test_a_truth_file_is_read_and_one_that_is_none_is_named_with_its_line(tmp_path: Path):
    path = tmp_path / "truth.csv"
    path.write_text("from_s,until_s,mass_kg\n0.1,0.5,1.5\n0.7,0.9,2\n")
    assert read_truth(path) == [Pick(0.1, 0.5, 1.5), Pick(0.7, 0.9, 2.0)]
    path.write_text("from_s,until_s,mass_kg\n0.1,0.5,1.5\n0.1,nan,1.5\n")
    with pytest.raises(TraceError, match=r"truth.csv:3: expected"):
        read_truth(path)
    path.write_text("from_s,until_s,mass_kg\n0.1,0.5,heavy\n")
    with pytest.raises(TraceError, match=r"truth.csv:2: expected from_s, until_s, mass_kg as numbers"):
        read_truth(path)


def test_a_robot_that_was_never_identified_carries_something_unknown_where_its_gripper_is_closed(robot, record):
    trace = record(3, seconds=0.5)
    assert weighed_picks.carried(robot, trace).tolist() == [0.0] * 500
    closed = np.arange(500) > 200
    trace = replace(trace, gripper=np.where(closed, Gripper.CLOSED, Gripper.OPEN))
    np.testing.assert_array_equal(weighed_picks.carried(robot, trace), np.where(closed, np.nan, 0.0))


def test_rows_that_were_not_measured_are_counted(robot, record):
    trace = record(3, seconds=2.0)
    flags = np.where(np.isin(np.arange(2000), [900, 901, 902]), np.uint32(SampleFlag.NOT_A_NUMBER), np.uint32(0))
    found = evaluate(robot, replace(trace, flags=flags))
    assert (found.unmeasured, evaluate(robot, trace).unmeasured) == (3, 0)


def test_moments_are_those_of_the_rows_that_are_known():
    error = np.array([[0.1, np.nan], [0.4, np.nan], [np.nan, np.nan], [-0.2, np.nan]])
    found = evaluation.pooled([evaluation._moments(error[:2]), evaluation._moments(error[2:])])
    known = np.array([0.1, 0.4, -0.2])
    for got, expected in (
        (found.mean, known.mean()),
        (found.std, known.std()),
        (found.rms, np.sqrt(np.mean(known**2))),
    ):
        np.testing.assert_allclose(got, [expected, np.nan])


def test_the_command_tells_two_errors_of_every_mass_and_how_to_remove_the_common_one(tmp_path):
    plain = load_robot("d3-1200")
    empty, loaded = loaded_logs(plain)
    known = identified(plain, empty)
    write_trace(loaded, tmp_path / "loaded.csv")
    command = ["payload", str(tmp_path / "loaded.csv"), "--robot", str(tmp_path / "known.toml")]
    assert known.identified is not None
    calibrated = known.identified.model_copy(update={"torque_constant_error": 0.004})
    for update, share, said in (({}, 0.035, "--carried"), ({"identified": calibrated}, 0.004, "after a known load")):
        save_robot(known.model_copy(update=update), tmp_path / "known.toml")
        done = CliRunner().invoke(app, [*command, "--predictions", str(tmp_path / "told")])
        assert done.exit_code == 0, done.output
        assert done.stdout.count("common error:") == 1, "once a robot, whatever was picked"
        assert f"common error: at least {100 * share:.1f} % of every mass" in done.stdout
        assert said in done.stdout
        told = np.genfromtxt(tmp_path / "told" / "loaded.csv", delimiter=",", names=True)
        assert told.dtype.names is not None
        assert told.dtype.names[:5] == ("time_s", "mass_kg", "std_dev_kg", "trusted", "event")
        sure = told[told["trusted"] == 1][-1]
        assert sure["mass_kg"] == pytest.approx(3.0, abs=0.1)
        assert 0.0 < sure["random_std_dev_kg"] < 0.05
        assert share * 2.9 < sure["common_std_dev_kg"] < share * 3.1 + 0.1
        document = json.loads(CliRunner().invoke(app, [*command, "--json"]).stdout)
        assert document["common_error"] == {"share": share, "calibrated": share < 0.035}
