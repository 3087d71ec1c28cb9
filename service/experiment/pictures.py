"""Figures drawn twice from one description: interactive in a self-contained HTML page, and as PNG and PDF for paper."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from schemas.files import make_folder, whole
from service import pages
from service.pages import Headline
from service.pages.palette import Colour

if TYPE_CHECKING:
    from markupsafe import Markup

PANEL_HEIGHT = 180  # px in the page
CELL_INCHES = 0.75  # height of a row of a diagram
GAP = 75  # px between two panels, for the upper one's scale and label and the lower one's title


@dataclass(frozen=True)
class Line:
    """One curve: x, y (N,). spread: (N,) above and below the end of each bar."""

    name: str
    x: np.ndarray
    y: np.ndarray
    colour: Colour = Colour.MEASURED
    style: Literal["line", "thin", "dashed", "points", "bars"] = "line"
    spread: np.ndarray | None = None


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


def by_joint(
    lines: Sequence[Line], label: str, title: str = "", shade: tuple[tuple[float, float], ...] = ()
) -> tuple[Panel, ...]:
    """A panel a joint over time. lines: with y (N, 3). label, title: with {} for the joint's number."""
    return tuple(
        Panel(
            "time / s",
            label.format(joint + 1),
            tuple(replace(line, y=line.y[:, joint]) for line in lines),
            title.format(joint + 1),
            shade=shade,
        )
        for joint in range(3)
    )


@dataclass(frozen=True)
class Figure:
    """Panels one below the other. name: file name without ending."""

    name: str
    title: str
    caption: str
    panels: tuple[Panel, ...]


@dataclass(frozen=True)
class Box:
    """A block of a diagram, its middle in column and row of a grid, rows downwards."""

    text: str
    column: float
    row: float


@dataclass(frozen=True)
class Arrow:
    """From one box to another, by their numbers; `text` beside it."""

    start: int
    end: int
    text: str = ""


@dataclass(frozen=True)
class Diagram:
    """Blocks and what flows between them."""

    name: str
    title: str
    caption: str
    boxes: tuple[Box, ...]
    arrows: tuple[Arrow, ...]


@dataclass(frozen=True)
class Section:
    """From here on the page is about something else."""

    title: str
    text: str


@dataclass(frozen=True)
class PageTable:
    """A table of the page: cells as they are to be read."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


@dataclass(frozen=True)
class Page:
    """What goes into a report: the headline, the `first` figure of the parts, then the others in
    order, folded. lead: paragraphs."""

    title: str
    headline: Headline
    first: Figure
    lead: tuple[str, ...]
    parts: tuple[PageTable | Figure | Diagram | Section, ...]

    @property
    def drawings(self) -> list[Figure | Diagram]:
        """What of it is drawn, in order."""
        return [part for part in self.parts if isinstance(part, Figure | Diagram)]


def write_page(page: Page, path: Path) -> None:
    """The page as one HTML file that needs nothing else.

    Raises:
        StorageError: it cannot be written.
    """
    pages.write_page("findings", path, page.headline, page=page, draw=_interactive, sketch=_svg)


def write_pictures(figures: Sequence[Figure | Diagram], folder: Path, document: str) -> None:
    """Every figure as PNG, and all of them as the pages of one PDF named `document`.

    Raises:
        StorageError: a file cannot be written.
    """
    from matplotlib.backends.backend_pdf import PdfPages

    make_folder(folder)
    with whole(folder / f"{document}.pdf") as paper, PdfPages(paper) as sheets:
        for figure in figures:
            drawn = _sketched(figure, figure.title) if isinstance(figure, Diagram) else _printed(figure)
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
        if panel.heat is not None:
            heat = panel.heat
            place = 1 - (row - 0.5) / count
            bar = {"title": heat.name, "len": 0.9 / count, "y": place}
            drawn.add_trace(go.Heatmap(x=heat.x, y=heat.y, z=heat.z, colorscale="Viridis", colorbar=bar), row, 1)
        for line in panel.lines:
            common = {"x": line.x, "y": line.y, "name": line.name, "legendgroup": line.name}
            common["showlegend"] = line.name not in told
            told.add(line.name)
            colour = line.colour
            if line.style == "bars":
                if line.spread is not None:
                    common["error_y"] = {"type": "data", "array": line.spread}
                drawn.add_trace(go.Bar(marker_color=colour, **common), row, 1)
            elif line.style == "points":
                drawn.add_trace(go.Scatter(mode="markers", marker={"color": colour, "size": 8}, **common), row, 1)
            else:
                width, dash = (0.8, "solid") if line.style == "thin" else (1.5, "solid")
                dash = "dash" if line.style == "dashed" else dash
                look = {"color": colour, "width": width, "dash": dash}
                drawn.add_trace(go.Scatter(mode="lines", line=look, **common), row, 1)
        for start, end in panel.shade:  # after the lines: Plotly shades no empty axes
            drawn.add_vrect(
                x0=start, x1=end, fillcolor="#999999", opacity=0.18, line_width=0, layer="below", row=row, col=1
            )
        drawn.update_xaxes(title_text=panel.x_label, row=row, col=1)
        drawn.update_yaxes(title_text=panel.y_label, row=row, col=1)
    drawn.update_layout(
        height=height + 140,
        margin={"l": 70, "r": 20, "t": 90, "b": 50},  # above: Plotly's buttons, below them the legend
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
            colour = line.colour
            if line.style == "bars":
                width = 0.8 / len(bars)
                place = np.arange(len(line.x)) + (bars.index(line) - (len(bars) - 1) / 2) * width
                mark = axis.bar(place, line.y, width, color=colour, yerr=line.spread, capsize=3, ecolor="#555555")
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


def _svg(diagram: Diagram) -> Markup:
    """The diagram as an element of a page, its text as text."""
    import matplotlib
    from markupsafe import Markup

    stream = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": diagram.name}):
        _sketched(diagram, title="").savefig(
            stream, format="svg", metadata=dict.fromkeys(("Date", "Creator", "Format", "Type"))
        )
    return Markup(stream.getvalue().partition("<svg")[1] + stream.getvalue().partition("<svg")[2])


def _sketched(diagram: Diagram, title: str) -> Any:
    from matplotlib.figure import Figure as Canvas

    columns = max(box.column for box in diagram.boxes) + 1
    rows = max(box.row for box in diagram.boxes) + 1
    canvas = Canvas(figsize=(8.3, 0.5 + CELL_INCHES * rows), layout="constrained")
    axis = canvas.subplots()
    axis.set(xlim=(-0.5, columns - 0.5), ylim=(rows - 0.5, -0.5))
    axis.axis("off")
    canvas.suptitle(title, fontsize=11)
    drawn = []
    for box in diagram.boxes:
        frame = {"boxstyle": "round,pad=0.5", "facecolor": "#f6f8fa", "edgecolor": "#555555"}
        text = axis.text(box.column, box.row, box.text, ha="center", va="center", fontsize=8, bbox=frame, clip_on=False)
        drawn.append(text)
    for arrow in diagram.arrows:
        start, end = diagram.boxes[arrow.start], diagram.boxes[arrow.end]
        axis.annotate(
            "", (end.column, end.row), (start.column, start.row),
            arrowprops={"arrowstyle": "-|>", "color": "#333333", "linewidth": 1.0,
                        "patchA": drawn[arrow.start].get_bbox_patch(), "patchB": drawn[arrow.end].get_bbox_patch(),
                        "shrinkA": 2, "shrinkB": 2},
            annotation_clip=False,
        )  # fmt: skip
        if arrow.text:
            middle = (start.column + end.column) / 2, (start.row + end.row) / 2
            upright = start.column == end.column
            place: Any = {"ha": "left", "va": "center"} if upright else {"ha": "center", "va": "bottom"}
            axis.annotate(
                arrow.text, middle, (4, 0) if upright else (0, 3), textcoords="offset points",
                fontsize=7, color="#333333", annotation_clip=False, **place,
            )  # fmt: skip
    return canvas
