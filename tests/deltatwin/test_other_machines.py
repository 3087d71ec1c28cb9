"""Arms and axes by `import deltatwin`: the load and the motion that another program simulated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import deltatwin as dt
from tests.service.arms import FOUR, Load

pytest.importorskip("pinocchio")
LOAD = Load(1.7, (0.03, -0.02, 0.09), (0.006, 0.005, 0.004))


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> tuple[dt.Description, Path]:
    """An arm whose logs MuJoCo made, identified from a URDF with wrong masses; and their folder."""
    folder = tmp_path_factory.mktemp("arm")
    (folder / "arm.urdf").write_text(FOUR.urdf(scale=1.15))
    (folder / "arm.toml").write_text(FOUR.description())
    described = dt.load_robot(folder / "arm.toml")
    logs = [dt.read_trace(FOUR.record(folder / f"empty_{seed}.csv", seed), described) for seed in (0, 1)]
    return dt.identify(described, logs).robot, folder


def test_the_load_of_an_arm(arm: tuple[dt.Description, Path]) -> None:
    robot, folder = arm
    found = dt.payload(robot, dt.read_trace(FOUR.record(folder / "load.csv", 50, LOAD), robot), "flange")
    assert isinstance(found, dt.LoadResult)
    table = {row["name"]: row for row in found.to_frame().iter_rows(named=True)}
    assert table["mass"]["value"] == pytest.approx(LOAD.mass, abs=0.034)
    np.testing.assert_allclose([table[f"centre {axis}"]["value"] for axis in "xyz"], LOAD.centre, atol=0.01)
    assert all(row["separable"] for row in table.values())
    assert "kg on flange" in found.conclusion
    shown: Any = found.plot()
    without, with_it = (sum(bar.y) for bar in shown.data)
    assert with_it < 0.2 * without
    assert "1.7" in found._repr_html_()
    with pytest.raises(dt.RobotError, match="has no link 'hand'"):
        dt.payload(robot, dt.read_trace(folder / "load.csv", robot), "hand")


def test_the_motion_of_an_arm(arm: tuple[dt.Description, Path]) -> None:
    robot, folder = arm
    log = dt.read_trace(FOUR.record(folder / "later.csv", 7), robot)
    found = dt.rollout({"identified": robot}, log, horizon=0.1)
    assert isinstance(found, dt.JointRolloutResult)
    table = {row["robot"]: row for row in found.to_frame().iter_rows(named=True)}
    for joint in range(1, 5):
        assert table["identified"][f"joint_{joint}"] < 0.2 * table["stands still"][f"joint_{joint}"]
    shown: Any = found.plot()
    assert [line.name for line in shown.data] == ["plain", "identified", "floor"]
    assert "% of their travel" in found.conclusion
    with pytest.raises(dt.RobotError):
        dt.rollout(robot, log, commands=True)


def test_what_is_of_an_arm_is_not_asked_of_a_delta() -> None:
    robot, log = dt.load_demo()
    with pytest.raises(dt.DataError, match="has its load on the platform"):
        dt.payload(robot, log, "flange")  # type: ignore[call-overload]
