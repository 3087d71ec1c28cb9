"""Description of a serial arm by its URDF: a TOML file with `kind = "chain"`, for logs of real arms.

name = "ur10"
kind = "chain"
urdf = "ur10.urdf"                # beside this file
joints = ["pan", "lift", "elbow"] # joints of the URDF, in the order of the log
held = ["finger"]                 # joints that were at rest at zero
columns = "ur10_columns.toml"
gear_ratio = 101                  # motor turns per joint turn, for ripple orders: one, or one per joint
masses = "known"                  # those of the URDF, or of [identified]; default: to be identified
gravity_mps2 = [0.0, 0.0, -9.81]  # in the URDF's base frame; on the ceiling [0.0, 0.0, 9.81]
coupling = [[1, 0], [1, 1]]       # as of axes
payload = { frame = "tool0", mass_kg = 1.5, centre_m = [0.0, 0.0, 0.05] }  # without mass_kg: to be identified
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, PrivateAttr, model_validator

from schemas.columns import MAX_JOINTS
from schemas.errors import RobotError
from schemas.fitted import Figures, Fitted, Parameter, alone
from schemas.joints_description import JointFriction, Machine
from schemas.robot import Gravity, Source, Travel
from schemas.toml import NotNegative, Positive, Three, TomlTable
from schemas.urdf import Urdf, read_urdf

Names = Annotated[list[str], Field(max_length=MAX_JOINTS)]


class CarriedMass(TomlTable):
    """A mass on a link of the URDF."""

    frame: str  # link of the URDF
    mass_kg: NotNegative | None = None  # default: to be identified
    centre_m: Three = Field([0.0, 0.0, 0.0])  # centre of mass in the frame of the link


class ChainIdentified(JointFriction):
    """rigid: base parameters (combinations of masses that motion determines), rotor inertias and constant loads."""

    rigid: dict[str, Parameter]

    @classmethod
    def of(cls, fitted: Fitted, given: Mapping[str, Parameter]) -> Self:
        """The section with a fitted base model. given: of the links, not fitted."""
        rigid = {name: fitted.one(name) for name in fitted.figures if not name.startswith(("f_v_", "f_c_"))}
        return cls.model_validate({"rigid": {**given, **rigid}} | cls._frictions(fitted))

    @property
    def figures(self) -> Figures:
        return super().figures | alone(self.rigid)


class Chain(Machine):
    """A serial arm that is described by a URDF."""

    kind: Literal["chain"]  # of the machine
    called: ClassVar[str] = "an arm"
    at_rest: ClassVar[str] = "; move joints that rest at zero from `joints` to `held`"
    urdf: str  # file next to this one
    joints: Annotated[Names, Field(min_length=1)]  # of the URDF, in the order of the log
    held: Names = Field([])  # joints that were at rest at zero
    gear_ratio: Positive | list[Positive] = 1.0  # motor turns per turn of the joint: one, or one for each joint
    masses: Literal["identified", "known"] = "identified"  # known: those of the URDF, or of `identified`
    gravity_mps2: Gravity = Field([0.0, 0.0, -9.81])  # in the base frame of the URDF
    payload: CarriedMass | None = None
    identified: ChainIdentified | None = None
    _arm: Urdf | None = PrivateAttr(None)

    @model_validator(mode="after")
    def _for_each_joint(self) -> Chain:
        for name in self.joints:
            if (self.joints + self.held).count(name) > 1:
                raise ValueError(f"joints: {name!r} is named twice")
        if isinstance(self.gear_ratio, list) and len(self.gear_ratio) != self.count:
            raise ValueError(f"gear_ratio: {len(self.gear_ratio)} values for {self.count} joints")
        if self.payload is not None and self.payload.mass_kg is None and self.masses == "identified":
            raise ValueError(
                'payload: its mass is not separable from that of its link: give mass_kg, or masses = "known"'
            )
        self._check(self.identified)
        return self

    @property
    def count(self) -> int:
        return len(self.joints)

    def identified_as(self, fitted: Fitted) -> ChainIdentified:
        given = {} if self.identified is None or self.masses == "identified" else self.identified.rigid
        return ChainIdentified.of(fitted, given)

    @property
    def gear_ratios(self) -> list[float]:
        return self.gear_ratio if isinstance(self.gear_ratio, list) else [self.gear_ratio] * self.count

    @property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(self.joints)

    def read_from(self, source: Source) -> Self:
        """With its URDF."""
        super().read_from(source)
        self._arm = read_urdf(self.folder / self.urdf, self.joints, self.held)
        if self.payload is not None and self.payload.frame not in self.arm.links:
            raise RobotError(f"{self.origin}: payload.frame: {self.urdf} has no link {self.payload.frame!r}")
        return self

    @property
    def known(self) -> ChainIdentified | None:
        """`identified`."""
        return self.identified

    @property
    def separate(self) -> None:
        """None: its joints bear each other, and none is on a rig of its own."""

    @property
    def travels(self) -> tuple[Travel, ...]:
        both = zip(self.joints, self.arm.limits, strict=True)
        return tuple(Travel(low, high, f"joint {name!r} of {self.urdf}") for name, (low, high) in both)

    def check_rigid(self, coefficients: Collection[str]) -> None:
        found = {} if self.identified is None else self.identified.rigid
        for name in coefficients:
            if name not in found:
                raise RobotError(f"robot {self.name}: identified.rigid: {name!r} is missing")
        for name in found:
            if name not in coefficients and self.masses == "identified":
                raise RobotError(f"robot {self.name}: identified.rigid: {name!r} is not a parameter of {self.urdf}")

    @property
    def files(self) -> dict[str, str]:
        return super().files | {"urdf": str(self.folder / self.urdf)}

    @property
    def arm(self) -> Urdf:
        """The URDF."""
        assert self._arm is not None, "read by load_axes"
        return self._arm
