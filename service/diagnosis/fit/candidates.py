"""What every effect, on every joint and at every point of its grid, would tell of data left out.

The candidates' regressors are turned into normal equations once a step, one Gram matrix a fold; leaving a fold out,
adding any candidate and predicting what was left out then costs a small linear solve.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, combinations, groupby, pairwise, repeat
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from service.identification.fit import THREADS, Fit, Problem, solve, within
from service.identification.folds import Split
from service.model.effects.base import Effect
from service.model.hypothesis import Hypothesis, Term
from service.model.scene import Scene
from service.model.torque import reported

PROMISE = 0.5  # of what could be gained, that something has to promise on data left out before it is fitted
COUPLES = 40  # pairs of effects asked on data left out
JOINT_SHARE = 0.05  # an effect on all joints must beat the one on a single joint by this share of its gain
ROUGH_JOINT_SHARE = 0.3  # the same where the grid only comes near

Prior = np.ndarray | float


@dataclass(frozen=True)
class Candidate:
    """One way an effect may be at work: where, and at which point of its grid."""

    effect: Effect
    joints: tuple[int, ...]
    nonlinear: tuple[float, ...]

    def term(self) -> Term:
        """At amplitude zero."""
        return Term.blank(self.effect, self.joints, self.nonlinear)


class Piece(NamedTuple):
    """What a recording has of a joint in a fold. rows: among its (R,). columns: (r, C_j) of the candidates that reach
    the joint, in units of the noise, as they weigh; in single precision, products are in double."""

    fold: int
    joint: int
    recording: int
    rows: np.ndarray | slice
    columns: np.ndarray


class Regressors:
    """All candidates' regressors in the band, kept from round to round: only a delay or a filter of the torque alters
    them so much that it would show in the ranking.

    start: what is known before any of them is added. low: (C,) least that each amplitude can be. reach: of each joint
    the candidates (C_j,) that add torque to it: most are of one joint alone.
    """

    def __init__(self, problem: Problem, split: Split, effects: Iterable[Effect], start: Hypothesis):
        self.problem, self.split, self.start = problem, split, start
        self.effects = [e for e in effects if problem.recordings[0].mechanism.kind in e.kinds]
        self.index: dict[tuple[Effect, int, tuple[float, ...]], np.ndarray] = {}
        scenes, low = problem.scenes(start), []
        joints = range(scenes[0].joints)
        reach: list[list[int]] = [[] for _ in joints]
        for effect in self.effects:
            grid = dict.fromkeys(point for scene in scenes for point in effect.grid(scene))
            for joint in joints if effect.per_joint else (0,):
                for nonlinear in grid:
                    own = [amplitude.low for amplitude in effect.amplitudes.values()] or [0.0]
                    self.index[effect, joint, nonlinear] = len(low) + np.arange(len(own))
                    for place in (joint,) if effect.own_joint else joints:
                        reach[place] += range(len(low), len(low) + len(own))
                    low += own
        self.low, self.reach = np.array(low), [np.array(numbers, int) for numbers in reach]
        self.seen: list[Effect] | None = None
        self.pieces: list[Piece] = []
        self.grams = np.zeros((0, 0, 0))

    def along(self, hypothesis: Hypothesis) -> None:
        """Fill pieces, and grams (folds, C, C), as `hypothesis` sees them."""
        bent = [term.effect for term in hypothesis.terms if term.effect.measured and not term.effect.amplitudes]
        if bent == self.seen:
            return
        # What they take is free before more is asked for.
        self.seen, self.pieces, self.grams = bent, [], np.zeros((0, 0, 0))
        scenes = self.problem.scenes(hypothesis)
        found = THREADS.map(lambda n, scene: self._pieces(n, scene, hypothesis), range(len(scenes)), scenes)
        self.pieces = list(chain.from_iterable(found))
        self.grams = self._grams()

    def _grams(self) -> np.ndarray:
        result = np.zeros((self.split.folds, len(self.low), len(self.low)))

        def one(gram: np.ndarray, pieces: list[Piece]) -> None:
            for piece in pieces:
                reach, columns = self.reach[piece.joint], piece.columns.astype(float)
                gram[np.ix_(reach, reach)] += columns.T @ columns

        _done(THREADS.map(one, result, _by_fold(self.pieces, self.split.folds)))
        return result

    def _pieces(self, number: int, scene: Scene, hypothesis: Hypothesis) -> list[Piece]:
        """Of a recording; an effect is filtered in one go. A list: a generator would do its work in whose thread reads
        it."""
        problem, joints = self.problem, range(scene.joints)
        counts = problem.rows[number].sum(axis=0)
        every = [np.empty((count, len(self.reach[joint])), np.float32) for joint, count in enumerate(counts)]
        filled = [0 for _ in joints]
        for several, band in self._in_band(scene, hypothesis):
            for joint, values in zip(several, band, strict=True):
                part = slice(filled[joint], filled[joint] + values.shape[1])
                every[joint][:, part] = problem.of_joint(number, joint, values)
                filled[joint] = part.stop
        result: list[Piece] = []
        for joint, (start, end) in enumerate(pairwise(np.cumsum([0, *counts]))):
            fold = self.split.fold[number][start:end]
            for one in np.unique(fold):
                rows = _without_gap(np.flatnonzero(fold == one))
                whole = slice(start + rows.start, start + rows.stop) if isinstance(rows, slice) else start + rows
                result.append(Piece(int(one), joint, number, whole, every[joint][rows]))
        return result

    def _in_band(self, scene: Scene, hypothesis: Hypothesis) -> Iterator[tuple[Sequence[int], list[np.ndarray]]]:
        """The candidates in their order: joints that some reach, and the torque (M, K) they add to each, in the band.
        Of an effect on its own joint all joints are filtered in one go; of others, which are n times as much, one."""
        band = self.problem.band
        for effect, keys in groupby(self.index, key=itemgetter(0)):
            places = [(joint, [point for *_, point in points]) for joint, points in groupby(keys, key=itemgetter(1))]
            if effect.own_joint:
                own = band(_of_own_joints(scene, hypothesis, effect, places))
                yield [joint for joint, _ in places], [own[:, joint] for joint, _ in places]
                continue
            for place in places:
                yield range(scene.joints), list(band(columns_of(scene, hypothesis, effect, *place)).swapaxes(0, 1))


def _without_gap(rows: np.ndarray) -> np.ndarray | slice:
    """Rising indices, as a slice where none is left out: that takes no copy."""
    start, stop = int(rows[0]), int(rows[-1]) + 1
    return slice(start, stop) if stop - start == len(rows) else rows


def _done(work: Iterable[None]) -> None:
    """Wait for all of it, and raise what it raised."""
    for _ in work:
        pass


def _by_fold(pieces: Sequence[Piece], folds: int) -> list[list[Piece]]:
    return [[piece for piece in pieces if piece.fold == fold] for fold in range(folds)]


def _of_own_joints(
    scene: Scene, hypothesis: Hypothesis, effect: Effect, places: Sequence[tuple[int, Sequence[tuple[float, ...]]]]
) -> np.ndarray:
    """(N, n, K) as reported, of an effect on each of `places`, a joint and the points of its grid: what it adds to the
    joint that it sits on."""
    result: np.ndarray | None = None
    for joint, grid in places:
        values = effect.columns(scene, joint, grid)
        if result is None:
            result = np.zeros((len(values), scene.joints, values.shape[-1]))
        result[:, joint] = values
    assert result is not None
    return reported(scene, hypothesis, result)


def columns_of(
    scene: Scene, hypothesis: Hypothesis, effect: Effect, joint: int, grid: Sequence[tuple[float, ...]]
) -> np.ndarray:
    """(N, n, K) as reported, of an effect that reaches other joints than its own."""
    return reported(scene, hypothesis, effect.columns(scene, joint, grid))


@dataclass(frozen=True)
class _Fold:
    """What candidates and, behind them, the residual are beyond the P tangents of a hypothesis, which the other folds
    project out of them. As products of those that are asked for: all of them at once would be the most memory of all.

    gram: (C, C) products of candidates on the fold; every: on all folds. moment: (C + 1,) with the residual, on the
    fold; rest: on the others. near: (C + 1, P) with the tangents, on the fold; far: on the others. map_: (C + 1, P)
    weights of the tangents in each, on the others. back: (C + 1, P) products with the tangents of what these leave.
    """

    gram: np.ndarray
    every: np.ndarray
    moment: np.ndarray
    rest: np.ndarray
    near: np.ndarray
    far: np.ndarray
    map_: np.ndarray
    back: np.ndarray

    @classmethod
    def of(cls, gram: np.ndarray, every: np.ndarray, sums: np.ndarray, others: np.ndarray, prior: Prior) -> _Fold:
        """sums: (P + 1, P + C + 1) of tangents and residual with tangents, candidates and residual; others: of the
        other folds. prior: (P, P) information on the free parameters."""
        own = len(sums) - 1
        map_ = solve(others[:own, :own] + prior, others[:own, own:])
        back = sums[:own, :own] @ map_ - sums[:own, own:]
        near, far = np.ascontiguousarray(sums[:own, own:].T), np.ascontiguousarray(others[:own, own:].T)
        return cls(gram, every, sums[-1, own:], others[-1, own:], near, far, map_.T.copy(), back.T.copy())

    def training(self, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(G, k, k) products on the other folds of each row of candidates (G, k) among themselves, and (G, k) with the
        residual."""
        far = self.far[chosen]
        gram = _among(self.every, chosen) - _among(self.gram, chosen) - far @ self.map_[chosen].swapaxes(1, 2)
        return gram, self.rest[chosen] - far @ self.map_[-1]

    def left_out(self, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same on the fold."""
        near, map_ = self.near[chosen], self.map_[chosen]
        gram = _among(self.gram, chosen) + map_ @ self.back[chosen].swapaxes(1, 2) - near @ map_.swapaxes(1, 2)
        return gram, self.moment[chosen] + map_ @ self.back[-1] - near @ self.map_[-1]

    @property
    def nothing(self) -> float:
        """Squares of the residual that the tangents leave of it on the fold."""
        return float(self.moment[-1] + self.map_[-1] @ self.back[-1] - self.near[-1] @ self.map_[-1])

    @property
    def told(self) -> np.ndarray:
        """(C,) squares of each candidate that the tangents leave of it on the other folds."""
        return np.diag(self.every) - np.diag(self.gram) - np.sum(self.far * self.map_, axis=1)[:-1]


class Dictionary:
    """Normal equations of the present hypothesis's tangents, every candidate's regressors, and the residual."""

    def __init__(self, regressors: Regressors, fitted: Fit, prior: Prior = 0.0):
        """prior: (P, P) information on the free parameters."""
        regressors.along(fitted.hypothesis)
        self.index, self.effects, self.low = regressors.index, regressors.effects, regressors.low
        near = [np.column_stack([m, r]) for m, r in zip(fitted.moving, fitted.residuals, strict=True)]
        own, folds = near[0].shape[1] - 1, regressors.split.folds
        sums = np.zeros((folds, own + 1, own + len(self.low) + 1))

        def one(mine: np.ndarray, pieces: list[Piece]) -> None:
            for piece in pieces:
                rows = near[piece.recording][piece.rows]
                mine[:, own + regressors.reach[piece.joint]] += rows.T @ piece.columns
                square = rows.T @ rows
                mine[:, :own] += square[:, :own]
                mine[:, -1] += square[:, -1]

        _done(THREADS.map(one, sums, _by_fold(regressors.pieces, folds)))
        every, total = np.asarray(sum(regressors.grams)), sums.sum(axis=0)
        self.folds = list(
            THREADS.map(lambda gram, mine: _Fold.of(gram, every, mine, total - mine, prior), regressors.grams, sums)
        )
        # to rounding sums of its own
        self.known = np.asarray(sum(fold.told for fold in self.folds)) <= 1e-9 * np.diag(every)
        self.nothing = sum(fold.nothing for fold in self.folds)

    def losses(self, several: Sequence[Sequence[Candidate]]) -> np.ndarray:
        """Squared residual on the folds left out, with some candidates added inside their limits; for many such."""
        result = np.full(len(several), self.nothing)
        for members, chosen in _alike([self._columns(*candidates) for candidates in several]):
            result[members] += sum(THREADS.map(self._gain, self.folds, repeat(chosen)))
        return result

    def _gain(self, fold: _Fold, chosen: np.ndarray) -> np.ndarray:
        """(G,) squares that rows of candidates (G, k) add on a fold, most of them less than nothing."""
        new = ~self.known[chosen]
        (gram, moment), (square, product) = fold.training(chosen), fold.left_out(chosen)
        gram *= new[:, :, None] & new[:, None, :]
        weight = within(gram, moment * new, self.low[chosen], np.inf)
        return np.sum(weight * ((square @ weight[..., None])[..., 0] - 2 * product), axis=1)

    def _left_out(self, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(G, k, k) products of rows of candidates (G, k) and (G, k) with the residual, on all folds together."""
        grams, moments = zip(*(fold.left_out(chosen) for fold in self.folds), strict=True)
        return np.asarray(sum(grams)), np.asarray(sum(moments))

    def ranking(
        self, taken: Iterable[Term], joints: int, allows: Callable[[Effect, int], bool]
    ) -> list[tuple[float, Candidate]]:
        """The best candidate of every effect, best first. An effect at work is not offered on its own joints again."""
        result = []
        for scored in self._options(taken, joints, allows).values():
            found = _prefer_single(scored, self.nothing)
            if len(found[1].joints) > 1 and self._dead(found[1]):  # the others make up for what one cannot be
                found = min((item for item in scored if len(item[1].joints) == 1), key=lambda item: item[0])
            result.append(found)
        return sorted(result, key=lambda item: item[0])

    def couples(
        self, taken: Iterable[Term], joints: int, allows: Callable[[Effect, int], bool]
    ) -> list[tuple[float, tuple[Candidate, Candidate]]]:
        """Two effects at once, those that promise most, best first."""
        every = [candidate for scored in self._options(taken, joints, allows).values() for _, candidate in scored]
        own = [self._columns(candidate) for candidate in every]
        pairs = [(a, b) for a, b in combinations(range(len(every)), 2) if every[a].effect is not every[b].effect]
        (total,), (moments,) = self._left_out(np.arange(len(self.low))[None])
        rough = np.empty(len(pairs))
        for members, chosen in _alike([own[a] + own[b] for a, b in pairs]):
            moment = moments[chosen]
            gain = np.sum(moment * solve(_among(total, chosen), moment), axis=1)
            rough[members] = 2.0 * chosen.shape[1] - gain
        best = [(every[a], every[b]) for a, b in (pairs[place] for place in np.argsort(rough, kind="stable")[:COUPLES])]
        return sorted(zip(self.losses(best).tolist(), best, strict=True), key=itemgetter(0))

    def _options(
        self, taken: Iterable[Term], joints: int, allows: Callable[[Effect, int], bool]
    ) -> dict[Effect, list[tuple[float, Candidate]]]:
        """Where each effect may sit, with the point of its grid that does best there."""
        busy = {(term.effect, place) for term in taken for place in term.places}
        grids: dict[Effect, dict[tuple[float, ...], None]] = {}  # in the order of the grid, which decides a tie
        for effect, _, nonlinear in self.index:
            grids.setdefault(effect, {})[nonlinear] = None
        places: list[list[Candidate]] = []
        for effect in self.effects:
            options: list[tuple[int, ...]] = [(joint,) for joint in range(joints)] if effect.per_joint else [()]
            options = [
                option
                for option in options
                if not any((effect, place) in busy or not allows(effect, place) for place in option or (0,))
            ]
            if effect.per_joint and len(options) == joints > 1:
                options.append(tuple(range(joints)))
            places += [[Candidate(effect, option, point) for point in grids[effect]] for option in options]
        losses = iter(self.losses([(candidate,) for grid in places for candidate in grid]).tolist())
        result: dict[Effect, list[tuple[float, Candidate]]] = {}
        for grid in places:
            scored = [(next(losses) + 2.0 * len(self._columns(candidate)), candidate) for candidate in grid]
            result.setdefault(grid[0].effect, []).append(min(scored, key=itemgetter(0)))
        return result

    def _dead(self, candidate: Candidate) -> bool:
        """Whether all data together leave nothing of an effect on one of its joints."""
        chosen = [self.index[candidate.effect, joint, candidate.nonlinear] for joint in candidate.joints]
        every = np.concatenate(chosen)
        low = self.low[every]
        weight = within(*self._left_out(every[None]), low, np.inf)[0]
        parts = np.split(np.isfinite(low) & (weight <= low), len(chosen))
        bounded = np.split(np.isfinite(low), len(chosen))
        return any(b.any() and part[b].all() for part, b in zip(parts, bounded, strict=True))

    def _columns(self, *candidates: Candidate) -> list[int]:
        sits = [(c.effect, joint, c.nonlinear) for c in candidates for joint in c.joints or (0,)]
        return list(chain.from_iterable(self.index[where] for where in sits))


def _alike(columns: Sequence[list[int]]) -> Iterator[tuple[list[int], np.ndarray]]:
    """Those of as many columns: their places, and their columns (G, k)."""
    for size in sorted(set(map(len, columns))):
        members = [place for place, mine in enumerate(columns) if len(mine) == size]
        yield members, np.array([columns[place] for place in members], int)


def _among(gram: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """(G, k, k) of a Gram matrix (C, C): each row of columns chosen (G, k) among themselves."""
    return gram[chosen[:, :, None], chosen[:, None, :]]


def _prefer_single(scored: list[tuple[float, Candidate]], nothing: float) -> tuple[float, Candidate]:
    best = min(scored, key=lambda item: item[0])
    single = [item for item in scored if len(item[1].joints) <= 1]
    if not single:
        return best
    best_single = min(single, key=lambda item: item[0])
    share = ROUGH_JOINT_SHARE if best[1].effect.rough else JOINT_SHARE
    return best_single if best_single[0] - best[0] < share * (nothing - best[0]) else best
