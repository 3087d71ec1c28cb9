"""The report of logs of one to six joints, with every plot that a log gives: axes, made up, and two models of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from schemas.axes_description import Axes
from service.diagnosis.documents.report import write_report
from tests.service.pages.drawn import diagnosis
from tests.service.subject import Band, Base, DecoupledAxes, Hypothesis, Problem, Recording, Segment, evaluate
from tests.service.world import stub

PERIOD, SECONDS = 4e-3, 40.0
SIZE = np.array([40.0, 30.0, 12.0, 4.0, 2.0, 0.5])  # N m, of a large arm's joints from base to wrist


def log(joints: int, seed: int) -> Recording:
    """Sines, and a torque with a ripple that neither model has."""
    rng, time = np.random.default_rng(seed), np.arange(0.0, SECONDS, PERIOD)
    rate, phase = 2 * np.pi * rng.uniform(0.2, 3.0, (2, 5, joints))
    size = rng.uniform(0.02, 0.3, (5, joints))
    wave = size * np.exp(1j * (rate * time[:, None, None] + phase))
    theta, theta_dot, theta_ddot = ((wave * (1j * rate) ** order).sum(axis=1).imag for order in range(3))
    scale = SIZE[:joints]
    torque = 0.05 * theta_ddot + 0.3 * theta_dot + 0.2 * np.tanh(theta_dot / 0.01) + 0.05 * np.sin(9 * theta)
    torque = scale * (torque + 0.05 * rng.standard_normal(theta.shape))
    moving = np.abs(theta_dot) > 0.02
    part = Segment(np.arange(len(time)), time, PERIOD, theta, theta_dot, theta_ddot, torque, moving)
    return Recording(part, DecoupledAxes(np.ones(joints)), seed, f"run_{seed}")


def findings(joints: int) -> Any:
    """What the report draws of two logs; the model after has a fifth more viscous friction than that before."""
    scale, band = SIZE[:joints], Band.of(PERIOD)
    problem = Problem.of([log(joints, seed) for seed in range(2)], band, 0.05 * scale * band.white_share**0.5)
    rigid = np.r_[0.05 * scale, 0.0 * scale]
    before, after = (Hypothesis(Base(rigid, k * scale, 0.2 * scale, 0.01)) for k in (0.25, 0.3))
    left = [evaluate(problem, one).residuals for one in (before, after)]
    robot = Axes.model_validate({"name": "arm", "kind": "axes", "axis": [{"gravity": False}] * joints})
    return stub(
        robot=robot, problem=problem, before=left[0], after=left[1], noise=0.05 * scale,
        plain=stub(hypothesis=before), best=stub(hypothesis=after),
    )  # fmt: skip


def write_logs(joints: int, path: Path) -> None:
    """The page."""
    write_report(findings(joints), diagnosis(np.random.default_rng(joints), joints), path)
