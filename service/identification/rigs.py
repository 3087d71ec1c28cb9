"""What an axis moves on the rig of a log: one servo is identified from several rigs whose differences are known.

What a rig adds is a known torque of its log: the parameters are those of the servo with what all rigs have in common.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from schemas.axes_description import Axes
from schemas.errors import RobotError
from service.model.mechanism import DecoupledAxes, Rigid

GRAVITY = 9.80665  # m/s^2


@dataclass(frozen=True)
class Rig:
    """A body that an axis moves in one log.

    mass: kg. length: m from a turning axis to the centre of mass. inertia: kg m^2 about that centre. angle: rad, at
    which the centre hangs below the axis. axis: from 1; 0: the only one there is.
    """

    mass: float = 0.0
    length: float = 0.0
    inertia: float = 0.0
    angle: float = 0.0
    axis: int = 0

    @classmethod
    def read(cls, text: str) -> tuple[str, Rig]:
        """Log and rig of `log.csv:mass=0.5,length=0.1`.

        Raises:
            RobotError: another form, an unknown key, or a value that is no number or cannot be.
        """
        log, _, values = text.rpartition(":")
        known = [field.name for field in fields(cls)]
        given: dict[str, float] = {}
        for entry in values.split(","):
            key, _, value = entry.partition("=")
            if not log or key not in known:
                keys = ", ".join(known)
                raise RobotError(f"--rig {text}: give log and rig as log.csv:mass=0.5,length=0.1; keys: {keys}")
            try:
                given[key] = float(value)
            except ValueError:
                raise RobotError(f"--rig {text}: {key}: {value!r} is not a number") from None
            if not np.isfinite(given[key]) or (given[key] < 0 and key != "angle"):
                raise RobotError(f"--rig {text}: {key}: {value} is not possible")
        axis = given.pop("axis", 0.0)
        if axis != int(axis):
            raise RobotError(f"--rig {text}: axis: {axis:g} is not the number of an axis")
        return log, cls(**given, axis=int(axis))


@dataclass(frozen=True, kw_only=True)
class OnRig(DecoupledAxes):
    """Axes, one of which moves a body that is known. inertia: kg m^2 or kg, weight: N m, of it; angle: rad, at which it
    hangs."""

    axis: int
    inertia: float
    weight: float
    angle: float

    def rigid(self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray) -> Rigid:
        """Torque of (N, n) motions."""
        known, columns = super().rigid(theta, theta_dot, theta_ddot)
        known[:, self.axis] += self.inertia * theta_ddot[:, self.axis]
        known[:, self.axis] += self.weight * np.sin(theta[:, self.axis] - self.angle)
        return Rigid(known, columns)


def on_rig(axes: Axes, rig: Rig, log: str) -> OnRig:
    """The mechanism of a log.

    Raises:
        RobotError: the rig is of no axis that there is, or of a turning axis and without lever, naming the log.
    """
    if not rig.axis and axes.count > 1:
        raise RobotError(f"--rig {log}: {axes.name} has {axes.count} axes: say which, such as axis=1")
    number = max(rig.axis, 1)
    if number > axes.count:
        raise RobotError(f"--rig {log}: axis={number}: {axes.name} has {axes.count}")
    axis, mechanism = axes.axis[number - 1], DecoupledAxes.of(axes)
    if axis.unit == "m" and (rig.length or rig.inertia or rig.angle):
        raise RobotError(f"--rig {log}: axis {number} is linear: only the mass of a rig can be given")
    inertia = rig.mass if axis.unit == "m" else rig.mass * rig.length**2 + rig.inertia
    if not inertia:
        raise RobotError(f"--rig {log}: it adds no inertia: for a rotary axis, give length or inertia with the mass")
    weight = rig.mass * GRAVITY * rig.length if axis.weighs else 0.0
    return OnRig(
        mechanism.gear_ratio, mechanism.motors, mechanism.weighs,
        axis=number - 1, inertia=inertia, weight=weight, angle=rig.angle,
    )  # fmt: skip


def of_logs(rigs: Sequence[tuple[str, Rig]], logs: Sequence[str]) -> list[Rig | None]:
    """The rig of each log, None for one without.

    Raises:
        RobotError: a rig is of no log or the second of one.
    """
    result: list[Rig | None] = [None] * len(logs)
    for name, rig in rigs:
        if name not in logs:
            raise RobotError(f"--rig {name}: this log is not among those to identify: {', '.join(logs)}")
        place = logs.index(name)
        if result[place] is not None:
            raise RobotError(f"--rig {name}: given twice")
        result[place] = rig
    return result
