"""What every effect, on every joint and at every point of its grid, would tell of data left out.

The candidates' regressors are turned into normal equations once a step, one Gram matrix a fold; leaving a fold out,
adding any candidate and predicting what was left out then costs a small linear solve.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, combinations, groupby, pairwise
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


class Dictionary:
    """Normal equations of the present hypothesis's tangents, every candidate's regressors, and the residual."""

    def __init__(self, regressors: Regressors, fitted: Fit, prior: np.ndarray | float = 0.0):
        """prior: (P, P) information on the free parameters."""
        regressors.along(fitted.hypothesis)
        self.index, self.effects, self.low = regressors.index, regressors.effects, regressors.low
        own = fitted.moving
        self.own = own[0].shape[1]
        near = [np.concatenate([m, r[:, None]], axis=1) for m, r in zip(own, fitted.residuals, strict=True)]

        size = self.own + len(self.low) + 1
        grams = np.empty((regressors.split.folds, size, size))

        def one(gram: np.ndarray, pieces: list[Piece], columns: np.ndarray) -> None:
            square, cross = np.zeros((self.own + 1, self.own + 1)), np.zeros((self.own + 1, len(self.low)))
            for piece in pieces:
                mine = near[piece.recording][piece.rows]
                square += mine.T @ mine
                cross[:, regressors.reach[piece.joint]] += mine.T @ piece.columns
            _assemble(gram, self.own, square, cross, columns)

        _done(THREADS.map(one, grams, _by_fold(regressors.pieces, regressors.split.folds), regressors.grams))
        self._reduce(grams, prior)

    def _reduce(self, grams: np.ndarray, prior: np.ndarray | float) -> None:
        """Project the hypothesis's own tangents out of everything, a fold left out at a time. What is left of `grams`
        takes their place: many large matrices at once would be the most memory of all."""
        own, every = self.own, grams.sum(axis=0)
        self.left_out = grams[:, own:, own:]
        self.training = np.empty(self.left_out.shape)

        def one(gram: np.ndarray, left_out: np.ndarray, training: np.ndarray) -> None:
            train = every - gram
            map_ = solve(train[:own, :own] + prior, train[:own, own:])
            cross = gram[own:, :own] @ map_
            left_out -= cross
            left_out -= cross.T
            left_out += map_.T @ gram[:own, :own] @ map_
            np.subtract(train[own:, own:], train[own:, :own] @ map_, out=training)

        _done(THREADS.map(one, grams, self.left_out, self.training))
        known = np.diag(self.training.sum(axis=0))[:-1] <= 1e-9 * np.diag(every)[own:-1]
        self.training[:, :-1][:, known] = self.training[:, :, :-1][:, :, known] = 0.0  # to rounding a sum of its own
        self.nothing = float(self.left_out[:, -1, -1].sum())

    def losses(self, several: Sequence[Sequence[Candidate]]) -> np.ndarray:
        """Squared residual on the folds left out, with some candidates added inside their limits; for many such."""
        result = np.empty(len(several))
        for members, chosen in _alike([self._columns(*candidates) for candidates in several]):
            weight = within(_among(self.training, chosen), self.training[:, chosen, -1], self.low[chosen], np.inf)
            product = (_among(self.left_out, chosen) @ weight[..., None])[..., 0]
            result[members] = self.nothing + np.sum(weight * (product - 2 * self.left_out[:, chosen, -1]), axis=(0, 2))
        return result

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
        total, rough = self.left_out.sum(axis=0), np.empty(len(pairs))
        for members, chosen in _alike([own[a] + own[b] for a, b in pairs]):
            moment = total[chosen, -1]
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
        total = np.sum(self.left_out, axis=0)
        chosen = [self.index[candidate.effect, joint, candidate.nonlinear] for joint in candidate.joints]
        every = np.concatenate(chosen)
        low = self.low[every]
        weight = within(total[np.ix_(every, every)], total[every, -1], low, np.inf)
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


def _among(grams: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """(..., G, k, k) of Gram matrices (..., C, C): each row of columns chosen (G, k) among themselves."""
    return grams[..., chosen[:, :, None], chosen[:, None, :]]


def _assemble(gram: np.ndarray, own: int, near: np.ndarray, cross: np.ndarray, columns: np.ndarray) -> None:
    """Fill one Gram matrix, in the order own tangents, candidates, residual. near: of the first and the last."""
    ends = np.r_[0:own, len(gram) - 1]
    gram[np.ix_(ends, ends)] = near
    gram[ends, own:-1] = cross
    gram[own:-1, ends] = cross.T
    gram[own:-1, own:-1] = columns


def _prefer_single(scored: list[tuple[float, Candidate]], nothing: float) -> tuple[float, Candidate]:
    best = min(scored, key=lambda item: item[0])
    single = [item for item in scored if len(item[1].joints) <= 1]
    if not single:
        return best
    best_single = min(single, key=lambda item: item[0])
    share = ROUGH_JOINT_SHARE if best[1].effect.rough else JOINT_SHARE
    return best_single if best_single[0] - best[0] < share * (nothing - best[0]) else best
