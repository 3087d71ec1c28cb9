"""Hostile samples through the generated C under the sanitizers: nothing out of its bounds, every answer a number.

Ten million: tests/bench/bench_export.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from schemas.messages import REFERENCE
from schemas.robot import FourthAxis
from service.estimator.bounds import bounds_of
from service.estimator.estimator import Estimator
from tests.hostile import REAL, hostile
from tests.known import PERIOD, make, robot
from tests.service.codegen.built import needs_compiler
from tests.service.codegen.sanitized import Sanitized
from tests.service.codegen.test_twin import GROUPS, with_effects

__all__ = ["make", "robot"]
pytestmark = needs_compiler
SAMPLES, PLANNED = 20_000, 97
FOURTH_AXIS = FourthAxis(shaft_mass_kg=0.2)


def streams(good: np.ndarray, count: int, seed: int) -> np.ndarray:
    """`count` samples and more, hostile streams between good ones."""
    random, parts, made = np.random.default_rng(seed), [], 0
    while made < count:
        well = good[: int(random.integers(100, 400))].copy()
        well["sequence"] += random.integers(2**64, dtype=np.uint64)
        parts += [hostile(random, good, int(random.integers(50, 1000))), well]
        made += len(parts[-2]) + len(well)
    return np.concatenate(parts)


def turned(samples: np.ndarray, seed: int) -> np.ndarray:
    """With angles of a fourth axis, a twentieth of them hostile."""
    random, turning = np.random.default_rng(seed), samples.copy()
    struck = random.random(len(samples)) < 0.05
    swing = 2.0 * np.sin(4e-3 * np.arange(len(samples)))
    turning["fourth_position"] = np.where(struck, random.choice(REAL, len(samples)), swing)
    return turning


@pytest.mark.parametrize("group", ["friction", "gears", "loose"])
def test_nothing_is_out_of_its_bounds(robot, make, tmp_path: Path, group: str) -> None:
    described, samples = with_effects(robot, GROUPS[group]), streams(make(1.0, noise=0.25).samples, SAMPLES, 3)
    if group == "loose":
        described, samples = described.model_copy(update={"fourth_axis": FOURTH_AXIS}), turned(samples, 4)
    torque = Sanitized(described, PERIOD, tmp_path).run(samples)
    assert np.abs(torque).max() <= bounds_of(robot).peak_nm
    assert np.ptp(torque) > 1.0
    np.testing.assert_array_equal(torque, of_the_service(described, samples))


def of_the_service(robot, samples: np.ndarray) -> np.ndarray:
    """Torques (N, 3) N m, with the plans that `PROGRAM` makes."""
    estimator, found, plan = Estimator(robot, PERIOD), [], REFERENCE.empty()
    for begin in range(0, len(samples), PLANNED):
        part = samples[begin : begin + PLANNED]
        found.append(estimator.run(part).feedforward["torque"])
        if len(part) == PLANNED:
            plan["sequence"], plan["position"] = part["sequence"][-1:] + np.uint64(1), part["torque"][-1]
            plan["velocity"] = part["position_command"][-1]
            estimator.plan(plan[0])
    return np.concatenate(found)
