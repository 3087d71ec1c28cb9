"""What a correction is worth to the estimator, in sentences, and the advice that goes into `corrected.toml`."""

from __future__ import annotations

import textwrap
from typing import Literal

from schemas.diagnosis import OnlineFigures, OnlineTrial
from schemas.words import counted, percent, significant, words

Standing = Literal["better", "same", "worse"]

ONE_CHANGE = 1  # of the load: a difference of so much is chance
ALIKE = 1.05  # ratio of two errors of feed-forward up to which they are the same
KEEP = (
    "Keep the identified description for `estimate`; use the corrected one for `evaluate`, `rollout`, `export` and "
    "`plan-motion`."
)
BEGINS = {
    "better": "The estimator works better with the corrected description: it",
    "same": "The estimator works as well with the corrected description as with the identified one: it",
    "worse": "The estimator works worse with the corrected description than with the identified one: it",
}
NOTE = "# Online: "  # every line of the advice begins with it, so that the next diagnosis finds and replaces it
WIDTH = 120  # characters


def standing(identified: OnlineFigures, corrected: OnlineFigures, changes: int) -> Standing:
    """How the estimator does with the corrected description, compared with the identified one. The first of these
    that differs decides: the mass, false events, how long the mass is trusted, the feed-forward."""
    trusted = (corrected.trusted - identified.trusted) * changes
    before, after = identified.feedforward_nm, corrected.feedforward_nm
    if abs(corrected.right - identified.right) > ONE_CHANGE:
        better = corrected.right > identified.right
    elif corrected.false_events != identified.false_events:
        better = corrected.false_events < identified.false_events
    elif abs(trusted) > ONE_CHANGE:
        better = trusted > 0
    elif max(before, after) > ALIKE * min(before, after):
        better = after < before
    else:
        return "same"
    return "better" if better else "worse"


def sentences_of(trial: OnlineTrial) -> list[str]:
    """What the trial says, with the advice that follows."""
    if trial.reason == "not_carried":
        names = ", ".join(map(words, trial.left_out))
        return [f"The correction was not tried in the estimator: the online model does not contain {names}.", KEEP]
    known, better = trial.identified, trial.corrected
    if known is None or better is None:
        return ["The correction was not tried in the estimator: no log has two rests in which a load could change."]
    found = standing(known, better, trial.changes)
    over, was = (significant(one.feedforward_over_noise, 2) for one in (better, known))
    off = f"off by {over} times the noise (identified: {was})"
    if not trial.changes:
        return [
            f"{BEGINS[found]} gives a feed-forward torque that is {off}.",
            "Its payload estimates were not tried: with elastic gears a pick makes the links swing, which cannot be "
            "simulated on a log. Give logs with known loads (--loaded).",
            *([KEEP] if found == "worse" else []),
        ]
    said = (
        f"{BEGINS[found]} estimates the mass correctly, from 150 ms on, after {better.right} of {trial.changes} "
        f"changes of the load (identified: {known.right}), trusts its estimate {percent(better.trusted)} of the time "
        f"({percent(known.trusted)}), "
        f"reports {counted(better.false_events, 'false event')} ({known.false_events}), and its feed-forward is {off}."
    )
    where = ", ".join(trial.traces)
    source = f"loads simulated along {where}" if trial.simulated else f"the loads of {where}"
    seen = "held out of the fit" if trial.held_out else "which were also used for the fit"
    return [said, f"Tried on {source}, {seen}.", *([KEEP] if found == "worse" else [])]


def noted(text: str, trial: OnlineTrial) -> str:
    """The text of `corrected.toml` with the advice on top, in place of that of an earlier diagnosis."""
    lines = text.splitlines(keepends=True)
    while lines and lines[0].startswith(NOTE):
        del lines[0]
    advice = textwrap.wrap(" ".join(sentences_of(trial)), WIDTH - len(NOTE), break_on_hyphens=False)
    return "".join(f"{NOTE}{line}\n" for line in advice) + "".join(lines)
