"""How an arm's log is read: signs of positions by its links' weights, order and zero held against its URDF, units a
joint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.trace.tables import Table
from schemas.axes_description import Description, load_axes
from schemas.errors import DataError
from service.identification.proposal import Proposal, propose
from service.identification.readings import Stated
from tests.service import arm

JOINTS = ("j1", "j2", "j3")


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Description:
    return load_axes(arm.write(tmp_path_factory.mktemp("arm")))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    """(N, 7): time, positions and torques."""
    path = arm.record(tmp_path_factory.mktemp("log") / "log.csv", 1)
    return np.loadtxt(path, delimiter=",", skiprows=1)


def table(log: np.ndarray, position: np.ndarray, torque: np.ndarray, units: tuple[str, ...] = ("rad",) * 3) -> Table:
    columns = {"time [s]": log[:, 0]}
    columns |= {
        f"{name} pos [{unit}]": position[:, k] for k, (name, unit) in enumerate(zip(JOINTS, units, strict=True))
    }
    columns |= {f"{name} torque [Nm]": torque[:, k] for k, name in enumerate(JOINTS)}
    return Table(Path("log.csv"), "text", columns)


def test_a_log_with_fewer_joints_than_the_arm_says_where_those_at_rest_go(log: np.ndarray, tmp_path: Path) -> None:
    arm.write(tmp_path)
    four = arm.DESCRIPTION.replace(
        'joints = ["j1", "j2", "j3"]\nheld = ["grip"]', 'joints = ["j1", "j2", "j3", "grip"]'
    )
    (tmp_path / "four.toml").write_text(four)
    with pytest.raises(DataError, match=r"which 4 columns are the positions; .*move joints that rest at zero .*`held`"):
        propose(table(log, log[:, 1:4], log[:, 4:7]), load_axes(tmp_path / "four.toml"), Stated())


def signs(found: Proposal, role: str) -> list[int]:
    return [entry.get("sign", 1) for entry in found.columns[role]]


@pytest.mark.parametrize("torques_too", [False, True])
@pytest.mark.parametrize("turned", [(1, 1, 1), (-1, 1, 1), (1, -1, 1), (1, 1, -1), (1, -1, -1)])
def test_a_joint_that_was_recorded_with_the_other_sign(
    robot: Description, log: np.ndarray, turned: tuple[int, ...], torques_too: bool
) -> None:
    """Put right, with the ratio, and marked to be checked."""
    torque = log[:, 4:] * turned if torques_too else log[:, 4:]
    found = propose(table(log, log[:, 1:4] * turned, torque), robot, Stated())
    assert signs(found, "position") == list(turned)
    assert signs(found, "torque") == (list(turned) if torques_too else [1, 1, 1])
    told = [line for line in found.doubts if "with the other sign of the position of joint" in line]
    assert len(told) == (turned != (1, 1, 1))
    assert all("times likelier): the other sign is used" in line for line in told)


@pytest.mark.parametrize("what", ["order", "zero"])
def test_what_the_urdf_does_not_fit_is_to_be_checked(robot: Description, log: np.ndarray, what: str) -> None:
    order = [0, 2, 1] if what == "order" else [0, 1, 2]
    position = log[:, 1:4][:, order] + (np.array([0, 0.5, 0]) if what == "zero" else 0.0)
    found = propose(table(log, position, log[:, 4:][:, order]), robot, Stated())
    assert any("the equations of small leave" in line for line in found.doubts)


def test_a_unit_a_joint(robot: Description, log: np.ndarray) -> None:
    scale = np.array([1.0, 180 / np.pi, 1e3])
    found = propose(table(log, log[:, 1:4] * scale, log[:, 4:], ("rad", "deg", "mrad")), robot, Stated())
    assert [entry["unit"] for entry in found.columns["position"]] == ["rad", "deg", "mrad"]
    made = table(log, log[:, 1:4], log[:, 4:])
    some = {name.replace("j2 torque [Nm]", "j2 torque [%]"): values for name, values in made.columns.items()}
    with pytest.raises(DataError, match=r"torques have several units \(.*j2 torque \[%\]: percent.*give --torque-unit"):
        propose(Table(made.path, made.kind, some), robot, Stated())


def test_degrees_that_no_joint_could_turn_as_radians_are_not_called_radians(
    robot: Description, log: np.ndarray
) -> None:
    found = propose(table(log, np.degrees(log[:, 1:4]), log[:, 4:]), robot, Stated())
    assert [entry["unit"] for entry in found.columns["position"]] == ["deg"] * 3
    assert any(
        "positions are assumed to be deg of the joint, although the file says rad" in line for line in found.doubts
    )
    assert not any("positions are rad" in line for line in found.reasons)


def test_a_reading_that_fits_is_not_ruled_out_by_one_that_fits_better(robot: Description, log: np.ndarray) -> None:
    """Torques of joints that do not feel each other: it is another arm, of which radians leave less than a tenth."""
    speed = np.gradient(log[:, 1:4], log[:, 0], axis=0)
    torque = 2.0 * np.gradient(speed, log[:, 0], axis=0) + 4.0 * speed + 6.0 * np.tanh(speed / 0.02)
    found = propose(table(log, log[:, 1:4], torque), robot, Stated())
    assert [entry["unit"] for entry in found.columns["position"]] == ["rad"] * 3


def test_increments_under_a_header_that_says_radians(robot: Description, log: np.ndarray) -> None:
    with pytest.raises(DataError, match="the file says that positions are rad, but they are whole numbers: increments"):
        propose(table(log, np.round(log[:, 1:4] * 65536 / 6.2832), log[:, 4:]), robot, Stated())
