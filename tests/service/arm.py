"""A small arm as a URDF: three joints that turn, a finger that does not, a tool frame."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's compiled modules carry no types)

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from tests.service.sines import sines

LINK = """<link name="{name}"><inertial><origin xyz="{xyz}" rpy="0.1 0.2 -0.3"/><mass value="{mass}"/>
<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0.001" ixz="-0.002" iyz="0.0015"/></inertial></link>"""
JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/><limit lower="-3" upper="3" effort="99" velocity="9"/></joint>"""
URDF = "\n".join(
    [
        '<robot name="small"><link name="base"/>',
        LINK.format(name="l1", xyz="0.01 0.02 0.1", mass=4, ixx=0.03, iyy=0.03, izz=0.02),
        LINK.format(name="l2", xyz="0.15 0.01 0.02", mass=3, ixx=0.01, iyy=0.04, izz=0.04),
        LINK.format(name="l3", xyz="0.1 0 0.03", mass=1.5, ixx=0.006, iyy=0.012, izz=0.013),
        LINK.format(name="finger", xyz="0.02 0 0", mass=0.2, ixx=0.005, iyy=0.006, izz=0.006),
        '<link name="tool"/>',
        JOINT.format(name="j1", parent="base", child="l1", xyz="0 0 0.2", rpy="0 0 0", axis="0 0 1"),
        JOINT.format(name="j2", parent="l1", child="l2", xyz="0.05 0 0.1", rpy="1.5707963 0 0", axis="0 0 1"),
        JOINT.format(name="j3", parent="l2", child="l3", xyz="0.3 0 0", rpy="0 0.4 0", axis="0 0 -1"),
        JOINT.format(name="grip", parent="l3", child="finger", xyz="0.2 0 0", rpy="0 0 0", axis="0 1 0"),
        '<joint name="mount" type="fixed"><parent link="l3"/><child link="tool"/><origin xyz="0.25 0 0.05"/></joint>',
        "</robot>",
    ]
)
DESCRIPTION = 'name = "small"\nkind = "chain"\nurdf = "small.urdf"\njoints = ["j1", "j2", "j3"]\nheld = ["grip"]\n'


def write(folder: Path, urdf: str = URDF, more: str = "") -> Path:
    """The URDF and its description; the description's path."""
    (folder / "small.urdf").write_text(urdf)
    (folder / "small.toml").write_text(DESCRIPTION + more)
    return folder / "small.toml"


def torque(theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray, *, urdf: str = URDF) -> np.ndarray:
    """(N, 3) N m that MuJoCo says the joints of the URDF need, the finger at its zero."""
    model = mujoco.MjModel.from_xml_string(urdf)
    data = mujoco.MjData(model)
    result = np.empty(theta.shape)
    for row, (angle, speed, acceleration) in enumerate(zip(theta, theta_dot, theta_ddot, strict=True)):
        data.qpos[:3], data.qvel[:3], data.qacc[:3] = angle, speed, acceleration
        mujoco.mj_inverse(model, data)
        result[row] = data.qfrc_inverse[:3]
    return result


PERIOD, SECONDS, NOISE = 4e-3, 8.0, 0.02
VISCOUS, COULOMB, OFFSET = (1.5, 0.9, 0.4), (2.0, 1.4, 0.6), (0.3, -0.4, 0.2)
ROTOR = (0.0, 0.0, 0.05)  # of joint 3: on the first two it goes along with their links


def motion(seed: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """(N,) s and angle, speed, acceleration (N, 3) of sums of sines."""
    time = np.arange(round(SECONDS / PERIOD)) * PERIOD
    return time, sines(seed, time, ((0.9, 0.25), (0.35, 0.8), (0.08, 2.1)))


def record(
    path: Path, seed: int, more: np.ndarray | float = 0.0, urdf: str = URDF, share: float = 1.0, unit: float = 1.0
) -> Path:
    """A log in our own CSV. more: N m beside what the URDF, friction and rotors ask for. share: of the motion. unit:
    rad, of the logged positions."""
    time, signals = motion(seed)
    signals = [share * signal for signal in signals]
    needed = (
        torque(*signals, urdf=urdf) + signals[2] * ROTOR + signals[1] * VISCOUS + np.sign(signals[1]) * COULOMB + OFFSET
    )
    needed = needed + more + np.random.default_rng(seed + 50).normal(0, NOISE, needed.shape)
    header = "time_s," + ",".join(
        f"{name}_{j}_{unit}" for name, unit in (("position", "rad"), ("torque", "nm")) for j in (1, 2, 3)
    )
    np.savetxt(path, np.column_stack([time, signals[0] / unit, needed]), "%.10g", ",", header=header, comments="")
    return path
