"""blindtest.html: how good the diagnosis is, in figures and plots, one file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from schemas.words import counted, significant, words
from service import pages
from service.diagnosis.sealed_cases import confusion
from service.pages import Headline
from service.pages.palette import Colour

BOUNDS = {
    "right_first": ("right effect first (single, findable)", "≥ 0.97"),
    "right_joint": ("right joint", "≥ 1.0"),
    "extra_per_case": ("effects falsely named per case", "≤ 0.03"),
    "null_clean": ("gap-free logs reported as within noise", "≥ 0.99"),
    "unknown_said": ("cause outside the catalogue: reported as such", "≥ 0.90"),
    "pair_both": ("two effects: both named", "≥ 0.90"),
    "after_over_floor_median": ("gap after correction over noise floor, median", "≤ 1.3"),
    "claim_error_median": ("difference between claimed and measured shrink, median", "≤ 0.015"),
    "claim_error_p90": ("difference between claimed and measured shrink, 90 % quantile", "≤ 0.06"),
    "three_f1": ("three effects: mean F1 of the names", "≥ 0.90"),
    "three_first": ("three effects: first name true", "≥ 0.95"),
    "three_extra": ("three effects: effects falsely named per case", "≤ 0.15"),
    "outside_f1": ("two effects and one outside the catalogue: mean F1 of the two", "≥ 0.75"),
    "outside_said": ("two effects and one outside the catalogue: reported as partly unexplained", "≥ 0.95"),
    "outside_extra": ("two effects and one outside the catalogue: effects falsely named per case", "≤ 0.2"),
    "description_right": ("wrong description: reported as such, or no effect named", "≥ 0.95"),
    "description_extra": ("wrong description: effects falsely named per case", "≤ 0.05"),
    "production_told": ("production logs: first name true, or the true one among its alternatives", "≥ 0.95"),
    "production_first": ("production logs: first name true", "≥ 0.80"),
    "scope_first": ("recorded by a scope: first name true", "≥ 0.90"),
    "scope_explained": ("recorded by a scope: explained", "≥ 0.80"),
    "calibration": ("share of true names among those with a probability of 90 to 100 %", "≥ 0.90"),
    "seconds_median": ("seconds per case, median", "≤ 6"),
}
OF_SPEED = {"seconds_median"}  # the first case also compiles the kernels
LIFTS = ((0.0, 1.1), (1.1, 1.5), (1.5, 2.5), (2.5, 5.0), (5.0, float("inf")))


def write_page(
    rows: list[dict[str, Any]], summary: dict[str, Any], refused: list[str], commitment: str, path: Path
) -> None:
    """Write the page."""
    figures = [(label, _shown(summary[key]), summary["counts"][key], bound) for key, (label, bound) in BOUNDS.items()]
    kinds = {row["kind"] for row in rows if "error" not in row}
    plots = {"Confusion matrix": _confusion(rows)} if kinds & {"catalogue", "unknown", "null"} else {}
    plots |= {"Detection by ratio of gap to noise floor": _detection(rows)} if "catalogue" in kinds else {}
    plots["Shrink, claimed and measured"] = _claims(rows)
    fields: dict[str, Any] = {
        "rows": rows,
        "refused": refused,
        "figures": figures,
        "plots": plots,
    }
    pages.write_page("blindtest", path, headline(summary), commitment=commitment, **fields)


def headline(summary: dict[str, Any]) -> Headline:
    """Whether the bounds hold."""
    late, held = missed(summary), [key for key in BOUNDS if key not in OF_SPEED and summary[key] is not None]
    cases = f"bounds hold over {counted(summary['cases'], 'case')}"
    if summary["failed"]:
        cases += f", {summary['failed']} of which failed"
    number = f"{len(held) - len(late)} of {len(held)}"
    if not held:
        return Headline("open", "There is no case to judge.", number, cases, "run it with more --cases.")
    if not late:
        said = "The diagnosis meets every bound for which there were cases."
        return Headline(
            "good", said, number, cases, "more --cases narrow the intervals; another --seed repeats the test."
        )
    said = f"The diagnosis misses {counted(len(late), 'bound')}: {'; '.join(late)}."
    return Headline(
        "bad", said, number, cases, "find a case whose answer differs from the truth, and diagnose its logs."
    )


def missed(summary: dict[str, Any]) -> list[str]:
    """Figures of `BOUNDS` that do not hold; one without a case does not count, nor does one of the machine's speed."""
    late = []
    for key, (label, bound) in BOUNDS.items():
        if key in OF_SPEED:
            continue
        sign, number = bound.split()
        value = summary[key]
        if value is not None and not (value >= float(number) if sign == "≥" else value <= float(number)):
            late.append(label)
    return late


def _shown(value: float | None) -> str:
    return "no such case" if value is None else significant(value)


def _confusion(rows: list[dict[str, Any]]) -> go.Figure:
    truth, answer, table = confusion(rows)
    truth, answer = [words(name) for name in truth], [words(name) for name in answer]
    text = [[str(v) if v else "" for v in line] for line in table]
    figure = go.Figure(
        go.Heatmap(x=answer, y=truth, z=table, text=text, texttemplate="%{text}", colorscale="Blues", showscale=False)
    )
    figure.update_yaxes(autorange="reversed", title_text="truth", automargin=True)
    figure.update_xaxes(title_text="named first", tickangle=-90, automargin=True)
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
    figure.add_bar(x=labels, y=hits, text=counts, textposition="outside", marker_color=Colour.AFTER)
    figure.update_xaxes(title_text="gap over noise floor")
    figure.update_yaxes(title_text="right effect first, %", range=[0, 115])
    figure.update_layout(height=340)
    return figure


def _claims(rows: list[dict[str, Any]]) -> go.Figure:
    good = [row for row in rows if "error" not in row]
    figure = go.Figure()
    figure.add_scatter(
        x=[row["shrink"] for row in good], y=[row["claimed"] for row in good], mode="markers", showlegend=False,
        marker={"color": Colour.AFTER},
        text=[f"{words(row['case'])}: {', '.join(map(words, row['truth'])) or 'none'}" for row in good],
    )  # fmt: skip
    figure.add_scatter(
        x=[0, 1], y=[0, 1], mode="lines", line={"dash": "dot", "color": Colour.MEASURED}, showlegend=False
    )
    figure.update_xaxes(title_text="shrink measured on test logs")
    figure.update_yaxes(title_text="shrink claimed")
    figure.update_layout(height=420)
    return figure
