"""A Delta with nothing symmetric about it, so that no term can hide behind another."""

import numpy as np
import pytest

from schemas.robot import Geometry, Mass, Robot
from service.model.nominal import DeltaModel, pack


@pytest.fixture(scope="session")
def robot() -> Robot:
    return Robot(
        name="odd",
        geometry=Geometry(
            active_link_length=0.36,
            passive_link_length=0.85,
            base_radius=0.19,
            platform_radius=0.05,
            arm_angles_deg=[5.0, 118.0, 247.0],
            active_link_length_error=[0.0, 0.004, -0.006],
            passive_link_length_error=[0.003, -0.005, 0.0],
            base_radius_error=[-0.004, 0.0, 0.006],
            joint_offset_rad=[0.01, 0.0, -0.02],
        ),
        mass=Mass(active_link=2.7, passive_link=0.55, platform=1.3),
    )


@pytest.fixture(scope="session")
def model(robot: Robot) -> DeltaModel:
    return pack(robot)


@pytest.fixture(scope="session")
def poses() -> np.ndarray:
    """Joint angles over the whole workspace, rad, (2000, 3)."""
    return np.random.default_rng(1).uniform(-0.5, 1.3, (2000, 3))
