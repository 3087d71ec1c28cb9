"""fleet.html: what has changed, in which robot, since when; every robot over time; what could not be read."""

from __future__ import annotations

from pathlib import Path

import plotly.graph_objects as go

from schemas.diagnosis import named_joints
from schemas.fleet_document import Change, DayResult, Fleet
from schemas.words import counted, words
from service import pages
from service.fleet.changes import gap_in_words
from service.fleet.logs import natural
from service.pages import Headline

MOST_DAYS = 12  # named on the axis of days


def write_page(fleet: Fleet, path: Path) -> None:
    """Write the page."""
    pages.write_page(
        "fleet",
        path,
        headline(fleet, path.parent),
        fleet=fleet,
        found=found(fleet),
        gap=_gap(fleet),
        words=gap_in_words,
        when=when,
    )


def headline(fleet: Fleet, folder: Path) -> Headline:
    """How many robots have changed, and what to look at first. folder: of the page."""
    days = [day for robot in fleet.robots for day in robot.days]
    judged = sum(day.judged for day in days)
    robots, number = counted(len(fleet.robots), "robot"), f"{judged} of {counted(len(days), 'robot day')}"
    of = "judged"
    if not judged:
        step = "the reasons are below"
        step += (
            "." if all(one.error for one in fleet.robots) else "; record motion in which all joints move and reverse."
        )
        return Headline("open", f"No day of {robots} could be judged.", number, of, step)
    there = [(robot, change) for robot, change in found(fleet) if not change.gone]
    if not there:
        return _unchanged(fleet, robots, number, of)
    changed = list(dict.fromkeys(robot for robot, _ in there))
    robot, first = there[0]
    where = f" in {named_joints(first.joints)}" if first.joints else ""
    said = f"{len(changed)} of {robots} {'has' if len(changed) == 1 else 'have'} changed: {', '.join(changed)}."
    return Headline(
        "bad", said, str(len(changed)), f"of {robots} to look at ({number} {of})",
        f"look at {robot}: {first.title}{where}, since {first.since}; its days are in {folder}/robots/{robot}.",
    )  # fmt: skip


def _unchanged(fleet: Fleet, robots: str, number: str, of: str) -> Headline:
    """No change is a verdict on those alone of whom another day than that of the reference was judged."""
    without = [robot.robot for robot in fleet.robots if not robot.compared]
    if not without:
        return Headline("good", f"No change in {robots}.", number, of, "nothing; judge the next day's logs.")
    compared = len(fleet.robots) - len(without)
    said = f"No change in {compared} of {robots}" if compared else "No robot could be compared with its reference"
    step = f"record a day of {', '.join(without)} that can be compared; what was wrong is below."
    return Headline("open", f"{said}; not compared: {', '.join(without)}.", number, of, step)


def found(fleet: Fleet) -> list[tuple[str, Change]]:
    """(robot, change), what is still there first."""
    every = [(robot.robot, change) for robot in fleet.robots for change in robot.changes]
    return sorted(every, key=lambda one: one[1].gone)


def when(change: Change) -> str:
    """Since when, in words."""
    earlier = f" (not on {change.not_on})" if change.not_on else ", the first judged day, or earlier"
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
    return ", ".join(words(effect.name) for effect in day.effects) or day.error or words(day.verdict or "")
