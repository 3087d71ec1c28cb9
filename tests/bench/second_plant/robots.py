"""Robots of the second plant, drawn from a generator: description, report of the torque, control."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple, get_type_hints

import numpy as np

from tests.bench.second_plant.closed_chain import CYCLE_S, Plant
from tests.bench.second_plant.inverse import along, required
from tests.bench.second_plant.platform_paths import Room, picks, room_of

GRAVITY = 9.81


class Report(NamedTuple):
    """What becomes of the torque on its way into the log; arrays hold an entry a joint."""

    scale: np.ndarray  # reported over true, less 1
    offset: np.ndarray  # N m
    delay: float  # s
    filter_hz: float  # 0: none
    crossed: float  # share of the next joint's torque that is in a joint's report


@dataclass(frozen=True)
class World:
    """A robot as it is, and as it is described. description: by the keys of a robot description. size: N m, rms of the
    torque that it takes at work, by which effects are drawn."""

    plant: Plant
    report: Report
    description: dict[str, Any]
    room: Room
    size: float
    named: dict[str, dict[str, Any]] = field(default_factory=dict)  # effects at work, with joints and parameters
    disturbed: dict[str, dict[str, Any]] = field(default_factory=dict)  # what no catalogue has
    misdescribed: dict[str, Any] = field(default_factory=dict)

    @property
    def gear(self) -> float:
        """Motor turns for a turn of the joint."""
        return float(self.description["drive"]["gear_ratio"])


def plain(**given: Any) -> Plant:
    """A plant with `given`, and of all else nothing."""
    none, way = np.zeros(3), {"cable_way": 0.01, "warm_time": 1.0, "power": 1.0, "magnet_reach": 1.0, "jet_width": 1.0}
    special: dict[str, Any] = {
        "stribeck_speed": np.ones(3), "rough_width": np.ones(3), "shake": np.zeros((0, 5)), "knocks": np.zeros((0, 5)),
        "jet_point": np.zeros(2), "gravity": np.array([0.0, 0.0, -GRAVITY]), **way,
    }  # fmt: skip
    scalars = {name for name, kind in get_type_hints(Plant).items() if kind is float}
    values = {name: 0.0 if name in scalars else none.copy() for name in Plant._fields}
    return Plant(**{**values, **special, **given})


def drawn(rng: np.random.Generator) -> World:
    """A robot with nothing wrong: its links and rotors are not quite those of its description, which rho_1 and rho_2
    take up, and its gears have dry and viscous friction."""
    link = rng.uniform(0.22, 0.42)
    forearm, radius = link * rng.uniform(2.15, 2.75), link * rng.uniform(0.25, 0.65)
    platform_radius = radius * rng.uniform(0.2, 0.4)
    masses = rng.uniform((3.5, 1.2, 1.0), (9.0, 2.6, 4.5)) * [link, link, link / 0.3]
    description = {
        "gravity_mps2": GRAVITY,
        "geometry": {
            "active_link_length": link, "passive_link_length": forearm, "base_radius": radius,
            "platform_radius": platform_radius, "arm_angles_deg": [0.0, 120.0, 240.0],
        },
        "mass": dict(zip(("active_link", "passive_link", "platform"), map(float, masses), strict=True)),
        "drive": {"gear_ratio": float(rng.choice([10, 15, 21, 25, 33, 50]))},
    }  # fmt: skip
    described = as_described(description)
    inertia = described.link_mass[0] * link**2 / 3
    bare = described._replace(
        link_mass=described.link_mass * rng.uniform(0.92, 1.08),
        rotor=np.full(3, rng.uniform(0.3, 0.9) * inertia),
    )
    room = room_of(bare)
    size = float(np.std(required(bare, along(bare, picks(rng, room, 3.0), CYCLE_S))))
    friction = size * rng.uniform(0.1, 0.35)
    rubbing = bare._replace(
        coulomb=friction * rng.uniform(0.7, 1.3, 3),
        viscous=size * rng.uniform(0.03, 0.12) * rng.uniform(0.7, 1.3, 3),
    )
    report = Report(np.zeros(3), np.zeros(3), 0.0, 0.0, 0.0)
    return World(controlled(rubbing, rng), report, description, room, size)


def as_described(description: dict[str, Any]) -> Plant:
    """The plant that a description says there is: no rotor, no friction."""
    geometry, mass = description["geometry"], description["mass"]
    return plain(
        link=np.full(3, geometry["active_link_length"]),
        forearm=np.full(3, geometry["passive_link_length"]),
        radius=np.full(3, geometry["base_radius"] - geometry["platform_radius"]),
        azimuth=np.radians(geometry["arm_angles_deg"]),
        link_mass=np.full(3, mass["active_link"]),
        forearm_mass=np.full(3, mass["passive_link"]),
        platform_mass=mass["platform"],
        gravity=np.array([0.0, 0.0, -description["gravity_mps2"]]),
    )


def controlled(plant: Plant, rng: np.random.Generator) -> Plant:
    """With gains for a bandwidth of some hertz at the inertia that a joint feels."""
    turning = plant.link_mass * plant.link**2 / 3 + plant.rotor
    carried = (plant.platform_mass + plant.forearm_mass.sum()) * plant.link**2 / 3
    bandwidth = 2 * np.pi * rng.uniform(5.0, 9.0)
    inertia = turning + carried
    return plant._replace(
        position_gain=inertia * bandwidth**2,
        velocity_gain=1.6 * inertia * bandwidth,
        integral_gain=inertia * bandwidth**3 * rng.uniform(0.0, 0.15),
    )
