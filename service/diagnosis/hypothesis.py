"""A hypothesis: the base model and some effects with their parameters; what it predicts, and its fit to recordings."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np

from service.model.effects.base import Effect, on_joint
from service.model.friction import mean_direction
from service.model.scene import Base, Recording, Scene
from service.model.signals import Band, delayed

# A recording a thread: filters, matrix products and compiled kernels let go of the interpreter.
THREADS = ThreadPoolExecutor(os.cpu_count())
TIMING_LIMIT = 0.25  # samples: a shift below this is sampling, beyond it an effect
TRANSITION = (2e-4, 2e-2)  # rad/s, limits of the speed over which Coulomb friction turns; beyond is an effect
ITERATIONS = 6
SETTLED = 1e-4  # relative fall of the squared residual that ends the fit


@dataclass(frozen=True)
class Term:
    """One effect at work. joints from 0, empty unless the effect sits on joints. amplitude: (max(J, 1), k)."""

    effect: Effect
    joints: tuple[int, ...]
    amplitude: np.ndarray
    shape: tuple[float, ...]

    @property
    def places(self) -> tuple[int, ...]:
        """Joints to evaluate the effect on; 0 stands for the whole robot."""
        return self.joints or (0,)


@dataclass(frozen=True)
class Hypothesis:
    """Base model and effects."""

    base: Base
    terms: tuple[Term, ...] = ()
    timed: bool = True  # False: torque and position of one instant, as in the model that `identify` writes

    def parameters(self) -> np.ndarray:
        """All free parameters in one vector, the order of `with_parameters`."""
        parts = [self.base.rigid, self.base.viscous, self.base.coulomb, np.array([self.base.transition])]
        if self.fits_timing:
            parts.append(np.array([self.base.timing]))
        for term in self.terms:
            parts += [term.amplitude.ravel(), np.array(term.shape)[_free(term)]]
        return np.concatenate(parts)

    @property
    def fits_timing(self) -> bool:
        """A delay effect takes the place of the timing within a sample."""
        return self.timed and not any(term.effect.name == "torque_delay" for term in self.terms)

    def parameter_limits(self, period: float) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper limits in the order of `parameters`."""
        count = len(self.base.rigid) + 2 * len(self.base.viscous)
        low = [np.full(count, -np.inf), np.array([TRANSITION[0]])]
        high = [np.full(count, np.inf), np.array([TRANSITION[1]])]
        if self.fits_timing:
            low.append(np.array([-TIMING_LIMIT * period]))
            high.append(np.array([TIMING_LIMIT * period]))
        for term in self.terms:
            free = _free(term)
            low += [np.full(term.amplitude.size, -np.inf), limits(term.effect)[0][free]]
            high += [np.full(term.amplitude.size, np.inf), limits(term.effect)[1][free]]
        return np.concatenate(low), np.concatenate(high)

    def rough(self) -> np.ndarray:
        """(P,) bool: shapes whose torque is no smooth function of them, in the order of `parameters`."""
        marks = [
            np.zeros(len(self.parameters()) - sum(t.amplitude.size + int(_free(t).sum()) for t in self.terms), bool)
        ]
        for term in self.terms:
            marks += [np.zeros(term.amplitude.size, bool), np.full(int(_free(term).sum()), term.effect.rough)]
        return np.concatenate(marks)

    def with_parameters(self, values: np.ndarray) -> Hypothesis:
        """The same hypothesis at other parameters."""
        k, n = len(self.base.rigid), len(self.base.viscous)
        rigid, viscous, coulomb = values[:k], values[k : k + n], values[k + n : k + 2 * n]
        at = k + 2 * n
        base = replace(self.base, rigid=rigid, viscous=viscous, coulomb=coulomb, transition=float(values[at]))
        at += 1
        if self.fits_timing:
            base = replace(base, timing=float(values[at]))
            at += 1
        else:
            base = replace(base, timing=0.0)
        terms = []
        for term in self.terms:
            amplitude = values[at : at + term.amplitude.size].reshape(term.amplitude.shape)
            at += term.amplitude.size
            shape, free = np.array(term.shape, float), _free(term)
            count = int(free.sum())
            shape[free] = values[at : at + count]
            at += count
            terms.append(replace(term, amplitude=amplitude, shape=tuple(float(value) for value in shape)))
        return replace(self, base=base, terms=tuple(terms))


def _free(term: Term) -> np.ndarray:
    return np.array([not shape.fixed for shape in term.effect.shapes.values()], bool)


def limits(effect: Effect) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper limits of an effect's shapes."""
    shapes = list(effect.shapes.values())
    return np.array([shape.low for shape in shapes]), np.array([shape.high for shape in shapes])


def unreported(scene: Scene, hypothesis: Hypothesis) -> np.ndarray:
    """Torque (N, n) N m at the joints."""
    return scene.total + sum(added(scene, term) for term in hypothesis.terms if not term.effect.measured)


def added(scene: Scene, term: Term) -> np.ndarray:
    """Torque (N, n) N m that an effect adds at the joints."""
    torque = np.zeros((len(scene.time), scene.joints))
    for place, amplitude in zip(term.places, term.amplitude, strict=True):
        torque += term.effect.torque(scene, place, amplitude, term.shape)
    return torque


def reported(scene: Scene, hypothesis: Hypothesis, torque: np.ndarray) -> np.ndarray:
    """What measured effects make of a joint torque (N, n, ...); linear in it."""
    for term in hypothesis.terms:
        if term.effect.measured:
            for place, amplitude in zip(term.places, term.amplitude, strict=True):
                torque = term.effect.report(scene, place, torque, amplitude, term.shape)
    return torque


def predict(scene: Scene, hypothesis: Hypothesis) -> np.ndarray:
    """Reported torque (N, n) N m that the hypothesis expects."""
    torque = reported(scene, hypothesis, unreported(scene, hypothesis))
    return delayed(torque, hypothesis.base.timing, scene.period)


def tangent(scene: Scene, hypothesis: Hypothesis, band: Band) -> tuple[np.ndarray, np.ndarray]:
    """Prediction (M, n) and its derivative (M, n, P) by every free parameter, in the analysis band."""
    n = scene.joints
    own = [np.zeros(()) if term.effect.measured else added(scene, term) for term in hypothesis.terms]
    torque = scene.total + sum(own)
    at_joint: list[np.ndarray] = [scene.recording.rigid.columns]
    motion = scene.segment
    at_joint.append(_per_joint(motion.theta_dot))
    at_joint.append(_per_joint(scene.direction))
    wider = mean_direction(motion.theta_dot, 1.05 * hypothesis.base.transition) - scene.direction
    at_joint.append((hypothesis.base.coulomb * wider / (0.05 * hypothesis.base.transition))[..., None])
    if hypothesis.fits_timing:
        at_joint.append(-np.gradient(torque, scene.period, axis=0)[..., None])
    raw: dict[int, np.ndarray] = {}
    count = sum(part.shape[-1] for part in at_joint)
    for number, term in enumerate(hypothesis.terms):
        if term.effect.amplitudes:
            for place, amplitude in zip(term.places, term.amplitude, strict=True):
                if term.effect.measured:
                    columns = on_joint(torque[:, [place]], place, n)
                elif term.effect.own_joint:
                    columns = on_joint(term.effect.regressors(scene, place, term.shape), place, n)
                else:
                    columns = _by_amplitude(scene, term, place, amplitude)
                at_joint.append(columns)
                count += columns.shape[-1]
        for index in np.flatnonzero(_free(term)):
            moved, size = _moved(hypothesis, term, int(index))
            if term.effect.measured:
                change = reported(scene, moved, torque) - reported(scene, hypothesis, torque)
                raw[count] = change / size
                at_joint.append(np.zeros((len(torque), n, 1)))
            else:
                at_joint.append(((added(scene, moved.terms[number]) - own[number]) / size)[..., None])
            count += 1
    columns = reported(scene, hypothesis, np.concatenate([torque[..., None], *at_joint], axis=-1))
    columns[..., 0] = delayed(columns[..., 0], hypothesis.base.timing, scene.period)  # slopes can do without
    for index, values in raw.items():
        columns[..., index + 1] = values
    columns = band(columns)
    return columns[..., 0], columns[..., 1:]


def _per_joint(values: np.ndarray) -> np.ndarray:
    return values[..., None] * np.eye(values.shape[1])


def _by_amplitude(scene: Scene, term: Term, place: int, amplitude: np.ndarray) -> np.ndarray:
    if type(term.effect).torque is Effect.torque:
        return term.effect.regressors(scene, place, term.shape)
    step = 1e-4
    above = term.effect.torque(scene, place, amplitude + step, term.shape)
    below = term.effect.torque(scene, place, amplitude - step, term.shape)
    return ((above - below) / (2 * step))[..., None]


def _moved(hypothesis: Hypothesis, term: Term, index: int) -> tuple[Hypothesis, float]:
    low, high = limits(term.effect)
    shape = np.array(term.shape)
    size = 1e-2 * max(abs(shape[index]), 1e-3 * (high[index] - low[index]))
    if shape[index] + size > high[index]:
        size = -size
    shape[index] += size
    moved = replace(term, shape=tuple(float(value) for value in shape))
    return replace(hypothesis, terms=tuple(moved if t is term else t for t in hypothesis.terms)), float(size)


@dataclass(frozen=True)
class Problem:
    """Recordings, their torque in the analysis band, and the rows that count.

    target: (M, n) a recording. rows: (M, n) bool. sigma: (n,) N m, rms of the noise in the band, the unit of residuals.
    """

    recordings: Sequence[Recording]
    band: Band
    sigma: np.ndarray
    target: list[np.ndarray] = field(default_factory=list)
    rows: list[np.ndarray] = field(default_factory=list)

    @classmethod
    def of(cls, recordings: Sequence[Recording], band: Band, sigma: np.ndarray) -> Problem:
        """Filters and thins out the torque."""
        problem = cls(recordings, band, sigma)
        for recording in recordings:
            problem.target.append(band(recording.segment.torque))
            problem.rows.append(recording.segment.moving[:: band.step])
        return problem

    def scenes(self, base: Base) -> list[Scene]:
        """The recordings seen from `base`."""
        return [Scene(recording, base) for recording in self.recordings]

    @property
    def count(self) -> int:
        """Rows in all recordings and joints."""
        return int(sum(rows.sum() for rows in self.rows))

    def select(self, index: int, values: np.ndarray) -> np.ndarray:
        """Rows that count of (M, n, ...) of recording `index`, in units of the noise, joint after joint."""
        scaled = values / self.sigma.reshape(1, -1, *([1] * (values.ndim - 2)))
        return np.concatenate([scaled[self.rows[index][:, j], j] for j in range(values.shape[1])])


@dataclass(frozen=True)
class Fit:
    """A hypothesis at its optimum: residuals (R,) and tangents (R, P) a recording, in units of the noise.

    inside: (P,) bool, False for parameters that stand at a limit. free: also False for those too rough to be moved by a
    slope.
    """

    hypothesis: Hypothesis
    residuals: list[np.ndarray]
    tangents: list[np.ndarray]
    inside: np.ndarray
    free: np.ndarray

    @property
    def moving(self) -> list[np.ndarray]:
        """Tangents of the free parameters."""
        return [tangent[:, self.free] for tangent in self.tangents]

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
        return float(sum(r @ r for r in self.residuals))


def evaluate(problem: Problem, hypothesis: Hypothesis) -> Fit:
    """Residuals and tangents at the hypothesis's own parameters; its base is the operating point."""

    def one(index: int, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
        prediction, slope = tangent(scene, hypothesis, problem.band)
        return problem.select(index, problem.target[index] - prediction), problem.select(index, slope)

    parts = list(THREADS.map(one, range(len(problem.recordings)), problem.scenes(hypothesis.base)))
    residuals, tangents = [residual for residual, _ in parts], [slope for _, slope in parts]
    low, high = hypothesis.parameter_limits(problem.band.period)
    values = hypothesis.parameters()
    inside = (values > low) & (values < high)
    return Fit(hypothesis, residuals, tangents, inside, inside & ~hypothesis.rough())


def solve(gram: np.ndarray, moment: np.ndarray) -> np.ndarray:
    """Least squares from normal equations (P, P) and (P,) or (P, m); directions without information stay at zero."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram * scale[:, None] * scale)
    keep = values > 1e-10 * values[-1]
    root = vectors[:, keep] / np.sqrt(values[keep]) * scale[:, None]
    return root @ (root.T @ moment)


def fit(problem: Problem, hypothesis: Hypothesis, iterations: int = ITERATIONS) -> Fit:
    """Gauss-Newton over all parameters together, from the hypothesis's own, inside their limits.

    A parameter that would leave its limits is held there and the rest solved again; steps that do not help are halved.
    """
    best = evaluate(problem, hypothesis)
    for _ in range(iterations):
        gram = np.asarray(sum(t.T @ t for t in best.tangents))
        moment = np.asarray(sum(t.T @ r for t, r in zip(best.tangents, best.residuals, strict=True)))
        start = best.hypothesis.parameters()
        low, high = best.hypothesis.parameter_limits(problem.band.period)
        step = _within(gram, moment, low - start, high - start)
        for share in (1.0, 0.5, 0.2, 0.05):
            candidate = evaluate(problem, best.hypothesis.with_parameters(start + share * step))
            if candidate.cost < best.cost:
                break
        else:
            return best
        done = candidate.cost > best.cost * (1.0 - SETTLED)
        best = candidate
        if done:
            break
    return best


def _within(gram: np.ndarray, moment: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    step = solve(gram, moment)
    held = np.zeros(len(step), bool)
    while True:
        out = ~held & ((step < low) | (step > high))
        if not out.any():
            return step
        held |= out
        step[held] = np.clip(step, low, high)[held]
        step[~held] = solve(gram[np.ix_(~held, ~held)], moment[~held] - gram[np.ix_(~held, held)] @ step[held])
