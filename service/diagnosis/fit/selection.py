"""Which effects: forward selection on held-out prediction, every parameter refitted each time, with a backward check.

A dictionary of candidate regressors (every effect, joint and point of its grid) is turned into normal equations once a
step, one Gram matrix a fold; leaving a fold out, adding any candidate and predicting what was left out then costs a
small linear solve. The best few are fitted exactly, nonlinear parameters included, before one is believed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from itertools import chain, combinations, groupby, pairwise
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from service.diagnosis.fit.sound import Fault, fault_of
from service.identification.fit import THREADS, Fit, Problem, fit, solve, within
from service.identification.folds import Split, block_loss, held_out
from service.model.effects.base import Effect, on_joint
from service.model.hypothesis import Hypothesis, Term
from service.model.scene import Scene
from service.model.torque import reported

SHORTLIST = 5  # candidates fitted exactly a step
COUPLES = 40  # pairs of effects asked on data left out
MOST_EFFECTS = 4
# What an effect has to be worth on data left out, as a fall of the mean square in units of the noise:
LEAST_GAIN = 0.03  # 1.5 % of the noise floor's rms
LEAST_SHARE_OF_GAP = 0.01  # of the gap above the noise; or, as beside a strong effect a weak one is less,
MOST_OF_REST = 0.6  # of what was still above the noise when it was added, and
LEAST_BESIDE = 0.12  # more than what a strong effect's own model leaves, which passes for noise
LEAST_SHARE_OF_REST = 0.25  # of the same, in any case
LEAST_Z = 3.0  # standard errors over blocks
SIMPLER_SHARE = 0.02  # of a gain that a hypothesis with fewer parameters may lack
TOLD_APART = 2.0  # standard errors over blocks between two hypotheses
ROUGH_PROMISE = 0.7  # of the cost: a rough effect that does not get below it is not refined
ROUGH_STEPS = (0.88, 1.13, 0.94, 1.06, 0.97, 1.03)  # factors tried on its nonlinear parameters, where slopes mislead
SPREAD_GAIN = 40.0  # squared residual, in units of the noise, that nonlinear parameters of their own must be worth
ROUGH_JOINT_SHARE = 0.3  # the same where the grid only comes near
FAR_ABOVE = 2.0  # times the noise, from which what is left is a cause of its own
JOINT_SHARE = 0.05  # an effect on all joints must beat the one on a single joint by this share of its gain


@dataclass(frozen=True)
class Candidate:
    """One way an effect may be at work: where, and at which point of its grid."""

    effect: Effect
    joints: tuple[int, ...]
    nonlinear: tuple[float, ...]

    def term(self) -> Term:
        """At amplitude zero."""
        return Term.blank(self.effect, self.joints, self.nonlinear)


@dataclass(frozen=True)
class Scored:
    """A fitted hypothesis with its residuals on data left out. blocks: their squares summed, as they weigh."""

    fitted: Fit
    residuals: list[np.ndarray]
    blocks: np.ndarray

    @property
    def hypothesis(self) -> Hypothesis:
        """What was fitted."""
        return self.fitted.hypothesis

    @property
    def loss(self) -> float:
        """Squared residuals in all."""
        return float(sum(r @ r for r in self.residuals))

    @property
    def names(self) -> tuple[str, ...]:
        """Effects, in the order they were found."""
        return tuple(term.effect.name for term in self.hypothesis.terms)


def score(fitted: Fit, split: Split) -> Scored:
    """Held-out residuals of a fit."""
    residuals = held_out(fitted, split)
    return Scored(fitted, residuals, block_loss(residuals, split))


class Piece(NamedTuple):
    """What a recording has of a joint in a fold. rows: among its (R,). columns: (r, C_j) of the candidates that reach
    the joint, in units of the noise, as they weigh."""

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
        self.grams: list[np.ndarray] = []

    def along(self, hypothesis: Hypothesis) -> None:
        """Fill pieces, and grams, (C, C) a fold, as `hypothesis` sees them."""
        bent = [term.effect for term in hypothesis.terms if term.effect.measured and not term.effect.amplitudes]
        if bent == self.seen:
            return
        self.seen = bent
        scenes = self.problem.scenes(hypothesis)
        found = THREADS.map(lambda n, scene: self._pieces(n, scene, hypothesis), range(len(scenes)), scenes)
        self.pieces = list(chain.from_iterable(found))
        self.grams = self._grams()

    def weighing(self, problem: Problem) -> Regressors:
        """The same where rows that weighed alike weigh as in `problem`."""
        other = copy(self)
        other.problem = problem
        weights = [problem.pick(number, weights) for number, weights in enumerate(problem.weights)]
        other.pieces = [p._replace(columns=p.columns * weights[p.recording][p.rows, None]) for p in self.pieces]
        other.grams = other._grams()
        return other

    def _grams(self) -> list[np.ndarray]:
        grams = [np.zeros((len(self.low), len(self.low))) for _ in range(self.split.folds)]
        for piece in self.pieces:
            grams[piece.fold][np.ix_(self.reach[piece.joint], self.reach[piece.joint])] += (
                piece.columns.T @ piece.columns
            )
        return grams

    def _pieces(self, number: int, scene: Scene, hypothesis: Hypothesis) -> Iterator[Piece]:
        """Of a recording; an effect is filtered in one go."""
        problem, joints = self.problem, range(scene.joints)
        parts: list[list[np.ndarray]] = [[] for _ in joints]
        for effect, keys in groupby(self.index, key=itemgetter(0)):
            places = [
                (joint, _columns(scene, hypothesis, effect, joint, [point for *_, point in points]))
                for joint, points in groupby(keys, key=itemgetter(1))
            ]
            band = problem.band(np.concatenate([values for _, values in places], axis=-1))
            owner = np.concatenate([np.full(values.shape[-1], joint) for joint, values in places])
            for joint in joints:
                mine = band[:, owner == joint] if effect.own_joint else band[:, joint]
                parts[joint].append(problem.of_joint(number, joint, mine))
        ends = np.cumsum([0, *problem.rows[number].sum(axis=0)])
        for joint, (start, end) in enumerate(pairwise(ends)):
            columns, fold = np.concatenate(parts[joint], axis=1), self.split.fold[number][start:end]
            for one in np.unique(fold):
                mine = fold == one
                rows = slice(start, end) if mine.all() else start + np.flatnonzero(mine)
                yield Piece(int(one), joint, number, rows, columns if mine.all() else columns[mine])


def _columns(
    scene: Scene, hypothesis: Hypothesis, effect: Effect, joint: int, grid: Sequence[tuple[float, ...]]
) -> np.ndarray:
    """As reported: (N, K) on its own joint, (N, n, K) of an effect that reaches others."""
    values = effect.columns(scene, joint, grid)
    if not effect.own_joint:
        return reported(scene, hypothesis, values)
    if not any(term.effect.measured for term in hypothesis.terms):
        return values
    return reported(scene, hypothesis, on_joint(values, joint, scene.joints))[:, joint]


class Dictionary:
    """Normal equations of the present hypothesis's tangents, every candidate's regressors, and the residual."""

    def __init__(self, regressors: Regressors, fitted: Fit):
        regressors.along(fitted.hypothesis)
        self.index, self.effects, self.low = regressors.index, regressors.effects, regressors.low
        own, folds = fitted.moving, regressors.split.folds
        self.own = own[0].shape[1]
        near = [np.concatenate([m, r[:, None]], axis=1) for m, r in zip(own, fitted.residuals, strict=True)]
        nears = np.zeros((folds, self.own + 1, self.own + 1))
        crosses = np.zeros((folds, self.own + 1, len(self.low)))
        for fold, joint, recording, rows, columns in regressors.pieces:
            mine = near[recording][rows]
            nears[fold] += mine.T @ mine
            crosses[fold][:, regressors.reach[joint]] += mine.T @ columns
        whole = zip(nears, crosses, regressors.grams, strict=True)
        self._reduce(np.stack([_assembled(self.own, *parts) for parts in whole]))

    def _reduce(self, grams: np.ndarray) -> None:
        """Project the hypothesis's own tangents out of everything, a fold left out at a time."""
        own, train = self.own, grams.sum(axis=0) - grams
        map_ = solve(train[:, :own, :own], train[:, :own, own:])
        across = np.swapaxes(map_, 1, 2)
        self.training = train[:, own:, own:] - train[:, own:, :own] @ map_
        cross = grams[:, own:, :own] @ map_
        self.left_out = grams[:, own:, own:] - cross - np.swapaxes(cross, 1, 2) + across @ grams[:, :own, :own] @ map_
        known = np.diag(self.training.sum(axis=0))[:-1] <= 1e-9 * np.diag(grams.sum(axis=0))[own:-1]
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
        grids: dict[Effect, set[tuple[float, ...]]] = {}
        for effect, _, nonlinear in self.index:
            grids.setdefault(effect, set()).add(nonlinear)
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


def _assembled(own: int, near: np.ndarray, cross: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """One Gram matrix, in the order own tangents, candidates, residual. near: of the first and the last."""
    size = own + len(columns) + 1
    gram = np.empty((size, size))
    ends = np.r_[0:own, size - 1]
    gram[np.ix_(ends, ends)] = near
    gram[ends, own:-1] = cross
    gram[own:-1, ends] = cross.T
    gram[own:-1, own:-1] = columns
    return gram


def _prefer_single(scored: list[tuple[float, Candidate]], nothing: float) -> tuple[float, Candidate]:
    best = min(scored, key=lambda item: item[0])
    single = [item for item in scored if len(item[1].joints) <= 1]
    if not single:
        return best
    best_single = min(single, key=lambda item: item[0])
    share = ROUGH_JOINT_SHARE if best[1].effect.rough else JOINT_SHARE
    return best_single if best_single[0] - best[0] < share * (nothing - best[0]) else best


def z_score(worse: np.ndarray, better: np.ndarray) -> float:
    """How many standard errors over blocks `worse` is above `better`, in squares, their roots or their logarithms.

    Roots and logarithms are asked too: a few violent blocks make the spread of the squares large however sure the rest
    is.
    """
    scores = []
    floor = 1e-9 * float(np.mean(worse)) + 1e-300
    for difference in (
        worse - better,
        np.sqrt(worse) - np.sqrt(better),
        np.log(worse + floor) - np.log(better + floor),
    ):
        error = np.sqrt(len(difference)) * np.std(difference)
        scores.append(float(difference.sum() / error) if error > 0 else 0.0)
    return max(scores)


@dataclass(frozen=True)
class Standing:
    """How a name stands against models that lack its effect. without: the best model refitted without it. probability:
    that it is at work. confusable: what may be in its place. lead: squares, as they weigh, that the next of what may
    be leaves more."""

    without: Scored
    probability: float
    confusable: list[str]
    lead: float


@dataclass(frozen=True)
class Selection:
    """How the search went. none: the base model. best: with the effects found.

    path: a round each, the hypotheses fitted and the one taken (None where none was worth it).
    trimmed: a hypothesis taken -> what was left of it after the backward check. fault: of the hypothesis that would
    have been taken next and cannot be. standings: of each effect of `best` that has earned its name.
    """

    none: Scored
    best: Scored
    path: list[tuple[list[Scored], Scored | None]]
    trimmed: dict[int, Scored]
    fault: Fault | None = None
    standings: Mapping[Effect, Standing] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Effects that were found."""
        return self.best.names[len(self.none.names) :]

    def after(self, taken: Scored) -> Scored:
        """What a hypothesis taken became."""
        return self.trimmed.get(id(taken), taken)

    def rounds(self) -> Iterator[tuple[Scored, list[Scored], Scored | None]]:
        """The path with what each round began with."""
        before = self.none
        for tried, taken in self.path:
            yield before, tried, taken
            before = before if taken is None else self.after(taken)


def added(scored: Scored, before: Scored) -> tuple[str, ...]:
    """Effects that a round adds: one, or two at once."""
    return scored.names[len(before.names) :]


def search(
    regressors: Regressors,
    progress: Callable[[str], None],
    allows: Callable[[Effect, int], bool] = lambda effect, joint: True,
    grow: Callable[[Problem, Split, Scored], Scored] = lambda problem, split, best: best,
) -> Selection:
    """Add effects one by one while each is worth it on data left out; then see whether one can go again.

    allows: whether the data let an effect be looked for on a joint at all. grow: what else an effect just found brings.
    """
    problem, split, start = regressors.problem, regressors.split, regressors.start
    given = len(start.terms)
    rows = problem.count
    none = score(fit(problem, start), split)
    best = none
    path: list[tuple[list[Scored], Scored | None]] = []
    trimmed: dict[int, Scored] = {}
    fault: Fault | None = None
    for _ in range(MOST_EFFECTS if regressors.effects else 0):
        exact, fault = additions(regressors, best, none, given, allows, progress)
        if not exact:
            break
        rough = any(not term.effect.amplitudes for term in best.hypothesis.terms)
        if fault is not None or not worth(exact[0].blocks, best.blocks, none.blocks, rows, rough):
            path.append((exact, None))
            break
        path.append((exact, exact[0]))
        best = spread(problem, split, pruned(problem, split, exact[0], none, rows, given))
        best = trimmed[id(exact[0])] = grow(problem, split, best)
        if best.loss / rows < 1.0 + LEAST_GAIN:
            break
    return Selection(none, best, path, trimmed, fault)


def additions(
    regressors: Regressors, best: Scored, none: Scored, given: int, allows: Callable[[Effect, int], bool],
    progress: Callable[[str], None],
) -> tuple[list[Scored], Fault | None]:  # fmt: skip
    """What one more effect would make of `best`, those that promise most, in the order in which they are believed; and
    what is wrong with the first of them."""
    problem, mechanism = regressors.problem, regressors.problem.recordings[0].mechanism
    progress("weighing the catalogue")
    dictionary = Dictionary(regressors, best.fitted)
    exact: list[Scored] = []
    for loss, candidate in dictionary.ranking(best.hypothesis.terms, mechanism.joints, allows)[:SHORTLIST]:
        if dictionary.nothing - loss > 0.3 * LEAST_GAIN * problem.count:
            progress(f"fitting {candidate.effect.name.replace('_', ' ')}")
            exact.append(score(fit_added(problem, best.fitted, candidate.term()), regressors.split))
    if not exact:
        return [], None
    ordered = simplest_first(exact, best)
    if mechanism.kind == "delta":
        ordered = one_cause_first(ordered, best, 0 if problem.weights else problem.count)
    return _sound_first(problem, ordered, best, none, given)


def _sound_first(
    problem: Problem, ordered: list[Scored], without: Scored, none: Scored, given: int
) -> tuple[list[Scored], Fault | None]:
    """What cannot be is out. Where it leads and nothing that can be is as good, that is its fault: what comes next
    would stand in for something that is not in the catalogue."""
    faults = [fault_of(problem, scored.hypothesis, given) for scored in ordered]
    sound = [scored for scored, fault in zip(ordered, faults, strict=True) if fault is None]
    lead = ordered[0]
    if faults[0] is None:
        return sound, None
    gain = without.loss - lead.loss
    near = [s for s in sound if s.loss - lead.loss < JOINT_SHARE * gain or z_score(s.blocks, lead.blocks) < TOLD_APART]
    if near:
        return [near[0], *(scored for scored in sound if scored is not near[0])], None
    return sound or ordered, faults[0] if worth(lead.blocks, without.blocks, none.blocks, problem.count) else None


def simplest_first(tried: list[Scored], without: Scored) -> list[Scored]:
    """Best first; but of those that the data do not tell from the best, the one with the fewest parameters leads.

    A scale on every joint is a mass on the platform with two parameters more, a spring a constant torque with one.
    """

    def size(scored: Scored) -> int:
        return scored.fitted.tangents[0].shape[1]

    ordered = sorted(tried, key=lambda scored: scored.loss + 2 * size(scored))
    best = ordered[0]
    most = SIMPLER_SHARE * (without.loss - best.loss)
    equals = [s for s in ordered if s.loss - best.loss < most and z_score(s.blocks, best.blocks) < TOLD_APART]
    lead = min(equals, key=size, default=best)
    return [lead, *(scored for scored in ordered if scored is not lead)]


def one_cause_first(ordered: list[Scored], without: Scored, rows: int) -> list[Scored]:
    """The same order; but where what is left is a cause of its own, one force on the platform goes before springs,
    masses or lengths that each arm would have otherwise and that gain hardly more: they have the figures to stand in
    for both."""
    best = ordered[0]
    if not each_arm(best.hypothesis.terms[-1]) or best.loss < FAR_ABOVE**2 * rows:
        return ordered
    least = without.loss - (1.0 - JOINT_SHARE) * (without.loss - best.loss)
    return sorted(ordered, key=lambda scored: bool(scored.hypothesis.terms[-1].joints or scored.loss > least))


def each_arm(term: Term) -> bool:
    """Whether a term is a spring, mass or length that several arms would have, each another: a force on the platform is
    spread over the arms like that. Friction, cogging, play may be in every gear."""
    return len(term.joints) > 1 and not term.effect.dissipates and not term.effect.nonlinear


def fit_added(problem: Problem, without: Fit, term: Term) -> Fit:
    """Fit with one more effect, from the best of the starts it asks for. without: the fit that it is added to."""
    hypothesis = without.hypothesis
    points = [replace(term, nonlinear=start) for start in term.effect.starts(term.nonlinear)]
    starts = [hypothesis.carrying((*hypothesis.terms, point)) for point in points]
    if not term.effect.rough:
        return fit(problem, starts[0])
    best = min((fit(problem, start, iterations=1) for start in starts), key=lambda fitted: fitted.cost)
    if best.cost > ROUGH_PROMISE * without.cost:
        return best
    best = fit(problem, best.hypothesis)
    for index, searched in enumerate(term.effect.nonlinear.values()):
        for factor in ROUGH_STEPS if not searched.fixed else ():
            last = best.hypothesis.terms[-1]
            moved = tuple(v * factor if i == index else v for i, v in enumerate(last.nonlinear))
            terms = (*best.hypothesis.terms[:-1], replace(last, nonlinear=moved))
            trial = fit(problem, replace(best.hypothesis, terms=terms), iterations=2)
            best = trial if trial.cost < best.cost else best
    return best


def worth(candidate: np.ndarray, without: np.ndarray, none: np.ndarray, rows: int, rough: bool = False) -> bool:
    """Whether the data left out support an addition: enough, of enough of the gap, and not by chance.

    candidate, without, none: (blocks,) held-out losses with the addition, without it, and of the base model. rough: an
    effect is at work whose own model leaves more.
    """
    gain = float(without.sum() - candidate.sum()) / rows
    gap, rest = float(none.sum()) / rows - 1.0, float(without.sum()) / rows - 1.0
    share = LEAST_SHARE_OF_GAP * gap if rough else min(LEAST_SHARE_OF_GAP * gap, max(MOST_OF_REST * rest, LEAST_BESIDE))
    least = max(LEAST_GAIN, share, LEAST_SHARE_OF_REST * rest)
    return gain > least and z_score(without, candidate) > LEAST_Z


def without(problem: Problem, split: Split, selection: Selection, best: Scored, *effects: Effect) -> Scored:
    """The hypothesis refitted without some effects."""
    terms = tuple(term for term in best.hypothesis.terms if term.effect not in effects)
    if len(terms) == len(selection.none.hypothesis.terms):
        return selection.none
    return score(fit(problem, replace(best.hypothesis, terms=terms)), split)


def spread(problem: Problem, split: Split, best: Scored) -> Scored:
    """Give the joints of the effect found last their own nonlinear parameters, where the data left out gain by it."""
    term = best.hypothesis.terms[-1]
    if not term.effect.own_nonlinear or len(term.joints) < 2:
        return best
    apart = tuple(
        replace(term, joints=(joint,), amplitude=term.amplitude[[place]]) for place, joint in enumerate(term.joints)
    )
    trial = score(fit(problem, replace(best.hypothesis, terms=(*best.hypothesis.terms[:-1], *apart))), split)
    return trial if best.loss - trial.loss > max(SPREAD_GAIN, 0.01 * (best.loss - problem.count)) else best


def pruned(problem: Problem, split: Split, best: Scored, none: Scored, rows: int, given: int) -> Scored:
    """Drop whole effects, then single joints of effects, that the others make superfluous."""
    for effect in dict.fromkeys(term.effect for term in best.hypothesis.terms[given:-1]):
        fewer = tuple(t for t in best.hypothesis.terms if t.effect is not effect)
        trial = score(fit(problem, replace(best.hypothesis, terms=fewer)), split)
        if not worth(best.blocks, trial.blocks, none.blocks, rows):
            best = trial
    for term in best.hypothesis.terms[given:]:
        for joint in term.joints if len(term.joints) > 1 else ():
            current = next((t for t in best.hypothesis.terms if t.effect is term.effect), None)
            if current is None or len(current.joints) < 2:
                continue
            keep = [place for place, other in enumerate(current.joints) if other != joint]
            smaller = replace(current, joints=tuple(current.joints[i] for i in keep), amplitude=current.amplitude[keep])
            swapped = tuple(smaller if t is current else t for t in best.hypothesis.terms)
            trial = score(fit(problem, replace(best.hypothesis, terms=swapped), iterations=2), split)
            if trial.loss - best.loss < max(12.0, 0.02 * max(none.loss - best.loss, 0.0)):
                best = trial
    return best
