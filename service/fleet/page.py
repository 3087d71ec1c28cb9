"""fleet.html: what has changed, in which robot, since when; every robot over time; what could not be read."""

from __future__ import annotations

from pathlib import Path

import plotly.graph_objects as go

from schemas.fleet import Change, DayResult, Fleet
from service import pages
from service.fleet.changes import gap_in_words
from service.fleet.logs import natural

MOST_DAYS = 12  # named on the axis of days


def write_page(fleet: Fleet, path: Path) -> None:
    """Write the page."""
    pages.write_page("fleet", path, fleet=fleet, found=found(fleet), gap=_gap(fleet), words=gap_in_words, when=when)


def found(fleet: Fleet) -> list[tuple[str, Change]]:
    """(robot, change), what is still there first."""
    every = [(robot.robot, change) for robot in fleet.robots for change in robot.changes]
    return sorted(every, key=lambda one: one[1].gone)


def when(change: Change) -> str:
    """Since when, in words."""
    earlier = f" (not on {change.not_on})" if change.not_on else ", the first day judged, or before"
    return change.since + earlier


def _gap(fleet: Fleet) -> go.Figure:
    """The gap to the reference as a share of the torque, by robot and day."""
    days = sorted({day.day for robot in fleet.robots for day in robot.days}, key=natural)
    rows = [[next((d for d in robot.days if d.day == day), None) for day in days] for robot in fleet.robots]
    gaps = [[day.gap_percent if day else None for day in row] for row in rows]
    most = max((gap for row in gaps for gap in row if gap is not None), default=1.0)
    figure = go.Figure(
        go.Heatmap(
            x=days, y=[robot.robot for robot in fleet.robots], colorscale="Blues", xgap=1, ygap=1,
            z=gaps, zmin=0, zmax=most,  # Plotly takes one without the other for none
            customdata=[[_told(day) for day in row] for row in rows],
            colorbar={"title": "gap, % of<br>the torque", "thickness": 12},
            hovertemplate="%{y}, %{x}: %{z:.3g} % of the torque<br>%{customdata}<extra></extra>",
        )
    )  # fmt: skip
    shown = days[:: -(-len(days) // MOST_DAYS)] if days else days
    figure.update_xaxes(type="category", tickvals=shown, automargin=True, title_text="day")
    figure.update_yaxes(type="category", autorange="reversed", automargin=True)
    figure.update_layout(margin={"t": 32}, height=192 + 22 * len(rows))
    return figure


def _told(day: DayResult | None) -> str:
    if day is None:
        return "no log"
    return ", ".join(effect.title for effect in day.effects) or day.error or pages.words(day.verdict or "")
