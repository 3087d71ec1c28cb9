"""A robot with known truth and motion whose derivatives are exact, so that every estimate has a right answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from schemas.fitted import JointParameter, Parameter
from schemas.messages import SAMPLE, set_stamp, stamp_ns
from schemas.robot import Geometry, Identified, Mass, Robot
from schemas.trace import Trace
from service.estimator.estimator import Estimator
from service.model.dynamics import FOREARM, GRAVITY, INERTIA, PAYLOAD, PLATFORM, torque_terms
from service.model.nominal import pack

PERIOD = 1e-3
STOP_TIME = 0.1  # s, from full speed to rest


@pytest.fixture(scope="session")
def robot() -> Robot:
    return Robot(
        name="known",
        geometry=Geometry(active_link_length=0.36, passive_link_length=0.85, base_radius=0.19, platform_radius=0.05),
        mass=Mass(active_link=2.7, passive_link=0.55, platform=1.3),
        identified=Identified(
            rho_1=Parameter(value=2.3),
            rho_2=Parameter(value=1.1),
            viscous_friction_nms=JointParameter(value=[1.7, 2.0, 2.2]),
            coulomb_friction_nm=JointParameter(value=[3.9, 5.3, 5.2]),
            forearm_inertia_kg=Parameter(value=0.55),
            torque_noise_nm=JointParameter(value=[0.25, 0.25, 0.25]),
        ),
    )


@dataclass(frozen=True)
class Known:
    """Samples and what is true of them: motion (N, 3) rad and derivatives, torque (N, 3) N m without noise."""

    samples: np.ndarray
    theta: np.ndarray
    theta_dot: np.ndarray
    theta_ddot: np.ndarray
    torque: np.ndarray


@pytest.fixture(scope="session")
def make(robot: Robot) -> Callable[..., Known]:
    """Sinusoidal joint motion, `pace` times as fast, that stands still from rest[0] to rest[1] s; payload mass as a
    function of time; noise in the torque, counts in the position."""

    def known(
        seconds: float = 2.0,
        *,
        payload: Callable[[np.ndarray], np.ndarray] = np.zeros_like,
        noise: float = 0.0,
        seed: int = 1,
        period: float = PERIOD,
        pace: float = 1.0,
        rest: tuple[float, float] = (np.inf, np.inf),
    ) -> Known:
        time = np.arange(round(seconds / period)) * period
        rate = 2 * np.pi * np.array([1.1, 1.6, 2.1]) * pace
        way = np.clip(np.maximum(rest[0] - time, time - rest[1]) / STOP_TIME, 0.0, 1.0)
        speed = (way * way * (3 - 2 * way))[:, None]  # of the clock that the motion follows
        change = np.gradient(speed, period, axis=0)
        wave = rate * cumulative_trapezoid(speed, dx=period, axis=0, initial=0.0) + [0.0, 1.0, 2.0]
        theta = 0.4 + 0.35 * np.sin(wave)
        along, bent = 0.35 * rate * np.cos(wave), -0.35 * rate**2 * np.sin(wave)
        theta_dot, theta_ddot = along * speed, bent * speed**2 + along * change
        model, found = pack(robot), robot.identified
        assert found is not None
        terms = torque_terms(model, theta, theta_dot, theta_ddot)
        torque = (
            found.rho_1.value * terms[:, INERTIA]
            + found.rho_2.value * terms[:, GRAVITY]
            + terms[:, PLATFORM]
            + found.forearm_inertia_kg.value * terms[:, FOREARM]
            + found.viscous_friction_nms.value * theta_dot
            + found.coulomb_friction_nm.value * np.clip(theta_dot / 0.01, -1, 1)
            + payload(time)[:, None] * terms[:, PAYLOAD]
        )
        random = np.random.default_rng(seed)
        samples = SAMPLE.empty(len(time))
        set_stamp(samples, np.rint(time * 1e9).astype(np.int64))
        samples["sequence"] = np.arange(len(time))
        resolution = robot.drive.position_resolution_rad
        samples["position"] = np.round(theta / resolution) * resolution
        samples["torque"] = torque + noise * random.standard_normal(torque.shape)
        samples["position_command"] = theta
        samples["torque_command"] = np.nan
        return Known(samples, theta, theta_dot, theta_ddot, torque)

    return known


def trace_of(known: Known) -> Trace:
    """The samples as a recorded trace."""
    samples = known.samples
    command = samples["position_command"]
    return Trace(
        path=Path("known.csv"),
        time=stamp_ns(samples) * 1e-9,
        position=samples["position"].copy(),
        torque=samples["torque"].copy(),
        position_command=None if np.isnan(command).any() else command.copy(),
    )


def learnt(estimator: Estimator) -> tuple[np.ndarray, np.ndarray]:
    """How far friction and scale are from the identified ones, and its standard deviation: (COUNT,) each, in the order
    of `service.estimator.departure.place`."""
    known = estimator.state["payload"]["departure"]
    return known["delta"].copy(), np.sqrt(np.diag(known["covariance"]))
