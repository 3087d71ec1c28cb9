"""What `estimate` says before it runs."""

from __future__ import annotations

from pathlib import Path

from schemas.robot import Limits, load_robot
from service.estimator.bounds import assumed_limit


def test_a_largest_torque_that_is_assumed_is_said() -> None:
    """A heavier payload needs more of it."""
    robot = load_robot("d3-1200").model_copy(update={"limits": Limits(max_payload_kg=1.0)})
    said = assumed_limit(Path("d3.toml"), robot)
    assert said.startswith("d3.toml: limits.peak_torque_nm is not set: ")
    assert said.endswith(" N m assumed, the torque at 10 g with 1 kg")
    heavier = robot.model_copy(update={"limits": Limits(max_payload_kg=6.0)})
    least, most = (float(text.split(": ")[2].split()[0]) for text in (said, assumed_limit(Path("d3.toml"), heavier)))
    assert 0.0 < least < most
