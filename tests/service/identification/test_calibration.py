"""Logs with a known load: torque constants and the platform's mass come out, and only where they are wrong."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.trace import write_trace
from schemas.errors import DataError
from schemas.robot import EffectEntry, Identified, Robot, load_robot, save_robot
from schemas.trace import Trace
from service.cli.main import app
from service.estimator import state
from service.estimator.payload.payload_state import UNCALIBRATED
from service.identification.calibration import Calibration, calibrate
from service.identification.from_traces import identify
from service.identification.regression import summarise
from service.identification.weighed_picks import CommonError, common_error
from service.model.description import torque_along
from service.model.nominal import pack
from service.model.signals import smooth
from tests.service.identification.conftest import Truth, multisine, synthesise

SECONDS = 6.0
EMPTY = (1, 2, 3)


def logs(robot: Robot, extra: float = 0.0, scale=(1.0, 1.0, 1.0), load: float = 3.0) -> tuple[list[Trace], Trace]:
    """Three empty logs and one with `load` kg, of a robot whose platform is `extra` kg heavier than described and whose
    drives report `scale` times the true torque."""
    mass = robot.mass.model_copy(update={"platform": robot.mass.platform + extra})
    model = pack(robot.model_copy(update={"mass": mass}))

    def one(seed: int, payload: float) -> Trace:
        motion = multisine(seed, SECONDS, 2.0, 1e-3)
        made = synthesise(model, seed, Truth(payload=payload), motion, 1e-3)
        return replace(made, torque=made.torque * np.array(scale))

    return [one(seed, 0.0) for seed in EMPTY], one(9, load)


@pytest.fixture(scope="module")
def found(robot: Robot) -> tuple[Calibration, list[Trace], Trace]:
    empty, loaded = logs(robot, 0.15, (1.05, 0.96, 1.0))
    return calibrate(robot, empty, [(3.0, loaded)]), empty, loaded


def test_torque_constants_and_platform_are_put_right(found: tuple[Calibration, list[Trace], Trace]) -> None:
    calibration, _, _ = found
    assert np.allclose(calibration.scale[:2], [1.05, 0.96], atol=0.004)
    assert calibration.scale[2] == 1.0, "within its error of what is declared: left alone"
    assert calibration.robot.mass.platform == pytest.approx(1.45, abs=0.02)
    truth = [1.05, 0.96, 1.0, 1.45]
    for figure, true in zip(calibration.figures, truth, strict=True):
        assert abs(figure.value - true) < 4 * figure.std_error
        assert figure.std_error < 0.01
    assert [figure.changed for figure in calibration.figures] == [True, True, False, True]
    said = " ".join(calibration.warnings)
    told = replace(found[1][0], torque_command=found[1][0].torque)
    np.testing.assert_array_equal(calibration.true(told).torque_command, calibration.true(told).torque)
    assert all(
        words in said
        for words in (
            "joint 1: with the known load, the drive reports 1.05",
            "joint 2: with the known",
            "mass.platform: 1.4",
        )
    )
    assert "joint 3" not in said


def test_the_description_carries_what_was_found(robot: Robot, found: tuple[Calibration, list[Trace], Trace]) -> None:
    """It says what the drives report, joint by joint."""
    calibration, empty, _ = found
    model = pack(calibration.robot)
    logs = [summarise(model, calibration.true(log)) for log in empty]
    result = identify(calibration.robot, logs)
    assert not any("torque_scale" in warning for warning in result.warnings)
    assert np.allclose(result.fit.values[:2], [Truth().rho_1, Truth().rho_2], rtol=0.02)
    description = calibration.carried(result.robot)
    (effect,) = description.effect
    assert (effect.name, effect.joints) == ("torque_scale", [1, 2])
    motion, inner = smooth(empty[0].position, 1e-3), slice(200, -200)

    def left(description: Robot) -> np.ndarray:
        return (empty[0].torque - torque_along(description, empty[0].time, *motion))[inner].std(axis=0)

    noise = 0.3 * np.array([1.05, 0.96, 1.0])
    assert (left(description) < 1.3 * noise).all(), "what is left is noise and reversals"
    assert (left(result.robot)[:2] > 1.5 * left(description)[:2]).all()

    again = identify(description, logs)
    assert again.robot.effect == []
    assert any(warning.startswith("torque_scale: from an earlier diagnosis") for warning in again.warnings)


def test_masses_have_in_common_what_the_known_load_leaves_open(
    robot: Robot, found: tuple[Calibration, list[Trace], Trace]
) -> None:
    """One description is not calibrated, one has its torque constants put right, one has some left as declared."""
    calibration, empty, _ = found
    plain = identify(robot, [summarise(pack(robot), log) for log in empty]).robot
    assert common_error(plain) == CommonError(UNCALIBRATED, False)
    known = common_error(calibration.carried(plain))
    errors = [figure.std_error for figure in calibration.figures[:3]]
    assert known.calibrated
    assert np.min(errors) < known.share < 2 * np.max(errors)
    assert settings_of(calibration.carried(plain)) == pytest.approx(known.share)
    assert settings_of(plain) == UNCALIBRATED

    nearly = calibrate(robot, *as_known(logs(robot, 0.0, (1.008, 1.008, 1.008))))
    assert common_error(nearly.carried(plain)).share == pytest.approx(0.008, abs=0.002), "left alone, so masses have it"


def as_known(made: tuple[list[Trace], Trace]) -> tuple[list[Trace], list[tuple[float, Trace]]]:
    return made[0], [(3.0, made[1])]


def settings_of(robot: Robot) -> float:
    """What the estimator of `robot` takes all masses to be off by, as a share."""
    return float(state.settings(robot, 1e-3, 1)["payload"]["common_share"][0])


def test_the_command_takes_a_loaded_log_and_saves_what_it_tells(
    robot: Robot, found: tuple[Calibration, list[Trace], Trace], tmp_path: Path
) -> None:
    calibration, empty, loaded = found
    save_robot(robot, tmp_path / "robot.toml")
    for name, log in (("a", empty[0]), ("b", empty[1]), ("c", empty[2]), ("loaded", loaded)):
        write_trace(log, tmp_path / f"{name}.csv")
    command = ["identify", *(str(tmp_path / f"{name}.csv") for name in "abc"), "--robot", str(tmp_path / "robot.toml")]
    command += ["--out", str(tmp_path / "out.toml"), "--carried"]
    done = CliRunner().invoke(app, [*command, f"3.0:{tmp_path / 'loaded.csv'}", "--json"])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert [figure["changed"] for figure in told["calibration"]] == [True, True, False, True]
    true = identify(calibration.robot, [summarise(pack(calibration.robot), calibration.true(log)) for log in empty])
    assert [one["value"] for one in told["parameters"]] == pytest.approx(list(true.fit.values), rel=1e-6)
    saved = load_robot(tmp_path / "out.toml")
    assert saved.mass.platform == pytest.approx(calibration.robot.mass.platform)
    assert [(effect.name, effect.joints) for effect in saved.effect] == [("torque_scale", [1, 2])]
    for wrong in ("loaded.csv", "three:loaded.csv"):
        assert CliRunner().invoke(app, [*command, wrong]).exit_code == 2


def test_what_is_as_described_is_left_alone(robot: Robot) -> None:
    """Nearly: many standard errors off, and too little to matter."""
    empty, loaded = logs(robot, 0.016, (1.008, 0.992, 1.0))
    calibration = calibrate(robot, empty, [(3.0, loaded)])
    assert abs(calibration.figures[0].value - 1.0) > 3 * calibration.figures[0].std_error
    assert abs(calibration.figures[3].value - 1.3) > 3 * calibration.figures[3].std_error
    assert calibration.scale.tolist() == [1.0, 1.0, 1.0]
    assert calibration.robot == robot
    assert calibration.effect is None
    assert calibration.warnings == ()


def test_a_load_too_light_to_tell_changes_nothing(robot: Robot) -> None:
    empty, loaded = logs(robot, 0.0, (1.05, 1.05, 1.05), load=0.005)
    calibration = calibrate(robot, empty, [(0.005, loaded)])
    assert calibration.scale.tolist() == [1.0, 1.0, 1.0]
    assert len([line for line in calibration.warnings if "determines its torque constant only" in line]) == 3


@pytest.mark.parametrize(
    ("said", "words"),
    [
        (1.5, r"log_9\.csv \(1\.5 kg\): joint \d would report"),
        (0.0, "0 kg carried"),
        (float("nan"), "nan kg carried"),
        (60.0, "60 kg carried"),
    ],
)
def test_a_load_that_is_not_what_it_is_said_to_be(robot: Robot, said: float, words: str) -> None:
    empty, loaded = logs(robot)
    with pytest.raises(DataError, match=words):
        calibrate(robot, empty, [(said, loaded)])


def test_a_log_that_is_loaded_in_part_is_refused(robot: Robot) -> None:
    empty, loaded = logs(robot)
    bare = logs(robot, load=0.0)[1]
    half = len(bare.torque) // 2
    torque = np.concatenate([bare.torque[:half], loaded.torque[half:]])
    with pytest.raises(DataError, match=r"log_9\.csv: with 3 kg on the platform"):
        calibrate(robot, empty, [(3.0, replace(loaded, torque=torque))])


def test_what_drives_report_is_put_right_and_back(robot, record):
    """The torque and what was commanded, joint by joint; the description of what they report has the effect besides."""
    trace, scale = record(1, seconds=0.1), np.array([1.1, 1.0, 0.9])
    effect = EffectEntry.model_validate({"name": "torque_scale", "joints": [1], "parameters": {}})
    for entry in (None, effect):
        found = Calibration(robot, scale, 0.004, entry, (), ())
        assert found.carried(robot).identified == Identified(torque_constant_error=0.004)
        assert found.carried(robot).effect == ([] if entry is None else [effect])
        assert found.true(trace).torque_command is None
        right = found.true(replace(trace, torque_command=2.0 * trace.torque))
        np.testing.assert_allclose(right.torque * scale, trace.torque)
        assert right.torque_command is not None
        np.testing.assert_allclose(right.torque_command, 2.0 * right.torque)
