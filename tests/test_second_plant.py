"""The second plant against what does not know it: conserved energy, the published statics, and itself backwards."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import deltatwin
from drivers.trace import read_trace
from schemas.robot import Identified, load_robot
from service.model.effects import CATALOGUE
from tests.bench.second_plant.cases import at_rest, draw, make, motions, placed
from tests.bench.second_plant.closed_chain import (
    ANGLE,
    ANGLE_RATE,
    CYCLE_S,
    MOTOR,
    MOTOR_RATE,
    SPEED,
    Plant,
    energy,
    run,
)
from tests.bench.second_plant.closed_chain import PLACE as PLATFORM
from tests.bench.second_plant.faults import DISTURBANCES, EFFECTS, afflicted, disturbed, may_join
from tests.bench.second_plant.inverse import along, angles, elbows, required
from tests.bench.second_plant.recorder import coloured, reported, scope
from tests.bench.second_plant.robots import World, as_described, drawn

PLACE = np.array([0.11, -0.07, -0.71])
DESCRIPTION = {
    "gravity_mps2": 9.81,
    "geometry": {
        "active_link_length": 0.31, "passive_link_length": 0.76, "base_radius": 0.16, "platform_radius": 0.05,
        "arm_angles_deg": [0.0, 120.0, 240.0],
    },
    "mass": {"active_link": 1.9, "passive_link": 0.55, "platform": 1.3},
}  # fmt: skip


@pytest.fixture(scope="module")
def bare() -> Plant:
    return as_described(DESCRIPTION)._replace(rotor=np.array([0.03, 0.05, 0.04]))


def published_statics(place: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Torque (3,) at rest by the paper's G and Jacobian as they are right (docs/explanation/model.md)."""
    l1, r, azimuth = 0.31, 0.16 - 0.05, np.radians([0, 120, 240])
    m0, m1, m2, g = 1.3, 1.9, 0.55 / 2, 9.81
    x, y, z = place
    across = np.cos(azimuth), np.sin(azimuth)
    out = r + l1 * np.cos(angle)
    a = np.stack([x - out * across[0], y - out * across[1], z + l1 * np.sin(angle)])
    k = l1 * ((x * across[0] + y * across[1] - r) * np.sin(angle) + z * np.cos(angle))
    jacobian = -np.linalg.solve(a.T, np.diag(k))
    return -(m1 / 2 + m2) * g * l1 * np.cos(angle) + jacobian.T @ np.array([0.0, 0.0, (m0 + 3 * m2) * g])


def test_static_torque_is_the_published_one(bare: Plant) -> None:
    angle = angles(bare, PLACE[None])
    expected = published_statics(PLACE, angle[0])
    moving = along(bare, np.repeat(PLACE[None], 5, axis=0), CYCLE_S)
    np.testing.assert_allclose(required(bare, moving)[2], expected, rtol=1e-9)
    hold = np.repeat(expected[None], 200, axis=0)
    said, _, _, _ = run(bare, at_rest(bare, PLACE), 0 * hold, 0 * hold, hold, 0.0)
    assert np.abs(said[-1] - angle[0]).max() < 1e-9
    moved, _, _, _ = run(bare, at_rest(bare, PLACE), 0 * hold, 0 * hold, 0.99 * hold, 0.0)
    assert np.abs(moved[-1] - angle[0]).max() > 1e-5
    np.testing.assert_allclose(placed(bare, angle)[0], PLACE, atol=1e-12)


def test_free_motion_keeps_its_energy(bare: Plant) -> None:
    free = bare._replace(
        spring=np.array([0.0, 6.0, 0.0]), spring_zero=np.full(3, 0.3), hose=20.0, hose_point=np.array([0.2, 0.1, -0.1])
    )
    state = at_rest(free, PLACE)
    arm = elbows(free, angles(free, PLACE[None]), PLACE[None])
    state[SPEED : SPEED + 3] = speed = np.array([1.2, -0.6, 0.8])
    rate = np.sum(arm.forearm * speed, axis=-1)[0] / np.sum(arm.forearm * arm.slope, axis=-1)[0]
    state[ANGLE_RATE : ANGLE_RATE + 3] = state[MOTOR_RATE : MOTOR_RATE + 3] = rate
    nothing = np.zeros((800, 3))
    _, _, places, checks = run(free, state, nothing, nothing, nothing, 0.0)
    exchanged = np.ptp(places[:, 2]) * free.platform_mass * 9.81
    assert exchanged > 0.5
    assert np.abs(checks[:, 1]).max() < 1e-6 * exchanged
    assert checks[:, 0].max() < 1e-9
    assert energy(free, at_rest(free, PLACE)) != pytest.approx(energy(free, at_rest(free, PLACE + 0.01)))


def test_friction_takes_the_energy_that_its_torque_does(bare: Plant) -> None:
    rubbed = bare._replace(viscous=np.array([0.8, 0.5, 1.1]))
    nothing = np.zeros((400, 3))
    said, _, _, checks = run(rubbed, at_rest(rubbed, PLACE), nothing, nothing, nothing, 0.0)
    rate = np.gradient(said, CYCLE_S, axis=0)
    lost = np.trapezoid(np.sum(rubbed.viscous * rate**2, axis=1), dx=CYCLE_S)
    assert checks[-1, 1] == pytest.approx(-lost, rel=1e-3)


def test_the_torque_that_moves_it_is_the_one_that_the_motion_takes(bare: Plant) -> None:
    held = bare._replace(position_gain=np.full(3, 900.0), velocity_gain=np.full(3, 40.0))
    time = np.arange(2400) * CYCLE_S
    path = PLACE + 0.06 * (1 - np.cos(2 * np.pi * time / 0.6))[:, None] * [1.0, 0.7, 0.4]
    moving = along(held, path, CYCLE_S)
    said, asked, places, _ = run(held, at_rest(held, path[0]), moving.angle, moving.rate, required(held, moving), 0.0)
    taken = required(held, along(held, places, CYCLE_S))
    inner = slice(20, -20)
    assert np.abs(taken[inner] - asked[inner]).max() < 0.01 * np.abs(asked).max()
    assert np.abs(said - moving.angle).max() < 1e-3


@pytest.mark.parametrize("kind", ["effects", "disturbances"])
def test_each_changes_the_plant_or_the_report_and_is_noted(kind: str) -> None:
    rng = np.random.default_rng(4)
    whole = drawn(rng)
    for name in EFFECTS if kind == "effects" else DISTURBANCES:
        other = (afflicted if kind == "effects" else disturbed)(whole, name, rng)
        assert list(other.named if kind == "effects" else other.disturbed) == [name]
        assert differs(whole, other), name


def differs(one: World, other: World) -> bool:
    pairs = [*zip(one.plant, other.plant, strict=True), *zip(one.report, other.report, strict=True)]
    return any(not np.array_equal(np.asarray(a), np.asarray(b)) for a, b in pairs)


def test_its_effects_are_those_of_the_catalogue_and_its_disturbances_are_not() -> None:
    names = {effect.name for effect in CATALOGUE}
    assert set(EFFECTS) <= names
    assert not names.intersection(DISTURBANCES)


def test_effects_that_hide_each_other_are_not_drawn_together() -> None:
    assert may_join(["tool_mass", "backlash"])
    assert not may_join(["tool_mass", "tool_mass"])
    assert not may_join(["backlash", "joint_elasticity"])


def test_noise_has_its_size_and_its_memory() -> None:
    rng = np.random.default_rng(1)
    recorder = scope(rng, 20.0, 20.0)
    noise = coloured(rng, recorder, 200_000)
    assert noise.std() == pytest.approx(recorder.noise_nm, rel=0.05)
    lag = np.mean(noise[1:] * noise[:-1]) / noise.var()
    forgets = np.exp(-1 / (recorder.rate_hz * recorder.memory_s))
    assert lag == pytest.approx(recorder.coloured * forgets, abs=0.02)


def test_a_delayed_report_is_the_torque_of_before() -> None:
    world = drawn(np.random.default_rng(2))
    asked = np.cumsum(np.ones((100, 3)), axis=0)
    late = reported(asked, world.report._replace(delay=2.5 * CYCLE_S, offset=np.array([1.0, 0.0, 0.0])))
    np.testing.assert_allclose((asked - late)[10:, 1], 3.0)  # 2.5 cycles, and half a cycle's mean
    np.testing.assert_allclose((asked - late)[10:, 0], 2.0)


def test_a_case_is_what_identification_finds_the_robot_in(tmp_path: Path) -> None:
    """Identification shares no code with the plant."""
    truth, plant = make("gap_free", 1, tmp_path), draw("gap_free", 1).world.plant
    robot = load_robot(tmp_path / "robot.toml")
    names = {path.name for path in tmp_path.iterdir()}
    files = {f"{name}_work.csv" for name in ("fit_a", "fit_b", "fit_c", "test_a", "test_b")}
    assert names == {"robot.toml", "truth.json", *files}
    trace = read_trace(tmp_path / "fit_b_work.csv", robot)
    assert not trace.findings
    assert truth["effects"] == {}
    assert 1.0 <= truth["lift"] < 1.02  # nothing is wrong, so the base model leaves noise
    found = deltatwin.identify(
        robot, [read_trace(path, robot) for path in sorted(tmp_path.glob("fit_*.csv"))]
    ).robot.identified
    assert isinstance(found, Identified)
    assert found.forearm_inertia_kg.value == pytest.approx(plant.forearm_mass[0], rel=0.03)
    np.testing.assert_allclose(found.coulomb_friction_nm.value, plant.coulomb, rtol=0.03)
    np.testing.assert_allclose(found.viscous_friction_nms.value, plant.viscous, rtol=0.05)


def test_a_seed_is_one_case_and_another_is_another() -> None:
    first, again, other = (draw("three", seed) for seed in (1, 1, 2))
    assert not differs(first.world, again.world)
    assert first.world.named == again.world.named
    assert first.recorder == again.recorder
    assert differs(first.world, other.world)
    assert len(first.world.named) == 3
    for one, two in zip(
        motions(first, np.random.default_rng(1)).values(),
        motions(again, np.random.default_rng(1)).values(),
        strict=True,
    ):
        np.testing.assert_array_equal(one, two)


def test_a_soft_gear_begins_bent_by_its_weight_and_does_not_swing(bare: Plant) -> None:
    """Against a start at which it is straight: then the platform falls and swings."""
    soft = bare._replace(
        stiffness=np.full(3, 2500.0), damping=np.full(3, 0.6), position_gain=np.full(3, 3e3),
        velocity_gain=np.full(3, 20.0),
    )  # fmt: skip
    state = at_rest(soft, PLACE)
    hold = np.repeat(state[None, MOTOR : MOTOR + 3], 1200, axis=0)
    load = soft.stiffness * (state[MOTOR : MOTOR + 3] - state[ANGLE : ANGLE + 3])
    straight = state.copy()
    straight[ANGLE : ANGLE + 3], straight[PLATFORM : PLATFORM + 3] = state[MOTOR : MOTOR + 3], PLACE
    swings = [
        np.ptp(run(soft, start, hold, 0 * hold, 0 * hold + load, 0.0)[2][:, 2]) for start in (state, straight)
    ]  # fmt: skip
    assert swings[0] < 0.1 * swings[1]
    assert state[PLATFORM + 2] < PLACE[2] - 5e-4
