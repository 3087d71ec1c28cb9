"""Generated C against the service, bit for bit: one step, one result, whoever runs it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.trace import read_trace
from replay.demo import LOG, ROBOT
from schemas.fitted import JointParameter
from schemas.robot import SHIPPED, FourthAxis, load_robot
from service.estimator.estimator import Estimator
from service.model.effects import CATALOGUE
from tests.known import PERIOD, make, robot
from tests.service.codegen.built import Built, converted, differences, expected, needs_compiler
from tests.service.codegen.disturbed import disturbed
from tests.service.estimator.test_named_effects import FOUND, effect

__all__ = ["make", "robot"]
pytestmark = needs_compiler

# All effects of the catalogue, with neighbours that one robot may have; of the torque's way to its report one each.
GROUPS = {
    "friction": (
        "stribeck_friction", "asymmetric_friction", "load_dependent_friction", "nonlinear_viscous_friction",
        "position_dependent_friction", "warmup_friction", "presliding_friction", "passive_joint_friction",
        "shaft_friction", "torque_delay",
    ),
    "mechanics": (
        "rotor_inertia", "arm_mass", "joint_spring", "link_length_error", "forearm_length_error", "base_radius_error",
        "azimuth_error", "joint_offset", "tool_mass", "base_tilt", "hose_spring", "air_drag", "torque_filter",
    ),
    "gears": ("joint_elasticity", "presliding_friction", "cogging", "torque_scale", "torque_offset", "drive_lag"),
    "loose": ("backlash", "angle_scale", "encoder_eccentricity", "load_dependent_friction"),
}  # fmt: skip


def with_effects(robot, names):
    whole = {entry.name for entry in CATALOGUE if not entry.per_joint}
    return robot.model_copy(update={"effect": [effect(name, [1, 2, 3] if name in whole else [2]) for name in names]})


def picked(time: np.ndarray) -> np.ndarray:
    return 1.5 * ((time > 0.5) & (time < 1.3))


def test_the_demo_log_comes_out_bit_for_bit(tmp_path: Path) -> None:
    built = Built(load_robot(ROBOT), PERIOD, tmp_path)
    samples = read_trace(LOG, built.robot).samples()
    wanted = expected(built, samples)
    assert wanted["payload"]["event"].any()
    assert wanted["payload"]["trusted"].any()
    for _ in range(2):  # a second init begins as the first
        assert built.init() == 0
        assert differences(built.run(samples), wanted) == []


@pytest.mark.parametrize("case", ["plant_logs/case_004", "payload_logs/case_001"])
def test_stored_logs_of_other_robots_come_out_bit_for_bit(data: Path, tmp_path: Path, case: str) -> None:
    logs = sorted((data / case).glob("*.csv"))
    assert stored(data / case / "robot.toml", [logs[0], logs[-1]], tmp_path)[0] == {}


def stored(description: Path, logs: list[Path], folder: Path) -> tuple[dict[str, list[str]], int]:
    """What differs, by log, each plain and with faults; and how many samples they are."""
    robot, built, wrong, count = load_robot(description), None, {}, 0
    for path in logs:
        trace = read_trace(path, robot)
        built = built or Built(robot, trace.period, folder, "-O0")
        for samples in (trace.samples(), disturbed(trace.samples())):
            assert built.init() == 0
            found, count = differences(built.run(samples), expected(built, samples)), count + len(samples)
            wrong |= {path.name: found} if found else {}
    assert count > 0
    return wrong, count


def test_every_effect_is_in_a_group() -> None:
    assert {name for names in GROUPS.values() for name in names} == {entry.name for entry in CATALOGUE} == set(FOUND)


@pytest.mark.parametrize("group", GROUPS)
def test_effects_faults_picks_and_restarts_come_out_bit_for_bit(robot, make, tmp_path: Path, group: str) -> None:
    built = Built(with_effects(robot, GROUPS[group]), PERIOD, tmp_path, "-O0")
    assert built.twin.left_out == {}
    samples = disturbed(make(2.4, payload=picked, noise=0.25).samples)
    wanted = expected(built, samples)
    seen = np.bitwise_or.reduce(wanted["feedforward"]["flags"])
    assert seen & 0x3FF == 0x3FF, "every fault that a sample can have"
    assert built.init() == 0
    assert differences(built.run(samples), wanted) == []


@pytest.mark.parametrize("path", sorted(SHIPPED.glob("*.toml")), ids=lambda path: path.stem)
@pytest.mark.parametrize("period", [0.25e-3, 4e-3])
def test_robots_that_come_along_at_fast_and_slow_rates(make, tmp_path: Path, path: Path, period: float) -> None:
    built = Built(load_robot(path), period, tmp_path, "-O0")
    samples = disturbed(make(1200 * period, payload=picked, noise=0.25, period=period).samples)
    assert built.init() == 0
    assert differences(built.run(samples), expected(built, samples)) == []


def test_a_fourth_axis_that_swings_the_load(robot, make, tmp_path: Path) -> None:
    built = Built(robot.model_copy(update={"fourth_axis": FourthAxis(shaft_mass_kg=0.2)}), PERIOD, tmp_path, "-O0")
    samples = make(2.0, payload=picked, noise=0.1).samples
    time = np.arange(len(samples)) * PERIOD
    samples["fourth_position"] = np.where(time < 0.3, np.nan, 2.0 * np.sin(4.0 * time))
    wanted = expected(built, samples)
    assert built.init() == 0
    assert differences(built.run(samples), wanted) == []
    plain = samples.copy()
    plain["fourth_position"] = np.nan
    assert differences(wanted, expected(built, plain)) != [], "the angle has a say"


def test_planned_motion_is_answered_for_as_in_the_service(robot, make, tmp_path: Path) -> None:
    built, estimator = Built(robot, PERIOD, tmp_path, "-O0"), Estimator(robot, PERIOD)
    known = make(0.4)
    answer, planned = np.zeros(1, built.dtypes["feedforward"]), np.zeros(1, built.dtypes["reference"])
    given = built.samples(known.samples)
    assert built.init() == 0
    sources = set()
    for k in range(len(given) - 1):
        planned["sequence"], planned["position"] = k + 1, known.theta[k + 1]
        planned["velocity"] = known.theta_dot[k + 1] if k % 50 else np.nan  # refused now and then
        planned["acceleration"] = known.theta_ddot[k + 1]
        estimator.plan(_on_the_wire(planned))
        assert built.call("plan", planned) == 0
        estimator.step(known.samples[k].tobytes())
        assert built.call("step", given[k : k + 1], answer) == 0
        wanted = converted(estimator.feedforward, built.dtypes["feedforward"])
        assert differences({"feedforward": answer}, {"feedforward": wanted}) == []
        sources.add(int(answer["source"][0]))
    assert len(sources) == 3


def _on_the_wire(planned: np.ndarray) -> np.void:
    from schemas.messages import REFERENCE

    record = REFERENCE.empty()
    for name in planned.dtype.names or ():
        record[name] = planned[name]
    return record[0]


def test_a_robot_that_weighs_by_the_commanded_torque(robot, make, tmp_path: Path) -> None:
    noise = JointParameter(value=[0.25, 0.25, 0.25])
    commanded = robot.identified.model_copy(update={"torque_commanded": True, "torque_noise_nm": noise})
    built = Built(robot.model_copy(update={"identified": commanded}), PERIOD, tmp_path, "-O0")
    samples = make(2.0, payload=picked).samples
    samples["torque_command"] = samples["torque"]
    samples["torque"] += np.random.default_rng(5).normal(0.0, 0.25, samples["torque"].shape)
    samples["torque_command"][1600:, 1] += 8.0  # refuted
    assert built.init() == 0
    assert differences(built.run(samples), expected(built, samples)) == []
