"""A small robot like those of the reference logs, and a motion for it."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.motion import Planner
from drivers.simulated.plant.plant import Plant
from drivers.simulated.plant.truth import PlantTruth
from schemas.robot import Geometry, Mass, Robot

FRICTION = {"coulomb_friction_nm": [3.0, 2.5, 3.5], "viscous_friction_nms": [1.0, 0.8, 1.2]}


@pytest.fixture(scope="session")
def robot() -> Robot:
    return Robot(
        name="small",
        geometry=Geometry(active_link_length=0.35, passive_link_length=0.86, base_radius=0.19, platform_radius=0.05),
        mass=Mass(active_link=2.6, passive_link=0.6, platform=1.3),
    )


@pytest.fixture(scope="session")
def planner(robot: Robot) -> Planner:
    return Planner(robot, 1e-3)


@pytest.fixture
def ideal(robot: Robot) -> Plant:
    return Plant(robot, PlantTruth.nominal(robot))


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)
