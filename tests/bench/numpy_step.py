"""The estimator step in plain NumPy, as one would write it without a compiler: the yardstick, and an independent check.

Written from the equations, not from the kernels. Good samples only: the bad-sample handling, which costs NumPy more
still, is left out.
"""

from __future__ import annotations

import numpy as np

from schemas.messages import FEEDFORWARD, MODEL_ERROR, PAYLOAD, SAMPLE
from schemas.robot import Robot
from service.estimator.kalman import MotionFilter, design
from service.estimator.payload import payload_state as p
from service.estimator.payload.payload_step import payload_kernel
from service.estimator.state import settings
from service.estimator.step import CREEPING_SPEED, MODEL_SHARE, REVERSAL_SPEED
from service.estimator.stream import SETTLE_TIME
from service.model.coulomb_viscous import SOFT
from service.model.dynamics import REST_SPEED
from service.model.nominal import pack


class Track:
    """A Kalman filter for three joints at a steady rate, as it stands in every book."""

    def __init__(self, filter_: MotionFilter, position: np.ndarray) -> None:
        self.filter, self.state, self.covariance = filter_, np.zeros((3, 4)), filter_.first
        self.state[:, 0] = position
        self.gain, self.innovation, self.spread = np.zeros(4), np.zeros(3), 1.0

    def follow(self, position: np.ndarray) -> None:
        transition = self.filter.transition
        prior = transition @ self.covariance @ transition.T + self.filter.noise
        predicted = self.state @ transition.T
        self.spread = prior[0, 0] + self.filter.resolution**2
        self.gain, self.innovation = prior[:, 0] / self.spread, position - predicted[:, 0]
        self.state = predicted + np.outer(self.innovation, self.gain)
        rest = np.eye(4) - np.outer(self.gain, np.eye(4)[0])
        self.covariance = rest @ prior @ rest.T + np.outer(self.gain, self.gain) * self.filter.resolution**2

    def kept(self) -> tuple:
        return self.state, self.covariance, self.gain, self.innovation, self.spread


class NumpyEstimator:
    """`step(bytes) -> bytes of feed-forward, payload and error` (the latter two empty until the lag line is full)."""

    def __init__(self, robot: Robot, period: float) -> None:
        self.model, self.period = pack(robot), period
        self.filter = design(period, robot.drive.position_resolution_rad)
        found = robot.identified
        assert found is not None
        settling = Track(self.filter, np.zeros(3))
        for _ in range(2000):
            settling.follow(np.zeros(3))
        noise = min(settling.covariance[1, 1] ** 0.5, REST_SPEED)
        self.transition = max(found.friction_transition_radps, noise)  # of a commanded motion
        self.rho_1, self.rho_2, self.forearm = found.rho_1.value, found.rho_2.value, found.forearm_inertia_kg.value
        self.viscous = np.array(found.viscous_friction_nms.value)
        self.coulomb = np.array(found.coulomb_friction_nm.value)
        assert found.torque_noise_nm is not None
        assert found.model_error_nm is not None
        square, noise = np.square(found.model_error_nm.value), np.square(found.torque_noise_nm.value)
        self.variance = noise + square**2 / (square + noise) * p.MODEL_ERROR_TIME / p.CORRELATION_TIME
        self.azimuth = np.stack([self.model.azimuth_cos, self.model.azimuth_sin, np.zeros(3)], axis=1)
        self.measured: Track | None = None
        self.count = 0
        self.past: list = []
        # how the payload is weighed is checked against truths elsewhere, and shared here
        self.weigher = settings(robot, period, 1)["payload"][0]
        self.weighed = np.zeros(1, p.STATE)
        p.start(self.weighed, self.weigher["prior"])

    def step(self, message: bytes) -> tuple[bytes, bytes, bytes]:
        sample = np.frombuffer(message, SAMPLE.dtype)[0]
        position, command = sample["position"], sample["position_command"]
        if self.measured is None:
            self.measured, self.commanded = Track(self.filter, position), Track(self.filter, command)
        else:
            self.measured.follow(position)
            self.commanded.follow(command)
        self.count += 1
        if self.count * self.period > SETTLE_TIME:
            self.past.append((self.measured.kept(), sample))
        answer = FEEDFORWARD.empty(1)
        answer["position_offset"] = 0.0  # no gear yields
        for field in ("stamp_sec", "stamp_nanosec", "sequence"):
            answer[field] = sample[field]
        answer["target_sequence"] = sample["sequence"]
        if self.count > SETTLE_TIME / self.period:
            mass, turned = self.mass(), np.tanh(self.commanded.state[:, 1] / self.transition)
            motion = self.commanded.state[:, :3].T
            inertia, gravity, platform, forearm, friction, load, balls = self.terms(*motion, direction=turned)
            answer["source"] = 1
            answer["torque"] = (
                (1.0 + self.learnt("sure")[3:-1:4])
                * (
                    self.rho_1 * inertia + self.rho_2 * gravity + platform
                    + self.forearm * forearm + friction + mass * load
                )
                + self.learnt_friction(self.commanded.state[:, 1], balls, turned)
            )  # fmt: skip
        else:
            answer["source"] = 3
        if len(self.past) <= self.filter.lag:
            return answer.tobytes(), b"", b""
        return answer.tobytes(), *self.lagged()

    def lagged(self) -> tuple[bytes, bytes]:
        (state, covariance, *_), sample = self.past.pop(0)
        adjoint = np.zeros((4, 3))
        for (_, _, gain, innovation, spread), _ in reversed(self.past):
            adjoint[0] += innovation / spread - gain @ adjoint
            adjoint = self.filter.transition.T @ adjoint
        state = state + (covariance @ adjoint).T
        direction = np.clip(state[:, 1] / REST_SPEED, -1, 1)
        inertia, gravity, platform, forearm, friction, load, balls = self.terms(*state[:, :3].T, direction=direction)
        grey = self.rho_1 * inertia + self.rho_2 * gravity + platform
        full = grey + self.forearm * forearm + friction
        torque = sample["torque"]
        doubt = MODEL_SHARE * (np.abs(inertia) + np.abs(gravity) + np.abs(platform) + np.abs(friction))
        speed = np.abs(state[:, 1])
        noise = np.where(speed > REVERSAL_SPEED, self.variance + doubt**2, np.inf)
        now = self.weighed[0]
        scale, carried = self.learnt("delta")[3:-1:4], now["mass"] * load
        now["column"][:, 0], now["weight"] = (1.0 + scale) * load, 1.0 / noise
        now["creeps"] = (speed > REVERSAL_SPEED) & (speed <= CREEPING_SPEED)
        now["residual"] = torque - full + scale * carried
        now["shape"] = np.stack([direction, state[:, 1], np.ones(3), full + carried, balls], axis=1)
        event = payload_kernel(self.weigher, now)
        mass = self.mass()
        payload, error = PAYLOAD.empty(1), MODEL_ERROR.empty(1)
        for field in ("stamp_sec", "stamp_nanosec", "sequence"):
            payload[field] = error[field] = sample[field]
        error["kh"], error["id"] = torque - inertia - gravity - platform, torque - grey
        error["id_friction"], error["full"] = torque - grey - friction, torque - full - mass * load
        for field in ("mass", "std_dev", "random_std_dev", "common_std_dev", "trusted"):
            payload[field] = now[field]
        payload["excitation"], payload["event"] = now["information"][0, 0] - p.PRIOR_STD**-2, event
        return payload.tobytes(), error.tobytes()

    def terms(self, theta, theta_dot, theta_ddot, direction):
        """inertia, gravity, platform, forearm, friction, load per kg and that of ball joints per N m, (3,) each."""
        model = self.model
        angle = theta + model.joint_offset
        sine, cosine, l1 = np.sin(angle), np.cos(angle), model.active_length
        down = np.array([0.0, 0.0, 1.0])
        elbow = (model.radius + l1 * cosine)[:, None] * self.azimuth - (l1 * sine)[:, None] * down
        slope = -(l1 * sine)[:, None] * self.azimuth - (l1 * cosine)[:, None] * down
        bend = -(l1 * cosine)[:, None] * self.azimuth + (l1 * sine)[:, None] * down
        # the platform: p = elbow_0 + w with |w| a forearm, and so from the other two
        a, b = elbow[1] - elbow[0], elbow[2] - elbow[0]
        normal = np.cross(a, b)
        aa, bb = np.array([a @ a, b @ b]) + model.passive_length[0] ** 2 - model.passive_length[1:] ** 2
        centre = (np.cross(normal, a) * bb + np.cross(b, normal) * aa) / (2 * normal @ normal)
        drop = np.sqrt((model.passive_length[0] ** 2 - centre @ centre) / (normal @ normal))
        position = elbow[0] + centre - np.sign(normal[2]) * drop * normal
        forearm = position - elbow
        lever = np.einsum("ia,ia->i", forearm, slope)
        jacobian = np.linalg.solve(forearm, np.diag(lever))
        velocity = jacobian @ theta_dot
        swing = velocity - slope * theta_dot[:, None]
        right = lever * theta_ddot + np.einsum("ia,ia->i", forearm, bend) * theta_dot**2 - (swing**2).sum(axis=1)
        acceleration = np.linalg.solve(forearm, right)
        rod = acceleration - slope * theta_ddot[:, None] - bend * (theta_dot**2)[:, None]
        load = jacobian.T @ (acceleration - model.gravity)
        square, axle = (model.passive_length**2)[:, None], np.cross(down, self.azimuth)
        turn = np.cross(forearm, swing) / square
        turn, bend = (rate / np.sqrt(np.sum(rate**2, axis=1, keepdims=True) + SOFT**2)
                      for rate in (turn, turn - axle * theta_dot[:, None]))  # fmt: skip
        push = np.cross(turn + bend, forearm) / square
        return (
            model.inertia * theta_ddot,
            -model.link_mass * slope @ model.gravity,
            model.moving_mass * load,
            -(jacobian.T @ rod.sum(axis=0) - np.einsum("ia,ia->i", slope, rod)) / 6,
            self.viscous * theta_dot + self.coulomb * direction,
            load,
            jacobian.T @ push.sum(axis=0) - np.einsum("ia,ia->i", slope, push) - np.einsum("ia,ia->i", axle, bend),
        )

    def learnt_friction(self, theta_dot: np.ndarray, balls: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """(3,) N m, what is sure of it beside the identified. balls: (3,), of ball joints per N m."""
        sure = self.learnt("sure")
        dry, viscous, offset, _ = sure[:-1].reshape(3, 4).T
        return dry * direction + viscous * theta_dot + offset + sure[-1] * balls

    def learnt(self, field: str) -> np.ndarray:
        """(13,): Coulomb N m, viscous N m s/rad, offset N m, scale of each joint; friction of ball joints N m."""
        return self.weighed[0]["departure"][field]

    def mass(self) -> float:
        return self.weighed[0]["usable"]
