"""What can be wrong with a robot of the second plant.

Effects have the names of the catalogue and are written from its reference pages; disturbances are what no catalogue
has. Each is drawn in the size of a real fault, by the torque that the robot takes at work.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from tests.bench.second_plant.robots import World

Draw = Callable[[World, np.random.Generator, np.ndarray], tuple[dict[str, Any], dict[str, Any]]]
# Changes of the plant and of the report, by their fields.

MILLIMETRE = 1e-3
GEOMETRY = ("link_length_error", "forearm_length_error", "base_radius_error", "azimuth_error", "joint_offset")


def _signed(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high) * rng.choice([-1, 1]))


def _stribeck(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    size = world.plant.coulomb * rng.uniform(0.5, 1.1, 3) * on
    return {"stribeck": size, "stribeck_speed": np.full(3, rng.uniform(0.08, 0.4))}, {}


def _asymmetric(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    side = rng.choice([-1, 1], 3) * on
    return {
        "one_sided_coulomb": side * world.plant.coulomb * rng.uniform(0.15, 0.4, 3),
        "one_sided_viscous": side * world.plant.viscous * rng.uniform(0.3, 0.6, 3),
    }, {}


def _load(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"load_friction": on * rng.uniform(0.06, 0.14, 3)}, {}


def _power(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    thinning = rng.random() < 0.5
    power = rng.uniform(0.35, 0.6) if thinning else rng.uniform(1.7, 2.2)
    size = world.size * (rng.uniform(0.12, 0.3) if thinning else rng.uniform(0.02, 0.06))
    return {"power": power, "power_friction": on * size}, {}


def _wave_friction(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    return {
        "wave_friction": on * world.plant.coulomb * rng.uniform(0.3, 0.7, 3),
        "wave_order": np.full(3, float(rng.integers(2, 9))),
        "wave_phase": rng.uniform(0, 2 * np.pi, 3),
    }, {}


def _warm(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    size = world.plant.viscous * rng.uniform(0.7, 1.6)
    return {"warm_friction": on * size, "warm_time": rng.uniform(10.0, 50.0)}, {}


def _bristles(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"bristle_way": on * rng.uniform(0.015, 0.07)}, {}


def _balls(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"ball_dry": world.size * rng.uniform(0.015, 0.05), "ball_viscous": world.size * rng.uniform(0.0, 0.008)}, {}


def _rotor(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    plant = world.plant
    inertia = plant.link_mass * plant.link**2 / 3 + plant.rotor
    return {"rotor": plant.rotor + on * inertia * rng.uniform(0.2, 0.5)}, {}


def _arm_mass(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"link_mass": world.plant.link_mass * (1 + on * rng.uniform(0.1, 0.3))}, {}


def _tool(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"platform_mass": world.plant.platform_mass * (1 + rng.uniform(0.12, 0.4))}, {}


def _tilt(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    lean, turn = np.radians(rng.uniform(1.2, 4.0)), rng.uniform(0, 2 * np.pi)
    down = float(np.linalg.norm(world.plant.gravity))
    toward = [np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), -np.cos(lean)]
    return {"gravity": down * np.array(toward)}, {}


def _spring(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"spring": on * world.size * rng.uniform(0.15, 0.5), "spring_zero": np.full(3, rng.uniform(-0.4, 0.8))}, {}


def _hose(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    pull = world.size / float(world.plant.link.mean()) * rng.uniform(0.1, 0.35)
    turn = rng.uniform(0, 2 * np.pi)
    point = np.array([0.35 * np.cos(turn), 0.35 * np.sin(turn), rng.uniform(-0.2, 0.1)])
    return {"hose": pull, "hose_point": point}, {}


def _drag(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"drag": world.size / float(world.plant.link.mean()) * rng.uniform(0.03, 0.1)}, {}


def _length(name: str) -> Draw:
    def draw(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
        return {name: getattr(world.plant, name) + on * _signed(rng, 3.0, 9.0) * MILLIMETRE}, {}

    return draw


def _azimuth(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"azimuth": world.plant.azimuth + on * np.radians(_signed(rng, 1.0, 3.0))}, {}


def _zero(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"encoder_offset": on * np.radians(_signed(rng, 1.0, 3.0))}, {}


def _angle_scale(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"encoder_scale": on * _signed(rng, 0.015, 0.05)}, {}


def _elastic(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    stiffness = world.size * rng.uniform(60, 250)
    inertia = float(world.plant.rotor.mean())
    damping = 2 * rng.uniform(0.03, 0.12) * np.sqrt(stiffness * inertia)
    return {"stiffness": on * stiffness, "damping": on * damping, "lash": np.zeros(3)}, {}


def _lash(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    inertia = float(world.plant.rotor.mean())
    stiffness = inertia * (2 * np.pi * rng.uniform(70, 110)) ** 2
    damping = 2 * rng.uniform(0.15, 0.35) * np.sqrt(stiffness * inertia)
    return {"stiffness": on * stiffness, "damping": on * damping, "lash": on * rng.uniform(2e-3, 8e-3)}, {}


def _cogging(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    order = float(rng.choice([1, 2, 4, 6]))
    return {
        "cogging": on * world.size * rng.uniform(0.05, 0.15),
        "cogging_order": np.full(3, order * world.gear),
        "cogging_phase": rng.uniform(0, 2 * np.pi, 3),
    }, {}


def _eccentric(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    return {
        "encoder_wave": on * rng.uniform(4e-3, 12e-3) / world.gear,
        "encoder_order": np.full(3, world.gear),
        "encoder_phase": rng.uniform(0, 2 * np.pi, 3),
    }, {}


def _shaft(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    force = world.size / float(world.plant.link.mean())
    return {"shaft_dry": force * rng.uniform(0.1, 0.3), "shaft_viscous": force * rng.uniform(0.0, 0.06)}, {}


def _drive_lag(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"lag_hz": np.full(3, rng.uniform(18.0, 60.0))}, {}


def _torque_scale(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    return {}, {"scale": on * _signed(rng, 0.05, 0.14)}


def _torque_offset(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    return {}, {"offset": on * _signed(rng, 0.05, 0.15) * world.size}


def _delay(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    return {}, {"delay": _signed(rng, 1e-3, 4e-3)}


def _filter(world: World, rng: np.random.Generator, on: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    return {}, {"filter_hz": rng.uniform(8.0, 40.0)}


# On one joint; on one or on all; on the robot as a whole.
ONE: dict[str, Draw] = {
    "rotor_inertia": _rotor, "arm_mass": _arm_mass, "joint_spring": _spring, "link_length_error": _length("link"),
    "forearm_length_error": _length("forearm"), "base_radius_error": _length("radius"), "azimuth_error": _azimuth,
    "joint_offset": _zero, "angle_scale": _angle_scale, "backlash": _lash, "torque_scale": _torque_scale,
    "torque_offset": _torque_offset, "cogging": _cogging, "encoder_eccentricity": _eccentric,
}  # fmt: skip
SOME: dict[str, Draw] = {
    "stribeck_friction": _stribeck, "asymmetric_friction": _asymmetric, "load_dependent_friction": _load,
    "nonlinear_viscous_friction": _power, "position_dependent_friction": _wave_friction, "warmup_friction": _warm,
    "presliding_friction": _bristles, "joint_elasticity": _elastic,
}  # fmt: skip
WHOLE: dict[str, Draw] = {
    "passive_joint_friction": _balls, "tool_mass": _tool, "base_tilt": _tilt, "hose_spring": _hose, "air_drag": _drag,
    "shaft_friction": _shaft, "drive_lag": _drive_lag, "torque_delay": _delay, "torque_filter": _filter,
}  # fmt: skip
EFFECTS = tuple(sorted({**ONE, **SOME, **WHOLE}))
# Both would alter the same entries of the plant, or one hides the other by what they are.
APART = (
    {"joint_elasticity", "backlash"}, {"torque_offset", "asymmetric_friction"},
    {"torque_delay", "torque_filter", "drive_lag"}, {*GEOMETRY, "angle_scale"}, {"encoder_eccentricity", "cogging"},
)  # fmt: skip


def may_join(names: list[str]) -> bool:
    """Whether effects can be at work together as separate ones."""
    return len(set(names)) == len(names) and all(len(group.intersection(names)) < 2 for group in APART)


def afflicted(world: World, name: str, rng: np.random.Generator) -> World:
    """The world with the effect `name` at work, and noted."""
    joint = int(rng.integers(3))
    every = name in SOME and rng.random() < 0.5
    on = np.ones(3) if every else np.eye(3)[joint]
    changed, reported = {**ONE, **SOME, **WHOLE}[name](world, rng, on)
    joints = [] if name in WHOLE else [1, 2, 3] if every else [joint + 1]
    return _with(world, changed, reported, "named", name, joints)


def _slosh(world: World, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    mass = world.plant.platform_mass * rng.uniform(0.2, 0.5)
    turn = 2 * np.pi * rng.uniform(1.5, 5.0)
    return {
        "slosh_mass": mass, "slosh_stiffness": mass * turn**2,
        "slosh_damping": 2 * rng.uniform(0.04, 0.2) * mass * turn,
    }, {}  # fmt: skip


def _shake(world: World, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    rows = []
    for _ in range(2):
        turn = rng.uniform(0, 2 * np.pi)
        rows.append([rng.uniform(0.5, 2.0), rng.uniform(4, 16), rng.uniform(0, 6), np.cos(turn), np.sin(turn)])
    return {"shake": np.array(rows)}, {}


def _frame(world: World, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    mass, turn = world.plant.platform_mass * rng.uniform(6, 15), 2 * np.pi * rng.uniform(5, 14)
    return {
        "frame_mass": mass, "frame_stiffness": mass * turn**2,
        "frame_damping": 2 * rng.uniform(0.03, 0.1) * mass * turn,
    }, {}  # fmt: skip


def _place(world: World, rng: np.random.Generator) -> np.ndarray:
    turn, far = rng.uniform(0, 2 * np.pi), world.room.radius * rng.uniform(0.4, 0.9)
    return np.array(
        [far * np.cos(turn), far * np.sin(turn), world.room.middle - world.room.half * rng.uniform(0.8, 1.6)]
    )


def _force(world: World) -> float:
    return world.size / float(world.plant.link.mean())


def _magnet(world: World, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    return {
        "magnet": _force(world) * rng.uniform(0.15, 0.4), "magnet_point": _place(world, rng),
        "magnet_reach": world.room.radius * rng.uniform(0.2, 0.45),
    }, {}  # fmt: skip


def _saturates(world: World, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"saturation": np.full(3, world.size * rng.uniform(3.5, 7.0))}, {}


def _knocks(world: World, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    count = int(rng.integers(12, 40))
    begin, lasting = rng.uniform(0, 75, count), rng.uniform(0.008, 0.05, count)
    force = rng.normal(size=(count, 3)) * _force(world) * rng.uniform(0.4, 1.5, (count, 1))
    return {"knocks": np.column_stack([begin, lasting, force])}, {}


def _cable(world: World, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"cable": _force(world) * rng.uniform(0.08, 0.25), "cable_way": rng.uniform(0.02, 0.15)}, {}


def _jet(world: World, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    width = world.room.radius * rng.uniform(0.2, 0.5)
    return {"jet": _force(world) * rng.uniform(0.15, 0.4), "jet_point": _place(world, rng)[:2], "jet_width": width}, {}


def _rough(world: World, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    on = np.eye(3)[rng.integers(3)]
    return {
        "rough": on * world.plant.coulomb * rng.uniform(0.8, 2.0), "rough_at": np.full(3, rng.uniform(0.2, 0.7)),
        "rough_width": np.full(3, rng.uniform(0.02, 0.08)),
    }, {}  # fmt: skip


def _fades(world: World, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"fading": rng.uniform(0.5e-3, 2.5e-3, 3)}, {}


def _crossed(world: World, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    return {}, {"crossed": _signed(rng, 0.03, 0.1)}


DISTURBANCES: dict[str, Callable[[World, np.random.Generator], tuple[dict[str, Any], dict[str, Any]]]] = {
    "sloshing_load": _slosh, "vibrating_base": _shake, "soft_frame": _frame, "magnet": _magnet,
    "saturating_torque_constant": _saturates, "knocks": _knocks, "dragged_cable": _cable, "air_jet": _jet,
    "rough_spot": _rough, "fading_torque_constant": _fades, "crossed_torque": _crossed,
}  # fmt: skip


def disturbed(world: World, name: str, rng: np.random.Generator) -> World:
    """The world with the disturbance `name` at work, and noted."""
    changed, reported = DISTURBANCES[name](world, rng)
    return _with(world, changed, reported, "disturbed", name, [])


def misdescribed(world: World, rng: np.random.Generator) -> World:
    """The world with a description whose masses are off by up to a quarter and whose lengths by some millimetres, alike
    on all arms, as a description from a data sheet is; the robot stays as it is."""
    geometry, mass = dict(world.description["geometry"]), dict(world.description["mass"])
    wrong: dict[str, Any] = {}
    for name in mass:
        wrong[name] = float(rng.uniform(0.75, 1.25))
        mass[name] *= wrong[name]
    for name in rng.choice(["active_link_length", "passive_link_length", "base_radius"], 2, replace=False):
        wrong[str(name)] = _signed(rng, 2.0, 6.0) * MILLIMETRE
        geometry[str(name)] += wrong[str(name)]
    described = {**world.description, "geometry": geometry, "mass": mass}
    return World(**{**vars(world), "description": described, "misdescribed": wrong})


def _with(
    world: World, changed: dict[str, Any], reported: dict[str, Any], where: str, name: str, joints: list[int]
) -> World:
    noted = {key: np.asarray(value).tolist() for key, value in {**changed, **reported}.items()}
    entry = {"joints": joints, "parameters": noted}
    return World(
        **{
            **vars(world), "plant": world.plant._replace(**changed), "report": world.report._replace(**reported),
            where: {**getattr(world, where), name: entry},
        }
    )  # fmt: skip
