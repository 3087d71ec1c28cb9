"""Where the gap lies: a budget a joint that adds up, and the regimes that hold more than their share of it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from schemas.diagnosis import FrequencyShare, JointWhere, Regime, RunLevel, Where
from service.diagnosis.findings import Findings
from service.identification.events import bursts, events_of, rhythm
from service.identification.fit import Problem
from service.model.description import in_units_of
from service.model.hypothesis import Hypothesis
from service.model.signals import LEVER

REVERSAL_SPEED = 0.1  # rad/s: nearer than this to zero is a reversal
ANGLE_BINS = 10
FREQUENCIES = (0.0, 3.0, 10.0, 20.0, 40.0)  # Hz
MOST_BURSTS = 60  # told, strongest first


@dataclass(frozen=True)
class RowStates:
    """Every row's joint, residual and state. All (R,) over all recordings; platform (R, 3) m or None."""

    joint: np.ndarray
    theta: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    load: np.ndarray
    clock: np.ndarray
    platform: np.ndarray | None

    @classmethod
    def of(cls, problem: Problem, hypothesis: Hypothesis) -> RowStates:
        """The state at each row of the problem."""
        parts: list[list[np.ndarray]] = [[] for _ in range(5)]
        platforms: list[np.ndarray] = []
        for index, recording in enumerate(problem.recordings):
            segment, step = recording.segment, problem.band.step
            scene = hypothesis.seen(recording)
            clock = np.repeat((segment.time - segment.time[0])[:, None], scene.joints, axis=1)
            states = (segment.theta, segment.theta_dot, segment.theta_ddot, scene.load, clock)
            for part, state in zip(parts, states, strict=True):
                part.append(problem.pick(index, state[::step]))
            if recording.mechanism.platform is not None:
                place = np.repeat(recording.arms.position[::step, None, :], scene.joints, axis=1)
                platforms.append(problem.pick(index, place))
        theta, speed, acceleration, load, clock = (np.concatenate(part) for part in parts)
        platform = np.concatenate(platforms) if platforms else None
        return cls(np.concatenate(problem.joints_of_rows), theta, speed, acceleration, load, clock, platform)


def budget(findings: Findings, joint: int) -> dict[str, float]:
    """Energy of the gap of one joint, (N m)^2 mean square, by cause; adds up to that of the base model's gap.

    reversals: friction steps whose place between two samples is open. refit: what the base model gains over a
    baseline by being fitted to these logs.
    """
    problem = findings.problem
    mine = [joints == joint for joints in problem.joints_of_rows]
    count = sum(int(m.sum()) for m in mine)
    if not count:
        return {}
    scale = problem.sigma[joint] ** 2 / count

    def energy(residuals: list[np.ndarray]) -> float:
        return scale * float(sum(r[m] @ r[m] for r, m in zip(residuals, mine, strict=True)))

    before, after = energy(findings.before), energy(findings.after)
    noise = min(problem.sigma[joint] ** 2, after)
    reversals = min(float(findings.reversal[joint] ** 2), max(after - noise, 0.0))
    parts = {"noise": noise, "reversals": reversals, "unexplained": max(after - noise - reversals, 0.0)}
    explained = before - after
    left = energy(findings.best.residuals)
    weights = {
        effect.name: max(energy(one.without.residuals) - left, 0.0)
        for effect, one in findings.selection.standings.items()
    }
    weights["refit"] = max(before - energy(findings.selection.none.residuals), 0.0)
    total = sum(weights.values())
    for name, weight in weights.items():
        parts[name] = explained * weight / total if total > 0 else 0.0
    return parts


def regimes(findings: Findings, rows: RowStates, residuals: list[np.ndarray], joint: int) -> list[Regime]:
    """Share of one joint's gap above the noise in each regime, strongest concentration first."""
    residual = np.concatenate(residuals)
    mine = rows.joint == joint
    if not mine.any():
        return []
    square = residual[mine] ** 2 - 1.0
    total = float(square.sum())
    if total <= 0.02 * mine.sum():
        return []
    speed_unit, angle_unit, torque_unit = (in_units_of(findings.robot, unit) for unit in ("rad/s", "rad", "N m"))
    speed, acceleration, load = np.abs(rows.speed[mine]), np.abs(rows.acceleration[mine]), np.abs(rows.load[mine])
    theta = rows.theta[mine]
    reversal = REVERSAL_SPEED * (1.0 if findings.problem.recordings[0].segment.angular else LEVER)
    masks: list[tuple[str, np.ndarray]] = [
        (f"within {reversal:g} {speed_unit} of reversal", speed < reversal),
        ("forward motion", rows.speed[mine] > 0),
    ]
    for name, values, unit in (
        ("speed", speed, speed_unit),
        ("acceleration", acceleration, f"{speed_unit}²"),
        ("load", load, torque_unit),
    ):
        low, high = np.quantile(values, [1 / 3, 2 / 3])
        masks += [(f"{name} below {low:.2g} {unit}", values < low), (f"{name} above {high:.2g} {unit}", values > high)]
    edges = np.linspace(theta.min(), theta.max() + 1e-9, ANGLE_BINS + 1)
    masks += [
        (f"angle {low:.3g} to {high:.3g} {angle_unit}", (theta >= low) & (theta < high))
        for low, high in pairwise(edges)
    ]
    clock = rows.clock[mine]
    masks.append(("first half of the runs", clock < 0.5 * clock.max()))
    if rows.platform is not None:
        place = rows.platform[mine]
        for axis, letter in enumerate("xyz"):
            middle = float(np.median(place[:, axis]))
            masks.append((f"platform {letter} above {middle:.2f} m", place[:, axis] > middle))
    found = []
    for name, mask in masks:
        of_time = float(mask.mean())
        if 0.005 < of_time < 0.995:
            share = float(square[mask].sum()) / total
            share = round(float(np.clip(share, 0, 1)), 4)
            found.append(Regime(regime=name, share=share, of_time=round(of_time, 4)))
    return sorted(found, key=lambda item: -(item.share - item.of_time))


def spectrum(findings: Findings, residuals: list[np.ndarray], joint: int) -> list[FrequencyShare]:
    """Share of one joint's gap above the noise by frequency, in the analysis band."""
    problem = findings.problem
    rate = 1.0 / (problem.band.period * problem.band.step)
    energy, floor = np.zeros(len(FREQUENCIES) - 1), np.zeros(len(FREQUENCIES) - 1)
    for residual, joints in zip(residuals, problem.joints_of_rows, strict=True):
        values = residual[joints == joint]
        if len(values) < 32:
            continue
        power = np.abs(np.fft.rfft(values)) ** 2 / len(values)
        frequency = np.fft.rfftfreq(len(values), 1.0 / rate)
        for band, (low, high) in enumerate(pairwise(FREQUENCIES)):
            inside = (frequency >= low) & (frequency < high)
            energy[band] += power[inside].sum()
            floor[band] += inside.sum() * rate / 2 / problem.band.cutoff_hz
    above = np.maximum(energy - floor, 0.0)
    total = above.sum()
    return [
        FrequencyShare(from_hz=low, to_hz=high, share=round(float(value / total), 4) if total > 0 else 0.0)
        for low, high, value in zip(FREQUENCIES[:-1], FREQUENCIES[1:], above, strict=True)
    ]


def where(findings: Findings) -> Where:
    """The `where` section of the document."""
    problem, rows = findings.problem, RowStates.of(findings.problem, findings.best.hypothesis)
    moving = sum(int(r.segment.moving.sum()) for r in problem.recordings)
    samples = sum(r.segment.moving.size for r in problem.recordings)
    found = events_of(problem, findings.after)
    told = sorted(bursts(problem, found), key=lambda burst: -burst.over_noise)
    return Where(
        joints=[
            JointWhere(
                joint=joint + 1,
                rows=int((rows.joint == joint).sum()),
                budget_nm2={name: float(f"{value:.4g}") for name, value in budget(findings, joint).items()},
                before=regimes(findings, rows, findings.before, joint)[:8],
                after=regimes(findings, rows, findings.after, joint)[:8],
                spectrum_before=spectrum(findings, findings.before, joint),
                spectrum_after=spectrum(findings, findings.after, joint),
            )
            for joint in range(len(problem.sigma))
        ],
        left_out_at_rest_and_ends=round(1.0 - moving / samples, 4),
        worst_runs=_runs(findings),
        bursts=told[:MOST_BURSTS],
        bursts_rhythm_s=rhythm(found),
    )


def _runs(findings: Findings) -> list[RunLevel]:
    result = []
    for recording, residual in zip(findings.problem.recordings, findings.after, strict=True):
        level = float(np.sqrt(np.mean(residual**2))) if len(residual) else 0.0
        result.append(RunLevel(run=recording.name, after_over_noise=round(level, 3)))
    return sorted(result, key=lambda item: -item.after_over_noise)
