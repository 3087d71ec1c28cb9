"""blindtest.html: how good the diagnosis is, in figures and plots, one file."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from schemas.files import write_text
from service.diagnosis.blindtest import confusion
from service.diagnosis.report import CONFIG, PRINT, STYLE

BOUNDS = {
    "right_first": ("right effect first (single, findable)", "≥ 0.90"),
    "right_joint": ("right joint", "≥ 0.95"),
    "extra_per_case": ("effects named that are not there, a case", "≤ 0.10"),
    "null_clean": ("gap-free logs called within noise", "≥ 0.95"),
    "unknown_said": ("outside the catalogue: said so", "≥ 0.90"),
    "pair_both": ("both of a pair named", "≥ 0.75"),
    "after_over_floor_median": ("gap after over noise floor, median", "≤ 1.3"),
    "claim_error_median": ("claimed against measured shrink, median", "≤ 0.03"),
    "claim_error_p90": ("claimed against measured shrink, 90 %", "≤ 0.10"),
    "seconds_median": ("seconds a case, median", "≤ 20"),
}
LIFTS = ((0.0, 1.1), (1.1, 1.5), (1.5, 2.5), (2.5, 5.0), (5.0, float("inf")))


def write_page(rows: list[dict[str, Any]], summary: dict[str, Any], commitment: str, path: Path) -> None:
    """Write the page."""
    table = "".join(
        f"<tr><td>{escape(label)}</td><td class=n>{_shown(summary[key])}</td><td class=n>{bound}</td></tr>"
        for key, (label, bound) in BOUNDS.items()
    )
    figures = [("Confusion", _confusion(rows)), ("Detection against lift", _detection(rows)), ("Shrink", _claims(rows))]
    body = (
        f"<h1>Blind test of the diagnosis</h1><p class=muted>{summary['cases']} cases, {summary['failed']} failed · "
        f"key sealed before the first log was read: {escape(commitment)}</p>"
        f"<table><tr><th>figure</th><th class=n>measured</th><th class=n>bound</th></tr>{table}</table>"
    )
    for title, figure in figures:
        figure.update_layout(template="plotly_white", font_size=11, margin={"t": 30, "r": 20})
        html = figure.to_html(full_html=False, include_plotlyjs=False, config=CONFIG)
        body += f"<h2>{title}</h2><div class=plot>{html}</div>"
    body += f"<h2>Cases</h2><table>{''.join(map(_case, rows))}</table>"
    page = (
        f"<!doctype html><html lang=en><head><meta charset=utf-8><title>Blind test</title><style>{STYLE}</style>"
        f"<script>{get_plotlyjs()}</script></head><body>{body}<script>{PRINT}</script></body></html>"
    )
    write_text(path, page)


def _shown(value: float | None) -> str:
    return "no such case" if value is None else str(value)


def _case(row: dict[str, Any]) -> str:
    if "error" in row:
        return f"<tr><td>{row['case']}</td><td>{escape(row['error'])}</td></tr>"
    named = ", ".join(effect["name"] for effect in row["named"]) or "—"
    cells = [
        row["case"], "+".join(row["truth"]) or "none", f"lift {row['lift']:.2f}", row["verdict"], named,
        f"{row['before_nm']:.3f} → {row['after_nm']:.3f} N m", f"claimed {row['claimed']:.2f}, got {row['shrink']:.2f}",
    ]  # fmt: skip
    return "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>"


def _confusion(rows: list[dict[str, Any]]) -> go.Figure:
    truth, answer, table = confusion(rows)
    text = [[str(v) if v else "" for v in line] for line in table]
    figure = go.Figure(
        go.Heatmap(x=answer, y=truth, z=table, text=text, texttemplate="%{text}", colorscale="Blues", showscale=False)
    )
    figure.update_yaxes(autorange="reversed", title_text="truth", automargin=True)
    figure.update_xaxes(title_text="named first", tickangle=-60, automargin=True)
    figure.update_layout(height=260 + 20 * len(truth))
    return figure


def _detection(rows: list[dict[str, Any]]) -> go.Figure:
    figure = go.Figure()
    good = [row for row in rows if "error" not in row and row["kind"] == "catalogue"]
    labels, hits, counts = [], [], []
    for low, high in LIFTS:
        inside = [row["hit"] for row in good if low <= row["lift"] < high]
        labels.append(f"{low:g} to {high:g}" if high < 1e9 else f"above {low:g}")
        hits.append(100 * sum(inside) / len(inside) if inside else 0.0)
        counts.append(f"{sum(inside)} of {len(inside)}")
    figure.add_bar(x=labels, y=hits, text=counts, textposition="outside")
    figure.update_xaxes(title_text="gap over noise floor")
    figure.update_yaxes(title_text="right effect first, %", range=[0, 115])
    figure.update_layout(height=340)
    return figure


def _claims(rows: list[dict[str, Any]]) -> go.Figure:
    good = [row for row in rows if "error" not in row]
    figure = go.Figure()
    figure.add_scatter(
        x=[row["shrink"] for row in good], y=[row["claimed"] for row in good], mode="markers",
        text=[f"{row['case']} {'+'.join(row['truth']) or 'none'}" for row in good], showlegend=False,
    )  # fmt: skip
    figure.add_scatter(x=[0, 1], y=[0, 1], mode="lines", line={"dash": "dot"}, showlegend=False)
    figure.update_xaxes(title_text="shrink measured on test logs")
    figure.update_yaxes(title_text="shrink claimed")
    figure.update_layout(height=420)
    return figure
