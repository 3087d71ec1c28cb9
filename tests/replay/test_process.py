"""Process replay and the bus give the same bits; a stored run guards both."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from drivers.bus import LINK_S, open_bus
from replay.player import play, schedule
from replay.process import process
from schemas.messages import Role
from schemas.robot import save_robot
from service.estimator.estimator import Estimator
from tests.known import trace_of


@pytest.fixture
def estimator(bus_folder, tmp_path, robot, until):
    """`deltatwin estimate` as a user runs it."""
    Estimator(robot, 1e-3).warm_up()  # leaves the compiled kernel on the disk for the process
    path = tmp_path / "robot.toml"
    save_robot(robot, path)
    process = subprocess.Popen([Path(sys.executable).with_name("deltatwin"), "estimate", "--robot", path])
    yield process
    process.send_signal(signal.SIGTERM)
    assert process.wait(20) == 0


def collect(inboxes, counts):
    """Take until every inbox has given its count; the oldest first."""
    parts = [[] for _ in inboxes]
    give_up = time.monotonic() + 30
    while any(sum(map(len, part)) < count for part, count in zip(parts, counts, strict=True)):
        assert time.monotonic() < give_up, f"got {[sum(map(len, p)) for p in parts]} of {counts}"
        for inbox, part in zip(inboxes, parts, strict=True):
            part.append(inbox.take()[0])
        time.sleep(0.01)
    return [np.concatenate(part) for part in parts]


def test_at_a_higher_rate_a_thousand_reports_a_second_and_every_event(estimator, robot, make, until):
    known = make(1.5, payload=lambda t: 3.0 * ((t > 0.7) & (t < 1.1)), noise=0.25, period=2.5e-4)
    expected = process(robot, known.samples)
    told = (expected.payload["sequence"] % 4 == 0) | (expected.payload["event"] != 0)
    assert np.count_nonzero(expected.payload["event"]) == 2
    with open_bus(robot.name, Role.PLAYER) as bus, open_bus(robot.name, Role.OBSERVER) as observer:
        inboxes = [observer.subscribe(topic) for topic in ("feedforward", "payload", "error")]
        publisher = bus.publisher("sample")
        until(lambda: Role.ESTIMATOR in observer.alive and Role.ESTIMATOR in bus.alive and publisher.heard)
        time.sleep(LINK_S)
        for n in range(len(known.samples)):
            publisher.put(known.samples[n : n + 1].tobytes())
            time.sleep(2.5e-4)
        answers = collect(inboxes, [len(known.samples), told.sum(), told.sum()])
    assert answers[0].tobytes() == expected.feedforward.tobytes()
    assert answers[1].tobytes() == expected.payload[told].tobytes()
    assert answers[2].tobytes() == expected.error[told].tobytes()


@pytest.mark.parametrize("commands", [True, False], ids=["with commands", "without"])
def test_the_bus_gives_the_bits_of_process_replay(estimator, robot, make, until, commands):
    known = make(1.5, payload=lambda t: 2.0 * (t > 0.7), noise=0.25)
    samples = known.samples
    if not commands:
        samples["position_command"] = np.nan
    trace = trace_of(known)
    expected = process(robot, trace.samples())
    with open_bus(robot.name, Role.PLAYER) as bus, open_bus(robot.name, Role.OBSERVER) as observer:
        inboxes = [observer.subscribe(topic) for topic in ("feedforward", "payload", "error")]
        publisher = bus.publisher("sample")
        until(lambda: Role.ESTIMATOR in observer.alive and Role.ESTIMATOR in bus.alive and publisher.heard)
        time.sleep(LINK_S)
        play(schedule(trace), publisher.put, None, lambda _: None)
        answers = collect(inboxes, [len(expected.feedforward), len(expected.payload), len(expected.error)])
    for name, answer in zip(("feedforward", "payload", "error"), answers, strict=True):
        assert answer.tobytes() == getattr(expected, name).tobytes(), name
