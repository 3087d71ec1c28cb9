"""Trajectories as a controller plans them: joint position, velocity and acceleration for every cycle, within limits.

A planner knows the description, so all of this is nominal: torque is the rigid body's as drawn, uniform rods included.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from schemas.errors import DataError, PoseError
from schemas.robot import Robot
from service.model import kinematics
from service.model.dynamics import FOREARM, GRAVITY, INERTIA, PLATFORM, torque_terms
from service.model.nominal import DeltaModel, pack

REST_BEFORE, REST_AFTER = 0.10, 0.16  # s at the ends of a pick-and-place run
GRIP = 0.06  # s that the platform stands while a payload is gripped or let go
HOME = 0.15  # rad, all joints: where slow and multisine runs start and end
STEEPEST = math.radians(40)  # of a forearm out of the plane of its arm: what ball joints allow
WIDEST = (-0.85, 1.4)  # rad, joint angles that the work space may ask for
LONGEST_MOVE = 20.0  # s
DRIVE_ACCELERATION = 400.0  # rad/s^2 at which drives for pick-and-place throw links and platform about
TORQUE_GRID = 5e-3  # s between the instants at which the torque limit is checked
SLACK = 1.005  # of a limit, that a motion read from a file may be above it: the way between its points is a spline
REST = 0.01  # rad/s


class Payload(NamedTuple):
    """A mass at the platform between two instants, s since the motion began, kg."""

    pick: float
    release: float
    mass: float


@dataclass(frozen=True)
class Trajectory:
    """N + 1 instants `period` s apart: joint motion (N + 1, 3) rad, rad/s, rad/s^2, and what is carried when."""

    period: float
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    payloads: tuple[Payload, ...] = ()

    def __len__(self) -> int:
        return len(self.position) - 1

    @property
    def duration(self) -> float:
        """Seconds."""
        return len(self) * self.period


@dataclass(frozen=True)
class MotionLimits:
    """What a motion must stay within: joint side rad/s, rad/s^2, N m."""

    speed: float = 10.0
    acceleration: float = 250.0
    torque: float = 100.0


@dataclass(frozen=True)
class Workspace:
    """A cylinder about the z axis in which every pose is comfortable, metres, base frame."""

    radius: float
    top: float
    bottom: float


class Planner:
    """Plans motions of one robot at one cycle time."""

    def __init__(self, robot: Robot, period: float, limits: MotionLimits | None = None):
        self.period = period
        self.limits = limits or limits_of(robot)
        self.geometry: DeltaModel = pack(robot)
        self.forearm_kg = robot.mass.passive_link
        self.range = robot.geometry.joint_range_rad
        self.workspace = find_workspace(self.geometry)

    def pick_and_place(
        self, rng: np.random.Generator, duration: float, masses: tuple[float, ...] = (), speed: float = 1.0
    ) -> Trajectory:
        """Products from one conveyor to another and back empty-handed, until `duration` s are full.

        masses: kg to draw from, one a product; without any, all moves are empty. speed: share of the acceleration limit
        that a move may use, drawn between 0.5 and 1 of it.
        """
        space = self.workspace
        height = space.top - space.bottom
        heading = rng.uniform(0, 2 * math.pi)
        cross = np.array([math.cos(heading), math.sin(heading), 0.0])
        along = np.array([-math.sin(heading), math.cos(heading), 0.0])

        def place(side: float) -> np.ndarray:
            point = (
                side * rng.uniform(0.45, 0.8) * space.radius * cross + rng.uniform(-0.45, 0.45) * space.radius * along
            )
            return point + np.array([0.0, 0.0, space.bottom + rng.uniform(0.0, 0.25) * height])

        parts: list[kinematics.PlatformMotion] = []
        payloads: list[Payload] = []
        side, here = 1.0, place(1.0)
        clock = self._hold(parts, here, REST_BEFORE)
        while True:
            mass = float(rng.choice(masses)) if side > 0 and masses else 0.0
            there = place(-side)
            move = self._gate(here, there, rng.uniform(0.3, 0.7) * height, speed * rng.uniform(0.5, 1.0))
            length = len(move.position) * self.period
            if clock + length > duration and len(parts) == 1:
                raise DataError(
                    f"one move takes {length:.3g} s at this speed, longer than the motion of {duration:g} s"
                )
            if clock + length + 2 * GRIP + REST_AFTER > duration and len(parts) > 1:
                break
            pick = clock + GRIP / 2
            if mass:
                clock += self._hold(parts, here, GRIP)
            parts.append(move)
            clock += length
            side, here = -side, there
            if mass:
                payloads.append(Payload(pick, clock + GRIP / 2, mass))
                clock += self._hold(parts, here, GRIP)
            clock += self._hold(parts, here, rng.uniform(0.02, 0.12))
        self._hold(parts, here, max(REST_AFTER, duration - clock) + self.period)
        return self._joint(_chain(parts), tuple(payloads))

    def multisine(self, rng: np.random.Generator, duration: float, speed: float = 1.0) -> Trajectory:
        """Harmonics up to 2.5 Hz on every joint, random phases, as large as joint, speed, torque and workspace allow.

        speed: share of the limits that is used.
        """
        time = self._clock(duration)
        orders = np.arange(1, max(4, int(2.5 * duration)) + 1)
        chosen = [np.sort(rng.choice(orders, min(10, len(orders)), replace=False)) for _ in range(3)]
        omega = 2 * math.pi * np.array(chosen) / duration
        weight = rng.uniform(0.5, 1.0, omega.shape) / omega**0.7
        phase = rng.uniform(0, 2 * math.pi, omega.shape)
        window = _window(time, duration, 0.8)
        return self._largest(_even(_windowed(_waves(time, omega, weight, phase), window), rng), speed)

    def swing(
        self, duration: float, frequency: float, weight: np.ndarray, phase: np.ndarray, middle: np.ndarray, share: float
    ) -> Trajectory:
        """Sines round `middle`, from rest and back, as large as `share` of the limits allows.

        frequency: Hz of the first harmonic. weight, phase: (3, H), rad, of the harmonics of each joint, the weights as
        speeds. middle: (3,) beside the weights over the frequency, how far the joints swing away from `HOME`.
        """
        time = self._clock(duration)
        omega = 2 * math.pi * frequency * np.arange(1, weight.shape[1] + 1)
        wave = _waves(time, omega, weight / omega, phase)
        wave[0] += middle / omega[0]
        window = _window(time, duration, 0.5)
        return self._largest(_windowed(wave, window), share, what="swing")

    def slow(self, rng: np.random.Generator, duration: float) -> Trajectory:
        """A slow sweep of every joint with reversals, below 1.3 rad/s, to show friction and gravity."""
        time = self._clock(duration)
        omega = 2 * math.pi * rng.uniform(0.5, 3.2, (3, 3)) / max(duration, 4.0)
        weight = rng.uniform(0.4, 1.0, omega.shape)
        phase = rng.uniform(0, 2 * math.pi, omega.shape)
        window = _window(time, duration, 0.8)
        limits = MotionLimits(speed=1.3, acceleration=self.limits.acceleration, torque=self.limits.torque)
        return self._largest(_even(_windowed(_waves(time, omega, weight, phase), window), rng), 1.0, limits)

    def bound(self, rng: np.random.Generator, duration: float, speed: float = 1.0) -> Trajectory:
        """Round the rim of the workspace, up and down its wall, both ways round: what stresses geometry and gears."""
        space, time = self.workspace, self._clock(duration)
        window = _window(time, duration, 0.8)
        heights = (space.top - space.bottom) / 2
        phase, turn = rng.uniform(0, 2 * math.pi, 3), rng.uniform(0.30, 0.45)
        middle = (space.top + space.bottom) / 2

        def at(rate: float) -> kinematics.PlatformMotion:
            # the angle swings over more than a turn, so that every direction is met both ways
            swing, bob = 2 * math.pi * turn * rate, 2 * math.pi * 0.9 * rate
            angle = _sine(time, swing, phase[0], 3.5)
            z = _sine(time, bob, phase[1], 0.9 * heights)
            flat = _sine(time, bob * 0.37, phase[2], 0.06)
            radius = space.radius * np.array([0.92 + flat[0], flat[1], flat[2]])
            circle = np.stack([np.cos(angle[0]), np.sin(angle[0])])
            normal = np.stack([-circle[1], circle[0]])
            point = np.vstack([radius[0] * circle, middle + z[0]])
            first = np.vstack([radius[1] * circle + radius[0] * angle[1] * normal, z[1]])
            second = np.vstack(
                [
                    (radius[2] - radius[0] * angle[1] ** 2) * circle
                    + (2 * radius[1] * angle[1] + radius[0] * angle[2]) * normal,
                    z[2],
                ]
            )
            start = np.array([0.0, 0.0, middle])
            wave = np.stack([(point - start[:, None]).T, first.T, second.T])
            return kinematics.PlatformMotion(*_offset(_windowed(wave, window), start))

        def excess(rate: float) -> float:
            return self.excess(self._joint(at(rate), ()), speed)

        return self._joint(at(_fullest(excess, 0.05, 3.0, "bound")), ())

    def closed(self, motion: Trajectory) -> Trajectory:
        """`motion` with a smooth way back to its start, so that it can run round and round."""
        away = motion.position[0] - motion.position[-1]
        # a smooth step of length T peaks at 2.2/T in speed and 7.5/T^2 in acceleration; a third of the limits will do
        distance = float(np.abs(away).max())
        length = max(0.1, 6.6 * distance / self.limits.speed, math.sqrt(22.5 * distance / self.limits.acceleration))
        step = _smooth_step(self._clock(length)[1:], 0.0, length)
        back = step[..., None] * away
        return Trajectory(
            self.period,
            np.concatenate([motion.position, motion.position[-1] + back[0]]),
            np.concatenate([motion.velocity, back[1]]),
            np.concatenate([motion.acceleration, back[2]]),
            motion.payloads,
        )

    def excess(self, motion: Trajectory, share: float = 1.0, limits: MotionLimits | None = None) -> float:
        """Largest of joint speed, acceleration and torque over `share` of their limits; above 1 it is too much."""
        limits = limits or self.limits
        every = max(1, round(TORQUE_GRID / self.period))
        theta = motion.position[::every]
        torque = self.torque(theta, motion.velocity[::every], motion.acceleration[::every])
        holding = self.torque(theta, 0 * theta, 0 * theta)
        # holding the weight is not motion, so the share scales only what is beyond it
        spare = np.maximum(limits.torque - np.abs(holding), 1e-9) * share
        return max(
            float(np.abs(motion.velocity).max() / (limits.speed * share)),
            float(np.abs(motion.acceleration).max() / (limits.acceleration * share)),
            float((np.abs(torque - holding) / spare).max()),
        )

    def torque(self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray) -> np.ndarray:
        """N m (N, 3) that the nominal robot takes, empty and without friction, for (N, 3) rad, rad/s, rad/s^2."""
        terms = torque_terms(self.geometry, theta, theta_dot, theta_ddot)
        return terms[:, (INERTIA, GRAVITY, PLATFORM)].sum(axis=1) + self.forearm_kg * terms[:, FOREARM]

    def _clock(self, duration: float) -> np.ndarray:
        return np.arange(max(2, round(duration / self.period)) + 1) * self.period

    def _hold(self, parts: list[kinematics.PlatformMotion], point: np.ndarray, length: float) -> float:
        count = max(1, round(length / self.period))
        still = np.zeros((count, 3))
        parts.append(kinematics.PlatformMotion(still + point, still, still))
        return count * self.period

    def _gate(self, start: np.ndarray, end: np.ndarray, lift: float, share: float) -> kinematics.PlatformMotion:
        """Up, across, down, each a smooth step in time, overlapping: as fast as `share` of the limits allows."""
        path = self._gate_in(start, end, lift, length := 0.35)
        for _ in range(12):
            over = self.excess(self._joint(path, ()), share)
            if 0.97 < over <= 1.0:
                break
            # torque and acceleration go with the square of the time; a little less than full, so that it settles
            length *= math.sqrt(over / 0.985)
            if length > LONGEST_MOVE:
                raise DataError(f"a single move takes more than {LONGEST_MOVE:g} s within these limits")
            path = self._gate_in(start, end, lift, length)
        return path

    def _gate_in(self, start: np.ndarray, end: np.ndarray, lift: float, length: float) -> kinematics.PlatformMotion:
        time = np.arange(max(20, round(length / self.period))) * self.period
        length = len(time) * self.period
        across = _smooth_step(time, 0.15 * length, 0.85 * length)
        up, down = _smooth_step(time, 0.0, 0.5 * length), _smooth_step(time, 0.5 * length, length)
        drop = end - start
        rise = np.array([0.0, 0.0, lift])
        fall = rise - np.array([0.0, 0.0, drop[2]])
        flat = np.array([drop[0], drop[1], 0.0])
        wave = across[..., None] * flat + up[..., None] * rise - down[..., None] * fall
        return kinematics.PlatformMotion(*_offset(wave, start))

    def _joint(self, platform: kinematics.PlatformMotion, payloads: tuple[Payload, ...]) -> Trajectory:
        return Trajectory(self.period, *kinematics.inverse_motion(self.geometry, platform), payloads)

    def check(self, motion: Trajectory, name: str) -> None:
        """See that a motion from elsewhere is one that this planner could have made.

        Raises:
            DataError: naming the first joint, instant, value and limit that is not kept, or an end that is not at rest.
            PoseError: a pose out of reach.
        """
        low, high = self.range
        torque = self.torque(motion.position, motion.velocity, motion.acceleration)
        for values, least, most, unit in (
            (motion.position, low, high, "rad"),
            (motion.velocity, -self.limits.speed, self.limits.speed, "rad/s"),
            (motion.acceleration, -self.limits.acceleration, self.limits.acceleration, "rad/s^2"),
            (torque, -self.limits.torque, self.limits.torque, "N m"),
        ):
            middle, half = (least + most) / 2, (most - least) / 2
            if (beyond := ~(np.abs(values - middle) <= SLACK * half)).any():
                row, joint = np.argwhere(beyond)[0]
                raise DataError(
                    f"{name}: joint {joint + 1} at {row * self.period:.3f} s: {values[row, joint]:.4g} {unit}, "
                    f"must be {least:.4g} to {most:.4g} {unit}"
                )
        for row in range(0, len(motion.position), max(1, round(TORQUE_GRID / self.period))):
            pose = motion.position[row : row + 1]
            if not _comfortable(self.geometry, pose, kinematics.forward(self.geometry, pose)):
                raise DataError(f"{name}: at {row * self.period:.3f} s outside the workspace")
        for row, ending in ((0, "starts"), (-1, "ends")):
            joint = int(np.abs(motion.velocity[row]).argmax())
            if abs(motion.velocity[row, joint]) > REST:
                raise DataError(
                    f"{name}: joint {joint + 1} {ending} at {motion.velocity[row, joint]:.3g} rad/s, not at rest"
                )

    def _largest(
        self, wave: np.ndarray, share: float, limits: MotionLimits | None = None, what: str = "multisine"
    ) -> Trajectory:
        """Joint motion `HOME + scale wave` with the largest scale that stays in limits and workspace."""

        def at(scale: float) -> Trajectory:
            return Trajectory(self.period, *_offset(scale * wave, np.full(3, HOME)))

        def excess(scale: float) -> float:
            motion = at(scale)
            low, high = self.range
            if motion.position.min() < low or motion.position.max() > high:
                return 2.0
            every = max(1, round(TORQUE_GRID / self.period))
            try:
                platform = kinematics.forward(self.geometry, motion.position[::every])
            except PoseError:
                return 2.0
            if not _comfortable(self.geometry, motion.position[::every], platform):
                return 2.0
            return self.excess(motion, share, limits)

        top = float(np.abs(wave[0]).max())
        return at(_fullest(excess, 1e-3 / top, 1.5 / top, what))


def limits_of(
    robot: Robot, speed: float | None = None, acceleration: float | None = None, torque: float | None = None
) -> MotionLimits:
    """What a motion of `robot` stays within, where it is not given otherwise; the torque without friction."""
    peak = min(robot.limits.peak_torque_nm or math.inf, peak_torque(robot))
    return MotionLimits(
        speed or min(MotionLimits.speed, robot.limits.joint_speed_radps),
        acceleration or robot.limits.joint_acceleration_radps2 or MotionLimits.acceleration,
        torque or 0.6 * peak,  # the rest is for friction, a payload and the feedback
    )


def peak_torque(robot: Robot) -> float:
    """N m, joint side, that the drives of a robot of this size are good for."""
    geometry, mass = robot.geometry, robot.mass
    reach = geometry.active_link_length + max(geometry.active_link_length_error)
    felt = (mass.active_link / 3 + mass.passive_link / 2 + mass.platform) * reach**2
    return felt * DRIVE_ACCELERATION


def find_workspace(geometry: DeltaModel) -> Workspace:
    """The cylinder between the heights of links a little up and well down, as wide as joints and forearms allow.

    Raises:
        DataError: there is none.
    """
    try:
        top = float(kinematics.forward(geometry, np.full(3, -0.20))[2])
        bottom = float(kinematics.forward(geometry, np.full(3, 0.50))[2])
    except PoseError as error:
        raise DataError(f"no workspace: {error}") from error
    azimuth = np.linspace(0, 2 * math.pi, 48, endpoint=False)
    rim = np.array([(math.cos(a), math.sin(a), 0.0) for a in azimuth])

    def comfortable(radius: float) -> bool:
        for height in np.linspace(bottom, top, 3):
            points = rim * radius + np.array([0.0, 0.0, height])
            try:
                theta = kinematics.inverse(geometry, points)
            except PoseError:
                return False
            if not _comfortable(geometry, theta, points):
                return False
        return True

    radii = np.linspace(0.02, 1.0, 99) * geometry.passive_length.min()
    fits = [radius for radius in radii if comfortable(radius)]
    if not fits:
        raise DataError(f"no workspace: no pose within the limits between z = {bottom:.3f} m and {top:.3f} m")
    return Workspace(float(fits[-1]), top, bottom)


def _comfortable(geometry: DeltaModel, theta: np.ndarray, platform: np.ndarray) -> bool:
    """Whether poses, joint angles (N, 3) rad and platform (N, 3) m, are within what joints and ball joints allow."""
    lateral = np.abs(platform[:, 1:2] * geometry.azimuth_cos - platform[:, 0:1] * geometry.azimuth_sin)
    steep = (lateral > geometry.passive_length * math.sin(STEEPEST)).any()
    return not steep and theta.min() >= WIDEST[0] and theta.max() <= WIDEST[1]


def _fullest(excess: Callable[[float], float], low: float, high: float, what: str) -> float:
    """The largest scale between `low` and `high` whose `excess` is not above 1, to a thousandth."""
    if excess(low) > 1:
        raise DataError(f"{what}: even the smallest motion breaks a limit of speed, acceleration, torque or workspace")
    if excess(high) <= 1:
        return high
    while high - low > 1e-3 * high:  # halving, for the excess jumps where a pose becomes uncomfortable
        middle = (low + high) / 2
        if excess(middle) > 1:
            high = middle
        else:
            low = middle
    return low


def _smooth_step(time: np.ndarray, start: float, end: float) -> np.ndarray:
    """0 to 1 between `start` and `end` by the polynomial with no speed, acceleration or jerk at its ends; (3, N)."""
    span = end - start
    x = np.clip((time - start) / span, 0.0, 1.0)
    value = x**4 * (35 - 84 * x + 70 * x**2 - 20 * x**3)
    first = 140 * x**3 * (1 - x) ** 3 / span
    second = 420 * x**2 * (1 - x) ** 2 * (1 - 2 * x) / span**2
    return np.stack([value, first, second])


def _window(time: np.ndarray, duration: float, ramp: float) -> np.ndarray:
    """Fades in and out over `ramp` s, a quarter of `duration` at most; (3, N) with its derivatives."""
    ramp = min(ramp, duration / 4)
    return _smooth_step(time, 0.0, ramp) - _smooth_step(time, duration - ramp, duration)


def _waves(time: np.ndarray, omega: np.ndarray, weight: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """(3, N, 3) angle, speed and acceleration of sums of sines. omega: (H,) or (3, H) rad/s; weight, phase: (3, H)."""
    argument = omega[..., None] * time + phase[..., None]
    return np.stack(
        [
            (weight[..., None] * omega[..., None] ** n * np.sin(argument + n * math.pi / 2)).sum(axis=1).T
            for n in range(3)
        ]
    )


def _windowed(wave: np.ndarray, window: np.ndarray) -> np.ndarray:
    """Product rule on wave (3, N, 3) and window (3, N), value and two derivatives each."""
    w = window[..., None]
    return np.stack(
        [w[0] * wave[0], w[1] * wave[0] + w[0] * wave[1], w[2] * wave[0] + 2 * w[1] * wave[1] + w[0] * wave[2]]
    )


def _even(wave: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Wave (3, N, 3) with every joint swinging nearly as far as the others."""
    return wave * (rng.uniform(0.75, 1.0, 3) / np.abs(wave[0]).max(axis=0))


def _sine(time: np.ndarray, omega: float, phase: float, amplitude: float) -> np.ndarray:
    """Value and two derivatives, (3, N)."""
    return np.stack([amplitude * omega**n * np.sin(omega * time + phase + n * math.pi / 2) for n in range(3)])


def _offset(wave: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return wave[0] + start, wave[1], wave[2]


def _chain(parts: list[kinematics.PlatformMotion]) -> kinematics.PlatformMotion:
    position, velocity, acceleration = (np.concatenate(pieces) for pieces in zip(*parts, strict=True))
    return kinematics.PlatformMotion(position, velocity, acceleration)
