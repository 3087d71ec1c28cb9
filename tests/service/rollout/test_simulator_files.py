"""The exported model is the robot that `rollout` simulates."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's compiled modules carry no types)

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.simulated.plant.mujoco_delta import CompiledMechanism, close, dependence
from schemas.robot import EffectParameter, Robot, save_robot
from service.cli.main import app
from service.model import kinematics
from service.rollout.gap import plain, simulate
from service.rollout.packed import SeenStretch, stretch
from service.rollout.simulator_files import STEP, to_mjcf
from tests.service.rollout.test_kernel import HORIZON, effect, identified, recorded
from tests.service.world import PERIOD, ROBOT

BODIES = (
    "tool_mass", "rotor_inertia", "arm_mass", "base_tilt", "link_length_error", "forearm_length_error",
    "base_radius_error", "azimuth_error", "joint_offset", "joint_spring", "hose_spring", "torque_scale",
    "torque_offset",
)  # fmt: skip
CALLED = (
    "stribeck_friction", "asymmetric_friction", "load_dependent_friction", "nonlinear_viscous_friction",
    "position_dependent_friction", "warmup_friction", "cogging", "presliding_friction", "air_drag",
)  # fmt: skip


def run(robot: Robot, seen: SeenStretch, at: int, torque: np.ndarray) -> np.ndarray:
    """Angles (3,) rad that the encoders of the exported model give after the horizon, from the state of row `at`."""
    made = to_mjcf(robot)
    model = made.spec.compile()
    data = mujoco.MjData(model)
    names = ("arm0", "arm1", "arm2")
    arm = np.array([model.joint(name).qposadr[0] for name in names])
    motors = [f"motor{i}" if f"motor{i}" in {joint.name for joint in made.spec.joints} else f"arm{i}" for i in range(3)]
    motor = np.array([model.joint(name).qposadr[0] for name in motors])
    platform = np.array([model.joint(axis).qposadr[0] for axis in "xyz"])
    mechanism = CompiledMechanism(model, seen.model._replace(joint_offset=np.zeros(3)), arm, motor, platform, 0)
    link, link_dot, angle, speed, bristles = seen.start[at]
    true = link + seen.model.joint_offset
    data.qpos[:] = close(mechanism, true[None])[0]
    data.qvel[:] = dependence(mechanism, true[None])[0] @ link_dot
    data.qpos[arm], data.qpos[motor], data.qvel[motor] = link, angle, speed
    if model.na:
        data.act[:] = seen.torque[at]  # what drives that lag give by then
    scope: dict = {}
    if made.callback is not None:
        exec(made.callback, scope)
    effects = scope["Effects"](model) if scope else None
    if effects is not None:
        effects.bristle[:] = bristles
    steps = round(PERIOD / STEP)
    data.time = at * PERIOD
    for k in range(HORIZON - 1):
        for part in range(steps):
            data.ctrl[:] = torque[k] + (torque[k + 1] - torque[k]) * (part + 0.5) / steps
            if effects is not None:
                effects.apply(data)
            mujoco.mj_step(model, data)
    return data.qpos[motor].copy()


@pytest.mark.parametrize(
    "names",
    [(), BODIES, ("joint_elasticity",), ("backlash",), CALLED, ("shaft_friction",), ("drive_lag",)],
    ids=["wall", "bodies", "spring", "gap", "called", "shaft", "lag"],
)
def test_it_goes_where_rollout_goes(names: tuple[str, ...]) -> None:
    effects = [effect(name) for name in names]
    for entry in effects:
        if "motor_share" in entry.parameters:  # more than the link has to give could not be built
            entry.parameters["motor_share"] = EffectParameter(value=0.15)
    robot = identified(*effects)
    if not names:
        robot = robot.model_copy(update={"gravity_mps2": [-9.4, 2.0, -2.0]})  # a wall that leans
    part = recorded(robot)
    seen = stretch(robot, part, part.theta)
    for at in (200, 620):
        rows = slice(at, at + HORIZON)
        ours = simulate(seen, seen.start[[at]], seen.torque[None, rows], part.time[[at]], PERIOD)[0]
        there, begin = (kinematics.forward(seen.model, angle) for angle in (ours[-1], ours[0]))
        theirs = kinematics.forward(seen.model, run(robot, seen, at, part.torque[rows]))
        off, moved = np.linalg.norm(theirs - there), np.linalg.norm(there - begin)
        print(f"{names}: {1e3 * off:.3f} mm of {1e3 * moved:.0f} mm")
        assert moved > 0.05
        assert off < 0.01 * moved


def test_a_robot_as_it_was_drawn_up_is_exported_too() -> None:
    """Its forearms are point masses: rods without any are left between them."""
    robot = plain(ROBOT)
    part = recorded(robot)
    seen = stretch(robot, part, part.theta)
    at, rows = 200, slice(200, 200 + HORIZON)
    ours = simulate(seen, seen.start[[at]], seen.torque[None, rows], part.time[[at]], PERIOD)[0]
    there, begin = (kinematics.forward(seen.model, angle) for angle in (ours[-1], ours[0]))
    theirs = kinematics.forward(seen.model, run(robot, seen, at, part.torque[rows]))
    moved = np.linalg.norm(there - begin)
    assert moved > 0.05
    assert np.linalg.norm(theirs - there) < 0.01 * moved


def test_a_viewer_shows_its_links_where_they_are() -> None:
    """Each moving body with a shape that weighs nothing and touches nothing; rods end at the platform's edge."""
    made = to_mjcf(identified())
    model = made.spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    shown = {model.geom(number).name: number for number in range(model.ngeom)}
    rods = [f"rod{i}{k}" for i in range(3) for k in (0, 1)]
    assert set(shown) == {"base", "platform", *(f"arm{i}" for i in range(3)), *rods}
    assert not model.geom_contype.any()
    assert not model.geom_conaffinity.any()
    bare = made.spec.copy()
    for geom in list(bare.geoms):
        bare.delete(geom)
    plain_model = bare.compile()
    np.testing.assert_array_equal(model.body_mass, plain_model.body_mass)
    np.testing.assert_array_equal(model.body_inertia, plain_model.body_inertia)
    middle = data.geom_xpos[shown["platform"]]
    for name in rods:
        number = shown[name]
        along = data.geom_xmat[number].reshape(3, 3)[:, 2] * model.geom_size[number][1]
        ends = data.geom_xpos[number] + np.outer((-1, 1), along)
        end = data.site(f"end{name[3:]}").xpos
        assert np.linalg.norm(ends - end, axis=1).min() == pytest.approx(0.0, abs=1e-9)
        assert np.linalg.norm(end - middle) < 3 * model.geom_size[shown["platform"]][0]


def test_the_command_writes_model_and_callback_and_says_what_is_left_out(tmp_path: Path) -> None:
    early = effect("torque_delay")
    early.parameters["delay"] = EffectParameter(value=-0.002)
    robot = identified(*(effect(name) for name in ("tool_mass", "stribeck_friction", "torque_filter")), early)
    save_robot(robot, tmp_path / "corrected.toml")
    told = CliRunner().invoke(app, ["export", str(tmp_path / "corrected.toml"), "--out", str(tmp_path / "robot.xml")])
    assert told.exit_code == 0, told.output
    assert "call Effects before every step for stribeck_friction\n" in told.output
    assert "Measurement turns true values into those of a log: torque_filter\n" in told.output
    assert "torque_delay is left out: the log shows the torque early" in told.output
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    assert [model.joint(f"arm{i}").name for i in range(3)] == ["arm0", "arm1", "arm2"]
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    assert np.abs(data.efc_pos[: data.ne]).max() < 1e-6  # the chain is closed at home
    compile((tmp_path / "robot_effects.py").read_text(), "robot_effects.py", "exec")


def test_what_a_log_shows_of_it_comes_with_the_callback() -> None:
    """Against closed forms: 20 Hz, 4 ms, and an encoder that reads wrong by what its own reading says."""
    made = to_mjcf(identified(*(effect(name) for name in ("torque_filter", "torque_delay", "encoder_eccentricity"))))
    assert made.measured == ["torque_filter", "torque_delay", "encoder_eccentricity"]
    assert made.callback is not None
    scope: dict = {}
    exec(made.callback, scope)
    shown = scope["Measurement"](made.spec.compile())
    assert shown.torque([0.0, 0.0, 0.0]) == [0.0, 0.0, 0.0]
    steps = np.arange(1, 200)
    told = np.array([shown.torque([1.0, 2.0, -1.0]) for _ in steps])
    risen = 1.0 - np.exp(-2.0 * np.pi * 20.0 * np.maximum(steps * STEP - 0.004, 0.0))
    np.testing.assert_allclose(told, risen[:, None] * [1.0, 2.0, -1.0], atol=1e-9)
    for angle in np.linspace(-0.5, 1.0, 7):
        read = shown.angle([angle] * 3)
        turn = ROBOT.drive.gear_ratio * read[0]
        assert read[0] + 0.003 * np.cos(turn) - 0.002 * np.sin(turn) == pytest.approx(angle, abs=1e-6)
        assert abs(read[0] - angle) < 0.004
        assert read[1:] == [angle, angle]


def test_a_urdf_has_the_three_active_links(tmp_path: Path) -> None:
    save_robot(identified(), tmp_path / "r.toml")
    arguments = ["export", str(tmp_path / "r.toml"), "--to", "urdf", "--out", str(tmp_path / "r.urdf")]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    root = ElementTree.parse(tmp_path / "r.urdf").getroot()
    joints = root.findall("joint")
    assert [joint.get("type") for joint in joints] == ["revolute"] * 3
    assert len(root.findall("link")) == 4
    for joint, azimuth in zip(joints, ROBOT.arm_angles, strict=True):
        origin = joint.find("origin")
        assert origin is not None
        place, turn = ([float(v) for v in origin.attrib[name].split()] for name in ("xyz", "rpy"))
        radius = ROBOT.geometry.base_radius
        np.testing.assert_allclose(place, [radius * np.cos(azimuth), radius * np.sin(azimuth), 0.0], atol=1e-6)
        np.testing.assert_allclose(turn, [0.0, 0.0, azimuth], atol=1e-5)


def test_figures_that_no_body_can_have_are_told(tmp_path: Path) -> None:
    heavy = identified().model_copy(
        update={"mass": identified().mass.model_copy(update={"platform": 0.01, "passive_link": 0.05})}
    )
    save_robot(heavy, tmp_path / "r.toml")
    told = CliRunner().invoke(app, ["export", str(tmp_path / "r.toml"), "--out", str(tmp_path / "r.xml")])
    assert "these values are physically impossible" in str(told.exception)
    assert not (tmp_path / "r.xml").exists()
