"""The diagnosis in sentences that a plant engineer understands."""

from __future__ import annotations

import math

from schemas.diagnosis import Burst, Caution, Diagnosis, Estimate, NamedEffect, Regime, Shrunk, Simulated, Unseen

VERDICTS = {
    "within_noise": "What is left between model and robot is within the noise of the torque signal.",
    "explained": "The named effects explain the gap: what they leave is within the noise of the torque signal.",
    "partly_explained": "The named effects explain part of the gap; what remains has structure that none explains.",
    "unexplained": "There is structure in the gap, and no effect in the catalogue explains it.",
}  # fmt: skip
# code of a caution -> what cannot be told
CAUTIONS = {
    "too_little_motion": "Cannot be told apart on this data: no joint moves for 3 s in all.",
    "joints_at_rest": "Joint {joints} hardly moves: effects of the whole robot and of that joint cannot be told apart "
    "on this data.",
    "one_way": "Joint {joints} moves one way only: its friction cannot be told from a constant torque on this data.",
    "one_run": "There is one run only: what is left out of the fit is a stretch of the same run.",
    "beyond_any_robot": "It would take {effect} beyond any robot's: cannot be told apart on this data.",
    "several_arms": "Several arms at once would have to be far from the described geometry: cannot be told apart on "
    "this data.",
    "runs_differ": "Each run fits alone, but not all together: cannot be told apart on this data.",
    "much_is_left": "What is left is {share:.0%} of the torque itself, more than effects of the catalogue would leave: "
    "cannot be told apart on this data.",
}
NO_NAMES = CAUTIONS.keys() - {"one_way", "one_run"}  # with these no effect is told from others
ADVICE = {
    "record_runs": "Record three or more runs of 5 s: picks, a multisine and a slow sweep with reversals.",
    "record_all_joints": "Record runs in which all joints move.",
    "record_reversals": "Record runs with reversals.",
    "check_description": "Check the description (lengths, gear ratio, order and sign of joints).",
    "check_runs": "Check that all runs are of one robot with one tool, in one state.",
}
ONLINE = {
    "present_sample": "carried by the online model, from the present sample",
    "settings": "carried by the online model, in its settings",
    "of_the_measurement": "offline only: of the reported torque, not of the robot",
    "no_online_form": "offline only: the online model does without it",
}
MOST_TOLD = 6  # events
LEAST_CONCENTRATED = 0.2  # of the gap in one regime


def paragraphs(document: Diagnosis) -> list[list[str]]:
    """Half a page: verdict, each joint's gap and where it sits, each effect, what remains, what to record next."""
    open_ = [caution(one) for one in document.cannot_tell if one.code in NO_NAMES]
    unasked = document.verdict == "unexplained" and not document.effects and bool(open_)
    verdict = open_ if unasked else [VERDICTS[document.verdict]]
    effects = [_effect(effect) for effect in document.effects]
    if document.effects:
        left_out = "runs" if len(document.traces) > 2 else "stretches"
        gap = Shrunk.model_validate(document.gap.model_dump(include=set(Shrunk.model_fields)))
        effects.append(
            f"On {left_out} used neither to fit nor to choose, the gap goes {_goes(gap, document.gap.unit)}."
        )
    tests = [line for test in document.tests for line in _unseen(test, document.gap.unit)]
    remaining = _remaining(document) if document.verdict in ("unexplained", "partly_explained") else []
    settles = dict.fromkeys(e.settles for e in document.effects if e.confusable_with or e.probability < 0.9)
    advice = [caution(one) for one in document.cannot_tell if caution(one) not in verdict]
    advice += [f"To be sure, record {settle}." for settle in settles]
    given = [f"{name.replace('_', ' ')} is in the description already." for name in document.given]
    groups = [verdict, _joints(document), effects, tests, remaining, advice + given]
    return [group for group in groups if group]


def sentences(document: Diagnosis) -> list[str]:
    """The paragraphs' lines."""
    return [line for group in paragraphs(document) for line in group]


def caution(found: Caution) -> str:
    """What cannot be told, and what to record or to check."""
    said = CAUTIONS[found.code].format(
        joints=", ".join(map(str, found.joints)), effect=(found.effect or "").replace("_", " "), share=found.share
    )
    return f"{said} {ADVICE[found.advice]}"


def _joints(document: Diagnosis) -> list[str]:
    gap, lines = document.gap, []
    for entry in document.where.joints:
        joint = entry.joint
        before, floor = gap.before_nm[joint - 1], gap.noise_floor_nm[joint - 1]
        if not entry.rows or not floor:
            lines.append(f"Joint {joint} hardly moves: nothing is said about it.")
            continue
        line = f"Joint {joint}: {before:.3g} {gap.unit} between model and robot, {before / floor:.1f} times the noise."
        if before > 1.15 * floor and entry.before:
            line += " " + _concentrated(entry.before[0])
        lines.append(line)
    return lines


def _rms(values: list[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / len(values))


def _concentrated(regime: Regime) -> str:
    if regime.share < LEAST_CONCENTRATED:
        return "It is spread over all of the motion."
    return f"{100 * regime.share:.0f} % of it: {regime.regime} ({100 * regime.of_time:.0f} % of the time)."


def _effect(effect: NamedEffect) -> str:
    name = effect.name.replace("_", " ")
    parameters = ", ".join(f"{key} = {_value(estimate)}" for key, estimate in effect.parameters.items())
    place = f" in joint {', '.join(map(str, effect.joints))}" if effect.joints else ""
    line = f"Most likely {name}{place} ({100 * effect.probability:.0f} %): {parameters}."
    line += f" It makes up {100 * effect.gap_share:.0f} % of the gap above the noise."
    if effect.confusable_with:
        others = " or ".join(other.replace("_", " ") for other in effect.confusable_with)
        line += f" On this data it cannot be told from {others}."
    return line


def _value(estimate: Estimate) -> str:
    """Value and half its interval to the same decimal, which is the first or second that the interval touches."""
    half = (estimate.ci95[1] - estimate.ci95[0]) / 2
    unit = f" {estimate.unit}" if estimate.unit else ""
    if half <= 0:
        return f"{estimate.value:.3g}{unit}"
    decimals = max(0, 1 - math.floor(math.log10(half)) - (half / 10 ** math.floor(math.log10(half)) >= 2))
    return f"{estimate.value:.{decimals}f} ± {half:.{decimals}f}{unit}"


def _unseen(test: Unseen, unit: str) -> list[str]:
    lines = [f"On {test.trace}, kept out of everything, the gap goes {_goes(test.whole, unit)}."]
    if test.outside is not None:
        lines[0] += f" Outside events ({100 * test.outside_share:.0f} % of the motion): {_goes(test.outside, unit)}."
        lines.append(_bursts(sorted(test.bursts, key=lambda burst: -burst.over_noise), test.rhythm_s))
    if test.simulated is not None:
        lines.append(_forward(test.simulated))
    return lines


def _forward(found: Simulated) -> str:
    before, after, floor = (
        f"{value:.2g} mm" if value is not None else "beyond the workspace"
        for value in (found.platform_before_mm, found.platform_after_mm, found.platform_floor_mm)
    )
    without = f" without {', '.join(name.replace('_', ' ') for name in found.left_out)}" if found.left_out else ""
    return (
        f"In the simulator{without}, under the recorded torque the platform's error after {found.horizon_s:.2g} s goes "
        f"from {before} to {after}; noise alone gives {floor}."
    )


def _goes(shrunk: Shrunk, unit: str) -> str:
    low, high = (100 * value for value in shrunk.shrink_ci95)
    return (
        f"from {_rms(shrunk.before_nm):.3g} to {_rms(shrunk.after_nm):.3g} {unit}, "
        f"a shrink of {100 * shrunk.shrink:.0f} % [{low:.0f}, {high:.0f}]"
    )


def _bursts(events: list[Burst], rhythm: float | None) -> str:
    many = "1 stretch stands" if len(events) == 1 else f"{len(events)} stretches stand"
    beat = f", most of them every {rhythm:.3g} s" if rhythm is not None else ""
    times = ", ".join(f"{e.run} {e.from_s:.2f} to {e.to_s:.2f} s" for e in events[:MOST_TOLD])
    more = ", ..." if len(events) > MOST_TOLD else ""
    return f"{many} far above the rest, as events do{beat}, the strongest first: {times}{more}."


def _remaining(document: Diagnosis) -> list[str]:
    lines = []
    for entry in document.where.joints:
        joint = entry.joint
        after, floor = document.gap.after_nm[joint - 1], document.gap.noise_floor_nm[joint - 1]
        if entry.after and after > 1.1 * floor:
            bands = max(entry.spectrum_after, key=lambda band: band.share, default=None)
            line = f"Unexplained in joint {joint}: {after / floor:.1f} times the noise. {_concentrated(entry.after[0])}"
            if bands and bands.share > 0:
                line += f" {100 * bands.share:.0f} % of it lies at {bands.from_hz:g} to {bands.to_hz:g} Hz."
            lines.append(line)
    if document.where.bursts:
        lines.append(_bursts(document.where.bursts, document.where.bursts_rhythm_s))
    if document.where.worst_runs:
        worst = document.where.worst_runs[0]
        lines.append(f"It is worst in {worst.run} ({worst.after_over_noise:.1f} times the noise): look there first.")
    return lines
