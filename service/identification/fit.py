"""The fit of a hypothesis to recordings: Gauss-Newton over all of its parameters together, in the analysis band."""

from __future__ import annotations

import os
import weakref
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import ClassVar, overload

import numpy as np

from service.identification.correlated import WHITE, Correlated
from service.model.hypothesis import Hypothesis
from service.model.parameters import FILTERED_LIMIT, LONGEST_DELAY, TIMING_LIMIT, Parameters
from service.model.scene import Recording, Scene
from service.model.signals import Band
from service.model.torque import expected, tangent_in_parts

# A recording a thread: filters, matrix products and compiled kernels let go of the interpreter.
THREADS = ThreadPoolExecutor(os.cpu_count())
ITERATIONS = 6
WITHIN_COLOURED = 1.25  # times the noise floor that is read from the noise's colour above the band
KEPT = 64 << 20  # bytes of tangents: of a fit and of what it is added to, also of an arm's many columns and rows
SETTLED = 1e-4  # relative fall of the squared residual that ends the fit


@dataclass(frozen=True)
class Problem:
    """Recordings, their torque in the analysis band, and the rows that count.

    target: (M, n) a recording. rows: (M, n) bool. sigma: (n,) N m, rms of the noise in the band, the unit of residuals.
    weights: (M, n) a recording, by which residuals are multiplied besides; none: 1.
    filtered: the noise has a memory, so the torque went through a filter. bare: no effect is looked for on it, so
    that a delay of whole samples is the base model's.
    """

    recordings: Sequence[Recording]
    band: Band
    sigma: np.ndarray
    target: list[np.ndarray] = field(default_factory=list)
    rows: list[np.ndarray] = field(default_factory=list)
    weights: Sequence[np.ndarray] = ()
    filtered: bool = False
    bare: bool = False

    @classmethod
    def of(cls, recordings: Sequence[Recording], band: Band, sigma: np.ndarray) -> Problem:
        """Filters and thins out the torque."""
        problem = cls(recordings, band, sigma)
        for recording in recordings:
            problem.target.append(band(recording.segment.torque))
            problem.rows.append(recording.segment.moving[:: band.step])
        return problem

    def scenes(self, hypothesis: Hypothesis) -> list[Scene]:
        """The recordings seen from where `hypothesis` stands."""
        return [hypothesis.seen(recording) for recording in self.recordings]

    @property
    def most(self) -> float:
        """Times sigma, that the noise may have: its level in the band is extrapolated where it has a memory."""
        return WITHIN_COLOURED if self.filtered else 1.0

    @property
    def apart(self) -> float:
        """Samples that torque and position may be, before it is an effect."""
        if self.bare:
            return LONGEST_DELAY / self.band.period
        return FILTERED_LIMIT if self.filtered else TIMING_LIMIT

    @property
    def count(self) -> int:
        """Rows in all recordings and joints, as they weigh: squared residual that noise alone leaves."""
        squares = [self.pick(i, w) ** 2 for i, w in enumerate(self.weights)] or [np.ones(r.sum()) for r in self.rows]
        return round(sum(float(square.sum()) for square in squares))

    @property
    def joints_of_rows(self) -> list[np.ndarray]:
        """(R,) joint of each row, a recording."""
        return [np.repeat(np.arange(rows.shape[1]), rows.sum(axis=0)) for rows in self.rows]

    @property
    def logs(self) -> list[int]:
        """Which trace each recording is from."""
        return [recording.trace for recording in self.recordings]

    def rms(self, residuals: Sequence[np.ndarray], groups: Sequence[int] | None = None) -> np.ndarray:
        """(G, n) N m of (R,) residuals a recording, in units of the noise, by log or other group of recordings."""
        groups = self.logs if groups is None else groups
        shape = max(groups) + 1, len(self.sigma)
        square, count = np.zeros(shape), np.zeros(shape)
        for group, residual, joint in zip(groups, residuals, self.joints_of_rows, strict=True):
            square[group] += np.bincount(joint, residual**2, shape[1])
            count[group] += np.bincount(joint, minlength=shape[1])
        return np.sqrt(square / np.maximum(count, 1)) * self.sigma

    def level(self, residuals: Sequence[np.ndarray]) -> np.ndarray:
        """(n,) rms of each joint's (R,) residuals a recording, in units of the noise, at least 1: joints weigh by it
        where a disturbance on one must hide nothing of the others."""
        return np.maximum(self.rms(residuals, [0] * len(self.rows))[0] / self.sigma, 1.0)

    def over_noise(self, residuals: Sequence[np.ndarray]) -> float:
        """Rms of (R,) residuals a recording, in units of the noise."""
        return (float(sum(r @ r for r in residuals)) / self.count) ** 0.5

    def pick(self, index: int, values: np.ndarray) -> np.ndarray:
        """Rows that count of (M, n, ...) of recording `index`, joint after joint."""
        return np.concatenate([values[rows, joint] for joint, rows in enumerate(self.rows[index].T)])

    def of_joint(self, index: int, joint: int, values: np.ndarray) -> np.ndarray:
        """Rows of `joint` that count, of its (M, ...) on recording `index`, in units of the noise, as they weigh."""
        rows = self.rows[index][:, joint]
        return self._in_units(index, joint, rows, values[rows])

    def _in_units(self, index: int, joint: int, rows: np.ndarray, picked: np.ndarray) -> np.ndarray:
        unit = self.sigma[joint] / (self.weights[index][rows, joint] if self.weights else np.ones(1))
        picked /= unit.reshape(-1, *([1] * (picked.ndim - 1)))
        return picked

    def select(self, index: int, *parts: np.ndarray) -> np.ndarray:
        """The same of (M, n) or of (M, n, F) side by side, joint after joint."""
        count, widths = np.count_nonzero(self.rows[index]), [part.shape[2:] for part in parts]
        result = np.empty((count, *map(sum, zip(*widths, strict=True))))
        end, joints = 0, len(self.sigma)
        every = [part.reshape(-1, *part.shape[2:]) for part in parts]  # whole rows are taken in two thirds of the time
        for joint in range(joints):
            rows = self.rows[index][:, joint]
            at = np.flatnonzero(rows) * joints + joint
            start, end, right = end, end + len(at), 0
            for part in every:
                left, right = right, right + (part.shape[1] if part.ndim > 1 else 0)
                place = (slice(start, end), slice(left, right)) if part.ndim > 1 else slice(start, end)
                result[place] = self._in_units(index, joint, rows, part.take(at, axis=0))
        return result


class Tangents(Sequence[np.ndarray]):
    """Tangents (R, F) a recording of a hypothesis, the most of a fit. `KEPT` bytes of all are kept, those asked for
    last and at least one fit's; the others are evaluated again when they are asked for."""

    _recent: ClassVar[list[weakref.ref[Tangents]]] = []

    def __init__(self, problem: Problem, hypothesis: Hypothesis, values: list[np.ndarray]) -> None:
        self._problem, self._hypothesis = problem, hypothesis
        self._values: list[np.ndarray] | None = values
        self._used()

    def _used(self) -> None:
        """Give up what was asked for longest ago."""
        alive = [one for ref in Tangents._recent if (one := ref()) is not None and one is not self]
        while alive and sum(one._size for one in (*alive, self)) > KEPT:
            alive.pop(0)._values = None
        Tangents._recent = [weakref.ref(one) for one in (*alive, self)]

    @property
    def _size(self) -> int:
        return sum(values.nbytes for values in self._values or ())

    def _now(self) -> list[np.ndarray]:
        values = self._values
        if values is None:
            values = self._values = _linearised(self._problem, self._hypothesis)[1]
        self._used()
        return values

    def __len__(self) -> int:
        return len(self._problem.recordings)

    def __iter__(self) -> Iterator[np.ndarray]:
        return iter(self._now())

    @overload
    def __getitem__(self, index: int) -> np.ndarray: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[np.ndarray]: ...
    def __getitem__(self, index: int | slice) -> np.ndarray | Sequence[np.ndarray]:
        return self._now()[index]


@dataclass(frozen=True)
class Fit:
    """A hypothesis at its optimum: residuals (R,) and tangents (R, F) a recording, in units of the noise.

    inside: (F,) bool, False for parameters that stand at a limit. free: also False for those too rough to be moved by a
    slope. reach: (F,) steps down and up over which slopes hold, inside the limits.
    """

    hypothesis: Hypothesis
    residuals: list[np.ndarray]
    tangents: Sequence[np.ndarray]
    inside: np.ndarray
    free: np.ndarray
    reach: tuple[np.ndarray, np.ndarray]

    @property
    def moving(self) -> list[np.ndarray]:
        """Tangents of the free parameters."""
        return [tangent[:, self.free] for tangent in self.tangents]

    def step(self, gram: np.ndarray, moment: np.ndarray) -> np.ndarray:
        """Least-squares step of the free parameters from normal equations in them, within reach."""
        return within(gram, moment, self.reach[0][self.free], self.reach[1][self.free])

    def stepped(self) -> tuple[np.ndarray, Fit]:
        """Least-squares step (P,) of the free parameters on all rows, within reach, and what it leaves as far as slopes
        say, at the same hypothesis."""
        moving = self.moving
        gram = np.asarray(sum(t.T @ t for t in moving))
        moment = np.asarray(sum(t.T @ r for t, r in zip(moving, self.residuals, strict=True)))
        step = self.step(gram, moment)
        residuals = [r - t @ step for r, t in zip(self.residuals, moving, strict=True)]
        low, high = (reach.copy() for reach in self.reach)
        low[self.free] -= step
        high[self.free] -= step
        return step, replace(self, residuals=residuals, reach=(low, high))

    def holding(self, columns: np.ndarray, values: np.ndarray) -> Fit:
        """With the free linear parameters of `columns` held at `values` (C,), and the others as they are."""
        parameters = Parameters(self.hypothesis)
        change, free = np.zeros(len(self.free)), self.free.copy()
        change[columns] = values - parameters.values[parameters.free][columns]
        free[columns] = False
        residuals = [r - t @ change for r, t in zip(self.residuals, self.tangents, strict=True)]
        return replace(self, residuals=residuals, free=free)

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
        return float(sum(r @ r for r in self.residuals))


def evaluate(problem: Problem, hypothesis: Hypothesis, scenes: Sequence[Scene] | None = None) -> Fit:
    """Residuals and tangents at the hypothesis's own parameters; its base is the operating point. scenes: as it sees
    the recordings, where they are known already."""
    residuals, tangents = _linearised(problem, hypothesis, scenes)
    parameters = Parameters(hypothesis)
    mechanism, period = problem.recordings[0].mechanism, problem.band.period
    low, high = parameters.limits(mechanism, period, problem.apart)
    values = parameters.values[parameters.free]
    inside = (values > low) & (values < high)
    reach = parameters.reach(mechanism, period, problem.apart)
    kept = Tangents(problem, hypothesis, tangents)
    return Fit(hypothesis, residuals, kept, inside, inside & ~parameters.rough, reach)


def _linearised(
    problem: Problem, hypothesis: Hypothesis, scenes: Sequence[Scene] | None = None
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Residuals (R,) and tangents (R, F) a recording."""

    def one(index: int, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
        prediction, *slopes = tangent_in_parts(scene, hypothesis, problem.band)
        return problem.select(index, problem.target[index] - prediction), problem.select(index, *slopes)

    scenes = problem.scenes(hypothesis) if scenes is None else scenes
    parts = list(THREADS.map(one, range(len(problem.recordings)), scenes))
    return [residual for residual, _ in parts], [slope for _, slope in parts]


def solve(gram: np.ndarray, moment: np.ndarray) -> np.ndarray:
    """Least squares from normal equations (..., P, P) and (..., P) or (..., P, m); directions without information stay
    at zero."""
    if moment.ndim < gram.ndim:
        return solve(gram, moment[..., None])[..., 0]
    if not gram.size:
        return moment
    square = np.diagonal(gram, axis1=-2, axis2=-1)
    told = square > 0  # the others' sums beside a zero are rounding
    scale = np.where(told, 1.0 / np.sqrt(np.where(told, square, 1.0)), 0.0)
    values, vectors = np.linalg.eigh(gram * scale[..., :, None] * scale[..., None, :])
    keep = values > 1e-10 * values[..., -1:]
    root = vectors / np.sqrt(np.where(keep, values, np.inf))[..., None, :] * scale[..., :, None]
    return root @ (np.swapaxes(root, -2, -1) @ moment)


def fit(
    problem: Problem, hypothesis: Hypothesis, iterations: int = ITERATIONS, noise: Correlated = WHITE,
    moved: np.ndarray | None = None,
) -> Fit:  # fmt: skip
    """Gauss-Newton over all parameters together, from the hypothesis's own, inside their limits.

    Steps that do not help are halved. noise: its covariance. moved: (F,) bool, parameters that
    are fitted; default: all.
    """
    best = evaluate(problem, hypothesis)
    gram, moment, cost = _equations(best, noise)
    for _ in range(iterations):
        parameters = Parameters(best.hypothesis)
        start = parameters.values[parameters.free]
        low, high = parameters.limits(problem.recordings[0].mechanism, problem.band.period, problem.apart)
        may = np.ones(len(start), bool) if moved is None else moved
        step = within(gram, moment, np.where(may, low - start, 0.0), np.where(may, high - start, 0.0))
        for share in (1.0, 0.5, 0.2, 0.05):
            candidate = parameters.at(start + share * step)
            scenes = problem.scenes(candidate)
            if noise.square(_residuals(problem, candidate, scenes)) < cost:
                break
        else:
            return best
        del best  # its tangents, while those of the next are made
        best, before = evaluate(problem, candidate, scenes), cost
        gram, moment, cost = _equations(best, noise)
        if cost > before * (1.0 - SETTLED):
            break
    return best


def _residuals(problem: Problem, hypothesis: Hypothesis, scenes: Sequence[Scene]) -> list[np.ndarray]:
    """(R,) a recording, as `evaluate` has them: a step that does not help needs no tangents."""

    def one(index: int, scene: Scene) -> np.ndarray:
        return problem.select(index, problem.target[index] - expected(scene, hypothesis, problem.band))

    return list(THREADS.map(one, range(len(scenes)), scenes))


def _equations(fitted: Fit, noise: Correlated) -> tuple[np.ndarray, np.ndarray, float]:
    """Gram matrix (F, F), moment (F,) and squared residual, as the noise weighs them."""
    tangents, residuals = list(fitted.tangents), fitted.residuals
    slopes, left = noise.weighed(tangents), noise.weighed(residuals)
    gram = np.asarray(sum(t.T @ w for t, w in zip(tangents, slopes, strict=True)))
    moment = np.asarray(sum(t.T @ w for t, w in zip(tangents, left, strict=True)))
    return gram, moment, noise.square(residuals)


def within(gram: np.ndarray, moment: np.ndarray, low: np.ndarray, high: np.ndarray | float) -> np.ndarray:
    """Least-squares steps (..., P) from normal equations (..., P, P) and (..., P), each entry between `low` and `high`.

    What would leave its limits is held there and the rest solved again; then let go, one at a time, what would rather
    come back in.
    """
    shape, size = moment.shape, moment.shape[-1]
    grams, moments = gram.reshape(-1, size, size), moment.reshape(-1, size)
    lows, highs = (np.broadcast_to(limit, shape).reshape(-1, size) for limit in (low, high))
    steps = solve(grams, moments)
    held = (steps < lows) | (steps > highs)
    live = np.flatnonzero(held.any(axis=1))
    for _ in range(3 * size if len(live) else 0):
        a, b, low, high, hold = grams[live], moments[live], lows[live], highs[live], held[live]
        step = np.where(hold, np.clip(steps[live], low, high), 0.0)
        free = ~hold
        rest = np.where(free, b - (a @ step[..., None])[..., 0], 0.0)
        step = np.where(hold, step, solve(a * free[:, :, None] * free[:, None, :], rest))
        out = free & ((step < low) | (step > high))
        unit = np.sqrt(np.maximum(np.diagonal(a, axis1=1, axis2=2), 1e-300))
        pull = (b - (a @ step[..., None])[..., 0]) * np.where(step <= low, 1.0, -1.0) / unit
        back = np.where(hold & (low < high), pull, 0.0)
        inside = ~out.any(axis=1)
        done = inside & (back.max(axis=1) <= 1e-6 * np.sqrt(np.abs(np.sum(b * step, axis=1))))
        come = np.flatnonzero(inside & ~done)
        hold |= out
        hold[come, np.argmax(back[come], axis=1)] = False
        steps[live], held[live] = step, hold
        live = live[~done]
        if not len(live):
            break
    return np.clip(steps, lows, highs).reshape(shape)
