"""Which discrepancies are at work beside a model: those that explain its residual on held-out data, most first.

Each is fitted together with all parameters of the model and those found before it. A priori it is as large as what is
left above the noise, and half as much is left beside it. All products of columns are summed once.

Source: Kennedy, O'Hagan: Bayesian calibration of computer models, 2001 (a discrepancy as a Gaussian process).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from schemas.diagnosis import Caution
from service.diagnosis.discrepancies import DISCREPANCIES
from service.diagnosis.discrepancies.discrepancy import Discrepancy, Process, Seen
from service.diagnosis.fit.selection import LEAST_Z, Scored, z_score
from service.diagnosis.fit.wide import Wide
from service.identification.correlated import WHITE, Correlated
from service.identification.fit import Fit, Problem, solve
from service.identification.folds import Split, block_loss
from service.model.description import digits
from service.model.hypothesis import Hypothesis

LEAST_SHARE = 0.05  # of the residual's energy above the noise that is worth telling
STANDS_OUT = 1.2  # times the noise's energy, below which the residual of a joint is not asked about


@dataclass(frozen=True)
class Tried:
    """A process together with those found before it. together: all of them, its own last. residuals: held out. gains:
    (blocks,) squares that it explains there."""

    process: Process
    together: list[Process]
    residuals: list[np.ndarray]
    gains: np.ndarray


@dataclass(frozen=True)
class _Group:
    """Processes of one joint, or those at the platform, side by side. at: (R',) which of all rows are theirs. columns:
    (R', C') in single precision, most of the memory that they take; products are in double precision. folds: (R',) bool
    a fold. first: of its columns among those of all groups."""

    at: np.ndarray
    columns: np.ndarray
    folds: list[np.ndarray]
    first: int

    @property
    def place(self) -> slice:
        """Of its columns among those of all groups."""
        return slice(self.first, self.first + self.columns.shape[1])

    def rows(self, fold: int) -> tuple[np.ndarray, np.ndarray]:
        """Of a fold: which of all they are, and the columns there."""
        mine = self.folds[fold]
        return self.at[mine], self.columns[mine].astype(float)


class Pool:
    """All discrepancies that there may be, as large as the noise, and their products, summed once a fold.

    Those of one joint are kept on its rows alone: on the others they are nothing.

    Args:
        problem: The logs, in units of the noise.
        split: Which rows are held out together.
        hypothesis: The model whose torque and directions they read.
        told: Only those that the document tells.
    """

    def __init__(self, problem: Problem, split: Split, hypothesis: Hypothesis, told: bool = False):
        self.problem, self.split = problem, split
        seen, platform = Seen.of(problem, hypothesis, problem.sigma), problem.recordings[0].mechanism.platform
        self.every: list[Process] = []
        made: dict[int | None, list[np.ndarray]] = {}
        for one in DISCREPANCIES:
            if one.over is not None or not told:
                for joint in range(len(problem.sigma)) if one.per_joint else () if platform is None else (0,):
                    process = one.process(seen, joint)
                    made.setdefault(process.joint, []).append(np.concatenate(process.columns))
                    kept = replace(process, columns=[], place=(), values=())
                    self.every.append(replace(process, columns=[]) if told else kept)
        joints, fold = np.concatenate(problem.joints_of_rows), np.concatenate(split.fold)
        self.fold = [fold == number for number in range(split.folds)]
        self._group: dict[int | None, _Group] = {}
        self.places: dict[int, np.ndarray] = {}
        self.count = 0
        for joint, parts in made.items():
            at = np.flatnonzero(joints == joint) if joint is not None else np.arange(len(joints))
            mine = [one for one in self.every if one.joint == joint]
            ends = self.count + np.cumsum([0, *(columns.shape[1] for columns in parts)])
            self.places |= {id(one): np.arange(*both) for one, both in zip(mine, pairwise(ends.tolist()), strict=True)}
            columns = np.concatenate(parts, axis=1)
            parts.clear()  # all of them twice would be the most memory of all
            self._group[joint] = _Group(at, columns, [part[at] for part in self.fold], self.count)
            self.count = int(ends[-1])
        self.grams = [self._gram(number) for number in range(split.folds)]

    def _gram(self, fold: int) -> np.ndarray:
        result = np.zeros((self.count, self.count))
        platform = self._group.get(None)
        for group in self._group.values():
            at, columns = group.rows(fold)
            result[group.place, group.place] = columns.T @ columns
            if platform is not None and group is not platform:
                cross = platform.columns[at].T @ columns
                result[platform.place, group.place], result[group.place, platform.place] = cross, cross.T
        return result

    def cross(self, near: np.ndarray, fold: int) -> np.ndarray:
        """(P, C) products of columns (R, P) with all of these, on a fold."""
        result = np.empty((near.shape[1], self.count))
        for group in self._group.values():
            at, columns = group.rows(fold)
            result[:, group.place] = near[at].T @ columns
        return result

    def torque(self, together: Sequence[Process], weight: np.ndarray, fold: int) -> np.ndarray:
        """(R,) of processes with these weights (C,) on the rows of a fold; 0 on the others."""
        result, end = np.zeros(len(self.fold[0])), 0
        for one in together:
            group, places = self._group[one.joint], self.places[id(one)]
            start, end, mine = end, end + len(places), group.folds[fold]
            columns = group.columns[mine, places[0] - group.first : places[-1] + 1 - group.first]
            result[group.at[mine]] += columns @ weight[start:end]
        return result

    def columns(self, together: Sequence[Process]) -> list[np.ndarray]:
        """(R, C) a recording, of processes side by side."""
        result, end = np.zeros((len(self.fold[0]), len(self.of(together)))), 0
        for one in together:
            group, places = self._group[one.joint], self.places[id(one)]
            start, end = end, end + len(places)
            result[group.at, start:end] = group.columns[:, places - group.first]
        return np.split(result, np.cumsum([rows.sum() for rows in self.problem.rows])[:-1])

    def of(self, together: Sequence[Process]) -> np.ndarray:
        """(C,) where the columns of processes are."""
        return np.concatenate([np.zeros(0, int), *(self.places[id(one)] for one in together)])


class Beside:
    """The discrepancies beside a model. every: those of joints of which more than noise is left. rest:
    mean square of noise and what else is left beside one, a priori. prior: (P,) information on each column of the pool:
    that over what a weight may be."""

    def __init__(self, pool: Pool, best: Scored):
        self.pool, self.best, level = pool, best, above(pool.problem, best.residuals)
        whole = float(np.mean(level))
        self.rest = 1.0 + whole / 2.0
        self.prior = np.zeros(pool.count)
        self.every = []
        for one in pool.every:
            size = whole if one.joint is None else float(level[one.joint])
            if size > 0.0:
                self.every.append(one)
                self.prior[pool.places[id(one)]] = self.rest / size
        self.own, self.residual = np.concatenate(best.fitted.moving), np.concatenate(best.fitted.residuals)
        near = np.column_stack([self.own, self.residual])
        self.near = [part.T @ part for part in (near[mine] for mine in pool.fold)]
        self.cross = [pool.cross(near, number) for number in range(pool.split.folds)]

    def held_out(self, together: Sequence[Process]) -> list[np.ndarray]:
        """Residuals (R,) a recording on held-out data, given these."""
        mine, own, pool = self.pool.of(together), self.own.shape[1], self.pool
        grams, moments = [], []
        for near, cross, far in zip(self.near, self.cross, pool.grams, strict=True):
            known = near[:own, :own], cross[:own, mine]
            grams.append(np.block([[known[0], known[1]], [known[1].T, far[np.ix_(mine, mine)]]]))
            moments.append(np.concatenate([near[:own, own], cross[own, mine]]))
        gram, moment = sum(grams) + np.diag(np.r_[np.zeros(own), self.prior[mine]]), sum(moments)
        left = self.residual.copy()
        for number, (out, without, less) in enumerate(zip(pool.fold, grams, moments, strict=True)):
            step = solve(gram - without, moment - less)
            left[out] -= self.own[out] @ step[:own]
            left -= pool.torque(together, step[own:], number)
        return np.split(left, np.cumsum([len(part) for part in self.best.residuals])[:-1])

    def worth(self, known: Sequence[Process], every: Sequence[Process], left: Sequence[np.ndarray]) -> list[Tried]:
        """Those of `every` that explain something given what is `known`, and not by chance. left: residuals given
        that."""
        blocks, result = block_loss(left, self.pool.split), []
        for process in every:
            rest = self.held_out([*known, process])
            tried = Tried(process, [*known, process], rest, blocks - block_loss(rest, self.pool.split))
            if z_score(blocks, blocks - tried.gains) > LEAST_Z:
                result.append(tried)
        return result


@dataclass(frozen=True)
class Opened:
    """What is at work beside a model. columns: (R, C) a recording, of all that was found. prior: (C,) information on
    the weight of each, where a mean square of `rest` is left. residuals: held out."""

    found: list[Process]
    columns: list[np.ndarray]
    prior: np.ndarray
    rest: float
    residuals: list[np.ndarray]

    @property
    def noise(self) -> Correlated:
        """With its covariance."""
        return Correlated(self.columns, self.prior) if self.found else WHITE

    def wide(self, fitted: Fit) -> Wide:
        """A fit with these free too."""
        return Wide.of(fitted, self.columns, self.prior)

    def in_its_units(self, fitted: Fit) -> Wide:
        """The same, the prior in units of what model and discrepancies leave."""
        return Wide.of(fitted, self.columns, self.prior / self.rest)

    def cautions(self) -> list[Caution]:
        """What was opened, where effects are hardly separable from it."""
        found: dict[Discrepancy, list[Process]] = {}
        for process in self.found:
            found.setdefault(process.discrepancy, []).append(process)
        return [
            Caution(
                code=one.code, joints=sorted(process.joint + 1 for process in mine if process.joint is not None),
                pitch_m=None if mine[0].pitch is None else digits(mine[0].pitch), advice=one.advice,
            )
            for one, mine in found.items()
            if one.code is not None
        ]  # fmt: skip

    @classmethod
    def beside(cls, pool: Pool, best: Scored) -> Opened:
        """As long as one more explains `LEAST_SHARE`."""
        beside, left, found = Beside(pool, best), best.residuals, []
        total = sum(float(residual @ residual) for residual in left) - pool.problem.count
        every = beside.every
        while every:
            tried = [one for one in beside.worth(found, every, left) if one.gains.sum() > LEAST_SHARE * total]
            if not tried:
                break
            first = max(tried, key=lambda one: float(one.gains.sum()))
            found, left = first.together, first.residuals
            every = [one.process for one in tried if one is not first]
        return cls(found, pool.columns(found), beside.prior[pool.of(found)], beside.rest, left)


def above(problem: Problem, residuals: Sequence[np.ndarray]) -> np.ndarray:
    """(n,) mean square of each joint above the noise; 0 where it does not stand out of it."""
    joint, count = np.concatenate(problem.joints_of_rows), len(problem.sigma)
    rows = np.maximum(np.bincount(joint, minlength=count), 1)
    square = np.bincount(joint, np.concatenate(residuals) ** 2, count) / rows
    return np.where(square > STANDS_OUT, square - 1.0, 0.0)
