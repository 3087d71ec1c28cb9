"""The diagnosis in sentences that a plant engineer understands."""

from __future__ import annotations

import math
from dataclasses import dataclass

from schemas.diagnosis import (
    Burst,
    Caution,
    Diagnosis,
    Estimate,
    NamedEffect,
    Regime,
    Shrunk,
    Simulated,
    Unseen,
    named_joints,
    placed,
)
from schemas.words import fixed, interval, percent, significant, words
from service.diagnosis.documents.online_text import sentences_of
from service.diagnosis.evidence.rivals import SURE
from service.diagnosis.fit.selection import Z95
from service.identification.loops import gains_in_words

VERDICTS = {
    "within_noise": "The gap between model and robot is within the noise of the torque signal.",
    "explained": "The named effects explain the gap: the residual is within the noise of the torque signal.",
    "hardly": "The gap was hardly above the noise of the torque signal; with the named effects it is within the noise.",
    "partly_explained": "The named effects explain part of the gap; the residual still has structure.",
    "unexplained": "There is structure in the gap, and no effect in the catalogue explains it.",
}  # fmt: skip
HELD_OUT = "predicted with parameters fitted to the others; effects were found and accepted on all data"
# code of a caution -> what the data do not show
CAUTIONS = {
    "too_little_motion": "The data cannot separate the effects: no joint moves for 3 s in total.",
    "joints_at_rest": "{Joints} hardly move{s}: the data cannot separate effects of the whole robot from those of "
    "{joints}.",
    "one_way": "{Joints} move{s} in one direction only: the data cannot separate friction there from a constant "
    "torque.",
    "one_run": "There is only one run: the held-out data are stretches of the same run.",
    "beyond_any_robot": "{Effect} would have to be larger than on any real robot: the data cannot separate the "
    "effects.",
    "several_arms": "The geometry of several arms at once would have to differ greatly from the description: the "
    "data cannot separate the effects.",
    "runs_differ": "The model fits each run alone, but not all runs together: the data cannot separate the effects.",
    "much_is_left": "The residual is {share} of the torque itself, more than would remain if effects of the "
    "catalogue were the cause: the data cannot separate them.",
    "much_beside": "The residual is {share} of the torque itself: besides the named effects, something is wrong or "
    "is not in the catalogue. The named effects shrink the gap of each held-out log. The data separate them from "
    "any load, inertia and friction that depend on the angle alone.",
    "other_joints": "The base model has to be corrected first: {share} of the gap in joint {first} follows the motion "
    "of joint {last}, which the model of joint {first} does not contain. No effect is named on a wrong base model.",
    "sine_of_angle": "The base model has to be corrected first: {share} of the gap in joint {first} depends on its "
    "angle, as with a weight, a counterbalance or a wrong gear ratio. No effect is named on a wrong base model.",
    "degrees": "The torque of {joints} depends on its angle as {effect} would cause. It would also do so if the "
    "axis bears a weight and its position is in degrees, not in radians: the data cannot separate the two. No effect "
    "is named on a wrong base model.",
    "gravity": "The base model has to be corrected first: a different direction or magnitude of gravity explains "
    "{share} of the gap, no worse than effects do. No effect is named on a wrong base model.",
    "closed_loop": "The torque of {joints} was not measured: it is the controller's response to its position error "
    "({gains}, without lag). Such a torque does not show its own delay or filter, the torque "
    "constant, or anything between command and shaft (back-EMF looks like viscous friction).",
    "torque_held": "The torque is updated only every {held:.3g} ms and repeated in between: the repeated samples are "
    "late and were not used.",
    "noise_coloured": "The noise of {joints} is coloured: there is more noise in the band than white noise of the "
    "same level would have. The noise floor is estimated from its spectrum, to about 20 %.",
    "noise_unknown": "The torque of {joints} shows no noise of its own (smoothed or computed?): its noise floor "
    "is unknown and assumed to be 1 % of the torque.",
    "at_limit": "The nearest effect is {effect}{where}, but its {quantity} is at the limit of its range: not accepted.",
    "drives": "The nearest effect is {effect}{where}, but this friction would drive the joint: not accepted.",
    "by_weight": "The nearest effect is {effect}{where}, but the joint turns so little that friction which grows with "
    "the weight looks the same: the data cannot separate them.",
    "does_not_fall": "The nearest effect is {effect}{where}, but the fitted friction does not fall as the speed "
    "grows: it levels off, or depends on the speed in a way that is not in the catalogue.",
    "left_open": "{Effect}{where} fits, but none of its parameters differs from zero: not accepted.",
    "any_shape": "{Effect}{where} fits equally well with any {quantity} in its range: the data do not determine that "
    "parameter, so the effect is not accepted.",
    "no_shrink": "{Effect}{where} fits, but it does not shrink the gap on held-out data ({share}): not accepted.",
    "no_shrink_on": "{Effect}{where} fits, but it does not shrink the gap on the held-out log {run} ({share}): "
    "not accepted.",
    "varies": "{Effect}{where} fits, but its value from {run} alone differs by {share} from that of all runs "
    "together: the cause is something else, so the effect is not accepted.",
    "rivalled": "{Effect}{where} fits, but other effects fit in its place, too: the data cannot separate them, so it "
    "is not accepted.",
    "not_its_own": "{Effect}{where} fits, but the same torque shifted in time explains {share} as much: the cause is "
    "something else, so the effect is not accepted.",
    "misplaced": "The URDF has to be corrected first: another position or orientation of {joints} on the link before "
    "explains {share} of the residual.",
    "by_place": "An unmodelled disturbance pulls at the platform everywhere. The named effects were found given any "
    "torque that depends on the platform's position: springs, offsets and weights cannot be separated from it.",
    "by_scale": "Part of the residual of {joints} is proportional to the torque itself, with a factor that differs "
    "between logs or changes within a log: the torque constants drift (do the motors get warm?). Torque scales and "
    "their aliases are hardly separable from this.",
    "comes_again": "An unmodelled disturbance pulls at the platform every {pitch:.0f} mm of its path (a toothed belt, "
    "a rack?). The named effects were found given this disturbance.",
}
BESIDE = {"by_place", "by_scale", "comes_again"}  # effects are named given an unmodelled disturbance
# with these the data separate no effect from another
NO_NAMES = {
    "too_little_motion", "joints_at_rest", "beyond_any_robot", "several_arms", "runs_differ", "much_is_left",
    "other_joints", "sine_of_angle", "gravity", "degrees",
}  # fmt: skip
ADVICE = {
    "record_runs": "Record three or more runs of 5 s: picks, a multisine and a slow sweep with reversals.",
    "record_all_joints": "Record runs in which all joints move.",
    "record_reversals": "Record runs with reversals.",
    "check_description": "Check the description: lengths, gravity, gear ratio, order and sign of joints, and that it "
    "has all joints of the machine.",
    "check_runs": "Check that all runs are of the same robot with the same tool, in the same condition.",
    "check_base": "Check the base model: kind, gravity, gear ratio, coupling of joints, order and sign of columns.",
    "record_more": "Record more motion of the kind that shows the gap, and note what else changed between the runs.",
    "measure_torque": "Log the drive's measured current as well as the command.",
    "look_there": "See below where and when the residual is largest.",
    "log_warm": "Log the motors' temperature, or record again when they are warm.",
    "log_quicker": "Let the drive send its torque with every sample.",
    "say_degrees": 'State the unit of the position in the mapping (unit = "deg"), or gravity = false in the '
    "description if the axis bears no weight.",
    "measure_noise": "Log the torque unfiltered, or log a stretch at rest with the drives on.",
}
# parameter of the base model, without its joint -> what it is
BASE = {
    "rho_1": "ρ1, factor on the inertia",
    "rho_2": "ρ2, factor on gravity",
    "forearm_inertia_kg": "mass of a forearm as it acts on the inertia",
    "f_v": "viscous friction",
    "f_c": "Coulomb friction",
    "transition": "speed range over which Coulomb friction changes sign",
    "offset": "constant load",
    "gravity_sin": "weight, sine of the angle",
    "gravity_cos": "weight, cosine of the angle",
}
ONLINE = {
    "present_sample": "in the online model, computed from the present sample",
    "settings": "in the online model, in its settings",
    "state": "in the online model, as a state kept from sample to sample",
    "report": "in the online model, between the true and the reported torque",
    "no_online_form": "offline only: the online model does not contain it",
}
PLANNED = (
    "`deltatwin plan-motion`, given this robot and the folder of this diagnosis, plans the run that separates the "
    "candidate effects."
)
# what a residual depends on -> what it is, what to check
LOCATED = {
    "angle": (
        "a torque in {} that depends on its angle",
        "Check what pulls at the arm or touches it there: a cable, a stop, a cover.",
    ),
    "friction_at_angle": (
        "friction in {} that depends on its angle", "Check gear and bearings at that angle: wear, dirt, a rough place."
    ),
    "speed": ("a torque in {} that depends on its speed", "Check friction there: lubricant, seals, a dragging brake."),
    "platform": (
        "a force on {} that depends on its position",
        "Check what pulls or touches there: a hose, a cable, a magnet, a jet of air.",
    ),
}  # fmt: skip
MOST_TOLD = 6  # events
MOST_NEAR = 3  # candidates listed where none is named
HARDLY = 0.1  # shrink below which there was hardly a gap
WORSE = 1.05  # gap on held-out data, after over before, from which the correction is said to do harm
LEAST_CONCENTRATED = 0.2  # of the gap in one regime


@dataclass(frozen=True)
class Cause:
    """A named effect: its name and place, the same in words of the plant, how sure that is, how much there is, what it
    means and what to do."""

    what: str
    title: str
    surety: str
    how_much: list[str]
    means: str


@dataclass(frozen=True)
class Answer:
    """The diagnosis in one look. online: what the correction is worth to the estimator, where that was tried. check:
    what to check first where no cause is named, or the data cannot say."""

    causes: list[Cause]
    gap: str
    verdict: list[str]
    online: list[str]
    check: list[str]


def answer(document: Diagnosis) -> Answer:
    """What a plant engineer wants to know first."""
    before, after = rms(document.gap.before_nm), rms(document.gap.after_nm)
    torque = rms(document.gap.torque_nm) if document.gap.torque_nm else 0.0

    def level(value: float) -> str:
        share = f" ({significant(100 * value / torque, 2)} % of the torque's rms)" if torque else ""
        return f"{significant(value)} {document.gap.unit}{share}"

    causes = [
        Cause(
            placed(effect.name, effect.joints).capitalize(),
            effect.title,
            f"Probability {percent(effect.probability)}, by bootstrap over blocks of the data.{_confusable(effect)}",
            how_much(effect),
            effect.means,
        )
        for effect in document.effects
    ]
    check = [ADVICE[one.advice] for one in document.cannot_tell]
    if not causes and document.verdict != "within_noise":
        check = check or [ADVICE["check_description"], ADVICE["record_more"]]
    check += _settling(document)
    gap = f"{level(before)} → {level(after)}" if causes else level(before)
    verdict = _verdict(document)
    check = [line for line in dict.fromkeys(check) if not any(line in said for said in verdict)]
    return Answer(causes, gap, verdict, _online(document), check[:MOST_NEAR])


def _settling(document: Diagnosis) -> list[str]:
    settles = dict.fromkeys(e.settles for e in document.effects if e.confusable_with or e.probability < SURE)
    lines = [f"To be sure, record {settle}." for settle in settles]
    open_ = document.verdict in ("unexplained", "partly_explained") and not document.effects
    if len(document.rivals) > 1 and (settles or open_):
        lines.append(PLANNED)
    return lines


def how_much(effect: NamedEffect) -> list[str]:
    """What was estimated of it, as far as it is told in one look."""
    lines = _figures(effect)
    more = len(lines) - MOST_TOLD
    return lines[:MOST_TOLD] + ([f"and {more} more, below"] if more > 0 else [])


def _figures(effect: NamedEffect) -> list[str]:
    """What was estimated of an effect; a cosine and a sine as one amplitude."""
    found = {key: one for key, one in effect.parameters.items() if not one.fixed}
    lines = []
    for key, one in found.items():
        partner = found.get(key.replace("cosine", "sine", 1)) if key.startswith("cosine") else None
        if key.startswith("sine") and key.replace("sine", "cosine", 1) in found:
            continue
        if partner:
            value = math.hypot(one.value, partner.value)
            half = math.hypot(one.value * _half(one), partner.value * _half(partner)) / max(value, 1e-300)
            meaning = one.meaning.replace("cosine part of the amplitude", "amplitude").replace(
                "cosine part", "amplitude"
            )
            one = Estimate(value=value, unit=one.unit, ci95=(value - half, value + half), meaning=meaning)
        lines.append(f"{in_words(key, one)} = {_value(one)}{_degrees(one)}")
    return lines


def in_words(key: str, estimate: Estimate) -> str:
    """What a parameter is."""
    return estimate.meaning or words(key)


def base_in_words(key: str) -> str:
    """What a parameter of the base model is."""
    for name, said in BASE.items():
        if key == name:
            return said
        if key.startswith(f"{name}_"):
            where = words(key.removeprefix(f"{name}_"))
            return f"{said}, {'joint ' * where.isdigit()}{where}"
    return words(key)


def _degrees(estimate: Estimate) -> str:
    return f" ({significant(math.degrees(estimate.value), 2)}°)" if estimate.unit == "rad" else ""


def _half(estimate: Estimate) -> float:
    return (estimate.ci95[1] - estimate.ci95[0]) / 2


def _verdict(document: Diagnosis) -> list[str]:
    """The verdict's sentence, or why there is none."""
    return unasked(document) or [VERDICTS[_said(document)]]


def unasked(document: Diagnosis) -> list[str]:
    """Why no effect could be asked for, where none could."""
    if document.verdict != "unexplained" or document.effects:
        return []
    return [caution(one) for one in document.cannot_tell if one.code in NO_NAMES]


def _why_it_grows(document: Diagnosis) -> str:
    """The gap on data left out."""
    if document.effects and BESIDE & {one.code for one in document.cannot_tell}:
        return "most of it is not in the catalogue; given the unmodelled part, the named effects shrink it"
    return "the fit to the other runs does not generalise"


def paragraphs(document: Diagnosis, figures: bool = True) -> list[list[str]]:
    """Half a page: verdict, each joint's gap and where it sits, each effect, what remains, what to record next.

    figures: of the effects and of the estimator with them, which a page has in its first box.
    """
    verdict = _verdict(document)
    effects = [_effect(effect, document, figures) for effect in document.effects]
    before, after = rms(document.gap.before_nm), rms(document.gap.after_nm)
    if document.effects or after > WORSE * before:
        left_out = "runs" if len(document.traces) > 2 else "stretches"
        gap, apart = document.gap.model_dump(include=set(Shrunk.model_fields)), ""
        if document.gap.slow_runs:
            gap |= {"before_nm": document.gap.work_before_nm, "after_nm": document.gap.work_after_nm}
            apart = f", without slow sweeps ({', '.join(document.gap.slow_runs)})"
        shrunk = Shrunk.model_validate(gap)
        line = f"On held-out {left_out} ({HELD_OUT}){apart} the gap goes {_goes(shrunk, document.gap.unit)}"
        grows = rms(shrunk.after_nm) > rms(shrunk.before_nm)
        effects.append(line + (f": {_why_it_grows(document)}." if grows else "."))
    if not document.effects and document.verdict == "unexplained":
        effects += _nearest(document)
    tests = [line for test in document.tests for line in _unseen(test, document.gap.unit)]
    remaining = _remaining(document) if document.verdict in ("unexplained", "partly_explained") else []
    advice = [caution(one) for one in document.cannot_tell if caution(one) not in verdict] + _settling(document)
    given = [f"The description already contains {name.replace('_', ' ')}." for name in document.given]
    online = _online(document) if figures else []
    groups = [verdict, _joints(document), effects, _moved(document), tests, online, remaining, advice + given]
    return [group for group in groups if group]


def of_candidates(document: Diagnosis) -> str:
    """What the shrinks of the candidates are, and why those that are not accepted are not."""
    accepted = {effect.name for effect in document.effects}
    refused = {one.name for one in document.ranking} - accepted
    lines = [
        "By how much each effect, added to those accepted before it, shrinks the gap on held-out data, with its joints "
        "chosen on all data. That alone makes it no cause: it also has to shrink the gap where nothing was chosen by, "
        "and to pass the other checks."
    ]
    lines += [_unadvised(one) for one in document.cannot_tell if one.effect in refused]
    if document.verdict in ("unexplained", "partly_explained"):
        lines.append(
            f"In {percent(document.probability_unknown)} of the bootstrap draws the residual is above the noise: by "
            "structure that is not in the catalogue."
        )
    return " ".join(dict.fromkeys(lines))


def caution(found: Caution) -> str:
    """What cannot be told, and what to record or to check."""
    return f"{_unadvised(found)} {ADVICE[found.advice]}"


def _unadvised(found: Caution) -> str:
    """What cannot be told."""
    joints, effect = named_joints(found.joints), words(found.effect or "")
    return CAUTIONS[found.code].format(
        joints=joints, Joints=joints.capitalize(), s="" if len(found.joints) > 1 else "s",
        effect=effect, Effect=effect.capitalize(), where=f" in {joints}" if joints else "",
        first=found.joints[0] if found.joints else "", last=found.joints[-1] if found.joints else "",
        share=percent(found.share or 0.0), run=found.run,
        gains=gains_in_words(found.gain or 0.0, found.gain_most or 0.0, found.gain_unit or "N m per rad"),
        held=1000 * (found.held_s or 0.0), pitch=1000 * (found.pitch_m or 0.0),
        quantity=words(found.quantity or ""),
    )  # fmt: skip


def _online(document: Diagnosis) -> list[str]:
    return sentences_of(document.online) if document.online else []


def _joints(document: Diagnosis) -> list[str]:
    gap, lines = document.gap, []
    for entry in document.where.joints:
        joint = entry.joint
        before, floor = gap.before_nm[joint - 1], gap.noise_floor_nm[joint - 1]
        if not entry.rows or not floor:
            lines.append(f"Joint {joint} hardly moves: no statement about it is possible.")
            continue
        line = f"Joint {joint}: {significant(before)} {gap.unit} between model and robot, "
        line += f"{before / floor:.1f} times the noise."
        if before > 1.15 * floor and entry.before:
            line += " " + _concentrated(entry.before[0])
        lines.append(line)
    return lines


def _said(document: Diagnosis) -> str:
    """The verdict, in the words of the figures."""
    hardly = document.verdict == "explained" and document.gap.shrink < HARDLY
    return "hardly" if hardly else document.verdict


def _nearest(document: Diagnosis) -> list[str]:
    """Where no name is earned: what came nearest, on data left out."""
    near = sorted((one for one in document.ranking if one.shrink > 0), key=lambda one: -one.shrink)[:MOST_NEAR]
    if not near:
        return []
    told = ", ".join(f"{placed(one.name, one.joints)} ({percent(one.shrink)})" for one in near)
    return [f"Nearest effects of the catalogue, with the shrink of the gap on held-out data: {told}."]


def _follows(document: Diagnosis) -> list[str]:
    what = {"sine_of_angle": "the sine of its angle", "position_error": "the position error"}
    return [
        f"{percent(one.share)} of the residual in joint {one.joint} follows "
        f"{what.get(one.what, f'the motion of joint {one.other}')}."
        for one in document.follows[:MOST_TOLD]
    ]


def _located(document: Diagnosis) -> list[str]:
    """On what the residual depends, and what to check."""
    lines = []
    for one in document.located:
        kind, check = LOCATED[one.over]
        place = "the platform" if one.joint is None else f"joint {one.joint}"
        begin = "Alternatively (the data cannot separate the two): " if one.alternative else ""
        extremes = " and ".join(f"{_vector(e.value)} {one.unit} at {_vector(e.at)} {one.at_unit}" for e in one.extremes)
        span = "between" if len(one.extremes) > 1 else "at most"
        lines.append(
            f"{begin}{percent(one.share)} {interval(one.share_ci95)} of the residual is {kind.format(place)}: "
            f"{significant(one.rms)} {one.unit} rms, {span} {extremes}. {check}"
        )
    return lines


def _vector(values: list[float]) -> str:
    told = ", ".join(significant(value) for value in values)
    return f"({told})" if len(values) > 1 else told


def _moved(document: Diagnosis) -> list[str]:
    """Base parameters against the baseline's."""
    lines = [
        f"{base_in_words(name)}: {_number(one.before, one.before_error)} -> "
        f"{_number(one.after, one.after_error)} {one.unit}".rstrip()
        for name, one in document.moved.items()
    ]
    return ["Base parameters, baseline -> refitted:", *lines] if lines else []


def _number(value: float, error: float) -> str:
    return significant(value, 4) + (f" ± {significant(Z95 * error, 2)}" if error else "")


def rms(values: list[float]) -> float:
    """Of the joints together."""
    return math.sqrt(sum(value**2 for value in values) / len(values))


def _concentrated(regime: Regime) -> str:
    if regime.share < LEAST_CONCENTRATED:
        return "It is spread over the whole motion."
    return f"{percent(regime.share)} of it occurs here: {regime.regime} ({percent(regime.of_time)} of the time)."


def _effect(effect: NamedEffect, document: Diagnosis, figures: bool) -> str:
    line = f"Most likely cause: {placed(effect.name, effect.joints)} (probability {percent(effect.probability)})"
    line += f": {'; '.join(_figures(effect))}." if figures else "."
    line += f" It explains {share_of_gap(effect, document)} of the gap above the noise."
    return line + _confusable(effect)


def share_of_gap(effect: NamedEffect, document: Diagnosis) -> str:
    """What an effect makes up of the gap above the noise: not all of it where something is left."""
    return percent(min(effect.gap_share, 0.9999) if document.verdict == "partly_explained" else effect.gap_share)


def _confusable(effect: NamedEffect) -> str:
    others = " or ".join(words(other) for other in effect.confusable_with)
    return f" The data cannot separate it from {others}." if others else ""


def _value(estimate: Estimate) -> str:
    """Value and half its interval to the same decimal, which is the first or second that the interval touches."""
    half = _half(estimate)
    unit = f" {estimate.unit}" if estimate.unit else ""
    if half <= 0:
        return f"{significant(estimate.value)}{unit}"
    decimals = max(0, 1 - math.floor(math.log10(half)) - (half / 10 ** math.floor(math.log10(half)) >= 2))
    return f"{fixed(estimate.value, decimals)} ± {fixed(half, decimals)}{unit}"


def _unseen(test: Unseen, unit: str) -> list[str]:
    lines = [f"On the test log {test.trace}, used for nothing else, the gap goes {_goes(test.whole, unit)}."]
    if test.outside is not None:
        lines[0] += (
            f" Outside the events ({percent(test.outside_share)} of the motion) it goes {_goes(test.outside, unit)}."
        )
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
        f"In the simulator{without}, driven by the recorded torque, the platform's error after {found.horizon_s:.2g} s "
        f"goes from {before} to {after}; noise alone gives {floor}."
    )


def _goes(shrunk: Shrunk, unit: str) -> str:
    return (
        f"from {significant(rms(shrunk.before_nm))} to {significant(rms(shrunk.after_nm))} {unit}, "
        f"a shrink of {percent(shrunk.shrink)} {interval(shrunk.shrink_ci95)}"
    )


def _bursts(events: list[Burst], rhythm: float | None) -> str:
    many = "1 stretch is" if len(events) == 1 else f"{len(events)} stretches are"
    beat = f", most of them every {rhythm:.3g} s" if rhythm is not None else ""
    times = ", ".join(f"{e.run} {e.from_s:.2f} to {e.to_s:.2f} s" for e in events[:MOST_TOLD])
    more = f", and {len(events) - MOST_TOLD} more" if len(events) > MOST_TOLD else ""
    return f"{many} far above the rest of the residual (events){beat}; strongest first: {times}{more}."


def _remaining(document: Diagnosis) -> list[str]:
    lines = []
    for entry in document.where.joints:
        joint = entry.joint
        after, floor = document.gap.after_nm[joint - 1], document.gap.noise_floor_nm[joint - 1]
        if entry.after and after > 1.1 * floor:
            bands = max(entry.spectrum_after, key=lambda band: band.share, default=None)
            line = f"Unexplained in joint {joint}: {after / floor:.1f} times the noise."
            line += f" {_concentrated(entry.after[0])}"
            if bands and bands.share > 0:
                line += f" {percent(bands.share)} of it lies at {bands.from_hz:g} to {bands.to_hz:g} Hz."
            lines.append(line)
    lines += _located(document)
    lines += _follows(document)
    if document.where.bursts:
        lines.append(_bursts(document.where.bursts, document.where.bursts_rhythm_s))
    if document.where.worst_runs:
        worst = document.where.worst_runs[0]
        lines.append(
            f"The residual is largest in {worst.run} ({worst.after_over_noise:.1f} times the noise): look there first."
        )
    return lines
