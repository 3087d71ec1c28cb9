"""Robot description: a TOML file checked by Pydantic, written back without losing the user's comments."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
import tomlkit
from pydantic import AfterValidator, BaseModel, BeforeValidator, Field, PrivateAttr, model_validator

from schemas.columns import Columns
from schemas.errors import RobotError
from schemas.files import make_folder, write_text
from schemas.fitted import Figures, Fitted, JointParameter, Parameter, alone, per_joint
from schemas.messages import OF_DELTA, Topics
from schemas.questions import Question
from schemas.toml import NotNegative, Positive, Three, TomlTable, read_toml, validate
from schemas.zenoh_keys import check_robot_name

LONGEST_M = 10.0  # of a link or a radius; a number above is one in millimetres


def _vector(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    if not 0 < value < math.inf:
        raise ValueError(f"must be greater than 0, or a vector [x, y, z] in the base frame (got {value})")
    return [0.0, 0.0, -float(value)]


def _pulling(value: list[float]) -> list[float]:
    if not any(value):
        raise ValueError(f"must have a direction (got {value})")
    return value


# A number stands for as much down the z axis, of a robot that hangs level.
Gravity = Annotated[Three, BeforeValidator(_vector), AfterValidator(_pulling)]


def _in_metres(value: float) -> float:
    if value > LONGEST_M:
        raise ValueError(f"{value:g} m: no Delta robot is that large; lengths are in metres (is it {value / 1e3:g} m?)")
    return value


Length = Annotated[Positive, AfterValidator(_in_metres)]


class Geometry(TomlTable):
    """Lengths in metres, azimuths in degrees. Frame: origin at the base centre, z up, the platform works at z < 0."""

    active_link_length: Length  # m, from the joint's axis to the elbow
    passive_link_length: Length  # m, of a forearm, from elbow to wrist
    base_radius: Length  # m, from the centre of the base to the joints' axes
    platform_radius: Length  # m, from the centre of the platform to the wrists
    arm_angles_deg: Three = [0.0, 120.0, 240.0]  # azimuth of each arm about the z axis
    active_link_length_error: Three = [0.0, 0.0, 0.0]  # true minus nominal per arm, found by `diagnose`
    passive_link_length_error: Three = [0.0, 0.0, 0.0]  # the same of the forearms
    base_radius_error: Three = [0.0, 0.0, 0.0]  # the same of base radius minus platform radius
    joint_offset_rad: Three = [0.0, 0.0, 0.0]  # true minus measured angle per joint, found by `diagnose`
    # lowest and highest joint angle
    joint_range_rad: Annotated[list[float], Field(min_length=2, max_length=2)] = [-1.6, 2.2]

    @model_validator(mode="after")
    def _possible(self) -> Geometry:
        reach = self.base_radius - self.platform_radius + self.active_link_length
        if self.passive_link_length <= abs(reach):
            raise ValueError(
                f"passive_link_length {self.passive_link_length} m does not reach the axis: it must exceed "
                f"base_radius - platform_radius + active_link_length = {reach:.4g} m"
            )
        if self.joint_range_rad[0] >= self.joint_range_rad[1]:
            raise ValueError(f"joint_range_rad {self.joint_range_rad}: give the lower limit first")
        angles = sorted(a % 360 for a in self.arm_angles_deg)
        gaps = [b - a for a, b in zip(angles, [*angles[1:], angles[0] + 360], strict=True)]
        if min(gaps) < 10 or max(gaps) >= 180:
            raise ValueError(
                f"arm_angles_deg {self.arm_angles_deg}: arms must be at least 10 deg apart and not all on one side"
            )
        return self


class Mass(TomlTable):
    """Masses in kilograms. `passive_link` is one forearm, both rods together."""

    active_link: NotNegative  # of one link, without motor and gear
    passive_link: NotNegative  # of one forearm, both rods together
    platform: Positive  # with the gripper that it always carries


class RatedTorque(TomlTable):
    """0x6077 counts per mille of the motor's rated torque, 0x6076, N m."""

    reference: Literal["rated_torque"]  # the torque of 1000 per mille
    rated_torque_nm: Positive  # 0x6076, of the motor

    @property
    def full_scale_nm(self) -> float:
        """Motor torque that 1000 per mille stand for, N m."""
        return self.rated_torque_nm


class StandstillTorque(TomlTable):
    """0x6077 counts per mille of the motor's standstill (stall) torque, N m."""

    reference: Literal["standstill_torque"]  # the torque of 1000 per mille
    standstill_torque_nm: Positive  # of the motor

    @property
    def full_scale_nm(self) -> float:
        """Motor torque that 1000 per mille stand for, N m."""
        return self.standstill_torque_nm


class RatedCurrent(TomlTable):
    """0x6077 counts per mille of a rated current, A, which a torque constant, N m/A, turns into torque.

    Each of the two says whether it means the rms or the peak of the sinusoidal phase current.
    """

    reference: Literal["rated_current"]  # the current of 1000 per mille
    rated_current_a: Positive  # of the motor
    rated_current_form: Literal["rms", "peak"]  # of the phase current
    torque_constant_nmpa: Positive  # N m per ampere, of the motor
    torque_constant_form: Literal["rms", "peak"]  # of the ampere in it

    @property
    def full_scale_nm(self) -> float:
        """Motor torque that 1000 per mille stand for, N m."""
        to_peak = {"rms": math.sqrt(2), "peak": 1.0}
        per_form = to_peak[self.rated_current_form] / to_peak[self.torque_constant_form]
        return self.rated_current_a * self.torque_constant_nmpa * per_form


class JointDrive(TomlTable):
    """One drive on the bus and the joint behind it: scaling, and where its objects lie in the process data.

    joint angle = sign (counts - zero_counts) / counts_per_turn / gear_ratio, in turns.
    joint torque = torque_sign (0x6077 / 1000) full scale of `torque` times gear_ratio.
    A mapped object is its index where CiA 402 fixes its size ("0x6064"), "index:bits" where it does not ("0x2010:16"),
    and ":8" leaves eight bits out. Without a mapping here the robot's ENI file says where the objects are.
    """

    station: Annotated[int, Field(ge=1, le=0xFFFF)] | None = None  # configured station address; an ENI needs it
    place: Annotated[int, Field(ge=1)] | None = None  # on the wire, from the master; needed if there are other stations
    counts_per_turn: Positive  # encoder counts per motor turn, 0x608F
    gear_ratio: Positive | None = None  # if it differs from [drive]
    sign: Literal[1, -1]  # -1: the drive counts up while the active link rises
    zero_counts: int  # 0x6064 at joint angle 0
    torque: Annotated[RatedTorque | StandstillTorque | RatedCurrent, Field(discriminator="reference")]
    torque_sign: Literal[1, -1] | None = None  # if it differs from `sign` (0x607E)
    velocity_unit_counts_per_s: Positive | None = None  # one unit of 0x606C, or:
    velocity_unit_rpm: Positive | None = None  # of the motor; with neither 0x606C is not checked
    outputs_address: Annotated[int, Field(ge=0, le=0xFFFFFFFF)] | None = None  # logical address of the first byte
    outputs: list[str] = []  # RxPDO: master to drive
    inputs_address: Annotated[int, Field(ge=0, le=0xFFFFFFFF)] | None = None  # the same of the inputs
    inputs: list[str] = []  # TxPDO: drive to master

    @model_validator(mode="after")
    def _addressed(self) -> JointDrive:
        if self.velocity_unit_counts_per_s and self.velocity_unit_rpm:
            raise ValueError("velocity_unit_counts_per_s and velocity_unit_rpm: give one of them, not both")
        for name, entries, address in (
            ("outputs", self.outputs, self.outputs_address),
            ("inputs", self.inputs, self.inputs_address),
        ):
            if bool(entries) != (address is not None):
                raise ValueError(f"{name} and {name}_address must be given together")
        return self


class GripperInput(TomlTable):
    """The digital input of a drive to which the gripper's switch or vacuum sensor is wired: a bit of 0x60FD."""

    joint: Annotated[int, Field(ge=1, le=3)]  # the joint whose drive has the input and maps 0x60FD
    bit: Annotated[int, Field(ge=0, le=31)]  # 16 to 31 are manufacturer-specific in CiA 402
    closed: Literal[0, 1] = 1  # value of the bit when the gripper is closed


class Drive(TomlTable):
    """The conversion between bus and joint. `joint`: one drive per joint, in joint order, to decode a bus."""

    gear_ratio: Positive = 1.0  # motor turns per turn of the joint
    position_resolution_rad: Positive = 2.4e-7  # one encoder count at the joint; a 20-bit encoder behind a 25:1 gear
    eni: str | None = None  # ENI file that maps the process data, relative to the robot description
    joint: Annotated[list[JointDrive], Field(max_length=3)] = []
    gripper: GripperInput | None = None

    @model_validator(mode="after")
    def _complete(self) -> Drive:
        if self.joint and len(self.joint) != 3:
            raise ValueError(f"joint: {len(self.joint)} drives, a Delta robot has 3")
        stations = [joint.station for joint in self.joint if joint.station is not None]
        if len(set(stations)) != len(stations):
            raise ValueError(f"joint: two drives have one station address: {stations}")
        places = [joint.place for joint in self.joint]
        if any(places) and (None in places or len(set(places)) != len(places)):
            raise ValueError(f"joint: place: {places}: give a different one for all drives, or none")
        return self


class Limits(TomlTable):
    """Limits of joints and gripper. Joint side, the same for all three joints.

    No feed-forward beyond these limits leaves the estimator or reaches a drive, whatever the input.
    """

    peak_torque_nm: Positive | None = None  # default: the torque at 10 g with the largest payload
    torque_slope_nmps: Positive | None = None  # default: from one peak to the other in 20 ms
    torque_fade_s: Positive = 0.05  # in which a feed-forward without new input fades to zero
    joint_speed_radps: Positive = 40.0  # faster motion of a position or command counts as a jump
    joint_acceleration_radps2: Positive | None = None  # of planned motion; default: 250
    max_payload_kg: Positive = 6.0  # largest payload
    friction_drift: Positive = 0.3  # share of the identified friction beyond which health reports a drift
    torque_scale_drift: Positive = 0.04  # the same for a joint's torque scale; magnets lose 0.1 %/K


class Servo(TomlTable):
    """The drives' control cascade, joint side, one value per joint; its law is in `service/rollout/servo.py`."""

    position_gain_ps: Three  # 1/s
    velocity_gain_nms: Three  # N m for a rad/s
    integral_time_s: Three = [0.0, 0.0, 0.0]  # of the velocity control; 0: none
    velocity_feedforward: Three = [1.0, 1.0, 1.0]  # share of the commanded speed
    acceleration_feedforward_kgm2: Three = [0.0, 0.0, 0.0]  # N m for a commanded rad/s^2
    peak_torque_nm: Positive | None = None  # default: that of `limits`


class FourthAxis(TomlTable):
    """The axis that turns the gripper, driven from the base through a telescopic shaft; its angle is `position_4_rad`.

    Of these values only the shaft's mass acts on the three arms: the parallelograms support torques about the axis.
    """

    shaft_mass_kg: NotNegative = 0.0  # part of the shaft that moves with the platform, in addition to `mass.platform`
    inertia_kgm2: NotNegative = 0.0  # about the axis, without load
    viscous_friction_nms: NotNegative = 0.0  # of the shaft
    coulomb_friction_nm: NotNegative = 0.0  # of the shaft


def check_joints(identified: BaseModel | None, effects: list[EffectEntry], count: int) -> None:
    """
    Raises:
        ValueError: a number a joint is not there for each of `count` joints, or an effect is on another joint.
    """
    for name, value in identified or ():
        if isinstance(value, JointParameter):
            for key, numbers in value:
                if len(numbers) != count and (key == "value" or numbers):
                    raise ValueError(f"identified.{name}.{key}: {len(numbers)} values for {count} joints")
    for effect in effects:
        if max(effect.joints, default=1) > count:
            raise ValueError(f"effect {effect.name}: joint {max(effect.joints)} of {count}")


Method = Literal["pooled", "paper"]


class Identified(TomlTable):
    """What `identify` found. Absent terms are zero (friction, forearm) or one (rho)."""

    method: Method = "pooled"  # of the fit: pooled least squares, or the grid of the paper
    rho_1: Parameter = Parameter(value=1.0)  # factor on the inertia
    rho_2: Parameter = Parameter(value=1.0)  # factor on the weight
    viscous_friction_nms: JointParameter = JointParameter(value=[0.0, 0.0, 0.0])  # N m s/rad
    coulomb_friction_nm: JointParameter = JointParameter(value=[0.0, 0.0, 0.0])  # N m
    forearm_inertia_kg: Parameter = Parameter(
        value=0.0
    )  # forearm mass whose rod coupling is added; 0: two point masses
    torque_noise_nm: JointParameter | None = None  # rms per sample of the torque signal's white noise
    model_error_nm: JointParameter | None = None  # rms residual of the model above that noise, while moving
    torque_commanded: bool = False  # the reported torque is the commanded one and white noise
    # Time by which the commanded torque leads the reported one, if they differ only by that, by noise and by a filter
    # among the effects; else absent.
    torque_command_ahead_s: float | None = None
    friction_transition_radps: NotNegative = 0.0  # speed over which Coulomb friction changes sign; 0: a jump
    # Standard error of the torque constants as a share, by a known load; absent without one.
    torque_constant_error: NotNegative | None = None
    torque_timing_s: float = 0.0  # time by which the torque is older than the position, within a sample

    @classmethod
    def of(cls, fitted: Fitted) -> Self:
        """The section with a fitted base model."""
        return cls.model_validate(
            {name: fitted.one(name) for name in _RIGID}
            | {"viscous_friction_nms": fitted.joints("f_v_{}"), "coulomb_friction_nm": fitted.joints("f_c_{}")}
            | {"friction_transition_radps": fitted.transition, "torque_timing_s": fitted.timing_s}
        )

    @property
    def transition(self) -> float | list[float]:
        """rad/s over which Coulomb friction changes sign."""
        return self.friction_transition_radps

    @property
    def band_hz(self) -> float:
        """Up to which the torque follows the motion as modelled."""
        return math.inf

    @property
    def figures(self) -> Figures:
        """Those of the base model."""
        rigid = alone({name: getattr(self, name) for name in _RIGID})
        viscous, coulomb = self.viscous_friction_nms, self.coulomb_friction_nm
        return rigid | per_joint("f_v_{}", viscous) | per_joint("f_c_{}", coulomb)


_RIGID = ("rho_1", "rho_2", "forearm_inertia_kg")


class EffectEntry(TomlTable):
    """One unmodelled effect that `diagnose` named. Parameters as name -> {value, unit, std_error}."""

    name: str  # of the catalogue
    joints: list[Annotated[int, Field(ge=1)]]  # on which it acts, from 1; empty: the whole robot
    parameters: dict[str, EffectParameter]  # by the names of the effect's reference page


class EffectParameter(TomlTable):
    value: float  # as fitted
    unit: str = ""  # SI
    std_error: NotNegative = 0.0  # of `value`


def _robot_name(name: str) -> str:
    try:
        return check_robot_name(name)
    except RobotError as error:
        raise ValueError(str(error)) from error  # Pydantic adds the key


RobotName = Annotated[str, AfterValidator(_robot_name)]


@dataclass(frozen=True)
class Source:
    """Where a description was read from. folder: that files it names are relative to. effects_file: Python file with
    effects of the user's own that `effect` may name. file: for messages; the same description may be in several."""

    folder: Path = Path()
    effects_file: Path | None = None
    file: Path | None = field(default=None, compare=False)


class Travel(NamedTuple):
    """low, high: rad, between which a joint moves. stated: what says so, for messages."""

    low: float
    high: float
    stated: str


class Described(TomlTable):
    """What descriptions of all kinds say of n joints. called: the kind, in words."""

    called: ClassVar[str]
    at_rest: ClassVar[str] = ""  # where a log has fewer joints: how those that rest are described
    name: RobotName  # of the robot, in keys, topics and reports
    _source: Source = PrivateAttr(Source())

    def __repr__(self) -> str:
        """Short: a notebook shows it where an object ends a cell."""
        known = "identified" if getattr(self, "identified", None) is not None else "not identified"
        carried = ", ".join(dict.fromkeys(effect.name for effect in getattr(self, "effect", ())))
        effects = f", with {carried}" if carried else ""
        return f"<{type(self).__name__} {self.name!r}: {known}{effects}>"

    @property
    def folder(self) -> Path:
        """Files that the description names are relative to it."""
        return self._source.folder

    @property
    def effects_file(self) -> Path | None:
        """Python file with effects of the user's own that `effect` may name."""
        return self._source.effects_file

    @property
    def sources(self) -> list[Path]:
        """All files that it was read from: its own, that with the user's effects, and those that it names."""
        return [path for path in (self._source.file, self._source.effects_file) if path is not None]

    @property
    def origin(self) -> str:
        """What an error about a key of it begins with."""
        return str(self._source.file or f"robot {self.name!r}")

    def read_from(self, source: Source) -> Self:
        """Take note of where it was read from, and read the files that it cannot do without.

        Raises:
            RobotError: one of these files is wrong, or does not match the description.
        """
        self._source = source
        return self

    def save(self, path: Path, template: Path | None = None) -> None:
        """Write it; see `save_description`."""
        raise NotImplementedError

    def answering(self, question: Question) -> Robot | None:
        """The Delta robot that answers `question`; None where this machine has no answer."""
        return None

    @property
    def count(self) -> int:
        """n."""
        raise NotImplementedError

    def has_joints_of(self, other: Described) -> bool:
        """Whether it describes the same joints, as far as they are told apart."""
        return type(self) is type(other) and (self.count, self.joint_names) == (other.count, other.joint_names)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Of the joints in the order of the log; empty: they have none."""
        return ()

    @property
    def motors(self) -> np.ndarray:
        """(n, n): row i, how far motor i turns, behind its gear, for a turn of each joint."""
        return np.eye(self.count)

    @property
    def coupled(self) -> bool:
        """Whether a motor may turn several joints."""
        return False

    @property
    def mapping(self) -> Columns | str | None:
        """Column mapping of its logs: itself, or a file as found from here, or the name of a bundled one."""
        return None

    @property
    def gear_ratios(self) -> list[float]:
        """Motor turns a joint turn, a number a joint."""
        raise NotImplementedError

    @property
    def predicts(self) -> bool:
        """Whether a torque follows from it, if only a rough one."""
        return True

    def identified_as(self, fitted: Fitted) -> TomlTable:
        """Its `[identified]` section with a fitted base model."""
        raise NotImplementedError

    @property
    def topics(self) -> Topics:
        """What its roles say on the bus."""
        raise NotImplementedError

    @property
    def linear(self) -> bool:
        """Metres and newtons, on all joints."""
        return False

    def joint_linear(self, joint: int) -> bool:
        """Metres and newtons, on one joint, from 0."""
        return self.linear

    @property
    def angular(self) -> bool:
        """Radians and newton metres, on all joints."""
        return not self.linear

    @property
    def swings(self) -> bool:
        """Whether its joints turn to and fro, within half a turn and at the speed of a Delta's arm; others may turn
        many times, as fast as a motor."""
        return False

    @property
    def joint_range(self) -> tuple[float, float] | None:
        """Lowest and highest angle of all joints, rad, beyond which a position is no reading; None: there is none."""
        return None

    @property
    def travels(self) -> tuple[Travel, ...]:
        """Of each joint, from a zero that may differ from that of the log; empty: not known."""
        return ()

    @property
    def turns_gripper(self) -> bool:
        """Whether a fourth position in a log may be of an axis that turns its gripper, without torque in the log."""
        return False

    @property
    def bears_load(self) -> bool:
        """Whether it has a tool or platform on which a load is weighed."""
        return True

    @property
    def masses_scale_torque(self) -> bool:
        """Whether its masses determine the unit of a log's torque."""
        return False

    @property
    def counts_per_turn(self) -> float | None:
        """Encoder counts per turn of a motor; None: not known."""
        return None

    @property
    def full_scale_nm(self) -> float | None:
        """Motor torque that 1000 per mille stand for, N m; None: not known."""
        return None

    @property
    def nominal(self) -> dict[str, float]:
        """Coefficients of the base model, by name, that keep this value where logs do not determine them."""
        return {}

    def check_rigid(self, coefficients: Collection[str]) -> None:
        """
        Raises:
            RobotError: `identified` has not the figures of these coefficients of its mechanism.
        """

    def refitted(self, section: TomlTable, noise: JointParameter) -> TomlTable:
        """The `[identified]` section `section` of a refit together with effects, with what such a refit leaves as it
        is. noise: rms per sample of the torque's white noise, N m or N."""
        return section

    def with_left(self, error: JointParameter, commanded: bool, ahead_s: float | None) -> Self:
        """With what held-out logs show of the model, as far as its `[identified]` section contains it. error:
        `model_error`. commanded: whether the reported torque is the command; ahead_s: by which the command is ahead."""
        return self

    @property
    def torque_noise(self) -> JointParameter | None:
        """Rms per sample of the white torque noise that `identify` found, N m or N; None: not known."""
        return None

    @property
    def model_error(self) -> JointParameter | None:
        """Rms residual above that noise that its model had when it was made, N m or N; None: not known."""
        return None


class Robot(Described):
    """A Delta robot with three actuated joints."""

    kind: Literal["delta"] = "delta"  # of the machine
    called: ClassVar[str] = "a Delta robot"
    gravity_mps2: Gravity = [0.0, 0.0, -9.81]  # in the base frame: [-9.81, 0, 0] with the x axis up a wall
    geometry: Geometry
    mass: Mass
    drive: Drive = Drive()
    limits: Limits = Limits()
    servo: Servo | None = None
    fourth_axis: FourthAxis | None = None
    columns: Columns | None = None
    identified: Identified | None = None
    effect: list[EffectEntry] = []

    @model_validator(mode="after")
    def _for_each_joint(self) -> Robot:
        check_joints(self.identified, self.effect, 3)
        return self

    @property
    def topics(self) -> Topics:
        return OF_DELTA

    def save(self, path: Path, template: Path | None = None) -> None:
        save_robot(self, path, template)

    def read_from(self, source: Source) -> Self:
        for name, scaled in (("rho_1", "inertia"), ("rho_2", "weight")):
            factor = Parameter(value=1.0) if self.identified is None else getattr(self.identified, name)
            if factor.value < 0.0 and factor.verdict == "identifiable":
                raise RobotError(
                    f"{source.file or self.name}: identified.{name}.value: {factor.value:g}: the {scaled} "
                    "times this is negative, and the feed-forward would push the wrong way"
                )
        return super().read_from(source)

    def answering(self, question: Question) -> Robot | None:
        return self if question in _ANSWERED else None

    @property
    def mapping(self) -> Columns | str | None:
        return self.columns

    @property
    def swings(self) -> bool:
        return True

    @property
    def joint_range(self) -> tuple[float, float] | None:
        low, high = self.geometry.joint_range_rad
        return low, high

    @property
    def turns_gripper(self) -> bool:
        return True

    @property
    def masses_scale_torque(self) -> bool:
        return True

    @property
    def counts_per_turn(self) -> float | None:
        return float(self.drive.joint[0].counts_per_turn) if self.drive.joint else None

    @property
    def full_scale_nm(self) -> float | None:
        return float(self.drive.joint[0].torque.full_scale_nm) if self.drive.joint else None

    @property
    def nominal(self) -> dict[str, float]:
        return {"rho_1": 1.0, "rho_2": 1.0, "forearm_inertia_kg": self.mass.passive_link}

    @property
    def known(self) -> Identified:
        """`identified`; without it the robot is as drawn."""
        return self.identified or Identified()

    def refitted(self, section: TomlTable, noise: JointParameter) -> TomlTable:
        kept = {name: getattr(self.known, name) for name in ("torque_commanded", "torque_constant_error")}
        return section.model_copy(update={"torque_noise_nm": noise} | kept)

    def with_left(self, error: JointParameter, commanded: bool, ahead_s: float | None) -> Self:
        if self.identified is None:
            return self
        told = {
            "model_error_nm": error,
            "torque_commanded": self.identified.torque_commanded or commanded,
            "torque_command_ahead_s": ahead_s,
        }
        return self.model_copy(update={"identified": self.identified.model_copy(update=told)})

    def identified_as(self, fitted: Fitted) -> Identified:
        """Of the plain model: what is known of the torque's noise and constants is told by other means."""
        return Identified.of(fitted)

    @property
    def torque_noise(self) -> JointParameter | None:
        return None if self.identified is None else self.identified.torque_noise_nm

    @property
    def model_error(self) -> JointParameter | None:
        return None if self.identified is None else self.identified.model_error_nm

    @property
    def count(self) -> int:
        return 3

    @property
    def gear_ratios(self) -> list[float]:
        every = self.drive.gear_ratio
        return [joint.gear_ratio or every for joint in self.drive.joint] or [every] * 3

    @property
    def sources(self) -> list[Path]:
        return super().sources + ([self.folder / self.drive.eni] if self.drive.eni else [])

    @property
    def arm_angles(self) -> list[float]:
        """Arm azimuths in radians."""
        return [math.radians(a) for a in self.geometry.arm_angles_deg]


_ANSWERED = frozenset(
    {
        Question.VIEW,
        Question.LEARNING,
        Question.FIELDBUS,
        Question.CODE,
        Question.CLOSED_LOOP,
        Question.COMMANDS,
        Question.PICKS,
        Question.CALLBACK,
        Question.RIVALS,
        Question.ROUTE,
    }
)

SHIPPED = Path(__file__).parent / "robots"


def robot_file(name: str | Path) -> Path:
    """The file of a robot description, or of one that comes with deltatwin, by name ("d3-1200").

    Raises:
        RobotError: there is neither; names the ones that there are.
    """
    path = Path(name)
    if path.exists() or path.suffix == ".toml":
        return path
    shipped = SHIPPED / f"{path}.toml"
    if len(path.parts) == 1 and shipped.is_file():
        return shipped
    known = ", ".join(sorted(file.stem for file in SHIPPED.glob("*.toml")))
    raise RobotError(f"{path}: no such robot description; bundled ones are: {known}")


def load_robot(path: str | Path, effects: Path | None = None) -> Robot:
    """Read a robot description: a file, or the name of one that comes with deltatwin ("d3-1200"). effects: Python file
    with effects of the user's own.

    Raises:
        RobotError: naming file, key and value of the first thing that is wrong.
    """
    path = robot_file(path)
    values = read_toml(path, RobotError)
    if (kind := values.get("kind", "delta")) != "delta":
        raise RobotError(f'{path}: kind = "{kind}": a Delta robot is needed')
    return validate(Robot, values, path, RobotError).read_from(Source(path.parent, effects, path))


def save_robot(robot: Robot, path: str | Path, template: str | Path | None = None) -> None:
    """Write `robot` as TOML; with `template`, keep that file's comments, order and layout and change only what differs.

    Raises:
        RobotError: the template is no robot. StorageError: the file cannot be written.
    """
    document, old = tomlkit.document(), {}
    if template is not None:
        old = load_robot(template).model_dump()
        document = tomlkit.parse(robot_file(template).read_text(encoding="utf-8-sig"))
    _update(document, old, robot.model_dump(), robot.model_dump(exclude_none=True, exclude_defaults=True))
    path = Path(path)
    make_folder(path.parent)
    write_text(path, tomlkit.dumps(document))


def _update(document: Any, old: dict[str, Any], new: dict[str, Any], written: dict[str, Any]) -> None:
    """Bring `document` from `old` to `new`; `written` is `new` without the defaults, which need not stand in a file."""
    for key in [*new, *(key for key in old if key not in new)]:
        if key in new and key in old and new[key] == old[key]:
            continue
        if isinstance(new.get(key), dict) and isinstance(document.get(key), dict):
            _update(document[key], old.get(key) or {}, new[key], written.get(key, {}))
        elif key in written:
            document[key] = toml_item(written[key])
        elif key in document and isinstance(new.get(key), (bool, int, float, str)):
            document[key] = new[key]  # back to its default: say so where the file said otherwise
        else:
            document.pop(key, None)


def toml_item(value: Any) -> Any:
    """`value` as TOML: lists of tables as such, small tables on one line."""
    if isinstance(value, list) and value and isinstance(value[0], dict):
        tables = tomlkit.aot()
        for entry in value:
            tables.append(toml_item(entry))
        return tables
    if isinstance(value, dict) and any(isinstance(v, dict) for v in value.values()):
        table = tomlkit.table()
        for key, entry in value.items():
            table[key] = _inline(entry) if isinstance(entry, dict) else entry
        return table
    return value


def _inline(entry: dict[str, Any]) -> Any:
    if any(isinstance(v, dict) for v in entry.values()):
        return toml_item(entry)
    table = tomlkit.inline_table()
    table.update(entry)
    return table
