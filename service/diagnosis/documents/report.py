"""report.html: one file, no network, interactive and fit for print."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from schemas.diagnosis import Diagnosis
from schemas.words import percent, significant, words
from service.diagnosis.documents.headline import headline
from service.diagnosis.documents.over_time import gap_over_time, worst_second
from service.diagnosis.documents.text import (
    ONLINE,
    answer,
    base_in_words,
    in_words,
    of_candidates,
    paragraphs,
    share_of_gap,
)
from service.diagnosis.evidence.where import RowStates
from service.diagnosis.findings import Findings
from service.identification.frequency import cross_density
from service.model.description import in_units_of
from service.model.hypothesis import Hypothesis
from service.model.torque import predict
from service.pages import Headline, logarithmic, under_buttons, write_page
from service.pages.palette import EFFECTS, Colour

BINS = 24
COLUMNS = 3  # of joints next to each other: a phone has room for no more
BETWEEN = 58  # px between rows of plots, for ticks and the title of the joint below
WINDOW = 512  # samples of a spectrum, where a run has as many
FIXED = {
    "noise": Colour.NOISE, "reversals": Colour.REVERSAL, "unexplained": Colour.FAULT, "refit": Colour.REFITTED,
}  # fmt: skip
CANDIDATES = "Candidates, and whether the checks accepted them"


def write_report(findings: Findings, document: Diagnosis, path: Path, said: Headline | None = None) -> None:
    """Write the report of a diagnosis. said: what it says first, where that names files (`headline`)."""
    plots = {
        "Gap over time, before and after": gap_over_time(findings),
        **of_document(document),
        "Residual over angle and speed": _maps(findings),
        "Residual over the workspace": _workspace(findings),
        "Spectrum of the residual (grey: above the analysis band)": _spectrum(findings),
    }
    write_diagnosis(document, worst_second(findings), plots, path, said)


def of_document(document: Diagnosis) -> dict[str, go.Figure | None]:
    """What is drawn of the document alone, by title."""
    return {
        "Gap of each joint": levels(document),
        "Composition of the gap": _budget(document),
        "Where the gap lies": _regimes(document),
        CANDIDATES: _ranking(document),
        "Frequency response from torque to speed": _response(document),
    }


def write_diagnosis(
    document: Diagnosis, first: tuple[str, go.Figure] | None, plots: dict[str, go.Figure | None], path: Path,
    said: Headline | None = None,
) -> None:  # fmt: skip
    """Write the page of a document with plots by title, the `first` of them open. said: see `write_report`."""
    _, *rest = paragraphs(document, figures=False)
    write_page(
        "diagnosis", path, said or headline(document), document=document, answer=answer(document), paragraphs=rest,
        first=first, plots=plots, notes={CANDIDATES: of_candidates(document)}, said=ONLINE, in_words=in_words,
        base_in_words=base_in_words, share_of_gap=share_of_gap,
    )  # fmt: skip


def levels(document: Diagnosis) -> go.Figure:
    """The gap of each joint before and after."""
    figure, gap = go.Figure(), document.gap
    for name, values in (("before", gap.before_nm), ("after", gap.after_nm), ("noise", gap.noise_floor_nm)):
        figure.add_bar(
            x=[f"joint {joint + 1}" for joint in range(len(values))], y=values, name=name,
            marker_color=Colour[name.upper()],
            text=[significant(value) for value in values], textposition="outside", cliponaxis=False,
        )  # fmt: skip
    top = max(*gap.before_nm, *gap.after_nm, *gap.noise_floor_nm, 1e-9)
    figure.update_yaxes(title_text=f"rms gap, {gap.unit}", range=[0, 1.18 * top])
    figure.update_layout(under_buttons(270))
    return figure


def _budget(document: Diagnosis) -> go.Figure:
    figure = go.Figure()
    joints = [f"joint {entry.joint}" for entry in document.where.joints]
    parts = list(dict.fromkeys(name for entry in document.where.joints for name in entry.budget_nm2))
    spare = cycle(EFFECTS)
    for part in sorted(parts, key=lambda name: list(FIXED).index(name) if name in FIXED else -1):
        values = [entry.budget_nm2.get(part, 0.0) for entry in document.where.joints]
        if part in FIXED and not any(values):
            continue
        figure.add_bar(
            y=joints,
            x=values,
            name=words(part),
            orientation="h",
            marker_color=FIXED.get(part) or next(spare),
        )
    figure.update_layout(barmode="stack", **under_buttons(140 + 55 * len(joints)))
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
        marker_color=Colour.BEFORE,
    )
    figure.add_bar(
        y=labels, x=[100 * r.of_time for _, r in entries][::-1], orientation="h", name="of the time",
        marker_color=Colour.MEASURED,
    )  # fmt: skip
    figure.update_layout(barmode="group", **under_buttons(130 + 34 * len(labels)))
    figure.update_xaxes(title_text="%")
    figure.update_yaxes(automargin=True)
    return figure


def _cell(joint: int, rows: int = 1, line: int = 0) -> tuple[int, int]:
    """Row and column, from 1, of a line of plots of a joint, from 0, which has so many `rows` of them."""
    block, column = divmod(joint, COLUMNS)
    return rows * block + line + 1, column + 1


def _by_joint(joints: int, rows: int, height: float, **more: Any) -> go.Figure:
    """Axes in `rows` for each joint, the joints next to each other as far as a phone is wide, in a plot `height` px
    high. more: as for Plotly's subplots."""
    columns, blocks = min(joints, COLUMNS), -(-joints // COLUMNS)
    there = [[block * COLUMNS + column < joints for column in range(columns)] for block in range(blocks)]
    cells = [block for block in there for _ in range(rows)]
    titles = [
        f"joint {block * COLUMNS + column + 1}" if row == 0 else ""
        for block in range(blocks) for row in range(rows) for column in range(columns) if there[block][column]
    ]  # fmt: skip
    return make_subplots(
        rows=rows * blocks, cols=columns, subplot_titles=titles, vertical_spacing=BETWEEN / height,
        specs=[[{} if one else None for one in line] for line in cells], **more,
    )  # fmt: skip


def _mean_map(x: np.ndarray, y: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    edges = (np.linspace(x.min(), x.max() + 1e-9, BINS + 1), np.linspace(y.min(), y.max() + 1e-9, BINS + 1))
    total, *_ = np.histogram2d(x, y, bins=edges, weights=value)
    count, *_ = np.histogram2d(x, y, bins=edges)
    mean = np.where(count > 2, total / np.maximum(count, 1), np.nan)
    return edges[0][:-1], edges[1][:-1], np.round(mean.T, 4)


def _maps(findings: Findings) -> go.Figure:
    rows = RowStates.of(findings.problem, findings.best.hypothesis)
    n = len(findings.problem.sigma)
    blocks = -(-n // COLUMNS)
    height = 480 * blocks + 80
    figure = _by_joint(n, 2, height, row_titles=["before", "after"] * blocks)
    for line, residuals in enumerate((findings.before, findings.after)):
        residual = np.concatenate(residuals)
        for joint in range(n):
            mine = rows.joint == joint
            if not mine.any():
                continue
            x, y, z = _mean_map(rows.theta[mine], rows.speed[mine], residual[mine] * findings.problem.sigma[joint])
            row, column = _cell(joint, 2, line)
            figure.add_trace(go.Heatmap(x=x, y=y, z=z, coloraxis="coloraxis"), row=row, col=column)
            if line and joint + COLUMNS >= n:
                title = f"position, {in_units_of(findings.robot, 'rad')}"
                figure.update_xaxes(title_text=title, row=row, col=column)
    figure.update_yaxes(title_text=f"speed, {in_units_of(findings.robot, 'rad/s')}", col=1)
    limit = float(np.quantile(np.abs(np.concatenate(findings.before)), 0.97) * findings.problem.sigma.max())
    figure.update_layout(
        height=height,
        margin={"t": 80},
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
        height=420,
        margin={"t": 80},
        coloraxis={"colorscale": "Blues", "cmin": 0, "cmax": top, "colorbar": {"title": "rms, N m"}},
    )
    return figure


def _ranking(document: Diagnosis) -> go.Figure | None:
    """Candidates by what they do to the gap on held-out data, accepted or not: a measure of the robot, while how
    probable one is among others says nothing where none of them is accepted."""
    if not document.ranking:
        return None
    accepted = {effect.name for effect in document.effects}
    figure, ranked = go.Figure(), sorted(document.ranking, key=lambda one: -one.shrink)
    for kind, colour, named in (("accepted", Colour.AFTER, True), ("not accepted", Colour.FAULT, False)):
        mine = [one for one in ranked if (one.name in accepted) is named]
        if mine:
            figure.add_bar(
                y=[words(one.name) for one in mine], x=[100 * one.shrink for one in mine], orientation="h", name=kind,
                marker_color=colour, text=[percent(one.shrink) for one in mine], textposition="outside",
                cliponaxis=False,
            )  # fmt: skip
    low, high = min(0.0, 100 * ranked[-1].shrink), max(1.0, 100 * ranked[0].shrink)
    room = 0.25 * (high - low)  # for the texts at the ends of bars
    figure.update_layout(showlegend=True, **under_buttons(130 + 26 * len(ranked)))
    figure.update_xaxes(title_text="shrink of the gap, %", range=[low - room * (low < 0), high + room])
    names = [words(one.name) for one in ranked]
    figure.update_yaxes(automargin=True, categoryorder="array", categoryarray=names[::-1])
    return figure


def _response(document: Diagnosis) -> go.Figure | None:
    """Magnitude, phase and coherence of each joint, measured and of the models before and after."""
    every = document.frequency_response
    if not every:
        return None
    blocks = -(-len(every) // COLUMNS)
    height = 480 * blocks + 80
    figure = _by_joint(len(every), 3, height, shared_xaxes=True, row_heights=[0.45, 0.3, 0.25] * blocks)
    for number, one in enumerate(every):
        (row, column), first = _cell(number, 3), number == 0
        for name, magnitude in one.magnitude.items():
            look = {"color": Colour[name.upper()], "width": 2 if name == "measured" else 1.3}
            shared = {"x": one.hz, "name": name, "legendgroup": name, "line": look}
            figure.add_trace(go.Scatter(y=magnitude, showlegend=first, **shared), row=row, col=column)
            figure.add_trace(go.Scatter(y=one.phase_deg[name], showlegend=False, **shared), row=row + 1, col=column)
        coherence = go.Scatter(
            x=one.hz, y=one.coherence, name="coherence", showlegend=first, line={"color": Colour.NOISE}
        )
        figure.add_trace(coherence, row=row + 2, col=column)
        if number + COLUMNS >= len(every):
            figure.update_xaxes(title_text="frequency, Hz", row=row + 2, col=column)
    logarithmic(figure, "x")
    for row in range(1, 3 * blocks, 3):
        logarithmic(figure, "y", row=row)
        figure.update_yaxes(row=row + 1, range=[-180, 180], tickvals=[-180, -90, 0, 90, 180])
        figure.update_yaxes(row=row + 2, range=[-0.15, 1.05])  # so that 0 and the first frequency stand apart
        for below, title in enumerate((every[0].unit, "phase, °", "coherence")):
            figure.update_yaxes(title_text=title, row=row + below, col=1)
    figure.update_layout(under_buttons(height, titles=True))
    return figure


def _spectrum(findings: Findings) -> go.Figure:
    n = len(findings.problem.sigma)
    height = 300 * -(-n // COLUMNS) + 70
    figure = _by_joint(n, 1, height, shared_yaxes="all")
    for name, hypothesis in (("before", findings.plain.hypothesis), ("after", findings.best.hypothesis)):
        frequency, density = _density(findings, hypothesis)
        for joint in range(n):
            trace = go.Scatter(
                x=frequency, y=density[:, joint], name=name, legendgroup=name, showlegend=joint == 0,
                line={"width": 1.3, "color": Colour[name.upper()]},
            )  # fmt: skip
            row, column = _cell(joint)
            figure.add_trace(trace, row=row, col=column)
    for joint in range(n):
        level = float(np.sqrt(findings.noise[joint] ** 2 * 2 * findings.problem.band.period))
        noise = go.Scatter(
            x=frequency[[0, -1]], y=[level] * 2, name="noise", legendgroup="noise", showlegend=joint == 0,
            mode="lines", line={"dash": "dot", "color": Colour.NOISE},
        )  # fmt: skip
        row, column = _cell(joint)
        figure.add_trace(noise, row=row, col=column)
        if joint + COLUMNS >= n:
            figure.update_xaxes(title_text="frequency, Hz", row=row, col=column)
    figure.add_vrect(x0=findings.problem.band.cutoff_hz, x1=frequency[-1], fillcolor="#59636e", opacity=0.08)
    logarithmic(figure, "x")
    logarithmic(figure, "y")
    figure.update_yaxes(title_text=f"{in_units_of(findings.robot, 'N m')} / √Hz", col=1)
    figure.update_layout(under_buttons(height, titles=True))
    return figure


def _density(findings: Findings, hypothesis: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
    total, weight, frequency = 0.0, 0, np.zeros(0)
    window = min(WINDOW, max(len(recording.segment.time) for recording in findings.problem.recordings))
    for recording in findings.problem.recordings:
        residual = recording.segment.torque - predict(hypothesis.seen(recording), hypothesis)
        if len(residual) >= window:
            frequency, density = cross_density(residual, residual, recording.segment.period, window)
            total, weight = total + np.real(density) * len(residual), weight + len(residual)
    return np.round(frequency[1:], 2), np.sqrt(np.asarray(total)[1:] / max(weight, 1))
