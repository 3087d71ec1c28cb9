"""What a command says at its end: a right description explains its logs, one of another geometry does not."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.trace import write_trace
from schemas.messages import PayloadEvent
from schemas.robot import Robot, save_robot
from schemas.trace import Trace
from service.cli.main import app
from service.identification.conclusion import of_evaluation, of_fit, of_payload
from service.identification.evaluation import evaluate
from service.identification.of_logs import identify_logs
from service.identification.weighed_picks import MassLevel

Record = Callable[..., Trace]


@pytest.fixture(scope="module")
def logs(record: Record) -> list[Trace]:
    return [record(seed) for seed in range(3)]


@pytest.fixture(scope="module")
def wrong(robot: Robot) -> Robot:
    """Its active links 17 % longer than they are."""
    longer = robot.geometry.model_copy(update={"active_link_length": 1.17 * robot.geometry.active_link_length})
    return robot.model_copy(update={"geometry": longer})


def ratios(said: str) -> list[float]:
    found = re.search(r"residual of ([\d., and]+) times the noise", said)
    assert found, said
    return [float(number) for number in re.findall(r"[\d.]+", found[1])]


def test_a_right_description_explains_its_logs_and_a_wrong_geometry_does_not(
    robot: Robot, wrong: Robot, logs: list[Trace], record: Record
) -> None:
    other = record(9)
    for description, explained in ((robot, True), (wrong, False)):
        found, _ = identify_logs(description, logs)
        for said, verdict in (of_fit(found.fit), of_evaluation(found.robot, [evaluate(found.robot, other)])):
            assert verdict is explained, said
            assert ("it explains them." in said) is explained
            assert ("it does not explain them. Possible causes: a wrong geometry" in said) is not explained
            assert max(ratios(said)) < 1.25 if explained else max(ratios(said)) > 4


def test_the_ratio_is_of_noise_in_the_band(robot: Robot, logs: list[Trace], record: Record) -> None:
    """Against the noise that was put in, 0.3 N m a sample at 1 kHz, of which sqrt(80/1000) lies below 40 Hz."""
    found, _ = identify_logs(robot, logs)
    log = record(9)
    rng = np.random.default_rng(1)
    for times in (1.0, 4.0):
        noise = np.sqrt(times**2 - 1) * 0.3 * rng.standard_normal(log.torque.shape)
        said, _ = of_evaluation(found.robot, [evaluate(found.robot, replace(log, torque=log.torque + noise))])
        assert ratios(said) == pytest.approx([times] * 3, rel=0.2), said
        assert ("times its residual on the logs it was identified on" in said) is (times > 2)


def test_a_robot_that_was_never_identified_is_told_so(robot: Robot, logs: list[Trace]) -> None:
    plain = robot.model_copy(update={"identified": None})
    said, explained = of_evaluation(plain, [evaluate(plain, logs[0])])
    assert said == "known was never identified: only the textbook model can be compared."
    assert not explained


def test_what_was_picked_in_a_sentence() -> None:
    assert of_payload([]).startswith("No pick was detected")
    one = MassLevel(1.0, 2.0, 1.5, 0.05, 0.02, 0.05, 0.9, PayloadEvent.PICK)
    empty = replace(one, mass=0.0, event=PayloadEvent.RELEASE)
    assert of_payload([one, empty]) == (
        "1 pick of 1.500 kg, known to ± 0.020 kg, with a common error of 3.3 % of the mass (one standard "
        "deviation); trusted during 90 % of its time."
    )
    longer = replace(one, begin=5.0, end=8.0, mass=0.25, trusted=0.5)
    first = replace(one, random_std_dev=0.098)
    assert "known to ± 0.020 kg (median; the worst to ± 0.098 kg)" in of_payload([first, one, empty, longer])
    two = of_payload([one, empty, longer])
    assert "2 picks of 0.250 to 1.500 kg" in two
    assert "with a common error of 3.3 % to 20.0 % of the mass" in two, "as the rows of the table have it"
    assert "trusted during 60 %" in of_payload([one, longer]), "by their time: 0.9 of 1 s, 0.5 of 3 s"


def test_commands_end_with_it_and_with_what_comes_next(wrong: Robot, logs: list[Trace], tmp_path: Path) -> None:
    plain = wrong.model_copy(update={"identified": None})
    save_robot(plain, tmp_path / "a robot.toml")
    names = []
    for number, log in enumerate(logs):
        names.append(str(tmp_path / f"log_{number}.csv"))
        write_trace(log, names[-1])
    robot, out = str(tmp_path / "a robot.toml"), str(tmp_path / "found.toml")

    def end(*arguments: str) -> list[str]:
        done = CliRunner().invoke(app, arguments)
        assert done.exit_code == 0, done.output
        return done.stdout.splitlines()[-2:]

    diagnose = f"next: deltatwin diagnose {' '.join(names)} --robot '{robot}' --out diagnosis"
    said, following = end("identify", *names, "--robot", robot, "--out", out)
    assert "it does not explain them" in said
    assert following == diagnose
    said, following = end("evaluate", *names, "--robot", robot)
    assert following == f"next: deltatwin identify {' '.join(names)} --robot '{robot}' --out identified.toml"
    said, following = end("evaluate", *names, "--robot", out)
    assert following == diagnose.replace(f"'{robot}'", out)
    said, following = end("payload", names[0], "--robot", out)
    assert following == f"next: deltatwin estimate --robot {out}"
