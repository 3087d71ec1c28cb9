"""Whether a name has earned it: what it explains has to shrink on data left out, and on logs kept out of everything.

A stand-in fits the runs that it was fitted to as well as the truth does. What it cannot do is carry over, with the same
figure in every run.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

import numpy as np

from schemas.diagnosis import Caution
from service.diagnosis.evidence import rivals, statistics
from service.diagnosis.evidence.accepted import Accepted, accepted
from service.diagnosis.evidence.cautions import FOLLOWS
from service.diagnosis.evidence.placement import Placement
from service.diagnosis.evidence.rivals import LIKELY
from service.diagnosis.evidence.unseen import without_events
from service.diagnosis.fit.candidates import Regressors
from service.diagnosis.fit.null import OWN
from service.diagnosis.fit.selection import LEAST_GAIN, Z95, Scored, Selection, added, without
from service.diagnosis.fit.sound import fault_of
from service.identification.correlated import WHITE, Correlated
from service.identification.events import events_of
from service.identification.fit import Problem, evaluate, solve
from service.identification.folds import Split, block_loss, normal_equations
from service.model.effects.base import Effect
from service.model.hypothesis import Hypothesis, Term
from service.model.parameters import Parameters

MOST_CHANGE = 0.25  # of an effect's figures from run to run; true ones of ten labelled cases stay within 0.07
LEAST_UNKNOWN = 0.1  # the same of all names together where the noise is not known and what is left is far above it
LEAST_PART = 0.1  # of what tells an effect's figures that a run has to hold to be asked for its own
# Of what an effect explains, that it still explains with the torque of a wrong description open: on arms, where joints
# may be elsewhere, true ones keep two thirds and more and what mimics a wrong URDF nothing; on axes, with all that
# depends on the angle, friction by the load keeps 0.6 and more and friction by the angle that mimics it 0.09 at most.
STANDS = 0.5
DRAWN = 12**-0.5  # of a range, the standard deviation of a number drawn from it


def earned(
    regressors: Regressors, selection: Selection, kept_out: Sequence[Problem], allows: Callable[[Effect, int], bool],
    limit: float, progress: Callable[[str], None], been: Collection[frozenset[str]] = (),
) -> tuple[Selection, list[Caution]]:  # fmt: skip
    """The selection with the names that stand and the noise beside them, and why each of the others fell.

    kept_out: of logs to test on. limit: rms that noise leaves at most. been: sets of names that have been in the place
    of each other: of two of which one is better and the other simpler, neither takes the place again.
    """
    problem, best, given = regressors.problem, selection.best, len(selection.none.hypothesis.terms)
    mechanism = problem.recordings[0].mechanism
    fallen: list[Caution] = []
    seen: rivals.Seen = lambda model: model  # noqa: E731
    counts: rivals.Counts = lambda model, instead: True  # noqa: E731
    found = None
    if mechanism.described_whole and problem.over_noise(best.residuals) > limit:
        found = accepted(regressors, selection, allows, progress)
        fallen += [
            _fell("not_its_own", effect, model, share=1.0 / max(over, 1.0)) for effect, model, over in found.rejected
        ]
        best, selection = found.best, found.continued(selection)
        seen, none, least = found.seen, selection.none, found.least
        counts = lambda model, instead: not 0.0 < least(none, model, instead) <= OWN  # noqa: E731
        allows = _but({effect for effect, _, over in found.rejected if over > 0.0}, allows)
    best, refits, fell = _borne_out(regressors, selection, best, kept_out, found)
    fallen += fell
    if refits and mechanism.tree is not None:
        best, refits, fell = _where_joints_are(regressors, selection, best, refits, kept_out)
        fallen += fell
    # where more than noise is left, it is not that by which a likelihood counts: blocks tell how it scatters
    explained = problem.over_noise(best.residuals) <= limit
    standings = rivals.standings(regressors, selection, best, refits, allows, explained, seen, counts)
    told = [effect for effect, one in standings.items() if one.probability < LIKELY]
    for effect, one in standings.items():
        better = one.better if effect in told else one.simpler
        if better is None or frozenset(better.names) in been:
            continue
        if fault_of(problem, better.hypothesis, given) is None and _may_replace(found, selection, one.without, better):
            changed = _in_its_place(selection, best, one.without, better)
            return earned(regressors, changed, kept_out, allows, limit, progress, [*been, frozenset(best.names)])
    if told:
        fallen += [_fell("rivalled", effect, best, share=standings[effect].probability) for effect in told]
        best = without(regressors.problem, regressors.split, selection.none, best, *told)
        best, refits, fell = _borne_out(regressors, selection, best, kept_out, found)
        fallen += fell
    kept = _cut(selection, best) if fallen else selection
    standings = {effect: replace(standings[effect], without=refit) for effect, refit in refits.items()}
    if found is None:
        return replace(kept, standings=standings), fallen
    opened = found.beside(best)
    noise = opened.noise if refits else WHITE
    return replace(kept, standings=standings, noise=noise), fallen + opened.cautions()


def _but(gone: Collection[Effect], allows: Callable[[Effect, int], bool]) -> Callable[[Effect, int], bool]:
    """The same without effects that explain by chance: they are no rivals either. What is not separable from the
    discrepancies may be at work, and remains one."""
    return lambda effect, joint: effect not in gone and allows(effect, joint)


def _may_replace(found: Accepted | None, selection: Selection, fewer: Scored, better: Scored) -> bool:
    """Whether what a model has beyond `fewer` is accepted."""
    names = [term.effect.name for term in added(better, fewer)]
    return found is None or found.least(selection.none, better, names) > OWN


def _in_its_place(selection: Selection, best: Scored, fewer: Scored, better: Scored) -> Selection:
    """The search with an effect in place of one that was taken as well when others were not known yet, and now is told
    to be worse. fewer: without either."""
    path = [(tried, taken) for tried, taken in selection.path if taken is not None]
    trimmed = selection.trimmed | ({id(path[-1][1]): fewer} if path else {})
    return replace(selection, best=better, path=[*path, ([better, best], better)], trimmed=trimmed)


def _borne_out(
    regressors: Regressors,
    selection: Selection,
    best: Scored,
    kept_out: Sequence[Problem],
    found: Accepted | None = None,
) -> tuple[Scored, dict[Effect, Scored], list[Caution]]:
    """`best` with the effects that the data bear out, the same without each of these, and why each of the others
    fell."""
    problem, split, given = regressors.problem, regressors.split, len(selection.none.hypothesis.terms)
    noise = found.opened.noise if found else WHITE
    fallen: list[Caution] = []
    while True:
        refits = {}
        for effect in _effects(best, given):
            refits[effect] = fewer = without(problem, split, selection.none, best, effect)
            caution = (
                _open(best, split, effect, noise)
                or (None if found else _varies(problem, best, effect))
                or _carries_over(problem, split, best, fewer, effect, kept_out, found)
            )
            if caution is not None:
                fallen.append(caution)
                best = fewer
                break
        else:
            return best, refits, fallen


def _where_joints_are(
    regressors: Regressors, selection: Selection, best: Scored, refits: dict[Effect, Scored],
    kept_out: Sequence[Problem],
) -> tuple[Scored, dict[Effect, Scored], list[Caution]]:  # fmt: skip
    """As `_borne_out`, of a serial arm, with the effects that still take something where its joints may be elsewhere
    than the URDF has them."""
    problem, split = regressors.problem, regressors.split
    placement = Placement(problem, split, best)
    with_all = placement.beside(best)
    gone = [
        effect
        for effect, fewer in refits.items()
        if placement.beside(fewer) - with_all < STANDS * (fewer.loss - best.loss)
    ]
    if not gone:
        return best, refits, []
    fallen = [_fell("rivalled", effect, best) for effect in gone]
    best = without(problem, split, selection.none, best, *gone)
    joint, loss = min(((j, placement.beside(best, j)) for j in range(len(problem.sigma))), key=lambda item: item[1])
    share = min((best.loss - loss) / max(best.loss - problem.count, 1e-9), 1.0)
    if share > FOLLOWS:
        caution = Caution(code="misplaced", joints=[joint + 1], share=round(share, 4), advice="check_description")
        fallen.append(caution)
    best, refits, fell = _borne_out(regressors, selection, best, kept_out)
    return best, refits, fallen + fell


def together(
    problem: Problem, split: Split, selection: Selection, chosen: Sequence[Scored], given: int, vague: bool
) -> tuple[Selection, list[Caution]]:
    """The selection, or none of its names where all of them leave the gap as it is on stretches that nothing was chosen
    by: each stretch would have another name. chosen: the model of each of these stretches. vague: the noise is not
    known, and more is left than it could be."""
    names = _effects(selection.best, given)
    none, *models = statistics.given([selection.none, *chosen], split, selection.noise)
    shrink = statistics.shrink(
        statistics.pooled_squares(problem, none.residuals, split),
        statistics.pooled_squares(problem, statistics.by_fold(models, split), split),
    )
    if not names or (shrink.low > 0 and shrink.value >= (LEAST_UNKNOWN if vague else 0.0)):
        return selection, []
    fallen = [_fell("no_shrink", effect, selection.best, share=shrink.value) for effect in names]
    return _cut(selection, selection.none), fallen


def _cut(selection: Selection, best: Scored) -> Selection:
    """The search as if it had stopped before the first effect that is not in `best`."""
    names, path = set(best.names), []
    for tried, taken in selection.path:
        if taken is None or not set(taken.names) <= names:
            path.append((tried, None))
            break
        path.append((tried, taken))
    return replace(selection, best=best, path=path, standings={}, noise=WHITE)


def _open(best: Scored, split: Split, effect: Effect, noise: Correlated) -> Caution | None:
    """Said of an effect none of whose quantities is told from nothing, or whose shape may be any. noise: its
    covariance."""
    parameters, errors = Parameters(best.hypothesis), statistics.standard_errors(best.fitted, split, noise)
    code, quantity = "left_open", None
    for term, mine in zip(best.hypothesis.terms, parameters.terms, strict=True):
        if term.effect is effect:
            values, error, count = parameters.values[mine], errors[mine], term.amplitude.size
            first = count or 1  # of one without amplitudes, its shape says how much there is of it
            told = np.abs(values[:first]) > Z95 * error[:first]
            shape = _any_shape(effect, error[count:])
            if told.any() and shape is None:
                return None
            if told.any():
                code, quantity = "any_shape", shape
    return _fell(code, effect, best, quantity=quantity)


def _any_shape(effect: Effect, errors: np.ndarray) -> str | None:
    """The quantity of its shape that the data tell no better than its range does. errors: standard ones."""
    for (name, searched), error in zip(effect.nonlinear.items(), errors.tolist(), strict=True):
        if not (searched.fixed or searched.minor) and error > DRAWN * (searched.high - searched.low):
            return name
    return None


def _varies(problem: Problem, best: Scored, effect: Effect) -> Caution | None:
    """Said of an effect whose figures one run alone would have otherwise, all other parameters left as they are."""
    runs = {recording.trace: recording.name for recording in problem.recordings}
    split = Split.of(problem)
    if len(runs) != split.folds:  # stretches of one or two runs
        return None
    names = [runs[trace] for trace in sorted(runs)]
    parameters = Parameters(best.hypothesis)
    mine = np.zeros(len(parameters.values), bool)
    for term, places in zip(best.hypothesis.terms, parameters.terms, strict=True):
        mine[places] = term.effect is effect
    values, columns = parameters.values[mine & parameters.free], mine[parameters.free]
    tangents = [tangent[:, columns] for tangent in best.fitted.tangents]
    grams, moments = normal_equations(tangents, best.fitted.residuals, split)
    steps = [solve(gram, moment) for gram, moment in zip(grams, moments, strict=True)]
    weights = np.array([values @ gram @ values for gram in grams])
    changes = np.sqrt(
        [step @ gram @ step for step, gram in zip(steps, grams, strict=True)] / np.maximum(weights, 1e-300)
    )
    told = weights >= LEAST_PART * weights.sum()
    if not (told & (changes > MOST_CHANGE)).any():
        return None
    worst = int(np.argmax(np.where(told, changes, 0.0)))
    return _fell("varies", effect, best, share=float(changes[worst]), run=names[worst])


def _carries_over(
    problem: Problem, split: Split, best: Scored, without: Scored, effect: Effect, kept_out: Sequence[Problem],
    found: Accepted | None,
) -> Caution | None:  # fmt: skip
    """Said of an effect that does not shrink the gap on data left out, or not on a log where it would have to. found:
    what discrepancies are open."""
    before, after = (one.residuals if found is None else found.seen(one).residuals for one in (without, best))
    even = replace(problem, sigma=problem.sigma / problem.level(after))
    shrink = statistics.shrink(
        statistics.pooled_squares(even, before, split), statistics.pooled_squares(even, after, split)
    )
    if shrink.low <= 0 or (1.0 - shrink.value) ** 2 > 1.0 - LEAST_GAIN:
        return _fell("no_shrink", effect, best, share=shrink.value)
    for other in kept_out:
        shrunk = shrink_on(other, without.hypothesis, best.hypothesis)
        if shrunk is not None and shrunk.low <= 0:
            return _fell("no_shrink_on", effect, best, share=shrunk.value, run=other.recordings[0].name)
    return None


def shrink_on(other: Problem, without: Hypothesis, best: Hypothesis) -> statistics.Shrink | None:
    """How the gap of another log shrinks, outside events, by what `best` adds; None where that moves nothing there."""
    calm = without_events(other, events_of(other, evaluate(other, best).residuals))
    other = calm if calm.count > 0.3 * other.count else other
    split = Split.of(other)
    before, after = (evaluate(other, hypothesis).residuals for hypothesis in (without, best))
    moved = sum(float(((b - a) ** 2).sum()) for b, a in zip(before, after, strict=True))
    if moved < LEAST_GAIN * other.count:
        return None
    return statistics.shrink(block_loss(before, split), block_loss(after, split))


def _fell(
    code: str, effect: Effect, best: Scored, share: float | None = None, run: str | None = None,
    quantity: str | None = None,
) -> Caution:  # fmt: skip
    joints = sorted({joint + 1 for term in _terms(best, effect) for joint in term.joints})
    rounded = None if share is None else round(share, 4)
    return Caution.model_validate(
        {
            "code": code,
            "effect": effect.name,
            "joints": joints,
            "share": rounded,
            "run": run,
            "quantity": quantity,
            "advice": "record_more",
        }
    )


def _effects(best: Scored, given: int) -> list[Effect]:
    """Beyond the `given` ones."""
    return list(dict.fromkeys(term.effect for term in best.hypothesis.terms[given:]))


def _terms(best: Scored, effect: Effect) -> list[Term]:
    return [term for term in best.hypothesis.terms if term.effect is effect]
