"""The closed loop in one look: verdict, table and pictures of what the drives were fed and how well they followed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from schemas.words import percent, significant
from service.experiment.live_loop import CORRECTED, FEEDBACK, RIGID, SETTLING, Ratio, Tracking, ratio
from service.experiment.pictures import Figure, Line, Page, PageTable, Panel, by_joint
from service.pages import Headline
from service.pages.palette import Colour

NOTE = (
    "Rms tracking error of each joint, and the largest error of any joint. Platform: error by the encoders; in truth: "
    "with elasticity and backlash of the gears. Times smaller: than with feedback alone. Helped: cycles with "
    "feed-forward; held: of these, cycles with a feed-forward for an earlier cycle; late: cycles that began late."
)
HEAD = (
    "fed with", "joint 1, mrad", "joint 2, mrad", "joint 3, mrad", "all, mrad", "platform, mm", "in truth, mm",
    "worst, mrad", "times smaller", "helped", "held", "late",
)  # fmt: skip
SHORT = (0, 4, 5, 6, 8, 9, 10, 11)  # columns of HEAD that a terminal has room for
AGAIN = "Stop other programs on this computer, or give a lower --rate, and run it again."


def row(run: Tracking, reference: Tracking) -> tuple[str, ...]:
    """The cells of `HEAD`."""
    joints = (f"{value * 1e3:.3f}" for value in run.joint_rms)
    return (
        run.name,
        *joints,
        f"{run.rms * 1e3:.3f}",
        f"{run.platform_rms * 1e3:.3f}",
        f"{run.true_rms * 1e3:.3f}",
        f"{run.worst * 1e3:.2f}",
        f"{reference.rms / run.rms:.1f}",
        percent(run.helped, 1),
        percent(run.held, 1),
        str(run.late),
    )


def verdict_of_models(runs: Sequence[Tracking]) -> Headline:
    """What feed-forward is worth. runs: with feedback alone first, with the best feed-forward last."""
    alone, best = runs[0], runs[-1]
    if spoilt := _spoilt(runs):
        return spoilt
    found = ratio(alone, best)
    return Headline(
        _tone(found),
        _compared(f"With tau_FF ({best.name}) the platform follows", found, "with feedback alone"),
        *_number(found, "feedback alone"),
        "simulate a robot that its description does not match:",
        (_errors(alone, best),),
        ("closed-loop", "--effect", "joint_elasticity"),
    )


def verdict_of_correction(
    runs: Sequence[Tracking], named: str, left_out: Sequence[str], described: tuple[Path, Path]
) -> Headline:
    """What the correction is worth. runs: by name as `closed_loop` has them. named: what the corrected description
    holds, in words. left_out: effects of it that the online model does not carry. described: files of the
    rigid and of the corrected description."""
    alone, rigid, corrected = ({run.name: run for run in runs}[name] for name in (FEEDBACK, RIGID, CORRECTED))
    if spoilt := _spoilt(runs):
        return spoilt
    found = ratio(rigid, corrected)
    lines = [_errors(alone, rigid, corrected), f"The correction: {named}."]
    if left_out:
        lines.append(f"The online model does not contain {', '.join(left_out)}: the feed-forward leaves it out.")
    command: tuple[object, ...] = ()
    if found.high < 1.0:
        step, command = "run the estimator with this feed-forward:", ("estimate", "--robot", described[1])
    elif found.low > 1.0:
        step = "keep the rigid model: the correction makes the tracking worse here."
        command = ("estimate", "--robot", described[0])
    else:
        step = "a longer --duration narrows the interval."
    said = _compared("With the correction the platform follows", found, "with the rigid model")
    return Headline(_tone(found), said, *_number(found, "the rigid model"), step, tuple(lines), command)


def colour_of(run: str) -> Colour:
    """What a run is fed with has its colour."""
    if run == FEEDBACK:
        return Colour.FEEDBACK
    if "lost" in run:
        return Colour.FAULT
    if run == CORRECTED or "payload-aware" in run:
        return Colour.AFTER
    stages = {"M_KH": Colour.TEXTBOOK, "M_Id": Colour.WITHOUT_FRICTION, "full": Colour.REFITTED}
    return stages.get(run.partition(",")[0], Colour.BEFORE)


def page(
    robot: str, which: str, masses: Sequence[float], runs: Sequence[Tracking], shown: Sequence[Tracking],
    headline: Headline,
) -> Page:  # fmt: skip
    """The page. which: what the robot really is, in words. shown: of `runs`, those whose error is drawn over time."""
    lines = [Line(run.name, run.time, run.error * 1e3, colour_of(run.name), "thin") for run in shown]
    joints = np.array(["joint 1", "joint 2", "joint 3"])
    bars = Panel(
        "",
        "rms error / mrad",
        tuple(Line(run.name, joints, run.joint_rms * 1e3, colour_of(run.name), "bars") for run in runs[:6]),
    )
    platform = Panel(
        "time / s",
        "platform error / mm",
        tuple(Line(run.name, run.time, run.astray * 1e3, colour_of(run.name), "thin") for run in shown),
    )
    first = Figure(
        "closed_loop_platform",
        "Platform error over time",
        "In truth: with elasticity and backlash of the gears.",
        (platform,),
    )
    loads = ", ".join(f"{mass:g} kg" for mass in masses)
    return Page(
        f"Closed loop: {robot}",
        headline,
        first,
        (
            f"Everything here is simulated. The robot is a rigid-body plant (MuJoCo; {which}) in real time. The "
            "estimator is a process of its own; the two communicate over Zenoh. The motion (pick-and-place with "
            f"{loads}) and the noise are the same in every run; only the feed-forward differs.",
        ),
        (
            PageTable("Tracking error", HEAD, tuple(row(run, runs[0]) for run in runs), NOTE),
            first,
            Figure(
                "closed_loop_error", "Tracking error over time", "Measured minus commanded joint angle.",
                by_joint(lines, "error / mrad", "joint {}"),
            ),
            Figure("closed_loop_rms", "Tracking error by model", f"rms after the first {SETTLING:g} s.", (bars,)),
        ),
    )  # fmt: skip


def _spoilt(runs: Sequence[Tracking]) -> Headline | None:
    """That figures do not count, where they do not."""
    spoilt = [run for run in runs if run.spoilt]
    if not spoilt:
        return None
    lines = tuple(
        f"{run.name}: {run.late} of {len(run.time)} cycles began late, "
        f"{percent(1 - run.helped, 1)} had no feed-forward."
        for run in spoilt
    )
    worst = max(run.late / len(run.time) for run in spoilt)
    said = "These results are not valid: the computer was too slow."
    return Headline("open", said, percent(worst, 1), "of the cycles of the worst run began late", AGAIN, lines)


def _tone(found: Ratio) -> Literal["good", "bad", "open"]:
    return "good" if found.high < 1.0 else "bad" if found.low > 1.0 else "open"


def _number(found: Ratio, than: str) -> tuple[str, str]:
    """The ratio and what it is of."""
    interval = f"95 % interval {significant(found.low, 2)} to {significant(found.high, 2)}"
    return f"{significant(found.value, 2)} times", f"the platform's error with {than} ({interval})"


def _compared(what: str, found: Ratio, than: str) -> str:
    if found.high < 1.0:
        return f"{what} {significant(1 / found.value, 2)} times as well as {than}."
    if found.low > 1.0:
        return f"{what} worse than {than}: {significant(found.value, 2)} times the error."
    return f"{what} as well as {than}: this run shows no difference."


def _errors(*runs: Tracking) -> str:
    """Platform errors of runs in turn, by the encoders and in truth."""
    seen, true = (" → ".join(significant(value * 1e3) for value in values) for values in (
        [run.platform_rms for run in runs], [run.true_rms for run in runs],
    ))  # fmt: skip
    names = " → ".join(run.name for run in runs)
    return f"Platform error, {names}: {seen} mm rms by the encoders, {true} mm in truth."
