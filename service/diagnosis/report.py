"""report.html: one file, no network, interactive and fit for print."""

from __future__ import annotations

from html import escape
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs
from plotly.subplots import make_subplots
from scipy.signal import welch

from schemas.diagnosis import Diagnosis
from schemas.files import write_text
from service.diagnosis.description import in_units_of
from service.diagnosis.diagnose import Findings
from service.diagnosis.hypothesis import Hypothesis, predict
from service.diagnosis.scene import Scene
from service.diagnosis.statistics import joint_of
from service.diagnosis.text import paragraphs
from service.diagnosis.where import Rows

COLOURS = {"before": "#b0b7c3", "after": "#1f6feb", "noise": "#d0d7de"}
EFFECTS = ("#1f6feb", "#2da44e", "#8250df", "#bf8700")
BINS = 24
MOST_POINTS = 5000  # a line
CONFIG = {"responsive": True, "displaylogo": False}
# plots take the width of the page before it is printed, and that of the window again after
PRINT = """
const fit=w=>document.querySelectorAll('.js-plotly-plot').forEach(p=>Plotly.relayout(p,w?{width:w}:{autosize:true}));
addEventListener('beforeprint',()=>fit(690));addEventListener('afterprint',()=>fit(0));
"""
STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#1f2328;max-width:1080px;margin:2rem auto;padding:0 1rem}
h1{font-size:1.5rem;margin-bottom:.2rem} h2{font-size:1.15rem;margin:2rem 0 .4rem;border-bottom:1px solid #d0d7de}
table{border-collapse:collapse;width:100%;font-size:.92em} td,th{padding:.25rem .6rem;border-bottom:1px solid #eaeef2;
text-align:left} td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}
.verdict{font-size:1.1rem;padding:.7rem 1rem;
border-left:5px solid #1f6feb;background:#f6f8fa} .muted{color:#59636e;font-size:.9em}
@media print{body{max-width:none;margin:0;padding:0;font-size:12px} h2{break-after:avoid}
.plot,table{break-inside:avoid}
.modebar{display:none!important}}
@page{size:A4;margin:14mm 12mm}
"""


def write_report(findings: Findings, document: Diagnosis, path: Path) -> None:
    """Write the report of a diagnosis."""
    verdict, *groups = paragraphs(document)
    plots = [
        ("Gap over time, before and after", _over_time(findings)),
        ("What the gap is made of", _budget(document)),
        ("Where it sits", _regimes(document)),
        ("Over angle and speed", _maps(findings)),
        ("Over the workspace", _workspace(findings)),
        ("Which effect", _ranking(document)),
        ("Spectrum of what is left", _spectrum(findings)),
    ]
    body = [
        f"<h1>Gap diagnosis of {escape(document.robot)}</h1>",
        f"<p class=muted>{escape(', '.join(document.traces))} · below {document.gap.band_hz:g} Hz, while joints move "
        f"({100 * document.where['left_out_at_rest_and_ends']:.0f} % left out at rest and at the ends)</p>",
        f"<p class=verdict><b>{document.verdict.replace('_', ' ')}</b><br>{escape(' '.join(verdict))}</p>",
        *(f"<p>{'<br>'.join(escape(line) for line in group)}</p>" for group in groups),
        _gap_table(document),
        _effect_table(document),
    ]
    for title, figure in plots:
        if figure is not None:
            figure.update_layout(template="plotly_white", margin={"l": 60, "r": 20, "t": 40, "b": 45}, font_size=12)
            html = figure.to_html(full_html=False, include_plotlyjs=False, config=CONFIG)
            body.append(f"<h2>{title}</h2><div class=plot>{html}</div>")
    body.append(_base_table(document))
    page = (
        "<!doctype html><html lang=en><head><meta charset=utf-8><meta name=viewport content='width=device-width'>"
        f"<title>Gap diagnosis of {escape(document.robot)}</title><style>{STYLE}</style>"
        f"<script>{get_plotlyjs()}</script></head><body>{''.join(body)}<script>{PRINT}</script></body></html>"
    )
    write_text(path, page)


def _row(cells: list[str], tag: str = "td") -> str:
    return "<tr>" + "".join(f"<{tag}{' class=n' if i else ''}>{cell}</{tag}>" for i, cell in enumerate(cells)) + "</tr>"


def _gap_table(document: Diagnosis) -> str:
    gap = document.gap
    head = _row(
        [f"rms on runs left out, {gap.unit}", "before", "after", "noise", "friction steps between samples"], "th"
    )
    columns = (gap.before_nm, gap.after_nm, gap.noise_floor_nm, gap.reversal_nm)
    rows = ""
    for joint in range(len(gap.before_nm)):
        rows += _row([f"joint {joint + 1}", *(f"{column[joint]:.4f}" for column in columns)])
    low, high = gap.shrink_ci95
    total = f"<p>Shrink {100 * gap.shrink:.1f} % [{100 * low:.1f}, {100 * high:.1f}] of the whole"
    if gap.shrink_of_explainable is not None:
        total += f"; {100 * gap.shrink_of_explainable:.0f} % of the energy that stood above the noise"
    return f"<h2>How far it shrinks</h2><table>{head}{rows}</table>{total}.</p>"


def _effect_table(document: Diagnosis) -> str:
    if not document.effects:
        return ""
    head = _row(["effect", "joints", "parameter", "value", "95 % interval", "unit"], "th")
    rows = ""
    for effect in document.effects:
        for key, estimate in effect.parameters.items():
            low, high = estimate.ci95
            place = ", ".join(map(str, effect.joints)) or "robot"
            cells = [effect.name, place, key, f"{estimate.value:.4g}", f"{low:.4g} … {high:.4g}", estimate.unit]
            rows += _row([escape(cell) for cell in cells])
    online = "".join(f"<li>{escape(e.name)}: {escape(e.online)}</li>" for e in document.effects)
    return f"<h2>Parameters</h2><table>{head}{rows}</table><p>Online model:</p><ul>{online}</ul>"


def _base_table(document: Diagnosis) -> str:
    head = _row(["base model, refitted together", "value", "95 % interval", "unit"], "th")
    rows = "".join(
        _row([escape(name), f"{e.value:.5g}", f"{e.ci95[0]:.5g} … {e.ci95[1]:.5g}", escape(e.unit)])
        for name, e in document.base.items()
    )
    return f"<h2>Base model</h2><table>{head}{rows}</table>"


def _over_time(findings: Findings) -> go.Figure:
    problem, n, unit = findings.problem, len(findings.problem.sigma), in_units_of(findings.robot, "N m")
    figure = make_subplots(rows=n, cols=1, shared_xaxes=True, vertical_spacing=0.04)
    joints = joint_of(problem)
    for name, residuals in (("before", findings.before), ("after", findings.after)):
        for joint in range(n):
            time, value = [], []
            for index, recording in enumerate(problem.recordings):
                clock = recording.segment.time[:: problem.band.step][problem.rows[index][:, joint]]
                gap = np.flatnonzero(np.diff(clock) > 3 * problem.band.period * problem.band.step) + 1
                errors = residuals[index][joints[index] == joint] * problem.sigma[joint]
                clock, errors, gap = _thinned(clock, errors, gap, -(-problem.count // n // MOST_POINTS))
                time += [np.insert(clock, gap, np.nan), [np.nan]]
                value += [np.insert(errors, gap, np.nan), [np.nan]]
            trace = go.Scatter(
                x=np.round(np.concatenate(time), 3), y=np.round(np.concatenate(value), 4), name=name,
                line={"width": 1, "color": COLOURS[name]}, legendgroup=name, showlegend=joint == 0,
            )  # fmt: skip
            figure.add_trace(trace, row=joint + 1, col=1)
            figure.update_yaxes(title_text=f"joint {joint + 1}, {unit}", row=joint + 1, col=1)
    figure.update_xaxes(title_text="time on the log's clock, s", row=n, col=1)
    figure.update_layout(height=190 * n + 60, legend={"orientation": "h", "y": 1.06})
    return figure


def _thinned(
    clock: np.ndarray, errors: np.ndarray, gap: np.ndarray, step: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The largest of every `step` errors between two breaks, so that peaks stay; breaks before the rows `gap`."""
    kept = (
        [
            block[np.argmax(np.abs(errors[block]))]
            for part in np.split(np.arange(len(clock)), gap)
            for block in np.array_split(part, -(-len(part) // step))
            if len(block)
        ]
        if len(clock)
        else []
    )
    return clock[kept], errors[kept], np.searchsorted(kept, gap)


def _budget(document: Diagnosis) -> go.Figure:
    figure = go.Figure()
    joints = [f"joint {entry['joint']}" for entry in document.where["joints"]]
    parts = list(dict.fromkeys(name for entry in document.where["joints"] for name in entry["budget_nm2"]))
    fixed = {"noise": "#d0d7de", "reversals": "#b0b7c3", "unexplained": "#cf222e", "timing": "#8c959f"}
    spare = iter(EFFECTS)
    for part in sorted(parts, key=lambda name: list(fixed).index(name) if name in fixed else -1):
        values = [entry["budget_nm2"].get(part, 0.0) for entry in document.where["joints"]]
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
    entries = [(e["joint"], r) for e in document.where["joints"] for r in e["before"][:4] if r["share"] > r["of_time"]]
    if not entries:
        return None
    labels = [f"joint {joint}: {regime['regime']}" for joint, regime in entries][::-1]
    figure = go.Figure()
    figure.add_bar(
        y=labels,
        x=[100 * r["share"] for _, r in entries][::-1],
        orientation="h",
        name="of the gap",
        marker_color=COLOURS["after"],
    )
    figure.add_bar(
        y=labels, x=[100 * r["of_time"] for _, r in entries][::-1], orientation="h", name="of the time",
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
    rows = Rows.of(findings.problem, findings.best.hypothesis)
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
    rows = Rows.of(findings.problem, findings.best.hypothesis)
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
    entries += [("none", document.probability_none), ("structure beyond the catalogue", document.probability_unknown)]
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
        level = findings.noise[joint] ** 2 * 2 * findings.problem.band.period
        figure.add_hline(y=float(np.sqrt(level)), line_dash="dot", line_color="#59636e", row=1, col=joint + 1)  # pyright: ignore[reportArgumentType]
    figure.update_xaxes(type="log", title_text="Hz")
    figure.update_yaxes(type="log")
    figure.update_yaxes(title_text=f"{in_units_of(findings.robot, 'N m')} / √Hz", col=1)
    figure.update_layout(height=340, legend={"orientation": "h", "y": 1.2})
    return figure


def _density(findings: Findings, hypothesis: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
    total, weight, frequency = 0.0, 0, np.zeros(0)
    for recording in findings.problem.recordings:
        residual = recording.segment.torque - predict(Scene(recording, hypothesis.base), hypothesis)
        if len(residual) >= 512:
            frequency, density = welch(residual, 1.0 / recording.segment.period, nperseg=512, axis=0)
            total, weight = total + density * len(residual), weight + len(residual)
    return np.round(frequency[1:], 2), np.sqrt(np.asarray(total)[1:] / max(weight, 1))
