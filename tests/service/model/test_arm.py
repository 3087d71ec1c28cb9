"""The arm of a URDF against MuJoCo, which knows nothing of it but the file."""

from __future__ import annotations

import math
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from schemas.axes_description import load_axes
from schemas.chain_description import Chain
from schemas.errors import RobotError
from service.model.mechanism import SerialArm
from tests.service import arm

pytest.importorskip("pinocchio")
DRAW = np.random.default_rng(5)
COUPLED = "coupling = [[1, 0, 0], [0, 1, 0], [0, 1, 1]]\n"  # motor 3 turns with joint 2 too
MOTION = DRAW.uniform(-1.5, 1.5, (3, 40, 3)) * np.array([1.0, 2.0, 5.0])[:, None, None]


def mechanism(folder: Path, more: str = "") -> SerialArm:
    description = load_axes(arm.write(folder, more=more))
    assert isinstance(description, Chain)
    return SerialArm.of(description)


def test_the_torque_is_that_of_another_engine(tmp_path: Path) -> None:
    expected = arm.torque(*MOTION)
    assert np.ptp(expected) > 10
    found = mechanism(tmp_path)
    np.testing.assert_allclose(found.rigid(*MOTION).torque(found.start), expected, atol=2e-5)
    known = mechanism(tmp_path, 'masses = "known"\n')
    np.testing.assert_allclose(known.rigid(*MOTION).torque(known.start), expected, atol=2e-5)


def test_joints_come_in_the_order_of_the_log(tmp_path: Path) -> None:
    path = arm.write(tmp_path)
    path.write_text(path.read_text().replace('"j1", "j2", "j3"', '"j3", "j1", "j2"'))
    description = load_axes(path)
    assert isinstance(description, Chain)
    turned = SerialArm.of(description)
    order = [2, 0, 1]
    found = turned.rigid(*MOTION[:, :, order]).torque(turned.start)
    np.testing.assert_allclose(found, arm.torque(*MOTION)[:, order], atol=2e-5)


def test_what_motion_cannot_tell_is_not_asked(tmp_path: Path) -> None:
    """Columns are independent, and what was left out changes no torque that cannot be given by the others."""
    found = mechanism(tmp_path)
    columns = found.rigid(*MOTION).columns.reshape(120, -1)
    assert np.linalg.matrix_rank(columns) == len(found.coefficients) == columns.shape[1]
    assert not {"m_1", "mz_1", "Ixx_1", "m_3", "Izz_1"} & found.coefficients.keys()
    assert found.links.tolist() == [name[0] in "mI" for name in found.coefficients]
    lows = {name.split("_")[0]: coefficient.low for name, coefficient in found.coefficients.items()}
    assert lows.pop("rotor") == 0.0
    assert set(lows.values()) == {-np.inf}, "what stands for several links may be less than nothing"
    everything = found.arm.columns(*MOTION).reshape(120, -1)
    assert np.linalg.matrix_rank(np.hstack([columns, everything]), tol=1e-4) == columns.shape[1]


def test_a_payload_is_a_mass_on_a_frame(tmp_path: Path) -> None:
    """1.5 kg at 4 cm before the tool: by the work that its weight and its acceleration ask for."""
    more = 'masses = "known"\npayload = { frame = "tool", centre_m = [0.04, 0.0, 0.0]'
    asked = mechanism(tmp_path, more + " }\n")
    column = asked.rigid(*MOTION).columns[..., list(asked.coefficients).index("payload")]
    theta, theta_dot, theta_ddot = MOTION

    def place(time: float) -> np.ndarray:
        angle = theta + theta_dot * time + theta_ddot * time**2 / 2
        return np.array([_tool(row) for row in angle])

    step = 1e-3
    acceleration = (place(step) - 2 * place(0.0) + place(-step)) / step**2 + [0, 0, 9.81]
    for joint in range(3):
        moved = theta.copy()
        moved[:, joint] += 1e-6
        slope = (np.array([_tool(row) for row in moved]) - place(0.0)) / 1e-6
        np.testing.assert_allclose(column[:, joint], (slope * acceleration).sum(axis=1), atol=2e-3)
    given = mechanism(tmp_path, more + ", mass_kg = 1.5 }\n")
    known = given.rigid(*MOTION).known - mechanism(tmp_path, 'masses = "known"\n').rigid(*MOTION).known
    np.testing.assert_allclose(known, 1.5 * column, atol=1e-9)


def _tool(angle: np.ndarray) -> np.ndarray:
    """Where a point 4 cm before the tool is, m, by hand."""

    def about(axis: str, angle: float) -> np.ndarray:
        c, s = math.cos(angle), math.sin(angle)
        return np.array(
            {"x": [[1, 0, 0], [0, c, -s], [0, s, c]], "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]]}.get(
                axis, [[c, -s, 0], [s, c, 0], [0, 0, 1]]
            )
        )

    point = about("z", -angle[2]) @ [0.29, 0, 0.05]
    point = about("z", angle[1]) @ (np.array([0.3, 0, 0]) + about("y", 0.4) @ point)
    return np.array([0, 0, 0.2]) + about("z", angle[0]) @ (np.array([0.05, 0, 0.1]) + about("x", 1.5707963) @ point)


def test_without_pinocchio_one_line_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    with pytest.raises(RobotError, match=r"small.urdf: Pinocchio is not installed .*pip install 'deltatwin\[chain\]'"):
        mechanism(tmp_path)


@pytest.mark.parametrize(
    ("along", "urdf"),
    [  # of joint 3, turned by 0.4 rad about y in the link before it
        ({6 * 2 + 0: 1e-4}, ('xyz="0.3 0 0"', f'xyz="{0.3 + 1e-4 * math.cos(0.4)} 0 {-1e-4 * math.sin(0.4)}"')),
        ({6 * 2 + 1: 1e-4}, ('xyz="0.3 0 0"', 'xyz="0.3 1e-4 0"')),
        ({6 * 2 + 4: 1e-4}, ('rpy="0 0.4 0"', 'rpy="0 0.4001 0"')),
        ({6 * 1 + 2: 1e-4}, ('xyz="0.05 0 0.1"', 'xyz="0.05 -1e-4 0.1"')),
        ({6 * 1 + 3: 1e-4}, ('rpy="1.5707963 0 0"', 'rpy="1.5708963 0 0"')),
    ],
)
@pytest.mark.parametrize("order", [[0, 1, 2], [2, 0, 1]])
def test_a_joint_elsewhere_in_its_link_asks_for_another_torque(tmp_path: Path, along, urdf, order) -> None:
    """As another engine has it, of a URDF that says so."""
    path = arm.write(tmp_path)
    joints = ", ".join(f'"j{joint + 1}"' for joint in order)
    path.write_text(path.read_text().replace('"j1", "j2", "j3"', joints))
    description = load_axes(path)
    assert isinstance(description, Chain)
    found = SerialArm.of(description)
    assert urdf[0] in arm.URDF
    expected = (arm.torque(*MOTION, urdf=arm.URDF.replace(*urdf)) - arm.torque(*MOTION))[:, order]
    ((column, size),) = along.items()
    column = 6 * order.index(column // 6) + column % 6
    motion = MOTION[:, :, order]
    torque = found.misplaced(*motion, coefficients=found.start)[..., column] * size
    np.testing.assert_allclose(torque, expected, atol=2e-3 * np.abs(expected).max() + 1e-8)


def test_a_joint_elsewhere_is_told_of_the_links_as_identified_and_of_what_they_carry(tmp_path: Path) -> None:
    """What the URDF says of a mass does not matter where it was identified, but for what the masses tell as well."""
    true, wrong = mechanism(tmp_path), arm.URDF.replace('mass value="3"', 'mass value="5"')
    described = load_axes(arm.write(tmp_path, wrong))
    assert isinstance(described, Chain)
    other = SerialArm.of(described)
    columns = true.rigid(*MOTION).columns.reshape(120, -1)
    first, second = (known.misplaced(*MOTION, coefficients=true.start).reshape(120, -1) for known in (true, other))
    basis, _ = np.linalg.qr(columns)
    change = second - first
    change -= basis @ (basis.T @ change)
    same = np.abs(change).max(axis=0) < 1e-6
    assert np.flatnonzero(~same).tolist() == [3, 4, 9], "turns after which motion would tell more of the masses"
    assert np.abs((first - basis @ (basis.T @ first))[:, same]).max() > 5
    more = 'masses = "known"\npayload = { frame = "tool", mass_kg = 1.5 }\n'
    loaded, asked = mechanism(tmp_path, more), mechanism(tmp_path, more.replace(", mass_kg = 1.5", ""))
    kilograms = np.zeros(len(asked.coefficients))
    kilograms[list(asked.coefficients).index("payload")] = 1.5
    np.testing.assert_allclose(
        asked.misplaced(*MOTION, coefficients=kilograms),
        loaded.misplaced(*MOTION, coefficients=loaded.start),
        rtol=1e-6,
        atol=1e-6,
    )
    assert np.abs(loaded.misplaced(*MOTION, coefficients=loaded.start).reshape(120, -1) - first).max() > 1


@pytest.mark.parametrize("more", ["", 'masses = "known"\npayload = { frame = "tool" }\n', COUPLED])
@pytest.mark.parametrize("order", [[0, 1, 2], [2, 0, 1]])
def test_derivatives_are_differences_of_the_columns(tmp_path: Path, more: str, order: list[int]) -> None:
    """Pinocchio's recursive algorithms against the regressor, at coefficients that no URDF says."""
    path = arm.write(tmp_path, more=more)
    path.write_text(path.read_text().replace('"j1", "j2", "j3"', ", ".join(f'"j{joint + 1}"' for joint in order)))
    description = load_axes(path)
    assert isinstance(description, Chain)
    found = SerialArm.of(description)
    values = found.start + DRAW.uniform(0.1, 0.5, len(found.start))
    motion = MOTION[:, :, order]

    def torque(*moved: np.ndarray) -> np.ndarray:
        return found.rigid(*moved).torque(values)

    theta, speed, acceleration = motion
    np.testing.assert_allclose(found.torque(theta, speed, acceleration, values), torque(*motion), atol=5e-4)
    slopes = found.slopes(theta, speed, acceleration, values)
    for joint, part in product(range(3), range(3)):
        step = 1e-5 * (np.arange(3) == joint)
        above, below = ([x + way * step if i == part else x for i, x in enumerate(motion)] for way in (1, -1))
        expected = (torque(*above) - torque(*below)) / 2e-5
        np.testing.assert_allclose(slopes[joint, :, :, part], expected, atol=5e-4)


def test_all_rows_in_one_call_are_those_of_one_call_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pinocchio built without OpenMP has only the latter."""
    found = mechanism(tmp_path)
    theta, speed, acceleration = MOTION
    at_once = found.torque(theta, speed, acceleration, found.start)
    monkeypatch.delattr(sys.modules["pinocchio"], "rneaInParallel", raising=False)
    np.testing.assert_array_equal(found.torque(theta, speed, acceleration, found.start), at_once)
