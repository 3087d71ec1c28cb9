"""Figures drawn twice from one description: interactive in a self-contained HTML page, and as PNG and PDF for paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from schemas.files import make_folder, whole
from service import pages

# Okabe and Ito's palette: told apart in print and by colour-blind eyes.
COLOURS = ("#000000", "#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
MOST_POINTS = 4000  # of a line in the HTML page
PANEL_HEIGHT = 180  # px in the page
GAP = 75  # px between two panels, for the upper one's scale and label and the lower one's title


@dataclass(frozen=True)
class Line:
    """One curve: x, y (N,). colour: index into `COLOURS`."""

    name: str
    x: np.ndarray
    y: np.ndarray
    colour: int = 0
    style: Literal["line", "thin", "dashed", "points", "bars"] = "line"


@dataclass(frozen=True)
class Heat:
    """A field z (len(y), len(x)) and what it stands for."""

    name: str
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray


@dataclass(frozen=True)
class Panel:
    """One set of axes. shade: spans of x with something going on."""

    x_label: str
    y_label: str
    lines: tuple[Line, ...] = ()
    title: str = ""
    heat: Heat | None = None
    shade: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Figure:
    """Panels one below the other. name: file name without ending."""

    name: str
    title: str
    caption: str
    panels: tuple[Panel, ...]


@dataclass(frozen=True)
class Table:
    """A table of the page: cells as they are to be read."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


@dataclass(frozen=True)
class Page:
    """What goes into a report, in order."""

    title: str
    lead: tuple[str, ...]  # paragraphs
    parts: tuple[Table | Figure, ...] = field(default=())


def write_page(page: Page, path: Path) -> None:
    """The page as one HTML file that needs nothing else.

    Raises:
        StorageError: it cannot be written.
    """
    pages.write_page("findings", path, page=page, draw=_interactive)


def write_pictures(figures: Sequence[Figure], folder: Path, document: str) -> None:
    """Every figure as PNG, and all of them as the pages of one PDF named `document`.

    Raises:
        StorageError: a file cannot be written.
    """
    from matplotlib.backends.backend_pdf import PdfPages

    make_folder(folder)
    with whole(folder / f"{document}.pdf") as paper, PdfPages(paper) as sheets:
        for figure in figures:
            drawn = _printed(figure)
            with whole(folder / f"{figure.name}.png") as partial:
                drawn.savefig(partial, dpi=150)
            sheets.savefig(drawn)


def _interactive(figure: Figure) -> Any:
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    count = len(figure.panels)
    titles = [panel.title for panel in figure.panels]
    height = PANEL_HEIGHT * count + GAP * (count - 1)
    drawn: Any = make_subplots(rows=count, cols=1, vertical_spacing=GAP / height, subplot_titles=titles)
    told: set[str] = set()
    for row, panel in enumerate(figure.panels, start=1):
        for start, end in panel.shade:
            drawn.add_vrect(x0=start, x1=end, fillcolor="#999999", opacity=0.18, line_width=0, row=row, col=1)
        if panel.heat is not None:
            heat = panel.heat
            place = 1 - (row - 0.5) / count
            bar = {"title": heat.name, "len": 0.9 / count, "y": place}
            drawn.add_trace(go.Heatmap(x=heat.x, y=heat.y, z=heat.z, colorscale="Viridis", colorbar=bar), row, 1)
        for line in panel.lines:
            every = max(1, len(line.x) // MOST_POINTS)
            common = {"x": line.x[::every], "y": line.y[::every], "name": line.name, "legendgroup": line.name}
            common["showlegend"] = line.name not in told
            told.add(line.name)
            colour = COLOURS[line.colour]
            if line.style == "bars":
                drawn.add_trace(go.Bar(marker_color=colour, **common), row, 1)
            elif line.style == "points":
                drawn.add_trace(go.Scatter(mode="markers", marker={"color": colour, "size": 8}, **common), row, 1)
            else:
                width, dash = (0.8, "solid") if line.style == "thin" else (1.5, "solid")
                dash = "dash" if line.style == "dashed" else dash
                look = {"color": colour, "width": width, "dash": dash}
                drawn.add_trace(go.Scatter(mode="lines", line=look, **common), row, 1)
        drawn.update_xaxes(title_text=panel.x_label, row=row, col=1)
        drawn.update_yaxes(title_text=panel.y_label, row=row, col=1)
    drawn.update_layout(
        template="plotly_white",
        height=height + 110,
        margin={"l": 70, "r": 20, "t": 60, "b": 50},
        legend={"orientation": "h", "y": 1.0 + 30 / height, "yanchor": "bottom"},
        barmode="group",
    )
    return drawn


def _printed(figure: Figure) -> Any:
    from matplotlib.figure import Figure as Canvas

    count = len(figure.panels)
    canvas = Canvas(figsize=(8.3, 1.2 + 2.1 * count), layout="constrained")
    axes = canvas.subplots(count, 1, squeeze=False)[:, 0]
    told: dict[str, Any] = {}
    for panel, axis in zip(figure.panels, axes, strict=True):
        for start, end in panel.shade:
            axis.axvspan(start, end, color="#999999", alpha=0.18, linewidth=0)
        if panel.heat is not None:
            heat = panel.heat
            canvas.colorbar(axis.pcolormesh(heat.x, heat.y, heat.z, shading="nearest"), ax=axis, label=heat.name)
        bars = [line for line in panel.lines if line.style == "bars"]
        for line in panel.lines:
            colour = COLOURS[line.colour]
            if line.style == "bars":
                width = 0.8 / len(bars)
                place = np.arange(len(line.x)) + (bars.index(line) - (len(bars) - 1) / 2) * width
                mark = axis.bar(place, line.y, width, color=colour)
                axis.set_xticks(np.arange(len(line.x)), line.x)
            elif line.style == "points":
                (mark,) = axis.plot(line.x, line.y, "o", color=colour, markersize=4)
            else:
                width = 0.5 if line.style == "thin" else 1.0
                dash = "--" if line.style == "dashed" else "-"
                (mark,) = axis.plot(line.x, line.y, dash, color=colour, linewidth=width)
            told.setdefault(line.name, mark)
        axis.set(title=panel.title, xlabel=panel.x_label, ylabel=panel.y_label)
        axis.grid(alpha=0.3)
    canvas.suptitle(figure.title)
    if told:
        columns = min(len(told), 4)
        canvas.legend(told.values(), told.keys(), loc="outside lower center", ncols=columns, fontsize=8)
    return canvas
