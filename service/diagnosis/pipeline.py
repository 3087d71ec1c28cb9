"""The whole diagnosis: recordings in, findings out. Documents are made from the findings elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from schemas.axes_description import Description
from schemas.diagnosis import Caution, Follows, Verdict
from schemas.errors import DataError, RobotError
from schemas.trace import Trace
from service.diagnosis.evidence import axis_friction, statistics
from service.diagnosis.evidence.cautions import (
    SearchScope,
    base_doubts,
    degrees_doubted,
    doubts_of,
    faults_of,
    limits_of,
    noise_of,
)
from service.diagnosis.evidence.earned import earned, together
from service.diagnosis.evidence.follows import follows
from service.diagnosis.evidence.unseen import kept_out
from service.diagnosis.evidence.values import Valued
from service.diagnosis.findings import Findings
from service.diagnosis.fit.candidates import Regressors
from service.diagnosis.fit.completed import completed
from service.diagnosis.fit.exchange import exchanged
from service.diagnosis.fit.selection import WITHIN_NOISE, Scored, Selection, score, search
from service.identification import pooled
from service.identification.angle_unit import refuse_wrong_angles
from service.identification.checks import SUSPECT, refuse_misread
from service.identification.correlated import WHITE
from service.identification.fit import WITHIN_COLOURED, Problem, evaluate, fit
from service.identification.folds import Split
from service.identification.loops import loops_of, position_errors
from service.identification.noise import Floor
from service.identification.regression import products
from service.identification.torque_source import command_ahead, is_commanded
from service.model.description import gain_unit, hypothesis_of
from service.model.effects.base import Effect
from service.model.hypothesis import Term, read_out
from service.model.mechanism import mechanism_of
from service.model.scene import Recording
from service.model.signals import fresh, segments_of


def diagnose(
    robot: Description,
    traces: Sequence[Trace],
    effects: Sequence[Effect],
    progress: Callable[[str], None] = lambda _: None,
    baseline: Description | None = None,
    tests: Sequence[Trace] = (),
) -> Findings:
    """Find out which effects the traces of `robot` support.

    Effects that the description or the baseline carries already are part of the model and not found again. baseline:
    the description whose gap counts as "before"; default: the plain model refitted, as `identify` does. tests: logs
    kept out of everything, on which a name has to shrink the gap too.

    Raises:
        RobotError: the baseline is of another robot.
        TraceError: a trace without a usable part, naming the file. DataError: no joint moves, a torque that was
        not recorded or is read in another order or with another sign, or logs of several rates.
        PoseError: positions that are no pose of the robot.
    """
    progress("smoothing the motion")
    mechanism = mechanism_of(robot)
    parts = [(index, segment) for index, mine in enumerate(segments_of(traces)) for segment in mine]
    recordings = [
        Recording(segment, mechanism, index, traces[index].name)
        for (index, _), segment in zip(parts, fresh([segment for _, segment in parts]), strict=True)
    ]
    if not any(recording.segment.moving.any() for recording in recordings):
        raise DataError(f"{traces[0].path}: no joint moves")
    pooled.refuse_dead_torque(recordings)
    _refuse_misread(robot, traces, recordings)
    given = _given(robot, baseline)
    searched, risen = _in_its_noise(robot, traces, recordings, effects, given, progress)
    problem, floor, split, plain = searched.problem, searched.floor, searched.split, searched.plain
    scope, regressors, selection = searched.scope, searched.regressors, searched.selection
    progress("checking on held-out data")
    reversal = statistics.reversal_noise(problem, selection.best.hypothesis.base.coulomb)
    coloured = bool((floor.coloured | floor.unknown).any())
    # The floor as it was read, also where it is too near for a second search.
    limit = (
        (WITHIN_COLOURED if coloured else WITHIN_NOISE) * _floor(problem, reversal) * float(np.mean(risen**2)) ** 0.5
    )
    selection = _past_fault(regressors, selection, limit, scope.allows, progress)
    selection = exchanged(regressors, selection, limit, scope.allows, progress)
    angular = all(trace.angular for trace in traces)
    kept = [kept_out(problem, log) for log in tests]
    unknown = bool(floor.unknown.any())

    def followed(scored: Scored) -> list[Follows]:
        return follows(problem, split, scored.residuals, traces, angular)

    wrong: list[Caution] = []
    doubts: list[Caution] = []
    if scope.enough:
        none, best = selection.none, selection.best
        before = followed(none)
        wrong = degrees_doubted(problem, best)
        wrong += base_doubts(problem, before, before if best is none else followed(best), none, best)
        doubts = wrong or doubts_of(problem, selection, limit)
    judged = _judged(regressors, selection, doubts, len(given), kept, unknown, limit, scope.allows, progress)
    judged, values = _valued(problem, split, judged, len(given))
    cautions = judged.cautions
    selection = replace(judged.selection, best=statistics.combined(problem, values.best))
    after = statistics.by_fold(judged.chosen, split)
    gap, reference = plain.residuals, plain.hypothesis
    if baseline is not None:
        reference = hypothesis_of(baseline)
        gap = evaluate(problem, reference).residuals
    verdict = _verdict(problem, selection, given, after, limit)
    commanded = all(is_commanded(trace) for trace in traces)
    model = selection.best.hypothesis
    ahead = None if commanded else command_ahead(traces, read_out(model.terms, model.base.timing))
    return Findings(
        robot, problem, split, plain, reference, selection, given, gap, after, floor.sample,
        commanded, ahead, reversal, values.errors, verdict, limit,
        [*noise_of(floor), *scope.cautions, *cautions], followed(selection.best), baseline,
    )  # fmt: skip


@dataclass(frozen=True)
class _Searched:
    """What a search starts from, and what it finds."""

    problem: Problem
    floor: Floor
    split: Split
    plain: Scored
    scope: SearchScope
    regressors: Regressors
    selection: Selection


def _in_its_noise(
    robot: Description, traces: Sequence[Trace], recordings: Sequence[Recording], effects: Sequence[Effect],
    given: tuple[Term, ...], progress: Callable[[str], None],
) -> tuple[_Searched, np.ndarray]:  # fmt: skip
    """A search in units of a noise floor that its best model confirms, and (n,) how far that model has it higher."""
    first = _searched(robot, traces, pooled.problem_of(recordings), effects, given, progress)
    again = pooled.floor_in_band(first.problem, first.floor, first.selection.best.hypothesis)
    risen = again[1].band / first.floor.band
    if np.abs(np.log(risen)).max() <= np.log(WITHIN_NOISE):
        return first, risen
    del first  # a catalogue's regressors
    return _searched(robot, traces, again, effects, given, progress), np.ones_like(risen)


def _searched(
    robot: Description, traces: Sequence[Trace], noise: tuple[Problem, Floor], effects: Sequence[Effect],
    given: tuple[Term, ...], progress: Callable[[str], None],
) -> _Searched:  # fmt: skip
    """The base model and the search beside it, in units of this noise."""
    progress("fitting the base model")
    problem, floor = noise
    fitted = pooled.fit(problem, floor.sample, robot).fitted
    split = Split.fair(problem, fitted)
    plain = score(fitted, split)
    refuse_wrong_angles(problem, ", ".join(trace.path.name for trace in traces), plain.fitted)
    start = plain.hypothesis.carrying(given)
    if given:
        plain = score(fit(problem, start), split)
    errors = position_errors(problem.recordings, traces)
    units = [gain_unit(robot, joint) for joint in range(len(problem.sigma))]
    scope = limits_of(problem, loops_of(problem, errors, plain.residuals), units)
    regressors = Regressors(problem, split, effects if scope.enough else (), start)
    selection = search(regressors, progress, scope.allows, completed)
    return _Searched(problem, floor, split, plain, scope, regressors, selection)


def _past_fault(
    regressors: Regressors, selection: Selection, limit: float, allows: Callable[[Effect, int], bool],
    progress: Callable[[str], None],
) -> Selection:  # fmt: skip
    """A search that ended at what cannot be, gone on with what can be where that explains all: what cannot be may stand
    in for several effects at once. limit: rms that noise leaves at most."""
    if selection.fault is None:
        return selection
    again = search(regressors, progress, allows, completed, selection)
    return again if regressors.problem.over_noise(again.best.residuals) <= limit else selection


@dataclass(frozen=True)
class Judged:
    """What stands of a search, the hypothesis chosen without each fold, and why the rest does not."""

    selection: Selection
    chosen: list[Scored]
    cautions: list[Caution]


def _judged(
    regressors: Regressors, selection: Selection, doubts: list[Caution], given: int, tests: Sequence[Problem],
    unknown: bool, limit: float, allows: Callable[[Effect, int], bool],
    progress: Callable[[str], None],
) -> Judged:  # fmt: skip
    """Names have to earn it. doubts: reasons to believe none. unknown: the noise is not known."""
    problem, split, fallen = regressors.problem, regressors.split, faults_of(selection)
    if doubts and (stands := axis_friction.named_beside(regressors, selection, doubts, tests, allows, limit)):
        selection, doubts = stands
    elif doubts:
        selection = replace(selection, best=selection.none, path=_untaken(selection))
    else:
        selection, fell = earned(regressors, selection, tests, allows, limit, progress)
        fallen += fell
    chosen = statistics.walked(selection, split, problem.count, problem.most)
    vague = unknown and problem.over_noise(statistics.by_fold(chosen, split)) > limit
    selection, fell = together(problem, split, selection, chosen, given, vague)
    if fell:
        chosen = [selection.none] * split.folds
    return Judged(selection, chosen, [*doubts, *fallen, *fell])


def _valued(problem: Problem, split: Split, judged: Judged, given: int) -> tuple[Judged, Valued]:
    """What stands with the values that are reported, which without the discrepancies that they were fitted beside have
    to shrink the gap as well: a corrected description has none."""
    found = judged.selection
    values = Valued.of(problem, split, found)
    chosen = [values.best if one is found.best else one for one in judged.chosen]
    none, fell = together(problem, split, replace(found, noise=WHITE), chosen, given, vague=False)
    if not fell:
        return replace(judged, chosen=chosen), values
    cut = Judged(none, [none.none] * split.folds, [*judged.cautions, *fell])
    return cut, Valued.of(problem, split, none)


def _untaken(selection: Selection) -> list[tuple[list[Scored], Scored | None]]:
    """The first round of a search as if nothing had been taken: what came nearest."""
    return [(tried, None) for tried, _ in selection.path[:1]]


def _refuse_misread(robot: Description, traces: Sequence[Trace], recordings: Sequence[Recording]) -> None:
    """
    Raises:
        DataError: torques of joints that bear one platform, which make sense only if read otherwise.
    """
    of_log: dict[str, list[Recording]] = {}
    for recording in recordings:
        of_log.setdefault(traces[recording.trace].path.name, []).append(recording)
    if (delta := recordings[0].mechanism.platform) is not None:
        grams = {name: products(delta.model, parts) for name, parts in of_log.items()}
        # what leaves more, whatever the reading, has a wrong base model: gravity from another side, say
        refuse_misread(grams, robot.gear_ratios[0], SUSPECT)


def _given(robot: Description, baseline: Description | None) -> tuple[Term, ...]:
    """Effects that are known already."""
    known = hypothesis_of(robot).terms
    if baseline is None:
        return known
    for key in ("kind", "axis", "geometry", "mass"):
        if getattr(baseline, key, None) != getattr(robot, key, None):
            raise RobotError(f"baseline {baseline.name}: its {key} differs from that of robot {robot.name}")
    taken = {term.effect.name for term in known}
    return known + tuple(term for term in hypothesis_of(baseline).terms if term.effect.name not in taken)


def _verdict(
    problem: Problem, selection: Selection, given: tuple[Term, ...], after: list[np.ndarray], limit: float
) -> Verdict:
    left = problem.over_noise(after)
    if len(selection.best.hypothesis.terms) == len(given):
        return "within_noise" if left <= limit else "unexplained"
    return "explained" if left <= limit else "partly_explained"


def _floor(problem: Problem, reversal: np.ndarray) -> float:
    """Rms that noise and unplaceable reversals leave, in units of the noise."""
    weight = np.sum([rows.sum(axis=0) for rows in problem.rows], axis=0)
    return float(np.sqrt(1.0 + np.sum(weight * (reversal / problem.sigma) ** 2) / np.sum(weight)))
