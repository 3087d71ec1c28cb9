"""Which effects: forward selection on held-out prediction, every parameter refitted each time, with a backward check.

The best few of the candidates are fitted exactly, nonlinear parameters included, before one is believed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from service.diagnosis.fit.candidates import JOINT_SHARE, Candidate, Dictionary, Regressors
from service.diagnosis.fit.sound import Fault, fault_of
from service.identification.correlated import WHITE, Correlated
from service.identification.fit import Fit, Problem, fit
from service.identification.folds import Split, block_loss, held_out
from service.model.effects.base import Effect
from service.model.hypothesis import Hypothesis, Term

SHORTLIST = 5  # candidates fitted exactly a step
MOST_EFFECTS = 4
# What an effect has to be worth on data left out, as a fall of the mean square in units of the noise:
LEAST_GAIN = 0.03  # 1.5 % of the noise floor's rms
LEAST_SHARE_OF_GAP = 0.01  # of the gap above the noise; or, as beside a strong effect a weak one is less,
LEAST_SHARE_OF_REST = 0.25  # of what was still above the noise when it was added, and more than passes for noise
# What is left counts as noise up to this ratio to the floor: the floor itself is known to about one percent, and the
# smoothing of the motion costs another two. Where it is read from the noise's colour above the band: `WITHIN_COLOURED`.
WITHIN_NOISE = 1.06
LEAST_Z = 3.0  # standard errors over blocks
SIMPLER_SHARE = 0.02  # of a gain that a hypothesis with fewer parameters, or on fewer joints, may lack
Z95 = 1.96  # standard errors to either side that hold 95 %: two hypotheses are told apart, a value is not zero
ROUGH_PROMISE = 0.7  # of the cost: a rough effect that does not get below it is not refined
ROUGH_STEPS = (0.88, 1.13, 0.94, 1.06, 0.97, 1.03)  # factors tried on its nonlinear parameters, where slopes mislead
FAR_ABOVE = 2.0  # times the noise, from which what is left is a cause of its own


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
    that it is at work. confusable: what may be in its place. ahead: standard errors over blocks that it is ahead of the
    next of what may be. better: the best model with another effect in its place, of those that are told to be better.
    simpler: one with one figure for the whole robot in place of one on each joint that may be the same on all.
    """

    without: Scored
    probability: float
    confusable: list[str]
    ahead: float
    better: Scored | None = None
    simpler: Scored | None = None


@dataclass(frozen=True)
class Selection:
    """How the search went. none: the base model. best: with the effects found.

    path: a round each, the hypotheses fitted and the one taken (None where none was worth it).
    trimmed: a hypothesis taken -> what was left of it after the backward check. fault: of the hypothesis that would
    have been taken next and cannot be. standings: of each effect of `best` that has earned its name. noise: its
    covariance beside `best`, discrepancies included.
    """

    none: Scored
    best: Scored
    path: list[tuple[list[Scored], Scored | None]]
    trimmed: dict[int, Scored]
    fault: Fault | None = None
    standings: Mapping[Effect, Standing] = field(default_factory=dict)
    noise: Correlated = WHITE

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


def added(scored: Scored, before: Scored) -> list[Term]:
    """Effects that a model has beyond `before`: a round adds one, or two at once. They need not stand last, as what
    another effect took the place of was found in another order."""
    known, result = [term.effect for term in before.hypothesis.terms], []
    for term in scored.hypothesis.terms:
        if term.effect in known:
            known.remove(term.effect)
        else:
            result.append(term)
    return result


def search(
    regressors: Regressors,
    progress: Callable[[str], None],
    allows: Callable[[Effect, int], bool] = lambda effect, joint: True,
    grow: Callable[[Problem, Split, Scored], Scored] = lambda problem, split, best: best,
    begun: Selection | None = None,
) -> Selection:
    """Add effects one by one while each is worth it on data left out; then see whether one can go again.

    allows: whether the data let an effect be looked for on a joint at all. grow: what else an effect just found brings.
    begun: a search that ended at what cannot be, to go on with what can be.
    """
    problem, split, start = regressors.problem, regressors.split, regressors.start
    given = len(start.terms)
    rows = problem.count
    none = best = score(fit(problem, start), split) if begun is None else begun.none
    path: list[tuple[list[Scored], Scored | None]] = []
    trimmed: dict[int, Scored] = {}
    if begun is not None:
        best, trimmed = begun.best, dict(begun.trimmed)
        path = [(tried, taken) for tried, taken in begun.path if taken is not None]
    fault: Fault | None = None
    for _ in range(MOST_EFFECTS - len(path) if regressors.effects else 0):
        exact, fault = additions(regressors, best, none, given, allows, progress)
        if not exact:
            break
        if begun is not None and fault_of(problem, exact[0].hypothesis, given) is None:
            fault = None
        rough = any(not term.effect.amplitudes for term in best.hypothesis.terms)
        found = worth(exact[0].blocks, best.blocks, none.blocks, rows, problem.most, rough)
        if fault is not None or not found or not _a_large_share(problem, exact[0], best):
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
    progress("comparing the effects of the catalogue")
    exact: list[Scored] = []
    for candidate in _promising(regressors, best, allows):
        progress(f"fitting {candidate.effect.name.replace('_', ' ')}")
        added = score(fit_added(problem, best.fitted, candidate.term()), regressors.split)
        exact.append(added)
    if not exact:
        return [], None

    def order(tried: list[Scored]) -> list[Scored]:
        ordered = simplest_first(tried, best)
        if mechanism.closed:
            ordered = one_cause_first(ordered, best, problem.count)
        return ordered

    return _sound_first(problem, exact, best, none, given, order)


def _promising(regressors: Regressors, best: Scored, allows: Callable[[Effect, int], bool]) -> list[Candidate]:
    """Candidates to be fitted exactly, best first. The products that rank them are large, and given up behind it."""
    problem, dictionary = regressors.problem, Dictionary(regressors, best.fitted)
    ranked = dictionary.ranking(best.hypothesis.terms, problem.recordings[0].mechanism.joints, allows)
    least = LEAST_GAIN * problem.count
    return [candidate for loss, candidate in ranked[:SHORTLIST] if dictionary.nothing - loss > least]


def _sound_first(
    problem: Problem, tried: list[Scored], without: Scored, none: Scored, given: int,
    order: Callable[[list[Scored]], list[Scored]],
) -> tuple[list[Scored], Fault | None]:  # fmt: skip
    """In the order in which they are believed, and what cannot be is out. Where it leads and nothing that can be is as
    good, that is its fault: what comes next would stand in for something that is not in the catalogue."""
    ordered = order(tried)
    faults = [fault_of(problem, scored.hypothesis, given) for scored in ordered]
    sound = [scored for scored, fault in zip(ordered, faults, strict=True) if fault is None]
    lead = ordered[0]
    if faults[0] is None:
        return sound, None
    gain = without.loss - lead.loss
    near = [s for s in sound if s.loss - lead.loss < JOINT_SHARE * gain or z_score(s.blocks, lead.blocks) < Z95]
    if near:
        return [near[0], *(scored for scored in sound if scored is not near[0])], None
    found = worth(lead.blocks, without.blocks, none.blocks, problem.count, problem.most)
    return order(sound) if sound else ordered, faults[0] if found else None


def size(scored: Scored) -> int:
    """How many parameters it has."""
    return len(scored.fitted.free)


def simplest_first(tried: list[Scored], without: Scored) -> list[Scored]:
    """Best first; but of those that the data do not tell from the best, the one with the fewest parameters leads.

    A scale on every joint is a mass on the platform with two parameters more, a spring a constant torque with one.
    """
    ordered = sorted(tried, key=lambda scored: scored.loss + 2 * size(scored))
    best = ordered[0]
    most = SIMPLER_SHARE * (without.loss - best.loss)
    equals = [s for s in ordered if s.loss - best.loss < most and z_score(s.blocks, best.blocks) < Z95]
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


def fit_added(problem: Problem, without: Fit, term: Term, noise: Correlated = WHITE) -> Fit:
    """Fit with one more effect, from the best of the starts it asks for.

    without: the fit that it is added to. noise: its covariance.
    """
    hypothesis = without.hypothesis

    def cost(fitted: Fit) -> float:
        return noise.square(fitted.residuals)

    points = [replace(term, nonlinear=start) for start in term.effect.starts(term.nonlinear)]
    starts = [hypothesis.carrying((*hypothesis.terms, point)) for point in points]
    if not term.effect.rough:
        return fit(problem, starts[0], noise=noise)
    best = min((fit(problem, start, iterations=1, noise=noise) for start in starts), key=cost)
    if cost(best) > ROUGH_PROMISE * cost(without):
        return best
    best = fit(problem, best.hypothesis, noise=noise)
    for index, searched in enumerate(term.searched.values()):
        for factor in ROUGH_STEPS if searched else ():
            last = best.hypothesis.terms[-1]
            moved = tuple(v * factor if i == index else v for i, v in enumerate(last.nonlinear))
            terms = (*best.hypothesis.terms[:-1], replace(last, nonlinear=moved))
            trial = fit(problem, replace(best.hypothesis, terms=terms), iterations=2, noise=noise)
            best = trial if cost(trial) < cost(best) else best
    return best


def worth(
    candidate: np.ndarray, without: np.ndarray, none: np.ndarray, rows: int, most: float = 1.0, rough: bool = False
) -> bool:
    """Whether the data left out support an addition: enough, of enough of the gap, and not by chance.

    candidate, without, none: (blocks,) held-out losses with the addition, without it, and of the base model. most: rms
    that noise may have: what is below it is no part of the gap. rough: an effect is at work whose own model leaves
    more.
    """
    gain = float(without.sum() - candidate.sum()) / rows
    gap, rest = float(none.sum()) / rows - most**2, float(without.sum()) / rows - most**2
    share = LEAST_SHARE_OF_GAP * gap
    if not rough:
        share = min(share, max(LEAST_SHARE_OF_REST * rest, WITHIN_NOISE**2 - 1.0))
    least = max(LEAST_GAIN, share, LEAST_SHARE_OF_REST * min(rest, FAR_ABOVE**2 - 1.0))
    return gain > least and z_score(without, candidate) > LEAST_Z


def _a_large_share(problem: Problem, candidate: Scored, without: Scored) -> bool:
    """Whether an addition takes a large share of what is left: what takes little is asked given discrepancies."""
    rest = without.loss - problem.most**2 * problem.count
    return without.loss - candidate.loss > LEAST_SHARE_OF_REST * rest


def without(problem: Problem, split: Split, none: Scored, best: Scored, *effects: Effect) -> Scored:
    """`best` refitted without some effects. none: without all that were found."""
    terms = tuple(term for term in best.hypothesis.terms if term.effect not in effects)
    if len(terms) == len(none.hypothesis.terms):
        return none
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
    large = best.loss - trial.loss > LEAST_SHARE_OF_GAP * (best.loss - problem.count)
    return trial if large and z_score(best.blocks, trial.blocks) > LEAST_Z else best


def pruned(problem: Problem, split: Split, best: Scored, none: Scored, rows: int, given: int) -> Scored:
    """Drop whole effects, then single joints of effects, that the others make superfluous."""
    for effect in dict.fromkeys(term.effect for term in best.hypothesis.terms[given:-1]):
        trial = without(problem, split, none, best, effect)
        if not worth(best.blocks, trial.blocks, none.blocks, rows, problem.most):
            best = trial
    for term in best.hypothesis.terms[given:]:
        if len(term.joints) < 2:
            continue
        gain = without(problem, split, none, best, term.effect).loss - best.loss
        for joint in term.joints:
            current = next((t for t in best.hypothesis.terms if t.effect is term.effect), None)
            if current is None or len(current.joints) < 2:
                continue
            keep = [place for place, other in enumerate(current.joints) if other != joint]
            smaller = replace(current, joints=tuple(current.joints[i] for i in keep), amplitude=current.amplitude[keep])
            swapped = tuple(smaller if t is current else t for t in best.hypothesis.terms)
            trial = score(fit(problem, replace(best.hypothesis, terms=swapped), iterations=2), split)
            if trial.loss - best.loss < SIMPLER_SHARE * gain or z_score(trial.blocks, best.blocks) < LEAST_Z:
                best = trial
    return best
