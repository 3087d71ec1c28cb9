"""Traces of a robot whose parameters are known, made from motions with exact derivatives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from schemas.robot import Geometry, Mass, Robot
from schemas.trace import Trace
from service.model.dynamics import FOREARM, GRAVITY, INERTIA, PAYLOAD, PLATFORM, torque_terms
from service.model.nominal import DeltaModel, pack

PERIOD = 1e-3


@dataclass(frozen=True)
class Truth:
    rho_1: float = 1.9
    rho_2: float = 1.1
    forearm: float = 0.5
    viscous: np.ndarray = field(default_factory=lambda: np.array([1.6, 1.4, 2.4]))
    coulomb: np.ndarray = field(default_factory=lambda: np.array([5.0, 3.9, 3.1]))
    noise: float = 0.3
    payload: float = 0.0

    @property
    def values(self) -> np.ndarray:
        return np.array([self.rho_1, self.rho_2, self.forearm, *self.viscous, *self.coulomb])


@pytest.fixture(scope="session")
def robot() -> Robot:
    return Robot(
        name="known",
        geometry=Geometry(active_link_length=0.36, passive_link_length=0.85, base_radius=0.19, platform_radius=0.05),
        mass=Mass(active_link=2.7, passive_link=0.55, platform=1.3),
    )


def multisine(seed: int, seconds: float, amplitude: float, period: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """theta, theta_dot, theta_ddot (N, 3) round 0.5 rad: eight sines of 0.2 to 4 Hz a joint, exact derivatives."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds / period))[:, None] * period
    theta, theta_dot, theta_ddot = np.full((len(time), 3), 0.5), np.zeros((len(time), 3)), np.zeros((len(time), 3))
    for hz in rng.uniform(0.2, 4.0, (8, 3)):
        w, phase = 2 * np.pi * hz, rng.uniform(0, 2 * np.pi, 3)
        size = amplitude * 0.1 * rng.uniform(0.5, 1.0, 3) / np.maximum(hz, 0.8)
        theta += size * np.sin(w * time + phase)
        theta_dot += size * w * np.cos(w * time + phase)
        theta_ddot -= size * w**2 * np.sin(w * time + phase)
    return theta, theta_dot, theta_ddot


def synthesise(
    model: DeltaModel, seed: int, truth: Truth, motion: tuple[np.ndarray, np.ndarray, np.ndarray], period: float
) -> Trace:
    """What a robot with `truth` in it would record along `motion`."""
    rng = np.random.default_rng([seed, 7])
    theta, theta_dot, theta_ddot = motion
    terms = torque_terms(model, theta, theta_dot, theta_ddot)
    torque = (
        truth.rho_1 * terms[:, INERTIA]
        + truth.rho_2 * terms[:, GRAVITY]
        + terms[:, PLATFORM]
        + truth.forearm * terms[:, FOREARM]
        + truth.payload * terms[:, PAYLOAD]
        + truth.viscous * theta_dot
        + truth.coulomb * np.sign(theta_dot)
    )
    return Trace(
        Path(f"log_{seed}.csv"),
        np.arange(len(theta)) * period,
        theta + 1e-7 * rng.standard_normal(theta.shape),
        torque + truth.noise * rng.standard_normal(theta.shape),
        flags=np.zeros(len(theta), np.uint32),
    )


@pytest.fixture(scope="session")
def record(robot: Robot) -> Callable[..., Trace]:
    """record(seed, truth, ...) -> Trace of `robot` with `truth` in it."""
    model = pack(robot)

    def make(
        seed: int,
        truth: Truth | None = None,
        seconds: float = 8.0,
        amplitude: float = 2.0,
        moves: tuple[float, float, float] = (1.0, 1.0, 1.0),
        motion: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
        period: float = PERIOD,
    ) -> Trace:
        theta, theta_dot, theta_ddot = motion or multisine(seed, seconds, amplitude, period)
        scaled = (0.5 + (theta - 0.5) * moves, theta_dot * moves, theta_ddot * moves)
        return synthesise(model, seed, truth or Truth(), scaled, period)

    return make
