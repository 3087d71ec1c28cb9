"""Findings into the documents: diagnosis.json and corrected.toml."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from schemas.diagnosis import Diagnosis, Estimate, Gap, NamedEffect
from schemas.robot import Robot
from service.diagnosis import statistics
from service.diagnosis.description import described, digits, names, values
from service.diagnosis.diagnose import Findings
from service.diagnosis.hypothesis import Term

Z95 = 1.96


def corrected(findings: Findings) -> Robot:
    """The description with base model and effects refitted together."""
    return described(findings.robot, findings.best.hypothesis, findings.errors, findings.noise)


def document(findings: Findings) -> Diagnosis:
    """`diagnosis.json`."""
    problem, split = findings.problem, findings.split
    before = statistics.rms_per_joint(problem, findings.before)
    after = statistics.rms_per_joint(problem, findings.after)
    before_blocks = statistics.pooled_squares(problem, findings.before, split)
    after_blocks = statistics.pooled_squares(problem, findings.after, split)
    shrink = statistics.shrink(before_blocks, after_blocks)
    count = np.sum([rows.sum(axis=0) for rows in problem.rows], axis=0)
    floor_energy = float(np.sum(count * (problem.sigma**2 + findings.reversal**2)))
    explainable = float(before_blocks.sum()) - floor_energy
    removed = float(before_blocks.sum() - after_blocks.sum())
    base = findings.best.hypothesis.base
    names_ = base_names(findings)
    numbers = np.concatenate([base.rigid, base.viscous, base.coulomb])
    return Diagnosis(
        schema="deltatwin.diagnosis/1",
        robot=findings.robot.name,
        traces=sorted({recording.name for recording in problem.recordings}),
        verdict=findings.verdict,  # pyright: ignore[reportArgumentType]
        effects=_effects(findings),
        cannot_tell=[],
        ranking=[],
        probability_none=0.0,
        probability_unknown=0.0,
        base={
            name: _estimate(value, error, unit)
            for (name, unit), value, error in zip(names_, numbers, findings.errors, strict=False)
        },
        where={},
        gap=Gap(
            before_nm=[digits(v) for v in before],
            after_nm=[digits(v) for v in after],
            noise_floor_nm=[digits(v) for v in problem.sigma],
            reversal_nm=[digits(v) for v in findings.reversal],
            shrink=shrink.value,
            shrink_ci95=(shrink.low, shrink.high),
            shrink_of_explainable=min(1.0, removed / explainable) if explainable > 0.05 * floor_energy else None,
            band_hz=problem.band.cutoff_hz,
        ),
        notes=[],
    )


def base_names(findings: Findings) -> list[tuple[str, str]]:
    """(name, unit) of the base model's parameters."""
    mechanism = findings.problem.recordings[0].mechanism
    joints = range(1, mechanism.joints + 1)
    return [
        *mechanism.coefficients.items(),
        *((f"f_v_{joint}", "N m s/rad") for joint in joints),
        *((f"f_c_{joint}", "N m") for joint in joints),
    ]


def _estimate(value: float, error: float, unit: str) -> Estimate:
    return Estimate(value=digits(value), unit=unit, ci95=(digits(value - Z95 * error), digits(value + Z95 * error)))


def _effects(findings: Findings) -> list[NamedEffect]:
    hypothesis = findings.best.hypothesis
    at = len(hypothesis.base.rigid) + 2 * len(hypothesis.base.viscous)
    result = []
    gap = findings.selection.none.loss - findings.problem.count
    for term in hypothesis.terms:
        count = len(names(term))
        errors = findings.errors[at : at + count]
        at += count
        result.append((worth_of(findings, term) / max(gap, 1e-9), _named(term, errors)))
    result.sort(key=lambda item: -item[0])
    return [effect.model_copy(update={"gap_share": float(np.clip(share, 0, 1))}) for share, effect in result]


def worth_of(findings: Findings, term: Term) -> float:
    """Held-out loss that returns when the term alone is taken out, the others and the base refitted linearly."""
    fitted = findings.best.fitted
    from service.diagnosis.selection import Scored, block_loss, held_out
    from service.diagnosis.statistics import term_columns

    columns = term_columns(fitted.hypothesis, term)
    free = fitted.free.copy()
    free[columns] = False
    values_ = fitted.hypothesis.parameters()
    change = np.zeros(len(values_))
    change[columns] = -values_[columns]
    residuals = [r - t @ change for r, t in zip(fitted.residuals, fitted.tangents, strict=True)]
    without = replace(fitted, residuals=residuals, free=free)
    del Scored
    return float(block_loss(held_out(without, findings.split), findings.split).sum()) - findings.best.loss


def _named(term: Term, errors: np.ndarray) -> NamedEffect:
    return NamedEffect(
        name=term.effect.name,
        joints=[joint + 1 for joint in term.joints],
        probability=1.0,
        parameters={
            key: _estimate(value, error, unit)
            for (key, unit), value, error in zip(names(term), values(term), errors, strict=True)
        },
        gap_share=0.0,
        confusable_with=[],
        settles=term.effect.settles,
        online=term.effect.online,
    )
