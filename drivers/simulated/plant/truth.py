"""What the simulated robot really is, where it departs from its description.

The description (`schemas.robot`) is what the user believes; the truth is what the physics runs on. Without a truth file
the plant is exactly as described: frictionless, noise-free, with ideal drives.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from drivers.motion import peak_torque
from schemas.errors import RobotError
from schemas.robot import Robot
from schemas.toml import NotNegative, Positive, Three, TomlTable, read_toml, validate

PositivePerJoint = Annotated[list[Positive], Field(min_length=3, max_length=3)]
NotNegativePerJoint = Annotated[list[NotNegative], Field(min_length=3, max_length=3)]

ROD_SPACING = 0.1  # m between the two rods of a forearm; of no effect on the torque while the platform cannot rotate

# Drives are tuned in practice to a position loop of some 8 Hz and a velocity loop of some 30 Hz on robots of this size.
POSITION_BANDWIDTH, VELOCITY_BANDWIDTH, INTEGRAL_TIME = 8.0, 30.0, 0.05  # Hz, Hz, s


class PlantTruth(TomlTable):
    """All parameters of the simulated physics. Joint side, SI; lists of three have one entry per arm."""

    gravity_mps2: Three  # vector in the base frame
    active_link_length_m: PositivePerJoint  # from the joint axis to the elbow
    passive_link_length_m: PositivePerJoint  # from elbow to wrist
    base_radius_m: PositivePerJoint  # of the joints' axes
    platform_radius_m: Positive  # from its centre to the wrists
    arm_angles_deg: Three  # azimuth of each arm
    joint_offset_rad: Three = [0.0, 0.0, 0.0]  # true minus measured angle
    active_link_kg: PositivePerJoint  # without motor and gear
    active_link_centre_m: Three  # distance of the centre of mass from the joint axis, along the link
    active_link_inertia_kgm2: PositivePerJoint  # about the joint axis, rotor and gear not included
    forearm_kg: PositivePerJoint  # both rods
    platform_kg: Positive  # with the gripper that it always carries
    rotor_inertia_kgm2: NotNegativePerJoint = [0.0, 0.0, 0.0]  # rotor and gear, reflected to the joint
    coulomb_friction_nm: NotNegativePerJoint = [0.0, 0.0, 0.0]  # per joint
    viscous_friction_nms: NotNegativePerJoint = [0.0, 0.0, 0.0]  # N m s/rad
    creep_radps: NotNegative = 0.0  # speed within which dry friction builds up in lubricated gears; 0: true stiction
    gear_ratio: Positive = 1.0  # motor turns per turn of the joint
    position_bandwidth_hz: Positive = POSITION_BANDWIDTH  # of the drives' position loop
    velocity_bandwidth_hz: Positive = VELOCITY_BANDWIDTH  # of the velocity loop
    integral_time_s: Positive = INTEGRAL_TIME  # of the velocity loop
    peak_torque_nm: Positive  # largest torque of a drive, at the joint
    encoder_counts_per_turn: NotNegative = 0.0  # motor side; 0: no quantisation
    encoder_noise_rad: NotNegative = 0.0  # rms per reading, joint side
    torque_noise_nm: NotNegativePerJoint = [0.0, 0.0, 0.0]  # rms per sample of the reported torque
    torque_resolution_nm: NotNegative = 0.0  # step of the reported torque; 0: none
    # unmodelled physics: name and parameters of `drivers.simulated.plant.effects`
    effect: list[dict[str, Any]] = []

    @classmethod
    def nominal(cls, robot: Robot) -> PlantTruth:
        """A plant that is exactly as described: uniform links, no friction, no noise."""
        geometry, mass = robot.geometry, robot.mass
        length = [geometry.active_link_length + error for error in geometry.active_link_length_error]
        return cls(
            gravity_mps2=robot.gravity_mps2,
            active_link_length_m=length,
            passive_link_length_m=[geometry.passive_link_length + e for e in geometry.passive_link_length_error],
            base_radius_m=[geometry.base_radius + error for error in geometry.base_radius_error],
            platform_radius_m=geometry.platform_radius,
            arm_angles_deg=geometry.arm_angles_deg,
            joint_offset_rad=geometry.joint_offset_rad,
            active_link_kg=[mass.active_link] * 3,
            active_link_centre_m=[value / 2 for value in length],
            active_link_inertia_kgm2=[mass.active_link * value**2 / 3 for value in length],
            forearm_kg=[mass.passive_link] * 3,
            platform_kg=mass.platform,
            gear_ratio=robot.drive.gear_ratio,
            peak_torque_nm=peak_torque(robot),
        )


TRUTHS = Path(__file__).parent / "truths"


def load_truth(path: str | Path, robot: Robot) -> PlantTruth:
    """Read a truth file: any field of `PlantTruth`; what it leaves out is as `robot` describes it.

    Raises:
        RobotError: naming file, key and value of the first thing that is wrong.
    """
    path = Path(path)
    given = read_toml(path, RobotError)
    return validate(PlantTruth, PlantTruth.nominal(robot).model_dump() | given, path, RobotError)


def shipped_truth(robot: Robot) -> Path | None:
    """The truth file that comes with deltatwin for a robot of this name."""
    path = TRUTHS / f"{robot.name}.toml"
    return path if path.is_file() else None
