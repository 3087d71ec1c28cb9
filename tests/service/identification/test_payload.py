"""Payload within one pick: on logs of another plant and on our own, each identified on its own free motion."""

import json
from pathlib import Path

import numpy as np
import pytest

from drivers.trace import read_trace
from schemas.errors import TraceError
from schemas.messages import PayloadEvent
from schemas.robot import load_robot
from service.estimator.recursion import fixed_forgetting
from service.identification.evaluation import WITH_PAYLOAD, evaluate
from service.identification.identify import identify
from service.identification.payload import Pick, course, picks, read_truth, score
from service.identification.regression import summarise
from service.model.nominal import pack
from service.model.prediction import FULL


@pytest.fixture(scope="module")
def cases(shared):
    """(robot as identified, its pick traces with their truth) of both reference robots."""
    result = []
    for case in json.loads((shared / "payload_logs/key.json").read_text()):
        folder = shared / "payload_logs" / case["case"]
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
def scores(cases):
    return [score(course(robot, trace), pick) for robot, _, logs in cases for trace, truth in logs for pick in truth]


def test_payload_is_found_within_the_same_move(scores):
    assert len(scores) == 28
    assert np.mean([s.settled <= 0.15 for s in scores]) >= 0.95
    assert all(s.released <= 0.15 for s in scores)
    heavy = np.array([abs(s.mass / s.truth.mass - 1) for s in scores if s.truth.mass >= 1.0])
    assert np.median(heavy) <= 0.015
    assert np.mean(heavy <= 0.04) >= 0.95


def test_every_pick_is_seen_once_and_free_motion_holds_none(cases):
    for robot, fits, logs in cases:
        for trace, truth in logs:
            found = course(robot, trace)
            assert len(picks(found)) == len(truth)
            assert np.count_nonzero(found.event == PayloadEvent.RELEASE) == len(truth)
        for trace in fits:
            assert not course(robot, trace).event.any()


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


def test_a_truth_file_that_is_none_is_named_with_its_line(tmp_path: Path):
    path = tmp_path / "truth.csv"
    path.write_text("from_s,until_s,mass_kg\n0.1,0.5,heavy\n")
    with pytest.raises(TraceError, match=r"truth.csv:2: wanted from_s, until_s, mass_kg as numbers"):
        read_truth(path)
