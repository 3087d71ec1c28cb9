"""Measured and predicted torque over time, and the gap between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from service.diagnosis.findings import Findings
from service.model.description import in_units_of
from service.pages import under_buttons
from service.pages.palette import Colour

MOST_NAMES = 12  # on the time axis
MOST_LETTERS = 24  # of each
WORST_S = 1.0  # that are shown first
ROW_HEIGHT, GAP_HEIGHT = 190, 100  # px, of a joint, and of its gap below it
BETWEEN = 20  # px between rows


def worst_second(findings: Findings) -> tuple[str, go.Figure] | None:
    """Title and plot: measured torque and both models on held-out data, and below each joint its gap, in the log whose
    second has the largest gap over the noise, zoomed to that second. None without a row."""
    place = _worst(findings)
    if place is None:
        return None
    index, begin = place
    problem, n, unit = findings.problem, len(findings.problem.sigma), in_units_of(findings.robot, "N m")
    recording = problem.recordings[index]
    clock = recording.segment.time[:: problem.band.step]
    near = (clock >= begin) & (clock < begin + WORST_S)
    height = (ROW_HEIGHT + GAP_HEIGHT) * n + 120
    figure = make_subplots(
        rows=2 * n, cols=1, shared_xaxes=True, vertical_spacing=BETWEEN / height,
        row_heights=[ROW_HEIGHT, GAP_HEIGHT] * n,
    )  # fmt: skip
    limits = []
    for joint in range(n):
        torque, gap = _lines(findings, index, joint)
        for row, (lines, title) in enumerate(((torque, f"joint {joint + 1}"), (gap, "gap")), 2 * joint + 1):
            for name, values in lines.items():
                figure.add_scatter(
                    x=clock, y=values, name=name, legendgroup=name, showlegend=row == 1,
                    line={"width": 1.4, "color": Colour[name.upper()]}, row=row, col=1,
                )  # fmt: skip
            figure.update_yaxes(title_text=f"{title}, {unit}", row=row, col=1)
            limits.append(_around(np.concatenate([values[near] for values in lines.values()])))
    whole, ends = [clock[0], clock[-1]], [begin, begin + WORST_S]
    zoomed, all_of_it = _axes(ends, limits), _axes(whole, [None] * len(limits))
    buttons = [
        {"label": label, "method": "relayout", "args": [ranges]}
        for label, ranges in (("worst second", zoomed), ("whole log", all_of_it))
    ]
    figure.update_layout(
        **under_buttons(height, titles=True),
        updatemenus=[{
            "type": "buttons", "direction": "right", "x": 0, "xanchor": "left", "y": 1.0, "yanchor": "bottom",
            "pad": {"t": 0, "b": 4}, "showactive": False, "buttons": buttons,
        }],
    )  # fmt: skip
    figure.update_layout({key: value for key, value in zoomed.items() if not key.endswith("autorange")})
    figure.update_xaxes(title_text=f"time in {recording.name}, s", row=2 * n, col=1)
    title = f"Measured and predicted torque: the second with the largest gap, {recording.name} from {begin:.2f} s"
    return title, figure


def _lines(findings: Findings, index: int, joint: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Torque of a joint in a recording, and measured minus predicted, by name; NaN where it is not compared."""
    problem = findings.problem
    mine, measured = problem.rows[index][:, joint], problem.target[index][:, joint]
    gap = {}
    for name, residuals in (("before", findings.before), ("after", findings.after)):
        gap[name] = np.full(len(measured), np.nan)
        gap[name][mine] = residuals[index][problem.joints_of_rows[index] == joint] * problem.sigma[joint]
    torque = {name: measured - values for name, values in gap.items()}
    return {"measured": np.where(mine, measured, np.nan), **torque}, gap


def _axes(x: list[float], y: Sequence[list[float] | None]) -> dict[str, object]:
    """Ranges of rows as Plotly sets them."""
    ranges: dict[str, object] = {}
    for number, limits in zip(["", *range(2, len(y) + 1)], y, strict=True):
        ranges[f"xaxis{number}.range"] = [float(one) for one in x]
        ranges |= {f"yaxis{number}.range": limits} if limits else {f"yaxis{number}.autorange": True}
    return ranges


def _around(values: np.ndarray) -> list[float] | None:
    known = values[np.isfinite(values)]
    if not len(known):
        return None
    room = 0.08 * max(float(np.ptp(known)), 1e-6)
    return [float(known.min()) - room, float(known.max()) + room]


def _worst(findings: Findings) -> tuple[int, float] | None:
    """Recording and start, s of its clock, of the second in which the corrected model's gap is largest over the
    noise."""
    problem, found, most = findings.problem, None, 0.0
    for index, recording in enumerate(problem.recordings):
        clock = recording.segment.time[:: problem.band.step]
        square, joints = np.zeros(len(clock)), problem.joints_of_rows[index]
        for joint in range(len(problem.sigma)):
            mine = problem.rows[index][:, joint]
            square[mine] += findings.after[index][joints == joint] ** 2
        total = np.concatenate([[0.0], np.cumsum(square)])
        ends = np.searchsorted(clock, clock + WORST_S)
        inside = total[ends] - total[:-1]
        if len(inside) and inside.max() > most:
            most, begin = float(inside.max()), float(clock[int(inside.argmax())])
            found = index, max(float(clock[0]), min(begin, float(clock[-1]) - WORST_S))
    return found


def gap_over_time(findings: Findings) -> go.Figure:
    """The gap of each joint on held-out data, log after log."""
    problem, n, unit = findings.problem, len(findings.problem.sigma), in_units_of(findings.robot, "N m")
    figure = make_subplots(rows=n, cols=1, shared_xaxes=True, vertical_spacing=0.04)
    joints = problem.joints_of_rows
    shifts, starts, total = _one_after_another(findings)
    for name, residuals in (("before", findings.before), ("after", findings.after)):
        for joint in range(n):
            time, value, own = [], [], []
            for index, recording in enumerate(problem.recordings):
                clock = recording.segment.time[:: problem.band.step][problem.rows[index][:, joint]]
                gap = np.flatnonzero(np.diff(clock) > 3 * problem.band.period * problem.band.step) + 1
                errors = residuals[index][joints[index] == joint] * problem.sigma[joint]
                time += [np.insert(clock + shifts[index], gap, np.nan), [np.nan]]
                own += [np.insert(clock, gap, np.nan), [np.nan]]
                value += [np.insert(errors, gap, np.nan), [np.nan]]
            trace = go.Scatter(
                x=np.concatenate(time), y=np.concatenate(value), name=name,
                line={"width": 1, "color": Colour[name.upper()]}, legendgroup=name, showlegend=joint == 0,
                customdata=np.concatenate(own), hovertemplate="%{customdata} s: %{y}",
            )  # fmt: skip
            figure.add_trace(trace, row=joint + 1, col=1)
            figure.update_yaxes(title_text=f"joint {joint + 1}, {unit}", row=joint + 1, col=1)
    if len(starts) > 1:
        shown = list(starts)[:: -(-len(starts) // MOST_NAMES)]
        figure.update_xaxes(
            tickvals=[starts[name] for name in shown], ticktext=[_short(name) for name in shown], gridcolor="#8c959f",
            range=[-0.01 * total, total],
        )  # fmt: skip
        figure.update_xaxes(title_text="one log after another; hover for the time in a log", row=n, col=1)
    else:
        figure.update_xaxes(title_text=f"time in {next(iter(starts))}, s", row=n, col=1)
    figure.update_layout(under_buttons(ROW_HEIGHT * n + 90))
    return figure


def _short(name: str) -> str:
    """A log's name without its middle: what does not fit on the axis would not be shown at all."""
    half = MOST_LETTERS // 2
    return name if len(name) <= MOST_LETTERS else f"{name[:half]}…{name[-half:]}"


def _one_after_another(findings: Findings) -> tuple[list[float], dict[str, float], float]:
    """s to add to the clock of each recording so that logs follow each other, where each log then begins, and the end.
    A log alone keeps its clock."""
    spans: dict[str, list[float]] = {}
    for recording in findings.problem.recordings:
        clock = recording.segment.time
        span = spans.setdefault(recording.name, [clock[0], clock[-1]])
        span[:] = min(span[0], clock[0]), max(span[1], clock[-1])
    if len(spans) == 1:
        return [0.0] * len(findings.problem.recordings), {name: span[0] for name, span in spans.items()}, 0.0
    starts, at = {}, 0.0
    for name, (first, last) in spans.items():
        starts[name] = at
        at += last - first
    return [starts[r.name] - spans[r.name][0] for r in findings.problem.recordings], starts, at
