"""What descriptions of anything but a Delta have in common: n servo joints, each with a position and a torque in the
log, and motors that may turn with several of them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from pydantic import BaseModel
from tomlkit.items import AoT, Table

from schemas.files import write_text
from schemas.fitted import Figures, Fitted, JointParameter, per_joint
from schemas.messages import OF_JOINTS, Topics
from schemas.robot import Described, EffectEntry, check_joints, toml_item
from schemas.toml import NotNegative, Positive, TomlTable

MOST_COUPLED = 1e6  # condition of a coupling matrix


class JointFriction(TomlTable):
    """viscous x_dot + coulomb sign x_dot, SI, one value per joint, and one per motor that turns with several joints.

    friction_transition: one for all, or one per joint and then one per such motor.
    """

    viscous_friction: JointParameter  # N m s/rad, or N s/m
    coulomb_friction: JointParameter  # N m, or N
    motor_viscous_friction: JointParameter | None = None
    motor_coulomb_friction: JointParameter | None = None
    # rad/s or m/s over which Coulomb friction changes sign; 0: a jump
    friction_transition: NotNegative | list[Positive] = 0.0
    torque_timing_s: float = 0.0  # time by which the torque is older than the position
    # Hz up to which the torque follows the motion as modelled; above, predictions are not reliable. Default: no limit
    torque_band_hz: Positive | None = None

    @staticmethod
    def _frictions(fitted: Fitted) -> dict[str, Any]:
        """The keys of a fitted base model that all kinds have."""
        band = {} if fitted.band_hz is None else {"torque_band_hz": fitted.band_hz}
        frictions = {key: fitted.joints(name) for key, name in _FRICTIONS.items()}
        return {"torque_timing_s": fitted.timing_s} | band | frictions | {"friction_transition": fitted.transition}

    @property
    def transition(self) -> float | list[float]:
        """rad/s or m/s over which Coulomb friction changes sign."""
        return self.friction_transition

    @property
    def band_hz(self) -> float:
        """Up to which the torque follows the motion as modelled."""
        return np.inf if self.torque_band_hz is None else self.torque_band_hz

    @property
    def figures(self) -> Figures:
        """Those of the base model."""
        found: Figures = {}
        for key, name in _FRICTIONS.items():
            found |= per_joint(name, getattr(self, key))
        return found


_FRICTIONS = {
    "viscous_friction": "f_v_{}", "coulomb_friction": "f_c_{}",
    "motor_viscous_friction": "f_v_motor_{}", "motor_coulomb_friction": "f_c_motor_{}",
}  # fmt: skip


class JointLimits(TomlTable):
    """Limits of the joints, one value per joint, for the feed-forward online and for planned motion.

    No feed-forward beyond them leaves the estimator, whatever the input. An arm's limits are in its URDF; give them
    here only to replace those.
    """

    torque: list[Positive] | None = None  # N m, or N: largest feed-forward
    speed: list[Positive] | None = None  # rad/s, or m/s; twice as fast counts as a jump of the position
    torque_fade_s: Positive = 0.05  # in which a feed-forward without new input fades to zero
    position_resolution: Positive = 1e-5  # rad, or m: standard deviation of a position sample


class Machine(Described):
    """n servo joints. coupling: row i, how far motor i, behind its gear, turns for a turn of each joint; default: its
    own."""

    columns: str | None = None  # column mapping: a file next to this one, or the name of a bundled one
    coupling: list[list[float]] | None = None  # turns of each motor per turn of each joint
    limits: JointLimits = JointLimits()
    effect: list[EffectEntry] = []

    @property
    def topics(self) -> Topics:
        """What its roles say on the bus."""
        return OF_JOINTS

    @property
    def files(self) -> dict[str, str]:
        """Files beside the description that it names, by key, as found from here."""
        beside = self.folder / (self.columns or "")
        return {"columns": str(beside)} if beside.is_file() else {}

    @property
    def sources(self) -> list[Path]:
        return super().sources + [Path(file) for file in self.files.values()]

    @property
    def motors(self) -> np.ndarray:
        return super().motors if self.coupling is None else np.array(self.coupling, float)

    @property
    def coupled(self) -> bool:
        return self.coupling is not None

    @property
    def shared_motors(self) -> list[int]:
        """Motors, from 0, that turn with several joints."""
        return [int(i) for i in np.flatnonzero(np.count_nonzero(self.motors, axis=1) > 1)]

    @property
    def mapping(self) -> str | None:
        return self.files.get("columns", self.columns) or None

    def save(self, path: Path, template: Path | None = None) -> None:
        document: Any = tomlkit.document()
        values = self.model_dump(exclude_none=True, exclude_defaults=True)
        values |= {key: os.path.relpath(file, path.parent) for key, file in self.files.items()}
        for key in sorted(values, key=lambda key: isinstance(toml_item(values[key]), (AoT, Table))):  # those come last
            document[key] = toml_item(values[key])
        write_text(path, tomlkit.dumps(document))

    def _check(self, identified: BaseModel | None) -> None:
        count = self.count
        check_joints(identified, self.effect, count)
        for name, numbers in (("torque", self.limits.torque), ("speed", self.limits.speed)):
            if numbers is not None and len(numbers) != count:
                raise ValueError(f"limits.{name}: {len(numbers)} values for {count} joints")
        if self.coupling is not None:
            if [len(row) for row in self.coupling] != [count] * count:
                raise ValueError(f"coupling: {count} rows of {count} numbers are needed, one row per motor")
            if np.linalg.cond(self.motors) > MOST_COUPLED:
                raise ValueError(f"coupling: {self.coupling}: the motor angles do not determine every joint angle")
