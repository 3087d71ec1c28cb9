"""report.html: one file, no network, interactive and fit for print."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from schemas.diagnosis import Diagnosis
from service.diagnosis.documents.text import ONLINE, answer, base_in_words, in_words, paragraphs
from service.diagnosis.evidence.where import RowStates
from service.diagnosis.findings import Findings
from service.model.description import in_units_of
from service.model.hypothesis import Hypothesis
from service.model.torque import predict
from service.pages import LOG_AXIS, write_page

COLOURS = {"before": "#b0b7c3", "after": "#1f6feb", "noise": "#d0d7de"}
EFFECTS = ("#1f6feb", "#2da44e", "#8250df", "#bf8700")
BINS = 24
MOST_NAMES = 12  # on the time axis
MOST_LETTERS = 24  # of each
MOST_POINTS = 5000  # a line
WINDOW = 512  # samples of a spectrum, where a run has as many


def write_report(findings: Findings, document: Diagnosis, path: Path) -> None:
    """Write the report of a diagnosis."""
    _, *rest = paragraphs(document, figures=False)
    plots = {
        "Gap over time, before and after": _over_time(findings),
        "What the gap is made of": _budget(document),
        "Where it sits": _regimes(document),
        "Over angle and speed": _maps(findings),
        "Over the workspace": _workspace(findings),
        "Which effect": _ranking(document),
        "Spectrum of what is left (grey: above what is analysed)": _spectrum(findings),
    }
    write_page(
        "diagnosis", path, document=document, answer=answer(document), levels=levels(document), paragraphs=rest,
        plots=plots, said=ONLINE, in_words=in_words, base_in_words=base_in_words,
    )  # fmt: skip


def levels(document: Diagnosis) -> go.Figure:
    """The gap of each joint before and after."""
    figure, gap = go.Figure(), document.gap
    for name, values in (("before", gap.before_nm), ("after", gap.after_nm)):
        figure.add_bar(
            x=[f"joint {joint + 1}" for joint in range(len(values))], y=values, name=name, marker_color=COLOURS[name],
            text=[f"{value:.3g}" for value in values], textposition="outside", cliponaxis=False,
        )  # fmt: skip
    figure.update_yaxes(title_text=f"rms gap, {gap.unit}", range=[0, 1.18 * max(*gap.before_nm, *gap.after_nm, 1e-9)])
    figure.update_layout(height=240, legend={"orientation": "h", "y": 1.25})
    return figure


def _over_time(findings: Findings) -> go.Figure:
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
                clock, errors, gap = _thinned(clock, errors, gap, -(-problem.count // n // MOST_POINTS))
                time += [np.insert(clock + shifts[index], gap, np.nan), [np.nan]]
                own += [np.insert(clock, gap, np.nan), [np.nan]]
                value += [np.insert(errors, gap, np.nan), [np.nan]]
            trace = go.Scatter(
                x=np.round(np.concatenate(time), 3), y=np.round(np.concatenate(value), 4), name=name,
                line={"width": 1, "color": COLOURS[name]}, legendgroup=name, showlegend=joint == 0,
                customdata=np.round(np.concatenate(own), 3), hovertemplate="%{customdata} s: %{y}",
            )  # fmt: skip
            figure.add_trace(trace, row=joint + 1, col=1)
            figure.update_yaxes(title_text=f"joint {joint + 1}, {unit}", row=joint + 1, col=1)
    if len(starts) > 1:
        shown = list(starts)[:: -(-len(starts) // MOST_NAMES)]
        figure.update_xaxes(
            tickvals=[starts[name] for name in shown], ticktext=[_short(name) for name in shown], gridcolor="#8c959f",
            range=[-0.01 * total, total],
        )  # fmt: skip
        figure.update_xaxes(title_text="log, each from its beginning; its own time under the pointer", row=n, col=1)
    else:
        figure.update_xaxes(title_text=f"time in {next(iter(starts))}, s", row=n, col=1)
    figure.update_layout(height=190 * n + 60, legend={"orientation": "h", "y": 1.06})
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


def _thinned(
    clock: np.ndarray, errors: np.ndarray, gap: np.ndarray, step: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The largest of every `step` errors between two breaks, so that peaks stay; breaks before the rows `gap`."""
    block, count = np.zeros(len(clock), int), 0
    for start, end in pairwise([0, *gap, len(clock)]):
        blocks = -(-(end - start) // step)
        block[start:end] = count + np.arange(end - start) * blocks // max(end - start, 1)
        count += blocks
    order = np.lexsort((-np.abs(errors), block))  # of each block the largest comes first
    kept = order[np.diff(block[order], prepend=-1) > 0]
    return clock[kept], errors[kept], np.searchsorted(kept, gap)


def _budget(document: Diagnosis) -> go.Figure:
    figure = go.Figure()
    joints = [f"joint {entry.joint}" for entry in document.where.joints]
    parts = list(dict.fromkeys(name for entry in document.where.joints for name in entry.budget_nm2))
    fixed = {"noise": "#d0d7de", "reversals": "#b0b7c3", "unexplained": "#cf222e", "refit": "#8c959f"}
    spare = iter(EFFECTS)
    for part in sorted(parts, key=lambda name: list(fixed).index(name) if name in fixed else -1):
        values = [entry.budget_nm2.get(part, 0.0) for entry in document.where.joints]
        figure.add_bar(
            y=joints,
            x=values,
            name=part.replace("_", " "),
            orientation="h",
            marker_color=fixed.get(part) or next(spare),
        )
    figure.update_layout(barmode="stack", height=110 + 55 * len(joints), legend={"orientation": "h", "y": 1.25})
    figure.update_xaxes(title_text=f"mean square of the gap, ({document.gap.unit})²")
    figure.update_yaxes(autorange="reversed")
    return figure


def _regimes(document: Diagnosis) -> go.Figure | None:
    entries = [(e.joint, r) for e in document.where.joints for r in e.before[:4] if r.share > r.of_time]
    if not entries:
        return None
    labels = [f"joint {joint}: {regime.regime}" for joint, regime in entries][::-1]
    figure = go.Figure()
    figure.add_bar(
        y=labels,
        x=[100 * r.share for _, r in entries][::-1],
        orientation="h",
        name="of the gap",
        marker_color=COLOURS["after"],
    )
    figure.add_bar(
        y=labels, x=[100 * r.of_time for _, r in entries][::-1], orientation="h", name="of the time",
        marker_color=COLOURS["noise"],
    )  # fmt: skip
    figure.update_layout(barmode="group", height=90 + 34 * len(labels), legend={"orientation": "h", "y": 1.12})
    figure.update_xaxes(title_text="%")
    figure.update_yaxes(automargin=True)
    return figure


def _mean_map(x: np.ndarray, y: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    edges = (np.linspace(x.min(), x.max() + 1e-9, BINS + 1), np.linspace(y.min(), y.max() + 1e-9, BINS + 1))
    total, *_ = np.histogram2d(x, y, bins=edges, weights=value)
    count, *_ = np.histogram2d(x, y, bins=edges)
    mean = np.where(count > 2, total / np.maximum(count, 1), np.nan)
    return edges[0][:-1], edges[1][:-1], np.round(mean.T, 4)


def _maps(findings: Findings) -> go.Figure:
    rows = RowStates.of(findings.problem, findings.best.hypothesis)
    n = len(findings.problem.sigma)
    figure = make_subplots(
        rows=2, cols=n, vertical_spacing=0.06,
        subplot_titles=[f"joint {j + 1}" for j in range(n)], row_titles=["before", "after"],
    )  # fmt: skip
    for line, residuals in enumerate((findings.before, findings.after)):
        residual = np.concatenate(residuals)
        for joint in range(n):
            mine = rows.joint == joint
            if not mine.any():
                continue
            x, y, z = _mean_map(rows.theta[mine], rows.speed[mine], residual[mine] * findings.problem.sigma[joint])
            figure.add_trace(go.Heatmap(x=x, y=y, z=z, coloraxis="coloraxis"), row=line + 1, col=joint + 1)
    figure.update_xaxes(title_text=f"position, {in_units_of(findings.robot, 'rad')}", row=2)
    figure.update_yaxes(title_text=f"speed, {in_units_of(findings.robot, 'rad/s')}", col=1)
    limit = float(np.quantile(np.abs(np.concatenate(findings.before)), 0.97) * findings.problem.sigma.max())
    figure.update_layout(
        height=520,
        coloraxis={
            "colorscale": "RdBu",
            "cmin": -limit,
            "cmax": limit,
            "colorbar": {"title": in_units_of(findings.robot, "N m")},
        },
    )
    return figure


def _workspace(findings: Findings) -> go.Figure | None:
    rows = RowStates.of(findings.problem, findings.best.hypothesis)
    if rows.platform is None:
        return None
    figure = make_subplots(rows=1, cols=2, subplot_titles=["before", "after"])
    sigma = findings.problem.sigma[rows.joint]
    top = 0.0
    for column, residuals in enumerate((findings.before, findings.after)):
        x, y, z = _mean_map(rows.platform[:, 0], rows.platform[:, 1], (np.concatenate(residuals) * sigma) ** 2)
        root = np.sqrt(np.maximum(z, 0))
        top = max(top, float(np.nanmax(root)))
        figure.add_trace(go.Heatmap(x=x, y=y, z=np.round(root, 4), coloraxis="coloraxis"), row=1, col=column + 1)
    figure.update_xaxes(title_text="platform x, m")
    figure.update_yaxes(title_text="platform y, m", col=1)
    figure.update_layout(
        height=380, coloraxis={"colorscale": "Blues", "cmin": 0, "cmax": top, "colorbar": {"title": "rms, N m"}}
    )
    return figure


def _ranking(document: Diagnosis) -> go.Figure | None:
    entries = [(entry.name.replace("_", " "), entry.probability) for entry in document.ranking]
    entries += [
        ("none", document.probability_none),
        ("structure beyond the catalogue beside them", document.probability_unknown),
    ]
    figure = go.Figure()
    figure.add_bar(
        y=[name for name, _ in entries][::-1], x=[100 * p for _, p in entries][::-1], orientation="h",
        marker_color=COLOURS["after"], text=[f"{100 * p:.0f} %" for _, p in entries][::-1], textposition="outside",
    )  # fmt: skip
    figure.update_layout(height=90 + 26 * len(entries), showlegend=False)
    figure.update_xaxes(title_text="probability, %", range=[0, 112])
    figure.update_yaxes(automargin=True)
    return figure


def _spectrum(findings: Findings) -> go.Figure:
    n = len(findings.problem.sigma)
    figure = make_subplots(rows=1, cols=n, shared_yaxes=True, subplot_titles=[f"joint {j + 1}" for j in range(n)])
    for name, hypothesis in (("before", findings.plain.hypothesis), ("after", findings.best.hypothesis)):
        frequency, density = _density(findings, hypothesis)
        for joint in range(n):
            trace = go.Scatter(
                x=frequency, y=density[:, joint], name=name, legendgroup=name, showlegend=joint == 0,
                line={"width": 1.3, "color": COLOURS[name]},
            )  # fmt: skip
            figure.add_trace(trace, row=1, col=joint + 1)
    for joint in range(n):
        level = float(np.sqrt(findings.noise[joint] ** 2 * 2 * findings.problem.band.period))
        noise = go.Scatter(
            x=frequency[[0, -1]], y=[level] * 2, name="noise", legendgroup="noise", showlegend=joint == 0,
            mode="lines", line={"dash": "dot", "color": "#59636e"},
        )  # fmt: skip
        figure.add_trace(noise, row=1, col=joint + 1)
    figure.add_vrect(x0=findings.problem.band.cutoff_hz, x1=frequency[-1], fillcolor="#59636e", opacity=0.08)
    figure.update_xaxes(title_text="frequency, Hz", **LOG_AXIS)
    figure.update_yaxes(**LOG_AXIS)
    figure.update_yaxes(title_text=f"{in_units_of(findings.robot, 'N m')} / √Hz", col=1)
    figure.update_layout(height=340, legend={"orientation": "h", "y": 1.2})
    return figure


def _density(findings: Findings, hypothesis: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
    total, weight, frequency = 0.0, 0, np.zeros(0)
    window = min(WINDOW, max(len(recording.segment.time) for recording in findings.problem.recordings))
    for recording in findings.problem.recordings:
        residual = recording.segment.torque - predict(hypothesis.seen(recording), hypothesis)
        if len(residual) >= window:
            frequency, density = welch(residual, recording.segment.period, window)
            total, weight = total + density * len(residual), weight + len(residual)
    return np.round(frequency[1:], 2), np.sqrt(np.asarray(total)[1:] / max(weight, 1))


def welch(values: np.ndarray, period: float, window: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (F,) Hz and spectral density (F, n), a square per Hz, of values (N, n) every `period` s: the mean
    over Hann windows of so many samples, each half over the last and without its mean. As SciPy's, which takes longer
    to import than the report to write."""
    parts = np.lib.stride_tricks.sliding_window_view(values, window, axis=0)[:: window - window // 2]
    taper = np.hanning(window + 1)[:-1]
    spectrum = np.fft.rfft((parts - parts.mean(axis=-1, keepdims=True)) * taper, axis=-1)
    density = (np.abs(spectrum) ** 2).mean(axis=0).T * period / np.sum(taper**2)
    density[1 : (window + 1) // 2] *= 2.0  # of both signs of a frequency
    return np.fft.rfftfreq(window, period), density
