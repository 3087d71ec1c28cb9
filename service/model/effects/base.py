"""What an effect is: a dataclass of quantities with units, and the torque it adds.

Amplitudes enter the torque linearly and are found by least squares; nonlinear parameters are searched. An effect on
single joints has its own amplitudes a joint and shares its nonlinear parameters; any other has one set for the robot.
"""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, NamedTuple

import numpy as np

from schemas.kernels import kernel
from service.model.mechanism import Mechanism
from service.model.nominal import Correction
from service.model.scene import Scene
from service.model.signals import delayed, lagging


class Instant(NamedTuple):
    """What an online form reads of the present sample; arrays are (3,).

    model: record of DeltaModel. direction: of motion, in [-1, 1]. load: N m, rigid torque through the gears, that of
    the payload included. seconds: of the bus clock. pose: record of `kinematics.POSE`, as the terms kernel left it for
    this motion. doubt: (N m)^2, to which a form adds the variance of its torque where it does not know its own state.
    """

    model: Any
    gear_ratio: float
    theta: np.ndarray
    theta_dot: np.ndarray
    theta_ddot: np.ndarray
    direction: np.ndarray
    load: np.ndarray
    seconds: float
    pose: Any
    doubt: np.ndarray


@kernel
def at_platform(now, i, x, y, z):
    """Torque of joint i, N m, that holds a force x, y, z, N, acting from the platform on its surroundings."""
    column = now.pose.column
    return now.pose.lever[i] * (column[i, 0] * x + column[i, 1] * y + column[i, 2] * z)


@dataclass
class Inside:
    """What effects put inside the robot that only a simulation forward in time has to carry. (3,) one entry a joint.

    bristle, distance: N m of the Coulomb friction that builds up, over rad. two_masses: joint -> half the lost motion
    rad, natural frequency Hz of the link, damping ratio, share of the inertia on the motor side. rotor: kg m^2 at the
    joint, arm: kg of an active link, tool: kg at the platform, each the inertia of an effect whose online form depends
    on the acceleration.
    """

    bristle: np.ndarray = field(default_factory=lambda: np.zeros(3))
    distance: np.ndarray = field(default_factory=lambda: np.ones(3))
    two_masses: dict[int, tuple[float, float, float, float]] = field(default_factory=dict)
    rotor: np.ndarray = field(default_factory=lambda: np.zeros(3))
    arm: np.ndarray = field(default_factory=lambda: np.zeros(3))
    tool: float = 0.0


@dataclass
class Readout:
    """What lies between the torque that acts and the one that is reported, alike for all joints, in s.

    late: by which it is reported later than the position. lag: time constant of a first-order low-pass of what is
    reported. follows: the same of the drive, which acts behind what is reported.
    """

    late: float = 0.0
    lag: float = 0.0
    follows: float = 0.0

    def report(self, torque: np.ndarray, period: float) -> np.ndarray:
        """What is reported of torques (N, n) N m that act, a sample every `period` s."""
        behind = lagging(torque, 0.5 / (np.pi * self.lag), period) if self.lag > 0.0 else torque
        return delayed(behind, self.late, period)


PERIODS = 1.5  # over a joint's travel, below which nothing shows that a torque is periodic


@dataclass(frozen=True)
class Amplitude:
    """A quantity that the torque is proportional to. unit: SI. meaning: for the report. low, high: what it can be."""

    unit: str
    meaning: str
    low: float = -math.inf
    high: float = math.inf


@dataclass(frozen=True)
class Nonlinear:
    """A quantity that is searched: tried at `grid`, refined between `low` and `high`, kept if `fixed`.

    minor: the torque hardly depends on it, so that a limit of its own says nothing about the effect. late: kept at the
    last of `grid` while effects are searched, and fitted from all of it once the effect has been found.
    most_step: over which a slope by it can be taken.
    """

    unit: str
    meaning: str
    grid: tuple[float, ...]
    low: float
    high: float
    fixed: bool = False
    minor: bool = False
    late: bool = False
    most_step: float = math.inf

    @property
    def tried(self) -> tuple[float, ...]:
        """Of the grid, what the search tries."""
        return self.grid[-1:] if self.late else self.grid


@dataclass(frozen=True)
class Effect(ABC):
    """One unmodelled effect. Fields of a subclass are its quantities, in the order of the documents.

    name: as in the catalogue. title: the same in words of the plant. means: what it means and what to do. per_joint:
    sits on single joints. own_joint: adds torque to no other joint than its own. measured: alters the reported torque
    of each joint by itself instead of adding to it. rough: its torque is no smooth function of its nonlinear
    parameters, so they are kept when a part of the data is left out. own_nonlinear: each joint may have own ones.
    repeats: may be at work more than once on a joint. of_motor_turns: comes again with the turns of a motor, so often a
    turn as its first nonlinear parameter says. kinds: mechanisms it makes sense for. settles: the motion that tells it
    from what it resembles. directional: a joint that moves one way only does not show it. dissipates: friction, which
    together with the base model's takes energy out of the motion in either direction. same: effects that no motion
    tells it from. takes_timing: it has the place of the timing within a sample. beyond: `size` that no robot which runs
    has, several times the strongest of the blind test: an effect that large stands in for a wrong description;
    beyond_together: the same on several joints at once.

    Its forms inside the online step, compiled; of the effects that come along only. online: (effect record, Instant,
    joint) -> N m. memory: how many numbers it carries on a joint from sample to sample, all zero at the start; then
    online is (effect record, Instant, joint, memory) -> N m, called once a sample, and again with the same motion
    without a change. by_load: it depends on the load of the gear, and so on the payload. encoder: (effect record, gear
    ratio, joint, motion (3, 3)), which makes the joint's true angle, speed and acceleration of the measured ones.
    """

    name: ClassVar[str]
    title: ClassVar[str] = ""
    means: ClassVar[str] = ""
    per_joint: ClassVar[bool] = True
    own_joint: ClassVar[bool] = True
    measured: ClassVar[bool] = False
    rough: ClassVar[bool] = False
    own_nonlinear: ClassVar[bool] = False
    repeats: ClassVar[bool] = False
    of_motor_turns: ClassVar[bool] = False
    kinds: ClassVar[frozenset[str]] = frozenset({"delta", "axes", "chain"})
    settles: ClassVar[str]
    directional: ClassVar[bool] = False
    dissipates: ClassVar[bool] = False
    same: ClassVar[frozenset[str]] = frozenset()
    takes_timing: ClassVar[bool] = False
    beyond: ClassVar[float] = math.inf
    beyond_together: ClassVar[float] = math.inf
    online: ClassVar[Callable[..., float] | None] = None
    memory: ClassVar[int] = 0
    by_load: ClassVar[bool] = False
    encoder: ClassVar[Callable[..., None] | None] = None

    @property
    def in_words(self) -> str:
        """The title, or the name where there is none."""
        return self.title or self.name.replace("_", " ").capitalize()

    @property
    def amplitudes(self) -> dict[str, Amplitude]:
        """Linear quantities, name -> description."""
        return {f.name: f.default for f in fields(self) if isinstance(f.default, Amplitude)}

    @property
    def nonlinear(self) -> dict[str, Nonlinear]:
        """Searched quantities, name -> description."""
        return {f.name: f.default for f in fields(self) if isinstance(f.default, Nonlinear)}

    @abstractmethod
    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """Torque per unit of each amplitude at the operating point of `scene`.

        joint: from 0; ignored unless `per_joint`. Returns (N, k) on that joint where `own_joint`, else (N, n, k). Where
        an effect has no amplitude: its whole torque, k = 1.
        """

    def columns(self, scene: Scene, joint: int, points: Sequence[tuple[float, ...]]) -> np.ndarray:
        """`regressors` at P nonlinear parameters side by side, (N, P k) or (N, n, P k)."""
        return np.concatenate([self.regressors(scene, joint, point) for point in points], axis=-1)

    def above_coulomb(self, theta_dot: np.ndarray, nonlinear: tuple[float, ...]) -> np.ndarray | None:
        """Share (N,) that is left at speeds (N,) rad/s of friction which falls to the base model's as the speed grows;
        None of any other effect."""
        return None

    def goes_by_load(self, travel: float, nonlinear: tuple[float, ...]) -> bool:
        """Whether friction that grows with the weight of a joint which goes `travel` rad would look like it."""
        return False

    def is_weight_in_degrees(self) -> bool:
        """Whether a weight asks for it that turns with the joint, where degrees were taken for radians: over a few of
        them its sine is a straight line."""
        return False

    def is_weight(self, gear_ratio: float, travel: float, nonlinear: tuple[float, ...]) -> bool:
        """Whether it is what a weight that turns with the joint asks for, or another load that goes by its angle, and
        so the base model's. travel: rad from the joint's lowest to its highest angle."""
        return False

    def size(self, mechanism: Mechanism, amplitude: np.ndarray) -> float:
        """How large amplitudes (J, k) are, in the terms of `beyond`."""
        return float(np.abs(amplitude).max(initial=0.0))

    def correct(self, correction: Correction, joint: int, amplitude: np.ndarray) -> None:  # noqa: B027 - most do not
        """Put the effect, with amplitudes (k,) on `joint`, into what is corrected of the online model; only where it
        adds no torque instead."""

    def read_out(self, readout: Readout, nonlinear: tuple[float, ...]) -> None:  # noqa: B027 - most do not
        """Put the effect into what lies between torque and report; only where `measured`."""

    def put_inside(  # noqa: B027 - most do not
        self, inside: Inside, joint: int, amplitude: np.ndarray, nonlinear: tuple[float, ...]
    ) -> None:
        """Put the effect on `joint` into what a simulation carries: where it has neither an online form nor a place in
        the online model's settings, and the inertia of one whose online form depends on the acceleration."""

    def grid(self, scene: Scene) -> list[tuple[float, ...]]:
        """Nonlinear parameters to try first."""
        return list(itertools.product(*(searched.tried for searched in self.nonlinear.values())))

    def starts(self, nonlinear: tuple[float, ...]) -> list[tuple[float, ...]]:
        """Where the fit of the nonlinear parameters starts; more than one where its neighbourhood is rough."""
        return [nonlinear]

    def torque(self, scene: Scene, joint: int, amplitude: np.ndarray, nonlinear: tuple[float, ...]) -> np.ndarray:
        """Torque (N, n) N m that the effect adds; exact where `regressors` is a linearisation."""
        columns = self.regressors(scene, joint, nonlinear)
        torque = columns @ amplitude if self.amplitudes else columns[..., 0]
        return on_joint(torque, joint, scene.joints) if self.own_joint else torque

    def torques(
        self, scene: Scene, joint: int, amplitude: np.ndarray, points: Sequence[tuple[float, ...]]
    ) -> np.ndarray:
        """`torque` at P nonlinear parameters, (N, n, P)."""
        return np.stack([self.torque(scene, joint, amplitude, point) for point in points], axis=-1)

    def slopes(self, scene: Scene, joint: int, amplitude: np.ndarray, nonlinear: tuple[float, ...]) -> np.ndarray:
        """Slope (N, n, k) of `torque` by each amplitude; only of effects that reach several joints."""
        if type(self).torque is Effect.torque:
            return self.regressors(scene, joint, nonlinear)
        steps = 1e-4 * np.eye(len(amplitude))
        columns = [
            self.torque(scene, joint, amplitude + step, nonlinear)
            - self.torque(scene, joint, amplitude - step, nonlinear)
            for step in steps
        ]
        return np.stack(columns, axis=-1) / 2e-4

    def report(self, scene: Scene, joint: int, torque: np.ndarray, amplitude: np.ndarray, nonlinear: tuple[float, ...]):
        """What is reported of a true joint torque (..., n); only where `measured`."""
        raise NotImplementedError

    def restore(
        self, torque: np.ndarray, period: float, joint: int, amplitude: np.ndarray, nonlinear: tuple[float, ...]
    ) -> np.ndarray:
        """`report` undone: the true joint torque (N, n) of a reported one; only where `measured`. period: s."""
        raise NotImplementedError


class WholeDelta(Effect):
    """An effect on a Delta as a whole: one set of amplitudes, felt by all joints."""

    per_joint = False
    own_joint = False
    kinds = frozenset({"delta"})


def geometric(low: float, high: float, count: int) -> tuple[float, ...]:
    """A grid of equal ratios."""
    return tuple(float(value) for value in np.geomspace(low, high, count))


def on_joint(values: np.ndarray, joint: int, joints: int) -> np.ndarray:
    """(N, ...) on one joint of (N, n, ...)."""
    result = np.zeros((len(values), joints, *values.shape[1:]))
    result[:, joint] = values
    return result
