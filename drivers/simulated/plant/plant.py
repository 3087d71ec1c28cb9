"""The robot that runs: MuJoCo mechanism, drives, gears, friction, sensors, payload, one controller cycle at a time."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's compiled modules carry no types)

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from drivers.simulated.plant.effects import PlantEffect, make_effects
from drivers.simulated.plant.mujoco_delta import (
    Design,
    build,
    centre_pose,
    close,
    dependence,
    holding_torque,
    reflected_inertia,
)
from drivers.simulated.plant.seen import Friction
from drivers.simulated.plant.servo_drive import Cycle, ServoState, control_kernel, creep_kernel, rest, tune
from drivers.simulated.plant.truth import PlantTruth, load_truth, shipped_truth
from schemas.errors import DataError
from schemas.robot import Robot

LONGEST_STEP = 0.25e-3  # s: the drives close their loops at 4 kHz or faster, and the physics with them


class Target(NamedTuple):
    """Commanded motion of one instant, both (3,): rad, rad/s."""

    position: np.ndarray
    velocity: np.ndarray


class Measured(NamedTuple):
    """What the bus carries of one cycle, all (3,): rad, N m, N m."""

    position: np.ndarray
    torque: np.ndarray
    torque_command: np.ndarray


class Plant:
    """A simulated Delta robot.

    Call `latch` then `run` once a controller cycle: `latch` takes the command for this cycle, reads the sensors and
    closes the drive loops for the first time; `run` lets the physics go to the end of the cycle.

    Effects read it as `Seen`. robot, described: what it was made of, before effects.
    """

    def __init__(
        self,
        robot: Robot,
        truth: PlantTruth | None = None,
        effects: tuple[PlantEffect, ...] = (),
        period: float = 1e-3,
        seed: int = 0,
    ):
        truth = truth or PlantTruth.nominal(robot)
        self.robot, self.described = robot, truth
        design = Design(truth)
        for effect in effects:
            design = effect.shape(design)
        self.truth = design.truth
        self.effects = effects
        self.period = period
        self.steps = max(1, math.ceil(period / LONGEST_STEP - 1e-9))
        self.step = period / self.steps
        self.rng = np.random.default_rng(seed)
        self._encoder_rng = np.random.default_rng([seed, 1])
        self._encoder_noise = iter(())
        self.mechanism = build(design, self.step)
        self.data = mujoco.MjData(self.mechanism.model)
        self.split = np.array(design.split)
        self._is_split = bool(self.split.any())
        self._stiffness, self._half_gap = np.array(design.drive_stiffness), np.array(design.half_gap)
        rotor = np.array(self.truth.rotor_inertia_kgm2)
        self._damping = 2 * np.array(design.drive_damping_ratio) * np.sqrt(self._stiffness * rotor)
        inertia = reflected_inertia(self.mechanism, centre_pose(self.truth))
        self.tuning = tune(inertia, self.truth, self.step)
        self.offset = np.array(self.truth.joint_offset_rad)
        self.noise = np.array(self.truth.torque_noise_nm)
        self._coulomb = np.array(self.truth.coulomb_friction_nm)
        self._viscous = np.array(self.truth.viscous_friction_nms)
        self.friction = Friction(np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3))
        # hooks that an effect does not override cost nothing
        self._on_friction = _overriding(effects, "friction")
        self._on_joint = _overriding(effects, "joint_torque")
        self._on_platform = _overriding(effects, "platform_force")
        self._on_motor = _overriding(effects, "motor_torque")
        self._on_reading = _overriding(effects, "reading")
        self._on_report = _overriding(effects, "report")
        self._on_bodies = _overriding(effects, "act_on_bodies")
        self.time = 0.0
        self.payload = 0.0
        self.load = np.zeros(3)
        self.torque = np.zeros(3)
        self._target = np.empty(3)
        self.reset(centre_pose(self.truth) - self.offset)

    def reset(self, position: np.ndarray) -> None:
        """Rest at joint `position` (3,) rad as the encoders read it, drives holding the weight. Time runs on."""
        motor = np.asarray(position, float) + self.offset
        holding = holding_torque(self.mechanism, motor)
        # a drive train that carries weight is twisted
        stiffness = np.where(self.split, self._stiffness, np.inf)
        link = motor - holding / stiffness - np.sign(holding) * self._half_gap
        mujoco.mj_resetData(self.mechanism.model, self.data)
        self.data.qpos[:] = close(self.mechanism, link)[0]
        self.data.qpos[self.mechanism.motor] = motor
        mujoco.mj_forward(self.mechanism.model, self.data)
        self.load = holding.copy()
        self.drive: ServoState = rest(holding)
        self._observe()
        self.reading = self.motor - self.offset
        for effect in self.effects:
            effect.start(self)
        self._set_friction()

    def adopt(self, other: Plant) -> None:
        """Go on where `other`, a plant of the same robot with other effects, is in its motion, between two cycles.

        Links, rotors and drives keep angle, speed and torque; effects begin anew.
        """
        link, mechanism = other.theta.copy(), self.mechanism
        slope = dependence(mechanism, link[None])[0]
        mujoco.mj_resetData(mechanism.model, self.data)
        self.data.qpos[:] = close(mechanism, link)[0]
        self.data.qvel[:] = slope @ other.theta_dot
        self.data.qpos[mechanism.motor], self.data.qvel[mechanism.motor] = other.motor, other.motor_dot
        self.set_payload(other.payload)
        mujoco.mj_forward(mechanism.model, self.data)
        self.time, self.load, self.torque = other.time, other.load.copy(), other.torque.copy()
        self.drive = ServoState(*(state.copy() for state in other.drive))
        self.rng, self._encoder_rng, self._encoder_noise = other.rng, other._encoder_rng, other._encoder_noise
        self._observe()
        self.reading = other.reading.copy()
        for effect in self.effects:
            effect.start(self)
        self._set_friction()

    def set_payload(self, mass: float) -> None:
        """Put `mass` kg on the platform in place of what is there."""
        if not mass >= 0 or not math.isfinite(mass):
            raise DataError(f"payload of {mass} kg: must be zero or more")
        model, body = self.mechanism.model, self.mechanism.platform_body
        model.body_mass[body] = self.truth.platform_kg + mass
        model.body_subtreemass[body] = model.body_mass[body]
        model.dof_M0[self.mechanism.platform] = model.body_mass[body]  # MuJoCo takes a slider's inertia from here
        self.payload = mass

    def latch(self, now: Target, end: Target, feedforward: np.ndarray | None = None) -> Measured:
        """Start a cycle that is commanded to go from `now` to `end` with `feedforward` (3,) N m added by the drives."""
        feedforward = np.zeros(3) if feedforward is None else feedforward
        self._cycle = Cycle(self.period, now.position, now.velocity, end.position, end.velocity, feedforward)
        self._control(0)
        reported = self.motor_command.copy()
        for effect in self._on_report:
            reported = effect.report(self, reported)
        if self.noise.any():
            reported = reported + self.noise * self.rng.standard_normal(3)
        if self.truth.torque_resolution_nm:
            reported = np.round(reported / self.truth.torque_resolution_nm) * self.truth.torque_resolution_nm
        return Measured(self.reading.copy(), reported, self.motor_command.copy())

    def run(self) -> None:
        """The rest of the cycle that `latch` started.

        Raises:
            DataError: the mechanism was torn apart (a singular pose, an unstable drive).
        """
        for k in range(self.steps):
            if k:
                self._control(k)
                for effect in self._on_report:
                    effect.report(self, self.motor_command)
            self._advance()
        if self.data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number or abs(self.closure_error) > 1e-3:
            raise DataError(
                f"simulated robot: the closed chain broke at {self.time:.3f} s, joints at "
                f"{', '.join(f'{angle:.3f}' for angle in self.theta)} rad: the motion runs into a singular pose"
            )

    def take_over(self, before: np.ndarray | None, after: np.ndarray | None) -> None:
        """Let the drives' integrators make up for feed-forward (3,) N m that comes or goes, so that no torque jumps."""
        if before is not None:
            self.drive.integral[:] += before
        if after is not None:
            self.drive.integral[:] -= after

    def warm_up(self) -> None:
        """Compile and call everything once, at rest, so that the first cycle is as quick as the others."""
        here = Target(self.reading.copy(), np.zeros(3))
        self.latch(here, here)
        self.run()
        self.reset(here.position)

    @property
    def closure_error(self) -> float:
        """Largest distance, m, by which a rod end misses its foot on the platform."""
        return float(np.abs(self.data.efc_pos[: self.data.ne]).max())

    def _observe(self) -> None:
        data, at = self.data, self.mechanism
        arm, platform = _stride(at.arm), _stride(at.platform)
        self.theta, self.theta_dot = data.qpos[arm], data.qvel[arm]
        self.platform, self.platform_dot = data.qpos[platform], data.qvel[platform]
        self._arm_force, self._platform_force = data.qfrc_applied[arm], data.qfrc_applied[platform]
        self.motor, self.motor_dot = self.theta, self.theta_dot
        self._observe_motors()

    def _observe_motors(self) -> None:
        """The rotors lie where they lie among the coordinates, so theirs are copies."""
        if self._is_split:
            at = self.mechanism.motor
            self.motor, self.motor_dot = self.data.qpos[at], self.data.qvel[at]

    def _control(self, k: int) -> None:
        """Read the encoders and close the drives' loops."""
        position = self.motor - self.offset
        for effect in self._on_reading:
            position = effect.reading(self, position)
        noise = next(self._encoder_noise, None)
        if noise is None:  # drawn a few thousand at a time, which is much cheaper
            block = self.truth.encoder_noise_rad * self._encoder_rng.standard_normal((4096, 3))
            self._encoder_noise = iter(block)
            noise = next(self._encoder_noise)
        self.reading, self.motor_command = np.empty(3), np.empty(3)
        control_kernel(
            self.tuning, self.drive, self._cycle, k / self.steps, position + noise,
            self._target, self.reading, self.motor_command,
        )  # fmt: skip

    def _set_friction(self) -> None:
        friction, model = self.friction, self.mechanism.model
        friction.forward[:] = friction.backward[:] = self._coulomb
        friction.viscous[:] = self._viscous
        friction.torque[:] = 0.0
        for effect in self._on_friction:
            effect.friction(self, friction)
        if self.truth.creep_radps:
            creep_kernel(friction.forward, friction.backward, self.motor_dot, self.truth.creep_radps, friction.torque)
        else:
            # MuJoCo's friction loss takes one level for both directions; the difference acts as a bias
            friction.torque -= (friction.forward - friction.backward) / 2
            model.dof_frictionloss[self.mechanism.motor] = np.maximum((friction.forward + friction.backward) / 2, 0.0)
        model.dof_damping[self.mechanism.motor] = friction.viscous

    def _drive_train(self) -> np.ndarray:
        """Torque (3,) N m from motor to link through spring, damper and gap; zero where they are one mass."""
        twist = self.motor - self.theta
        beyond = twist - np.clip(twist, -self._half_gap, self._half_gap)
        damping = self._damping * (self.motor_dot - self.theta_dot)
        passed = self._stiffness * beyond + np.where((beyond != 0) | (self._half_gap == 0), damping, 0.0)
        # teeth push, they do not pull
        return np.where((self._half_gap > 0) & (passed * beyond < 0), 0.0, passed)

    def _advance(self) -> None:
        data, at = self.data, self.mechanism
        torque = self.motor_command
        for effect in self._on_motor:
            torque = effect.motor_torque(self, torque)
        self.torque = torque
        if self._on_friction:
            self._set_friction()
            rubbed = torque + self.friction.torque
        elif self.truth.creep_radps:
            rubbed = torque.copy()
            creep_kernel(self._coulomb, self._coulomb, self.motor_dot, self.truth.creep_radps, rubbed)
        else:
            rubbed = torque
        if self._is_split:
            passed = self._drive_train()
            data.qfrc_applied[at.motor] = np.where(self.split, rubbed - passed, 0.0)
            self._arm_force[:] = np.where(self.split, passed, rubbed)
            self.load = np.where(self.split, passed, rubbed - self.friction.viscous * self.motor_dot)
        else:
            self._arm_force[:] = rubbed
            self.load = rubbed - self.friction.viscous * self.motor_dot
        for effect in self._on_joint:
            self._arm_force += effect.joint_torque(self)
        if self._on_platform:
            self._platform_force[:] = sum(effect.platform_force(self) for effect in self._on_platform)
        for effect in self._on_bodies:
            effect.act_on_bodies(self)
        mujoco.mj_step(at.model, data)
        self.time += self.step
        self._observe_motors()


def make_plant(
    robot: Robot, truth: str | Path | None, period: float, seed: int, more: tuple[PlantEffect, ...] = ()
) -> tuple[Plant, str]:
    """The plant of a truth file, and what it is in words. truth: None for the one that comes along for `robot`, else
    ideal, as for "ideal". more: effects at work besides.

    Raises:
        RobotError: naming file, key and value of the first thing that is wrong.
    """
    path = shipped_truth(robot) if truth is None else None if truth == "ideal" else Path(truth)
    if path is None:
        return Plant(robot, effects=more, period=period, seed=seed), "ideal: exactly as described"
    real = load_truth(path, robot)
    return Plant(robot, real, make_effects(real.effect, str(path)) + more, period, seed), f"truth of {path.name}"


def _stride(address: np.ndarray) -> slice:
    """Evenly spaced addresses as a slice, which gives a view where an index array gives a copy."""
    every = int(address[1] - address[0])
    return slice(int(address[0]), int(address[-1]) + 1, every)


def _overriding(effects: tuple[PlantEffect, ...], hook: str) -> tuple[PlantEffect, ...]:
    return tuple(effect for effect in effects if getattr(type(effect), hook) is not getattr(PlantEffect, hook))
