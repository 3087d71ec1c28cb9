"""The diagnosis in one box: verdict, one number, next step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from schemas.diagnosis import Diagnosis, NamedEffect, OnlineTrial, placed
from schemas.words import percent, significant, words
from service.diagnosis.documents.online_text import KEEP, standing
from service.diagnosis.documents.text import ADVICE, NO_NAMES, answer, rms, unasked
from service.pages import Headline

AGREE = "Model and robot agree: the gap is within the noise of the torque signal."
NONE = "No cause is confirmed: no effect of the catalogue explains the structure in the gap."
ASKED = "No effect can be diagnosed from these data."
TRY = "check the cause on the machine. Then compare the corrected description with {logs}:"
CORRECTED = Path("corrected.toml")


@dataclass(frozen=True)
class Given:
    """What a diagnosis was given and has written, for the command that comes next. corrected: the file of the corrected
    description. logs: that it was made from. tests: logs that it was tested on. read_by: options by which they are
    read."""

    corrected: Path = CORRECTED
    logs: Sequence[Path] = ()
    tests: Sequence[Path] = ()
    read_by: tuple[object, ...] = ()


NOTHING_GIVEN = Given()


def headline(document: Diagnosis, given: Given = NOTHING_GIVEN) -> Headline:
    """What the page and the command say first."""
    gap, said = document.gap, answer(document)
    before, noise = rms(gap.before_nm), rms(gap.noise_floor_nm)
    if document.effects:
        names = "; ".join(map(_named, document.effects))
        names = names[0].upper() + names[1:]
        rest = "explains the gap" if document.verdict == "explained" else "explains part of the gap"
        levels = (gap.work_before_nm, gap.work_after_nm) if gap.slow_runs else (gap.before_nm, gap.after_nm)
        goes = f"{' → '.join(significant(rms(level)) for level in levels)} {gap.unit} rms; noise {significant(noise)}"
        goes += "; without slow sweeps" if gap.slow_runs else ""
        shrinks = "smaller" if gap.shrink >= 0 else "larger"
        step, command, own = (said.check[0], (), "") if said.check else _step(document.online, given)
        return Headline(
            "bad", f"{names}: {rest if len(document.effects) == 1 else rest.replace('explains', 'explain')}.",
            percent(abs(gap.shrink)), f"{shrinks} gap on held-out data ({goes})",
            step, command=command, own=own,
        )  # fmt: skip
    of = f"the noise of the torque signal: {significant(before)} {gap.unit} rms between model and robot"
    times = f"{significant(before / noise, 2)} times" if noise else "no"
    if document.verdict == "within_noise":
        step = said.check[0] if said.check else "nothing; `deltatwin watch` raises an alarm when this changes."
        return Headline("good", AGREE, times, of, step)
    if refusal := unasked(document):
        advice = next(one.advice for one in document.cannot_tell if one.code in NO_NAMES)
        return Headline("open", ASKED, times, of, ADVICE[advice], tuple(refusal[:1]))
    return Headline("open", NONE, times, of, said.check[0])


def _named(effect: NamedEffect) -> str:
    others = " or ".join(map(words, effect.confusable_with))
    return placed(effect.name, effect.joints) + (f" (or {others})" if others else "")


def _step(online: OnlineTrial | None, given: Given) -> tuple[str, tuple[object, ...], str]:
    """What to do about a named cause: in words, the command, and what the user puts into it."""
    known = online.identified if online else None
    if online and known and online.corrected and standing(known, online.corrected, online.changes) == "worse":
        return KEEP, (), ""
    logs: Sequence[object] = given.tests or given.logs or ("LOG",)
    said = "the test logs" if given.tests else "these logs, or better with one that was not used here"
    own = "" if given.tests or given.logs else "LOG: a log of this robot that was not used here"
    command = ("evaluate", *logs, "--robot", given.corrected, *given.read_by)
    return TRY.format(logs="a log that was not used here" if own else said), command, own
