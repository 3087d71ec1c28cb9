"""What a trace holds: rate, jitter, gaps, ranges, what is missing. Figures only; `deltatwin inspect` shows them."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from drivers.trace.quality import GAP_PERIODS
from schemas.columns import CHANNELS
from schemas.messages import SampleFlag
from schemas.trace import Finding, Trace
from service.model.signals import LEAST_S


def survey(trace: Trace) -> dict[str, Any]:
    """Figures of `trace` as plain Python values, ready for JSON: seconds, hertz, rad and N m (m and N if linear)."""
    channels = {}
    for name in CHANNELS:
        values = getattr(trace, name)
        if values is None:
            continue
        for joint in range(values.shape[1]):
            label = f"{name}_{joint + 1}"
            channels[label] = {
                "unit": _unit(trace, name),
                **_stamps(trace.own_time.get(label, trace.time)),
                **_values(values[:, joint], trace.time),
            }
    return {
        "path": str(trace.path),
        "samples": len(trace),
        "joints": trace.position.shape[1],
        "start_s": float(trace.time[0]) + trace.epoch_ns * 1e-9,
        **_stamps(trace.time),
        "missing": [name for name in CHANNELS if getattr(trace, name) is None],
        "flags": {str(flag.name): count for flag in SampleFlag if (count := int(np.count_nonzero(trace.flags & flag)))},
        "flagged": int(np.count_nonzero(trace.flags & ~np.uint32(SampleFlag.NO_COMMAND))),
        "findings": [
            {"flag": finding.flag.name, "message": finding.message, "rows": finding.rows.tolist()}
            for finding in (*trace.findings, *_of_the_whole(trace, channels))
        ],
        "channels": channels,
    }


def is_of_use(figures: dict[str, Any]) -> bool:
    """Whether a joint moves in a log with these figures for as long as a model is fitted to at all."""
    measured = (one for name, one in figures["channels"].items() if re.match(r"position_\d", name))
    return figures["duration_s"] >= LEAST_S and any(map(_moves, measured))


def _moves(channel: dict[str, Any]) -> bool:
    return channel["min"] != channel["max"]


def _of_the_whole(trace: Trace, channels: dict[str, Any]) -> list[Finding]:
    """What no row by itself shows: a log too short for a model, measured channels that never change."""
    notes = []
    duration = float(np.ptp(trace.time))
    if duration < LEAST_S:
        notes.append(f"lasts {duration:.3g} s: a model is fitted to {LEAST_S:g} s or more")
    measured = {name: one for name, one in channels.items() if "command" not in name and one["min"] is not None}
    if constant := [name for name, one in measured.items() if not _moves(one)]:
        still = all(name in constant for name in measured if name.startswith("position"))
        held = f"{', '.join(constant)}: the same value in every row"
        notes.append(f"no joint moves; {held}" if still else held)
    return [Finding.note(note) for note in notes]


def _unit(trace: Trace, channel: str) -> str:
    return {True: ("rad", "N m"), False: ("m", "N")}[trace.angular][channel.startswith("torque")]


def _stamps(time: np.ndarray) -> dict[str, float | int]:
    """jitter: deviation of a step between two stamps from the median step, over steps that are no gap and rise."""
    step = np.diff(time)
    period = float(np.median(step[step > 0]))
    regular = step[(step > 0) & (step <= GAP_PERIODS * period)]
    jitter = np.abs(regular - period)
    return {
        "rate_hz": 1 / period,
        "period_s": period,
        "duration_s": float(time.max() - time.min()),
        "jitter_std_s": float(regular.std()),
        "jitter_p99_s": float(np.percentile(jitter, 99)),
        "jitter_max_s": float(jitter.max()),
        "gaps": int(np.count_nonzero(step > GAP_PERIODS * period)),
        "longest_step_s": float(step.max()),
        "repeats": int(np.count_nonzero(step == 0)),
        "backwards": int(np.count_nonzero(step < 0)),
    }


def _values(values: np.ndarray, time: np.ndarray) -> dict[str, float | int | None]:
    """resolution: the smallest difference that occurs. longest_hold: how long the value did not change a bit."""
    finite = values[np.isfinite(values)]
    figures: dict[str, float | int | None] = {"missing": len(values) - len(finite)}
    if len(finite) == 0:
        return {**figures, "min": None, "max": None, "mean": None, "resolution": None, "longest_hold_s": None}
    levels = np.diff(np.unique(finite))
    starts = np.flatnonzero(np.append(True, values[1:] != values[:-1]))  # NaN differs from NaN: no hold
    ends = np.append(starts[1:], len(values)) - 1
    return {
        **figures,
        "min": float(finite.min()),
        "max": float(finite.max()),
        "mean": float(finite.mean()),
        "resolution": float(levels.min()) if len(levels) else None,
        "longest_hold_s": float(np.max(time[ends] - time[starts])),
    }
