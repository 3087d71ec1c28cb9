"""What a robot has that its reference has not, and since when."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import hypot

from schemas.diagnosis import Moved
from schemas.fleet_document import Change, ChangeKind, DayResult
from schemas.words import change, percent, significant, words
from service.diagnosis.documents.text import how_much

MOVED_SIGMAS = 5.0  # standard errors of the difference: a fleet asks thousands of times
MOVED_SHARE = 0.1  # of the reference's value: below, no two days of a gear agree
FRICTION = {"f_v_": "viscous friction", "f_c_": "Coulomb friction"}
ORDER: tuple[ChangeKind, ...] = ("effect", "parameter", "unexplained", "risen")
RISEN = 2.0  # times the gap of the first day, as a share of the torque: two days of one robot differ by less


def changes(days: Sequence[DayResult]) -> list[Change]:
    """Of the `days` of one robot, in order. Days that were not judged, or on which nothing can be told, count neither
    for nor against."""
    judged = [day for day in days if day.judged]
    seen: dict[tuple[ChangeKind, str, int | None], list[int]] = {}  # kind, name, joint -> days
    for number, day in enumerate(judged):
        for key in dict.fromkeys(_found(day)):
            seen.setdefault(key, []).append(number)
    together: dict[tuple[ChangeKind, str, tuple[int, ...]], list[int]] = {}  # kind, name, days -> joints
    for (kind, name, joint), on in seen.items():
        together.setdefault((kind, name, tuple(on)), []).extend([joint] if joint else [])
    found = [_change(*key, sorted(joints), judged) for key, joints in together.items()]
    found += _risen(days)
    return sorted(found, key=lambda one: (one.gone, ORDER.index(one.kind), -one.days))


def _risen(days: Sequence[DayResult]) -> list[Change]:
    """That the gap has grown on days on which no cause of it was found, or could be: figures stand whether or not."""
    measured = [(day, day.gap_percent) for day in days if day.gap_percent]
    if not measured:
        return []
    (first, was), *_ = measured
    on = [k for k, (day, gap) in enumerate(measured) if gap > RISEN * was and not (day.judged and any(_found(day)))]
    if not on:
        return []
    begin, last = measured[on[0]], measured[on[-1]]
    grown = [
        f"{significant(one / was, 2)} times that of {first.day}, {gap_in_words(day)}" for day, one in (begin, last)
    ]
    return [
        Change(
            kind="risen", name="", title="the gap to the reference day has risen, the cause is unknown",
            since=begin[0].day, not_on=measured[on[0] - 1][0].day, last=last[0].day, gone=on[-1] < len(measured) - 1,
            days=len(on), of=len(measured) - on[0], first=[grown[0]], now=[grown[1]],
            means="`deltatwin diagnose` shows where it lies; record motion that excites all joints.",
        )
    ]  # fmt: skip


def _found(day: DayResult) -> Iterator[tuple[ChangeKind, str, int | None]]:
    for effect in day.effects:
        for joint in effect.joints or (None,):
            yield "effect", effect.name, joint
    if day.verdict in ("unexplained", "partly_explained"):
        yield "unexplained", "", None
        return  # a base that does not fit has figures that mean nothing
    for name, moved in day.moved.items():
        if _has_moved(moved):
            yield "parameter", name, None


def _has_moved(one: Moved) -> bool:
    if not (one.before_error and one.after_error):  # not known
        return False
    error = hypot(one.before_error, one.after_error)
    return abs(one.after - one.before) > max(MOVED_SIGMAS * error, MOVED_SHARE * abs(one.before))


def _change(kind: ChangeKind, name: str, on: tuple[int, ...], joints: list[int], judged: Sequence[DayResult]) -> Change:
    first, last = judged[on[0]], judged[on[-1]]
    title, means = "structure that no effect of the catalogue explains", "`deltatwin diagnose` shows where it lies."
    if kind == "effect":
        effect = next(one for one in last.effects if one.name == name)
        others = f" (or {', '.join(map(words, effect.confusable_with))})" if effect.confusable_with else ""
        title, means = words(effect.name) + others, f"{effect.title}. {effect.means}" if effect.title else effect.means
    elif kind == "parameter":
        prefix = next((prefix for prefix in FRICTION if name.startswith(prefix)), None)
        title, means = (
            words(name),
            "The value of the reference day no longer holds. Warm and cold gears differ, too.",
        )
        if prefix:
            title, joint = FRICTION[prefix], name.removeprefix(prefix)
            joints = [int(joint)] if joint.isdigit() else joints
    return Change(
        kind=kind, name=name, title=title, joints=joints, since=first.day,
        not_on=judged[on[0] - 1].day if on[0] else None, last=last.day, gone=on[-1] < len(judged) - 1, days=len(on),
        of=len(judged) - on[0], first=_amount(kind, name, first), now=_amount(kind, name, last), means=means,
    )  # fmt: skip


def _amount(kind: ChangeKind, name: str, day: DayResult) -> list[str]:
    if kind == "effect":
        effect = next(one for one in day.effects if one.name == name)
        return [f"{percent(effect.gap_share)} of the gap", *how_much(effect)]
    if kind == "parameter":
        one = day.moved[name]
        share = f" ({change(one.after / one.before)})" if one.before else ""
        return [f"{significant(one.before)} → {significant(one.after)} {one.unit}".rstrip() + share]
    return [gap_in_words(day)]


def gap_in_words(day: DayResult) -> str:
    """The gap to the reference and what is left of it."""
    if day.gap_nm is None or day.after_nm is None:
        return ""
    share = f" ({significant(day.gap_percent, 2)} % of the torque)" if day.gap_percent is not None else ""
    return f"{significant(day.gap_nm)} → {significant(day.after_nm)} {day.unit}{share}"
