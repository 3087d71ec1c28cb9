"""The closed loop in one look: verdict, table and pictures of what the drives were fed and how well they followed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.experiment.closed_loop import CORRECTED, FEEDBACK, RIGID, SETTLING, Ratio, Tracking, ratio
from service.experiment.pictures import COLOURS, Figure, Line, Page, PageTable, Panel, Verdict, by_joint

NOTE = (
    "rms tracking error, and the worst of any joint; the platform by the encoders, and in truth with what gears bend "
    "and play; times smaller than with feedback alone; cycles helped by feed-forward, those of them with one that was "
    "for an earlier cycle, and cycles that began late"
)
HEAD = (
    "fed with", "joint 1, mrad", "joint 2, mrad", "joint 3, mrad", "all, mrad", "platform, mm", "in truth, mm",
    "worst, mrad", "times smaller", "helped", "held", "late",
)  # fmt: skip
SHORT = (0, 4, 5, 6, 8, 9, 10, 11)  # columns of HEAD that a terminal has room for
AGAIN = "Stop what else runs on this computer, or take a lower --rate, and run it again."


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
        f"{run.helped:.1%}",
        f"{run.held:.1%}",
        str(run.late),
    )


def verdict_of_models(runs: Sequence[Tracking]) -> Verdict:
    """What feed-forward is worth. runs: with feedback alone first, with the best feed-forward last."""
    alone, best = runs[0], runs[-1]
    if spoilt := _spoilt(runs):
        return spoilt
    found = ratio(alone, best)
    return Verdict(
        _compared(f"With tau_FF ({best.name}) the platform follows", found, "with feedback alone"),
        (
            f"Platform error over that with feedback alone: {_in_words(found)}; {_errors(alone, best)}.",
            "Next: `deltatwin closed-loop --effect joint_elasticity` for a robot that its description does not know.",
        ),
    )


def verdict_of_correction(runs: Sequence[Tracking], named: str, left_out: Sequence[str], folder: str) -> Verdict:
    """What the correction is worth. runs: by name as `closed_loop` has them. named: what the corrected description
    holds, in words. left_out: effects of it that the online model does not carry. folder: of the descriptions."""
    alone, rigid, corrected = ({run.name: run for run in runs}[name] for name in (FEEDBACK, RIGID, CORRECTED))
    if spoilt := _spoilt(runs):
        return spoilt
    found = ratio(rigid, corrected)
    lines = [
        f"Platform error, corrected over rigid: {_in_words(found)}; {_errors(alone, rigid, corrected)}.",
        f"The correction: {named}.",
    ]
    if left_out:
        lines.append(f"The online model does not carry {', '.join(left_out)}: the feed-forward goes without it.")
    if found.high < 1.0:
        lines.append(f"Next: `deltatwin estimate --robot {folder}/corrected.toml` feeds this forward.")
    elif found.low > 1.0:
        lines.append(
            f"Next: keep `deltatwin estimate --robot {folder}/identified.toml`: the correction does harm here."
        )
    else:
        lines.append("Next: a longer --duration narrows the interval.")
    return Verdict(_compared("With the correction the platform follows", found, "with the rigid model"), tuple(lines))


def page(
    robot: str, which: str, masses: Sequence[float], runs: Sequence[Tracking], shown: Sequence[Tracking],
    verdict: Verdict,
) -> Page:  # fmt: skip
    """The page. which: what the robot really is, in words. shown: of `runs`, those whose error is drawn over time."""
    lines = [
        Line(run.name, run.time, run.error * 1e3, colour % len(COLOURS), "thin") for colour, run in enumerate(shown)
    ]
    joints = np.array(["joint 1", "joint 2", "joint 3"])
    bars = Panel(
        "",
        "rms error / mrad",
        tuple(Line(run.name, joints, run.joint_rms * 1e3, colour, "bars") for colour, run in enumerate(runs[:6])),
    )
    platform = Panel(
        "time / s",
        "platform error / mm",
        tuple(Line(run.name, run.time, run.astray * 1e3, colour, "thin") for colour, run in enumerate(shown)),
    )
    loads = ", ".join(f"{mass:g} kg" for mass in masses)
    return Page(
        f"Closed loop: {robot}",
        (
            f"Everything here is simulated: the robot is a rigid-body plant (MuJoCo; {which}) in real time, the "
            f"estimator a process of its own; they talk over Zenoh. The motion, pick-and-place with {loads}, and the "
            "noise are the same in every run; what the drives are fed differs.",
        ),
        (
            PageTable("Tracking error", HEAD, tuple(row(run, runs[0]) for run in runs), NOTE),
            Figure("closed_loop_platform", "Platform error over time", "In truth: gears bend and play.", (platform,)),
            Figure(
                "closed_loop_error", "Tracking error over time", "Measured minus commanded joint angle.",
                by_joint(lines, "error / mrad", "joint {}"),
            ),
            Figure("closed_loop_rms", "Tracking error by model", f"rms after the first {SETTLING:g} s.", (bars,)),
        ),
        verdict,
    )  # fmt: skip


def _spoilt(runs: Sequence[Tracking]) -> Verdict | None:
    """That figures do not count, where they do not."""
    said = tuple(
        f"{run.name}: {run.late} of {len(run.time)} cycles began late, {1 - run.helped:.1%} had no feed-forward."
        for run in runs
        if run.spoilt
    )
    if not said:
        return None
    return Verdict("These figures do not count: the computer was too slow.", (*said, f"Next: {AGAIN}"))


def _compared(what: str, found: Ratio, than: str) -> str:
    if found.high < 1.0:
        return f"{what} {1 / found.value:.2g} times as well as {than}."
    if found.low > 1.0:
        return f"{what} worse than {than}: {found.value:.2g} times the error."
    return f"{what} as well as {than}: no difference that this run can show."


def _in_words(found: Ratio) -> str:
    return f"{found.value:.2g} [{found.low:.2g}, {found.high:.2g}]"


def _errors(*runs: Tracking) -> str:
    """Platform errors of runs in turn, by the encoders and in truth."""
    seen, true = (" → ".join(f"{value * 1e3:.3g}" for value in values) for values in (
        [run.platform_rms for run in runs], [run.true_rms for run in runs],
    ))  # fmt: skip
    names = " → ".join(run.name for run in runs)
    return f"{seen} mm rms by the encoders ({names}), {true} mm in truth"
