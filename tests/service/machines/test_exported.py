"""URDF and MJCF of an arm and of axes, loaded by Pinocchio and MuJoCo: the torque is that of what was identified."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's and Pinocchio's compiled modules carry no types)

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from schemas.axes_description import Axes, load_axes
from schemas.chain_description import Chain, ChainIdentified
from schemas.errors import RobotError
from schemas.fitted import JointParameter, Parameter
from service.cli.machine_files import write_machine
from service.machines.consistent import bodies_near
from service.model.arm import pseudo_inertia
from service.model.description import base_of
from service.model.mechanism import SerialArm, mechanism_of
from tests.service import arm
from tests.service.arms import SIX

pinocchio = pytest.importorskip("pinocchio")
DRAW = np.random.default_rng(3)


def identified(folder: Path) -> Chain:
    """A six-axis arm whose URDF is 15 % too heavy, identified as it is, and rotors and friction with it."""
    (folder / "arm.urdf").write_text(SIX.urdf())
    (folder / "arm.toml").write_text(SIX.description())
    true = load_axes(folder / "arm.toml")
    assert isinstance(true, Chain)
    mechanism = SerialArm.of(true)
    values = dict(zip(mechanism.coefficients, mechanism.start.tolist(), strict=True))
    for number in range(1, 7):
        values[f"rotor_{number}"] += 0.1
        values[f"offset_{number}"] = 0.2 * number
    rigid = {name: Parameter(value=value, std_error=1e-4 + 1e-3 * abs(value)) for name, value in values.items()}
    rubs = JointParameter(value=[0.5] * 6)
    (folder / "arm.urdf").write_text(SIX.urdf(scale=1.15))
    wrong = load_axes(folder / "arm.toml")
    assert isinstance(wrong, Chain)
    known = ChainIdentified(rigid=rigid, viscous_friction=rubs, coulomb_friction=rubs)
    return wrong.model_copy(update={"identified": known})


def motions(joints: int) -> np.ndarray:
    return DRAW.uniform(-1.5, 1.5, (3, 30, joints)) * np.array([1.0, 1.5, 4.0])[:, None, None]


def in_mujoco(text: str, joints: list[str], motion: np.ndarray) -> np.ndarray:
    """(N, n) N m that the motors of a model give along a motion, but for friction."""
    model = mujoco.MjModel.from_xml_string(text)
    model.dof_frictionloss[:], model.dof_damping[:] = 0.0, 0.0
    data, result = mujoco.MjData(model), np.empty(motion.shape[1:])
    dofs = [model.joint(name).dofadr[0] for name in joints]
    for row, (angle, speed, acceleration) in enumerate(zip(*motion, strict=True)):
        data.qpos[dofs], data.qvel[dofs], data.qacc[dofs] = angle, speed, acceleration
        mujoco.mj_inverse(model, data)
        # the motors' bias is what constant load they bear: a motor that is told to do nothing pushes so much
        result[row] = data.qfrc_inverse[dofs] - model.actuator_biasprm[:, 0]
    return result


def test_an_arm_goes_to_a_urdf_that_other_engines_load(tmp_path: Path) -> None:
    chain = identified(tmp_path)
    write_machine(chain, "urdf", tmp_path / "out.urdf")
    told = json.loads((tmp_path / "out_parameters.json").read_text())
    mechanism, motion = SerialArm.of(chain), motions(6)
    expected = mechanism.rigid(*motion).torque(base_of(chain).rigid)
    model = pinocchio.buildModelFromUrdf(str(tmp_path / "out.urdf"))
    data = model.createData()
    found = np.array([pinocchio.rnea(model, data, *row) for row in np.swapaxes(motion, 0, 1)])
    found += motion[2] * list(told["rotor_inertia_kgm2"].values()) + list(told["constant_load_nm"].values())
    size = np.sqrt(np.mean(expected**2, axis=0))
    assert (np.sqrt(np.mean((found - expected) ** 2, axis=0)) < 0.01 * size).all()
    described = pinocchio.buildModelFromUrdf(str(tmp_path / "arm.urdf"))
    before = np.array([pinocchio.rnea(described, described.createData(), *row) for row in np.swapaxes(motion, 0, 1)])
    assert (np.sqrt(np.mean((before - expected) ** 2, axis=0)) > 0.05 * size).all(), "the URDF was wrong"
    for inertia in model.inertias[1:]:
        pseudo = pseudo_inertia(inertia.toDynamicParameters())
        assert np.linalg.eigvalsh(pseudo)[0] > 0
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "out.urdf")).nv == 6
    np.testing.assert_allclose(model.damping[:6], 0.5)
    assert set(told["base_parameters"]) >= set(mechanism.coefficients)


def test_an_arm_goes_to_mujoco_with_rotors_and_loads(tmp_path: Path) -> None:
    chain = identified(tmp_path)
    write_machine(chain, "mjcf", tmp_path / "out.xml")
    mechanism, motion = SerialArm.of(chain), motions(6)
    expected = mechanism.rigid(*motion).torque(base_of(chain).rigid)
    text = (tmp_path / "out.xml").read_text()
    found = in_mujoco(text, chain.joints, motion)
    size = np.sqrt(np.mean(expected**2, axis=0))
    assert (np.sqrt(np.mean((found - expected) ** 2, axis=0)) < 0.01 * size).all()
    model = mujoco.MjModel.from_xml_string(text)
    assert model.ngeom >= 6
    np.testing.assert_allclose(model.dof_frictionloss, 0.5)


def test_bodies_stay_possible_where_parameters_are_not() -> None:
    """A base parameter that asks for less inertia than nothing: the nearest bodies miss it, and say by how much."""
    body = np.array([[2.0, 0.1, 0.0, 0.0, 0.02, 0.0, 0.03, 0.0, 0.0, 0.03]])
    columns = np.eye(10)[[0, 9]]  # mass and Izz are told
    found = bodies_near(body, columns, np.zeros((2, 1)), np.array([2.0, -0.05]), np.array([0.01, 0.01]))
    assert np.linalg.eigvalsh(pseudo_inertia(found.bodies[0]))[0] > 0
    assert found.off[1] > 3
    near = bodies_near(body, columns, np.zeros((2, 1)), np.array([2.4, 0.035]), np.array([0.01, 0.001]))
    np.testing.assert_allclose(near.bodies[0][[0, 9]], [2.4, 0.035], rtol=0.02)


def test_axes_go_to_mujoco(tmp_path: Path) -> None:
    """A pendulum beside a balanced axis; two with a motor that turns with both; a linear axis."""
    (tmp_path / "bench.toml").write_text(
        'name = "bench"\nkind = "axes"\n[[axis]]\n[[axis]]\ngravity = false\n'
        "[identified]\ninertia = { value = [0.4, 0.2] }\noffset = { value = [0.3, -0.1] }\n"
        "gravity_sin = { value = [3.0, 0.0] }\ngravity_cos = { value = [-1.2, 0.0] }\n"
        "viscous_friction = { value = [0.5, 0.4] }\n"
        "coulomb_friction = { value = [1.0, 0.7] }\n"
    )
    axes = load_axes(tmp_path / "bench.toml")
    assert isinstance(axes, Axes)
    write_machine(axes, "mjcf", tmp_path / "out.xml")
    motion, mechanism = motions(2), mechanism_of(axes)
    expected = mechanism.rigid(*motion).torque(base_of(axes).rigid)
    text = (tmp_path / "out.xml").read_text()
    np.testing.assert_allclose(in_mujoco(text, ["axis_1", "axis_2"], motion), expected, atol=1e-3)
    coupled = axes.model_copy(update={"coupling": [[1, 0], [1, 1]]})
    with pytest.raises(RobotError, match="axis 1 bears a weight and motor_2 turns with several"):
        write_machine(coupled, "mjcf", tmp_path / "coupled.xml")
    known = coupled.identified
    assert known is not None
    none = JointParameter(value=[0.0, 0.0])
    shared = {"gravity_sin": none, "gravity_cos": none, "motor_inertia": JointParameter(value=[0.0, 0.05])}
    coupled = coupled.model_copy(update={"identified": known.model_copy(update=shared)})
    write_machine(coupled, "mjcf", tmp_path / "coupled.xml")
    found = in_mujoco((tmp_path / "coupled.xml").read_text(), ["axis_1", "axis_2"], motion)
    np.testing.assert_allclose(found, mechanism_of(coupled).rigid(*motion).torque(base_of(coupled).rigid), atol=1e-3)
    (tmp_path / "slide.toml").write_text(
        'name = "slide"\nkind = "axes"\n[[axis]]\nunit = "m"\n[identified]\ninertia = { value = [95.0] }\n'
        "offset = { value = [-7.0] }\nviscous_friction = { value = [200.0] }\ncoulomb_friction = { value = [20.0] }\n"
    )
    slide = load_axes(tmp_path / "slide.toml")
    write_machine(slide, "mjcf", tmp_path / "slide.xml")
    motion = motions(1)
    expected = mechanism_of(slide).rigid(*motion).torque(base_of(slide).rigid)
    found = in_mujoco((tmp_path / "slide.xml").read_text(), ["axis_1"], motion)
    np.testing.assert_allclose(found, expected, atol=1e-3)


def test_the_small_arm_with_a_held_finger_and_its_own_urdf(tmp_path: Path) -> None:
    """Never identified: bodies are those of the URDF, to rounding."""
    chain = load_axes(arm.write(tmp_path))
    assert isinstance(chain, Chain)
    write_machine(chain, "urdf", tmp_path / "out.urdf")
    motion = motions(3)
    np.testing.assert_allclose(
        arm.torque(*motion, urdf=(tmp_path / "out.urdf").read_text()), arm.torque(*motion), atol=0.02
    )


@pytest.mark.parametrize("axis", ['unit = "m"', "", "gravity = false"])
@pytest.mark.parametrize("inertia", [95.0, 0.004])
def test_a_sliding_axis_stops_where_coulomb_friction_stops_it(tmp_path: Path, axis: str, inertia: float) -> None:
    """From 0.05 rad/s or m/s in MuJoCo, after v^2 / 2a of closed form."""
    coulomb, speed = 0.2 * inertia**0.5, 0.05
    (tmp_path / "axis.toml").write_text(
        f'name = "axis"\nkind = "axes"\n[[axis]]\n{axis}\n[identified]\ninertia = {{ value = [{inertia}] }}\n'
        "offset = { value = [0.0] }\nviscous_friction = { value = [0.0] }\n"
        f"coulomb_friction = {{ value = [{coulomb}] }}\n"
    )
    write_machine(load_axes(tmp_path / "axis.toml"), "mjcf", tmp_path / "axis.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "axis.xml"))
    model.opt.timestep = 1e-4
    data = mujoco.MjData(model)
    data.qvel[0] = speed
    rate = coulomb / inertia
    for _ in range(round(1.5 * speed / rate / 1e-4)):
        mujoco.mj_step(model, data)
    assert data.qpos[0] == pytest.approx(speed**2 / rate / 2, rel=0.05)
    assert abs(data.qvel[0]) < 0.01 * speed


def test_friction_of_an_arm_is_all_there_at_low_speed(tmp_path: Path) -> None:
    chain = load_axes(arm.write(tmp_path))
    assert isinstance(chain, Chain)
    mechanism, rubs = SerialArm.of(chain), JointParameter(value=[1.0, 0.7, 0.4])
    rigid = {
        name: Parameter(value=float(value), std_error=0.01)
        for name, value in zip(mechanism.coefficients, mechanism.start, strict=True)
    }
    known = ChainIdentified(rigid=rigid, viscous_friction=JointParameter(value=[0.0] * 3), coulomb_friction=rubs)
    write_machine(chain.model_copy(update={"identified": known}), "mjcf", tmp_path / "arm.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    data = mujoco.MjData(model)
    data.qvel[:] = [0.02, -0.02, 0.02]
    model.opt.gravity[:] = 0.0
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qfrc_constraint, [-1.0, 0.7, -0.4], rtol=1e-3)
