"""Where the residual sits that no effect explains: as a force on the platform that depends on its position, or as a
torque of one joint that depends on its angle or its speed.

Each is a Gaussian process with squared-exponential covariance, fitted together with all parameters of the model. A
priori it is as large as what is left above the noise, and half as much is left beside it. How much it explains is
measured on held-out data.

Source: Kennedy, O'Hagan: Bayesian calibration of computer models, 2001 (a discrepancy as a Gaussian process).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from schemas.axes import Description
from schemas.diagnosis import Extreme, Located
from service.diagnosis.evidence.placement import beside
from service.diagnosis.evidence.statistics import Z95
from service.diagnosis.fit.selection import LEAST_Z, TOLD_APART, Scored, score, z_score
from service.identification.fit import Problem, evaluate, solve
from service.identification.folds import Split, block_loss
from service.model.description import digits, in_units_of
from service.model.hypothesis import Hypothesis
from service.model.scene import Scene

Over = Literal["angle", "friction_at_angle", "speed", "platform"]
UNITS: dict[Over, str] = {"angle": "rad", "friction_at_angle": "rad", "speed": "rad/s", "platform": "m"}
WIDTH, WIDTH_OF_PLACE = 0.05, 0.15  # length over which it varies, of the range of angle or speed; of the platform's
APART = 1.25  # widths between the points that carry a process: less adds columns and no detail
FAR = 1.5  # widths from any motion, from which such a point is left out
LEAST_SHARE = 0.05  # of the residual's energy above the noise that is worth telling
STANDS_OUT = 1.2  # times the noise's energy, below which the residual of a joint is not asked about


@dataclass(frozen=True)
class Process:
    """What the residual may depend on. joint: from 0; None of a force on the platform. place: (N, d) a recording, SI.
    values: (N, K) a recording, of a weight of 1: N m of the joint, or N of each component of the force. columns: (R, K)
    or (R, 3 K) a recording, torque in the band, in units of the noise, for weights of standard deviation 1."""

    over: Over
    joint: int | None
    place: list[np.ndarray]
    values: list[np.ndarray]
    columns: list[np.ndarray]


@dataclass(frozen=True)
class Tried:
    """A process together with those found before it. columns: (R, C) a recording, of all of them, its own last.
    residuals: held out. gains: (blocks,) squares that it explains there."""

    process: Process
    columns: list[np.ndarray]
    residuals: list[np.ndarray]
    gains: np.ndarray


def located(robot: Description, problem: Problem, split: Split, hypothesis: Hypothesis) -> list[Located]:
    """On what the residual of a model depends, what explains most first; further answers are given that one.

    Args:
        robot: Whose units are used.
        problem: The logs, in units of the noise.
        split: Which rows are held out together.
        hypothesis: The model whose residual it is.

    Returns:
        Nothing where the residual is noise, or depends on none of these.
    """
    best = score(evaluate(problem, hypothesis), split)
    left, known = best.residuals, [np.zeros((len(residual), 0)) for residual in best.residuals]
    level = _above(problem, left)
    everything: Iterable[Process] = _processes(problem, best, level)
    prior = 1.0 + float(np.mean(level)) / 2.0  # noise and the rest, over what a weight of 1 may be
    found, total = [], sum(float(residual @ residual) for residual in left) - problem.count
    while _above(problem, left).any():
        blocks = block_loss(left, split)
        asked = (_beside(best, split, known, process, prior, blocks) for process in everything)
        tried = [one for one in asked if z_score(blocks, blocks - one.gains) > LEAST_Z]  # the others are not kept
        worth = [one for one in tried if one.gains.sum() > LEAST_SHARE * total]
        if not worth:
            break
        first = max(worth, key=lambda one: float(one.gains.sum()))
        same = [t for t in worth if len({t.process.joint, first.process.joint} - {None}) < 2]
        alike = [t for t in same if t is first or z_score(blocks - t.gains, blocks - first.gains) < TOLD_APART]
        for one in sorted(alike, key=lambda one: -float(one.gains.sum())):
            found.append(_told(robot, problem, best, one, prior, total, one is not first))
        left, known = first.residuals, first.columns
        everything = [one.process for one in tried if one.process.joint != first.process.joint]
    return found


def _above(problem: Problem, residuals: Sequence[np.ndarray]) -> np.ndarray:
    """(n,) mean square of each joint above the noise; 0 where it does not stand out of it."""
    joint, count = np.concatenate(problem.joints_of_rows), len(problem.sigma)
    rows = np.maximum(np.bincount(joint, minlength=count), 1)
    square = np.bincount(joint, np.concatenate(residuals) ** 2, count) / rows
    return np.where(square > STANDS_OUT, square - 1.0, 0.0)


def _beside(
    best: Scored, split: Split, known: Sequence[np.ndarray], process: Process, prior: float,
    blocks: np.ndarray,
) -> Tried:  # fmt: skip
    columns = [np.concatenate(parts, axis=1) for parts in zip(known, process.columns, strict=True)]
    rest = beside(best.fitted, columns, split, prior)
    return Tried(process, columns, rest, blocks - block_loss(rest, split))


def _processes(problem: Problem, best: Scored, level: np.ndarray) -> Iterator[Process]:
    """All that are asked. level: (n,) mean square above the noise, in units of it."""
    scenes = problem.scenes(best.hypothesis)
    size = np.sqrt(level) * problem.sigma
    if problem.recordings[0].mechanism.kind == "delta":
        yield _force(problem, scenes, float(np.sqrt(np.mean(size**2))))
    for joint in np.flatnonzero(level).tolist():
        angle = [scene.segment.theta[:, [joint]] for scene in scenes]
        speed = [scene.segment.theta_dot[:, [joint]] for scene in scenes]
        direction = [scene.direction[:, [joint]] for scene in scenes]
        asked: list[tuple[Over, list[np.ndarray], list[np.ndarray] | None]] = [
            ("angle", angle, None), ("friction_at_angle", angle, direction), ("speed", speed, None),
        ]  # fmt: skip
        for over, place, factor in asked:
            values = [size[joint] * part for part in _features(place, WIDTH)]
            acting = values if factor is None else [v * f for v, f in zip(values, factor, strict=True)]
            torque = [np.zeros((len(part), len(size), part.shape[1])) for part in acting]
            for whole, part in zip(torque, acting, strict=True):
                whole[:, joint] = part
            yield Process(over, joint, place, values, _rows(problem, torque))


def _force(problem: Problem, scenes: Sequence[Scene], size: float) -> Process:
    """A force on the platform. size: N m, rms of its torque a priori."""
    place, joints = [scene.arms.position for scene in scenes], len(problem.sigma)
    levers = [-np.swapaxes(scene.arms.jacobian, 1, 2) for scene in scenes]  # m, (N, joint, component)
    lever = float(np.sqrt(3.0 * np.mean(np.concatenate(levers) ** 2)))
    values = [size / lever * part for part in _features(place, WIDTH_OF_PLACE)]
    torque = [
        (one[..., None] * part[:, None, None]).reshape(len(part), joints, -1)
        for one, part in zip(levers, values, strict=True)
    ]
    return Process("platform", None, place, values, _rows(problem, torque))


def _rows(problem: Problem, torque: Sequence[np.ndarray]) -> list[np.ndarray]:
    return [problem.select(number, problem.band(part)) for number, part in enumerate(torque)]


def _features(place: Sequence[np.ndarray], width: float) -> list[np.ndarray]:
    """(N, K) a recording, whose products with themselves are the covariance of the process over place (N, d).

    Source: Williams, Seeger: Using the Nyström method to speed up kernel machines, 2001.
    """
    every = np.concatenate(place)
    low, ways = every.min(axis=0), np.ptp(every, axis=0)
    unit = width * max(float(ways.max()), 1e-9)
    axes = [np.linspace(0.0, way / unit, math.ceil(way / unit / APART) + 1) for way in ways]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(ways))
    visited = np.unique(np.round(2.0 * (every - low) / unit), axis=0) / 2.0
    carriers = grid[((grid[:, None] - visited[None]) ** 2).sum(axis=2).min(axis=1) < FAR**2]
    value, vector = np.linalg.eigh(_covariance(carriers, carriers))
    root = vector / np.sqrt(np.maximum(value, 1e-6 * value[-1]))
    return [_covariance((part - low) / unit, carriers) @ root for part in place]


def _covariance(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(N, K) of places (N, d) and (K, d) in widths."""
    return np.exp(-0.5 * ((one[:, None] - other[None]) ** 2).sum(axis=2))


def _told(
    robot: Description, problem: Problem, best: Scored, tried: Tried, prior: float, total: float,
    alternative: bool,
) -> Located:  # fmt: skip
    """total: squares of all residuals above the noise. alternative: to what was told before it."""
    process, step = tried.process, problem.band.step
    weight = _weight(best, tried.columns, prior)[-process.columns[0].shape[1] :].reshape(-1, process.values[0].shape[1])
    rows = [r.any(axis=1) if process.joint is None else r[:, process.joint] for r in problem.rows]
    value = np.concatenate([v[::step][m] @ weight.T for v, m in zip(process.values, rows, strict=True)])
    place = np.concatenate([p[::step][m] for p, m in zip(process.place, rows, strict=True)])
    if process.joint is None:
        most, unit = [int(np.argmax(np.sum(value**2, axis=1)))], "N"
    else:
        most, unit = [int(np.argmin(value[:, 0])), int(np.argmax(value[:, 0]))], "N m"
    gains = tried.gains / total
    error = Z95 * float(np.sqrt(len(gains)) * np.std(gains))
    share = float(np.clip(gains.sum(), 0.0, 1.0))
    low, high = (float(np.clip(share + way * error, 0.0, 1.0)) for way in (-1.0, 1.0))
    return Located(
        joint=None if process.joint is None else process.joint + 1, over=process.over, alternative=alternative,
        share=round(share, 4), share_ci95=(round(low, 4), round(high, 4)),
        rms=digits(np.sqrt(np.mean(np.sum((value - value.mean(axis=0)) ** 2, axis=1)))), unit=in_units_of(robot, unit),
        extremes=[
            Extreme(value=[digits(v) for v in value[one]], at=[digits(p) for p in place[one]]) for one in most
        ],
        at_unit=in_units_of(robot, UNITS[process.over]),
    )  # fmt: skip


def _weight(best: Scored, columns: Sequence[np.ndarray], prior: float) -> np.ndarray:
    """(C,) posterior mean on all rows, the model's parameters free."""
    own = best.fitted.moving
    both = [np.concatenate(parts, axis=1) for parts in zip(own, columns, strict=True)]
    gram = np.asarray(sum(c.T @ c for c in both))
    moment = np.asarray(sum(c.T @ r for c, r in zip(both, best.fitted.residuals, strict=True)))
    open_ = own[0].shape[1]
    gram[open_:, open_:] += prior * np.eye(len(gram) - open_)
    return solve(gram, moment)[open_:]
