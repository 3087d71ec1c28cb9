"""A robot whose every signal is known exactly: motions in closed form, MuJoCo's own inverse dynamics for the torque.

Nothing here is computed by `service`: what the tests hold against it is independent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from drivers.simulated.plant.mujoco_delta import Design, build, dependence, required_torque
from drivers.simulated.plant.truth import PlantTruth
from schemas.robot import Drive, Geometry, Mass, Robot
from tests.service.subject import Band, Base, Delta, Problem, Recording, Scene, Segment

ROBOT = Robot(
    name="known",
    geometry=Geometry(active_link_length=0.36, passive_link_length=0.85, base_radius=0.19, platform_radius=0.05),
    mass=Mass(active_link=2.7, passive_link=0.55, platform=1.3),
    drive=Drive(gear_ratio=25.0),
)
ROTOR = 0.05  # kg m^2, reflected
PERIOD = 1e-3  # s
COULOMB, VISCOUS = np.array([3.0, 2.5, 3.5]), np.array([1.0, 0.8, 1.2])  # N m, N m s/rad
TRANSITION = 0.004  # rad/s
_INERTIA = (ROBOT.mass.active_link / 3 + ROBOT.mass.passive_link / 2) * ROBOT.geometry.active_link_length**2
BASE = Base(np.array([1 + ROTOR / _INERTIA, 1.0, ROBOT.mass.passive_link]), VISCOUS, COULOMB, TRANSITION)
TRUTH = PlantTruth.nominal(ROBOT).model_copy(update={"rotor_inertia_kgm2": [ROTOR] * 3})

Motion = tuple[np.ndarray, np.ndarray, np.ndarray]
Path = Callable[[np.ndarray], Motion]  # (N,) s to angles, speeds, accelerations (N, 3)


def sines(seed: int, size: float = 0.3, low: float = 2.0, high: float = 12.0) -> Path:
    """Three sines a joint round 0.45 rad, `low` to `high` rad/s."""
    rng = np.random.default_rng(seed)
    rate, phase = rng.uniform(low, high, (3, 3)), rng.uniform(0, 2 * np.pi, (3, 3))
    amplitude = size * rng.uniform(0.6, 1.0, (3, 3)) / 2.0

    def at(time: np.ndarray) -> Motion:
        wave = time[:, None, None] * rate + phase
        return (
            0.45 + (amplitude * np.sin(wave)).sum(axis=2),
            (amplitude * rate * np.cos(wave)).sum(axis=2),
            -(amplitude * rate**2 * np.sin(wave)).sum(axis=2),
        )

    return at


def rigid_torque(design: Design, motion: Motion) -> np.ndarray:
    """Torque (N, 3) N m that MuJoCo asks of the joints for a motion of the links."""
    return required_torque(build(design, PERIOD), *motion)


@dataclass(frozen=True)
class Course:
    """One motion, sampled, with the torque of the robot that has no effect, N m, without noise."""

    time: np.ndarray
    motion: Motion
    torque: np.ndarray


@cache
def course(seed: int, seconds: float, size: float = 0.3, low: float = 2.0, high: float = 12.0) -> Course:
    """A motion of `sines`, from time 0."""
    time = np.arange(round(seconds / PERIOD)) * PERIOD
    motion = sines(seed, size, low, high)(time)
    torque = rigid_torque(Design(TRUTH), motion) + VISCOUS * motion[1] + COULOMB * direction(motion[1])
    return Course(time, motion, torque)


def direction(theta_dot: np.ndarray, transition: float = TRANSITION) -> np.ndarray:
    """Direction of motion, its mean over each sample by brute force: 32 points between half-way speeds."""
    half = np.concatenate([theta_dot[:1], 0.5 * (theta_dot[1:] + theta_dot[:-1]), theta_dot[-1:]])
    share = (np.arange(32) + 0.5)[:, None, None] / 32
    return np.tanh((half[:-1] * (1 - share) + half[1:] * share) / transition).mean(axis=0)


def segment(course: Course, torque: np.ndarray | None = None, start: float = 0.0) -> Segment:
    """A course as the smoother would give it back if it were perfect; both ends do not count."""
    count = len(course.time)
    moving = np.abs(course.motion[1]) > 0.02
    moving[:100] = moving[-100:] = False
    values = course.torque if torque is None else torque
    return Segment(np.arange(count), course.time + start, PERIOD, *course.motion, values, moving)


def scene(course: Course, base: Base = BASE, start: float = 0.0, robot: Robot = ROBOT) -> Scene:
    """A course as effects see it."""
    return Scene(Recording(segment(course, start=start), Delta.of(robot), 0, "course"), base)


def problem(
    courses: Sequence[Course], torques: Sequence[np.ndarray], sigma: float = 0.3, starts: Sequence[float] | None = None
) -> Problem:
    """Courses with their measured torque (N, 3), white noise of `sigma` N m a sample known. starts: s, of each."""
    band = Band.of(PERIOD)
    mechanism = Delta.of(ROBOT)
    recordings = [
        Recording(segment(c, torque, start), mechanism, index, f"run_{index}")
        for index, (c, torque, start) in enumerate(zip(courses, torques, starts or [0.0] * len(courses), strict=True))
    ]
    return Problem.of(recordings, band, np.full(3, sigma * band.white_share**0.5))


def at_joints(motion: Motion, force: np.ndarray) -> np.ndarray:
    """Joint torque (N, 3) that a force (N, 3) N on the platform asks of the drives: virtual work, by differences."""
    mechanism = build(Design(TRUTH), PERIOD)
    slope = dependence(mechanism, motion[0])[:, mechanism.platform]
    return -np.einsum("nai,na->ni", slope, force)


def stub(**seen: Any) -> Any:
    """What a plant's effect reads of the plant, set by hand."""
    return SimpleNamespace(**seen)
