"""A controller's recorded answers against its twin's: same bits, another library's rounding, or what differs first."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from schemas.messages import REFERENCE, TOPICS, stamp_ns
from service.cli.main import MISSED, app
from service.codegen.folder import write_twin
from service.codegen.twin import to_c
from service.estimator.estimator import Estimator
from service.monitor.recording import RecordingWriter
from tests.known import PERIOD, make, robot

__all__ = ["make", "robot"]
WALL_NS = 1_790_000_000_000_000_000


@pytest.fixture(scope="module")
def folder(robot, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("twin")
    write_twin(robot, PERIOD, to_c(robot, PERIOD), path)
    return path


def record(path: Path, messages: dict[str, np.ndarray]) -> Path:
    """A recording in which each message arrives at its stamp, planned motion ahead of the sample that it is for."""
    recording = RecordingWriter(path, "known")
    for topic, records in messages.items():
        recording.write(topic, records, WALL_NS + stamp_ns(records) - (1_500_000 if topic == "reference" else 0))
    recording.close()
    return path


def answered(robot, samples: np.ndarray) -> dict[str, np.ndarray]:
    result = Estimator(robot, PERIOD).run(samples)
    return {"sample": samples} | result._asdict()


def said(folder: Path, log: Path, code: int, *options: str) -> str:
    told = CliRunner().invoke(app, ["verify", str(folder), "--log", str(log), *options])
    assert told.exit_code == code, told.output
    return told.output


def test_the_same_bits(robot, make, folder, tmp_path) -> None:
    log = record(tmp_path / "run.mcap", answered(robot, make(1.0, noise=0.2).samples))
    shown = said(folder, log, 0)
    assert "feedforward: 1000 answers, 1000 bit-identical" in shown
    assert "gives the same answers as its twin, bit for bit" in shown
    document = json.loads(said(folder, log, 0, "--json"))
    assert document["feedforward"]["alike"] == 1000
    assert document["error"]["first"] is None


def test_planned_motion_is_taken_when_it_came(robot, make, folder, tmp_path) -> None:
    known, estimator = make(0.5), Estimator(robot, PERIOD)
    references, answers = REFERENCE.empty(400), TOPICS["feedforward"].empty(500)
    for name in ("stamp_sec", "stamp_nanosec", "sequence"):
        references[name] = known.samples[name][100:]
    references["position"], references["velocity"] = known.theta[100:], known.theta_dot[100:]
    references["acceleration"] = known.theta_ddot[100:]
    for k, sample in enumerate(known.samples):
        if 0 <= k - 99 < 400:  # came between the sample before it and the one before that
            estimator.plan(references[k - 99])
        estimator.step(sample.tobytes())
        answers[k] = estimator.feedforward[0]
    assert (answers["source"] == 2).sum() > 300
    log = record(tmp_path / "run.mcap", {"sample": known.samples, "reference": references, "feedforward": answers})
    assert "bit for bit" in said(folder, log, 0)


def test_another_librarys_rounding_is_told_from_another_answer(robot, make, folder, tmp_path) -> None:
    messages = answered(robot, make(1.0, noise=0.2).samples)
    messages["feedforward"]["torque"][300:310, 2] += 3e-14
    shown = said(folder, record(tmp_path / "a.mcap", messages), 0)
    assert "990 bit-identical; largest differences: torque 3." in shown
    assert "except for the rounding of its mathematics library" in shown
    messages["feedforward"]["torque"][400:, 1] -= 0.25
    messages["payload"]["trusted"][700] ^= 1
    shown = said(folder, record(tmp_path / "b.mcap", messages), MISSED)
    first = messages["feedforward"][400]
    assert f"first at sequence 400 (t = 0.400000 s): torque of joint 2 is {first['torque'][1]:.9g}, not" in shown
    assert f"payload: {len(messages['payload'])} answers" in shown
    assert "trusted is" in shown
    assert "does not give the same answers as its twin" in shown


def test_lost_answers_are_counted(robot, make, folder, tmp_path) -> None:
    messages = answered(robot, make(1.0).samples)
    messages["feedforward"] = np.delete(messages["feedforward"], slice(100, 130))
    shown = said(folder, record(tmp_path / "run.mcap", messages), 0)
    assert "970 answers, 970 bit-identical; 30 samples without an answer" in shown


def test_a_recording_that_begins_later_than_the_controller(robot, make, folder, tmp_path) -> None:
    messages = answered(robot, make(2.0).samples)
    later = {topic: records[records["sequence"] >= 500] for topic, records in messages.items()}
    later = {topic: later[topic] for topic in ("sample", "feedforward")}
    shown = said(folder, record(tmp_path / "run.mcap", later), MISSED)
    assert "first at sequence 500" in shown


@pytest.mark.parametrize("missing", ["sample", "feedforward"])
def test_a_recording_without_what_is_compared(robot, make, folder, tmp_path, missing) -> None:
    messages = answered(robot, make(0.2).samples)
    del messages[missing]
    told = CliRunner().invoke(app, ["verify", str(folder), "--log", str(record(tmp_path / "run.mcap", messages))])
    assert f"no {missing} messages" in str(told.exception)


def test_a_folder_that_is_no_twin(tmp_path) -> None:
    for text in ("{", "[]", '{"schema": "deltatwin.twin/1"}'):
        (tmp_path / "twin.json").write_text(text)
        told = CliRunner().invoke(app, ["verify", str(tmp_path), "--log", "x.mcap"])
        assert str(tmp_path / "twin.json") in str(told.exception)
