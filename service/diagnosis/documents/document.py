"""Findings into the documents: diagnosis.json and corrected.toml."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np

from schemas.axes_description import Description
from schemas.diagnosis import (
    Diagnosis,
    Estimate,
    FrequencyResponse,
    Gap,
    Located,
    Moved,
    NamedEffect,
    Online,
    OnlineTrial,
    Provenance,
    Ranked,
    Rival,
)
from schemas.fitted import JointParameter
from schemas.questions import Question
from schemas.trace import Trace
from service.diagnosis.evidence import statistics
from service.diagnosis.evidence.located import located
from service.diagnosis.evidence.rivals import ModelComparison, comparisons, undecided
from service.diagnosis.evidence.unseen import unseen
from service.diagnosis.evidence.where import where
from service.diagnosis.findings import Findings
from service.diagnosis.fit.selection import Z95, added
from service.estimator.named_effects import form_of
from service.identification.folds import block_loss
from service.identification.frequency import responses, spectra_of
from service.model.description import base_errors, described, digits, entry, in_units_of
from service.model.effects.base import Effect
from service.model.parameters import Parameters, base_parameters, shown_parameters
from service.model.torque import predict


def corrected(findings: Findings) -> Description:
    """The description with base model and effects refitted together, and a robot's with what the logs tell its mass's
    estimate."""
    known = described(findings.robot, findings.best.hypothesis, findings.errors, findings.noise)
    return _with_what_logs_tell(findings, known, findings.after, findings.ahead)


def identified(findings: Findings) -> Description:
    """The description without the correction: the baseline, or what `identify` makes of the logs."""
    if findings.baseline is not None:
        return findings.baseline
    errors = statistics.standard_errors(findings.plain.fitted, findings.split)
    known = described(findings.robot, findings.plain.hypothesis, errors, findings.noise)
    return _with_what_logs_tell(findings, known, findings.before, None)


def _with_what_logs_tell(
    findings: Findings, known: Description, residuals: Sequence[np.ndarray], ahead: float | None
) -> Description:
    """A description with what `residuals` on data left out are above the noise, and whether a command may stand for the
    reported torque, or so many s `ahead` of it for the one that acts, as far as it can say so."""
    left = statistics.rms_per_joint(findings.problem, residuals)
    error = np.sqrt(np.maximum(left**2 - findings.problem.sigma**2, 0.0))
    model_error = JointParameter(value=[digits(e) for e in error])
    return known.with_left(model_error, findings.commanded, None if ahead is None else digits(ahead))


def made_from(paths: Iterable[Path]) -> Provenance:
    """Now, from the files among `paths` and in the folders among them."""
    files = [file for path in paths for file in (sorted(path.rglob("*")) if path.is_dir() else [path])]
    inputs = {}
    for path in files:
        if path.is_file():
            with path.open("rb") as stream:
                inputs[path.name] = hashlib.file_digest(stream, "sha256").hexdigest()
    return Provenance(at=datetime.now(UTC).isoformat(timespec="seconds"), version=version("deltatwin"), inputs=inputs)


def frequency_response(findings: Findings) -> list[FrequencyResponse]:
    """Measured, and of the models before and after, along the motion of all logs."""
    measured, models = [], {"before": [], "after": []}
    hypotheses = {"before": findings.reference, "after": findings.best.hypothesis}
    for recording in findings.problem.recordings:
        segment = recording.segment
        measured.append(spectra_of(segment.torque, segment.theta_dot, segment.period))
        for name, hypothesis in hypotheses.items():
            torque = predict(hypothesis.seen(recording), hypothesis)
            models[name].append(spectra_of(torque, segment.theta_dot, segment.period))
    return responses(measured, models, in_units_of(findings.robot, "rad/(N m s)"))


def document(
    findings: Findings,
    tests: Sequence[Trace] = (),
    made: Provenance | None = None,
    online: OnlineTrial | None = None,
    response: Sequence[FrequencyResponse] = (),
) -> Diagnosis:
    """`diagnosis.json`. tests: logs to try the correction on, kept out of everything else. online: how it did for the
    estimator, where that was tried. response: as `frequency_response` has it, where that was asked for."""
    problem, split = findings.problem, findings.split
    compared = comparisons(findings.selection, split, problem.count)
    before = statistics.rms_per_joint(problem, findings.before)
    after = statistics.rms_per_joint(problem, findings.after)
    before_blocks = statistics.pooled_squares(problem, findings.before, split)
    after_blocks = statistics.pooled_squares(problem, findings.after, split)
    runs, at_work = statistics.run_of_blocks(problem, split), statistics.runs_at_work(problem)
    works = np.isin(runs, at_work)
    shrink = statistics.shrink(before_blocks[works], after_blocks[works], runs=runs[works])
    slow = sorted({recording.name for recording in problem.recordings if recording.trace not in at_work})
    count = np.sum([rows.sum(axis=0) for rows in problem.rows], axis=0)
    floor_energy = float(np.sum(count * (problem.sigma**2 + findings.reversal**2)))
    explainable = float(before_blocks.sum()) - floor_energy
    removed = float(before_blocks.sum() - after_blocks.sum())
    base = shown_parameters(problem.recordings[0].mechanism)
    plain, best = (Parameters(scored.hypothesis).values for scored in (findings.plain, findings.best))
    return Diagnosis(
        schema="deltatwin.diagnosis/2",
        made=made,
        robot=findings.robot.name,
        traces=sorted({recording.name for recording in problem.recordings}),
        verdict=findings.verdict,
        effects=_effects(findings),
        cannot_tell=findings.cannot_tell,
        ranking=_ranking(findings, compared),
        probability_none=_none(compared),
        probability_unknown=_unknown(findings),
        plain={known.name: digits(plain[index]) for index, known in enumerate(base)},
        base={
            known.name: _estimate(best[index], findings.errors[index], in_units_of(findings.robot, known.unit))
            for index, known in enumerate(base)
        },
        where=where(findings),
        gap=Gap(
            unit=in_units_of(findings.robot, "N m"),
            before_nm=[digits(v) for v in before],
            after_nm=[digits(v) for v in after],
            noise_floor_nm=[digits(v) for v in problem.sigma],
            reversal_nm=[digits(v) for v in findings.reversal],
            torque_nm=[digits(v) for v in _torque(findings)],
            shrink=shrink.value,
            shrink_ci95=(shrink.low, shrink.high),
            slow_runs=slow,
            work_before_nm=_of_work(findings, findings.before, at_work) if slow else [],
            work_after_nm=_of_work(findings, findings.after, at_work) if slow else [],
            shrink_of_explainable=min(1.0, removed / explainable) if explainable > 0.05 * floor_energy else None,
            band_hz=problem.band.cutoff_hz,
        ),
        tests=[unseen(findings, trace) for trace in tests],
        given=[term.effect.name for term in findings.given],
        follows=findings.follows,
        located=_located(findings),
        moved=_moved(findings),
        rivals=_rivals(findings, compared),
        online=online,
        frequency_response=list(response),
    )


def _located(findings: Findings) -> list[Located]:
    """On what the residual depends, where the effects leave one."""
    if findings.verdict not in ("unexplained", "partly_explained"):
        return []
    return located(findings.robot, findings.problem, findings.split, findings.best.hypothesis)


def _of_work(findings: Findings, residuals: Sequence[np.ndarray], runs: np.ndarray) -> list[float]:
    """Rms a joint on the runs at work, N m."""
    return [digits(value) for value in statistics.rms_per_joint(findings.problem, residuals, runs)]


def _moved(findings: Findings) -> dict[str, Moved]:
    """The base parameters of the baseline beside those refitted, where a baseline was given."""
    if findings.baseline is None:
        return {}
    known = base_parameters(findings.problem.recordings[0].mechanism)
    before, after = (Parameters(h).values for h in (findings.reference, findings.best.hypothesis))
    errors = base_errors(findings.baseline)
    return {
        one.name: Moved(
            before=digits(before[index]),
            before_error=digits(errors[index]),
            after=digits(after[index]),
            after_error=digits(findings.errors[index]),
            unit=in_units_of(findings.robot, one.unit),
        )
        for index, one in enumerate(known)
    }


def _torque(findings: Findings) -> np.ndarray:
    """(n,) rms of the recorded torque on the samples that are compared."""
    problem = findings.problem
    square, count = np.zeros(len(problem.sigma)), np.zeros(len(problem.sigma))
    for recording, rows in zip(problem.recordings, problem.rows, strict=True):
        square += np.sum(np.where(rows, recording.segment.torque[:: problem.band.step] ** 2, 0.0), axis=0)
        count += rows.sum(axis=0)
    return np.sqrt(square / np.maximum(count, 1))


def _estimate(value: float, error: float, unit: str, meaning: str = "") -> Estimate:
    interval = (digits(value - Z95 * error), digits(value + Z95 * error))
    return Estimate(value=digits(value), unit=unit, ci95=interval, meaning=meaning)


def _meaning(effect: Effect, parameter: str, joint: str, at: str) -> str:
    """Of a parameter, named as in `parameters_of`, with the joint where there are several, and the value `at` of the
    first nonlinear parameter where the effect is at work more than once on it."""
    quantities = {**effect.amplitudes, **effect.nonlinear}
    if parameter not in quantities:
        parameter, _, joint = parameter.rpartition("_")
    which = (f", joint {joint}" if joint else "") + (f", {next(iter(effect.nonlinear))} {at}" if at else "")
    return quantities[parameter].meaning + which


def _effects(findings: Findings) -> list[NamedEffect]:
    hypothesis = findings.best.hypothesis
    every = Parameters(hypothesis)
    parameters: dict[Effect, dict[str, Estimate]] = {}
    joints: dict[Effect, list[int]] = {}
    for number, term in enumerate(hypothesis.terms):
        mine = every.terms[number]
        if number < len(findings.given):
            continue
        others = [other for other in hypothesis.terms if other.effect is term.effect]
        joint = f"{term.joints[0] + 1}" if len({other.joints for other in others}) > 1 and term.joints else ""
        at = f"{term.nonlinear[0]:.4g}" if sum(other.joints == term.joints for other in others) > 1 else ""
        suffix = "".join(f"_{told}" for told in (joint, at) if told)
        for known, value, error in zip(every.of_terms[number], every.values[mine], findings.errors[mine], strict=True):
            unit, meaning = in_units_of(findings.robot, known.unit), _meaning(term.effect, known.name, joint, at)
            estimate = _estimate(value, error, unit, meaning)
            parameters.setdefault(term.effect, {})[known.name + suffix] = estimate
        joints.setdefault(term.effect, [])
        joints[term.effect] += [joint + 1 for joint in term.joints if joint + 1 not in joints[term.effect]]
    gap = max(findings.selection.none.loss - findings.problem.count, 1e-9)
    result = []
    for effect, found in parameters.items():
        standing = findings.selection.standings[effect]
        lost = standing.without.loss - findings.best.loss
        result.append(
            NamedEffect(
                name=effect.name,
                title=effect.in_words,
                means=effect.means,
                joints=joints[effect],
                probability=round(standing.probability, 4),
                parameters=found,
                gap_share=round(float(np.clip(lost / gap, 0.0, 1.0)), 4),
                confusable_with=standing.confusable,
                settles=effect.settles,
                online=_online(effect),
            )
        )
    return sorted(result, key=lambda effect: -effect.gap_share)


def _online(effect: Effect) -> Online:
    reason = form_of(effect)
    return Online(carried=reason != "no_online_form", reason=reason)


def _ranking(findings: Findings, comparisons: list[ModelComparison]) -> list[Ranked]:
    """Every rival of the effects named, in the round in which it lost; the named ones in the round they won, as likely
    as they are in the end."""
    best: dict[str, Ranked] = {}
    count = findings.problem.count
    level = float(np.sqrt(np.mean(findings.problem.sigma**2)))
    named = {effect.name: standing.probability for effect, standing in findings.selection.standings.items()}
    for number, comparison in enumerate(comparisons):
        for scored, probability in comparison.candidates:
            *_, term = added(scored, comparison.before)
            if number and term.effect.name not in named:
                continue
            entry = Ranked(
                name=term.effect.name,
                joints=[joint + 1 for joint in term.joints],
                probability=round(probability, 4),
                after_nm=digits(level * (scored.loss / count) ** 0.5),
                shrink=round(1.0 - (scored.loss / comparison.before.loss) ** 0.5, 4),
            )
            known = best.get(entry.name)
            if known is None or entry.probability > known.probability:
                best[entry.name] = entry
    ranked = [
        entry.model_copy(update={"probability": round(named.get(entry.name, entry.probability), 4)})
        for entry in best.values()
    ]
    return sorted(ranked, key=lambda entry: (-entry.probability, entry.after_nm))


def _rivals(findings: Findings, comparisons: list[ModelComparison]) -> list[Rival]:
    """The candidates of the round that is decided least, as far as the gap shrinks by them."""
    comparison = undecided(findings.selection, comparisons)
    if comparison is None or findings.robot.answering(Question.RIVALS) is None:
        return []
    found = []
    for scored, probability in comparison.candidates:
        shrink = 1.0 - (scored.loss / comparison.before.loss) ** 0.5
        terms = scored.hypothesis.terms
        if shrink > 0:
            effects = [
                entry(term, np.zeros(term.amplitude.size + len(term.nonlinear)), findings.robot) for term in terms
            ]
            found.append(Rival(effects=effects, probability=round(probability, 4), shrink=round(shrink, 4)))
    return sorted(found, key=lambda rival: -rival.shrink)


def _none(comparisons: list[ModelComparison]) -> float:
    return round(comparisons[0].none, 4) if comparisons else 1.0


def _unknown(findings: Findings) -> float:
    """Share of bootstrap draws in which what is left is more than noise."""
    loss = block_loss(findings.after, findings.split)
    rows = block_loss([np.ones_like(r) for r in findings.after], findings.split)
    draw = np.random.default_rng(0).integers(0, len(loss), (1000, len(loss)))
    left = np.sqrt(loss[draw].sum(axis=1) / np.maximum(rows[draw].sum(axis=1), 1.0))
    return round(float(np.mean(left > findings.limit)), 4)
