"""What a rollout says: as a document and as a page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from schemas.robot import Robot
from schemas.rollout import LogInterruption, Reached, RegimeReached, RolloutDocument
from service.pages import LOG_AXIS, write_page
from service.rollout.gap import REGIMES, Deviation, Rollout, rms
from service.rollout.recognise import over_identified
from service.rollout.robot import left_out

TIMES = 21  # of the growth over the horizon
COLOURS = ("#b0b7c3", "#bf8700", "#1f6feb", "#8250df", "#2da44e")
FLOOR = "#d0d7de"
NAMED = 5  # interruptions of logs that are told one by one
STRANGE = 3.0  # times the torque unexplained that a description left when made, from which its log may be another's


def document(found: Rollout, robots: dict[str, Robot], traces: Sequence[str]) -> RolloutDocument:
    """The document of a rollout of `robots` over `traces`."""
    cuts, samples = found.cuts, found.floor.platform.shape[1]
    rows = np.unique(np.linspace(0, samples - 1, TIMES).round().astype(int))
    driven = found.servo is not None
    over = over_identified(robots[found.deviations[-1].name], cuts)
    shown = [reached(deviation, rows, left_out(robots[deviation.name]), driven) for deviation in found.deviations]
    return RolloutDocument(
        schema="deltatwin.rollout/1",
        traces=list(traces),
        horizon_s=round(cuts.horizon, 6),
        windows=len(cuts.runs),
        payload_kg=[float(f"{mass:.5g}") for mass in cuts.payload],
        untold_s=round(cuts.untold, 3),
        interruptions=[
            LogInterruption(trace=one.run, from_s=round(one.start, 3), until_s=round(one.stop, 3))
            for one in cuts.interruptions
        ],
        windows_lost=cuts.lost,
        seconds=round(cuts.seconds, 3),
        used_s=round(len(cuts.runs) * cuts.horizon, 3),
        path_mm=found.floor.path_mm,
        over_identified=None if over is None else _numbers(over),
        times_s=[round(float(row * cuts.period), 6) for row in rows],
        robots=shown,
        floor=reached(found.floor, rows, torque=driven),
        regimes=_regimes(found),
        servo=found.servo,
    )


def reached(
    deviation: Deviation, rows: Sequence[int] | np.ndarray = (), without: Sequence[str] = (), torque: bool = False
) -> Reached:
    """A deviation's figures. rows: samples at which to tell its growth. without: effects left out. torque: that too."""
    return Reached(
        robot=deviation.name,
        joint_mrad=_numbers(deviation.joint_mrad),
        platform_mm=_number(deviation.platform_mm),
        growth_mm=_numbers(deviation.growth_mm[list(rows)]),
        ran_away=int(np.sum(~deviation.good)),
        left_out=list(without),
        torque_nm=_numbers(deviation.torque_nm) if torque else [],
    )


def _regimes(found: Rollout) -> list[RegimeReached]:
    result = []
    deviations = (*found.deviations, found.floor)
    for joint in range(3):
        for number, regime in enumerate(REGIMES):
            mine = found.cuts.regime[:, joint] == number
            if not mine.any():
                continue
            errors = {}
            for deviation in deviations:
                repeats = len(deviation.angle) // len(mine)
                kept = np.repeat(mine, repeats) & deviation.good
                errors[deviation.name] = _number(1e3 * float(rms(deviation.angle[kept, -1, joint])))
            result.append(RegimeReached(joint=joint + 1, regime=regime, windows=int(mine.sum()), joint_mrad=errors))
    return result


def _number(value: float) -> float | None:
    return float(f"{value:.5g}") if np.isfinite(value) else None


def _numbers(values: np.ndarray) -> list[float | None]:
    return [_number(float(value)) for value in values]


def write_rollout(result: RolloutDocument, path: Path) -> None:
    """Write the page of a rollout."""
    plots = {"How the platform's error grows": growth(result), "By joint and kind of motion": _by_regime(result)}
    write_page("rollout", path, document=result, sentences=sentences(result), in_figures=in_figures, plots=plots)


def in_figures(value: float | None) -> str:
    """An error, mrad, mm or N m, as it is read."""
    if value is None:
        return "ran away"
    return f"{value:.3g}" if value < 1000.0 else f"{value:.0f}"


def sentences(result: RolloutDocument) -> list[str]:
    """What a reader should know first."""
    horizon = f"{1e3 * result.horizon_s:.0f} ms"
    shown = [robot for robot in result.robots if robot.platform_mm is not None]
    lines = []
    if result.over_identified is None:
        lines.append(f"{result.robots[-1].robot} was not identified on logs: whether these are of it cannot be told.")
    elif any(over is not None and over > STRANGE for over in result.over_identified):
        times = ", ".join("-" if over is None else f"{over:.3g}" for over in result.over_identified)
        lines.append(
            f"{result.robots[-1].robot} leaves {times} times as much torque unexplained, by joint, as in the logs it "
            "was identified on: these are of another robot, in another unit, or it has changed since."
        )
    if len(shown) > 1:
        first, last = shown[-2], shown[-1]
        lines.append(
            f"In the simulator the platform's error after {horizon} goes from {first.platform_mm:.3g} mm "
            f"({first.robot}) to {last.platform_mm:.3g} mm ({last.robot})."
        )
    elif shown:
        lines.append(
            f"In the simulator the platform is off by {shown[0].platform_mm:.3g} mm ({shown[0].robot}) after {horizon}."
        )
    if result.servo is not None:
        gains, speeds = (
            ", ".join(f"{value:.3g}" for value in values)
            for values in (result.servo.position_gain_ps, result.servo.velocity_gain_nms)
        )
        lines.append(
            f"Commands went in, through drives of position gain {gains} 1/s, velocity gain {speeds} N m s/rad."
        )
    if result.floor.platform_mm is not None:
        lines.append(
            f"Torque noise and start state alone give {result.floor.platform_mm:.3g} mm; "
            f"the platform goes {result.path_mm:.3g} mm in that time."
        )
    masses = [mass for mass in result.payload_kg if mass]
    if masses:
        least, most = f"{min(masses):.3g}", f"{max(masses):.3g}"
        lines.append(
            f"In {len(masses)} of {result.windows} windows {least if least == most else f'{least} to {most}'} kg hang "
            "on every simulated robot: what is carried, as the last description weighs it."
        )
    if len(masses) == result.windows:
        lines.append("It is never empty: a tool whose mass the description lacks would look the same.")
    if result.untold_s:
        lines.append(f"{result.untold_s:.3g} s are left out in which it cannot be told what is carried.")
    if result.interruptions:
        shown = result.interruptions[:NAMED]
        where = ", ".join(f"{one.trace} at {one.from_s:.3f} to {one.until_s:.3f} s" for one in shown)
        more = f" and {len(result.interruptions) - NAMED} more" if len(result.interruptions) > NAMED else ""
        lines.append(
            f"No window spans what interrupts a log, which costs {result.windows_lost} windows: {where}{more}."
        )
    for robot in result.robots:
        if robot.ran_away:
            lines.append(
                f"{robot.robot}: runs away in {robot.ran_away} of {result.windows} windows, which no figure counts."
            )
        elif robot.platform_mm is not None and robot.platform_mm > result.path_mm:
            lines.append(f"{robot.robot}: no better than a robot that stands still.")
        if robot.left_out:
            lines.append(f"{robot.robot}: the simulation does without {', '.join(robot.left_out)}.")
    return lines


def growth(result: RolloutDocument) -> go.Figure:
    """How the platform's error grows over the horizon."""
    figure = go.Figure()
    times = [1e3 * time for time in result.times_s[1:]]  # at first they are where the log is: zero has no logarithm
    for robot, colour in zip((*result.robots, result.floor), _colours(result), strict=True):
        dash = "dot" if robot is result.floor else "solid"
        figure.add_scatter(x=times, y=robot.growth_mm[1:], name=robot.robot, line={"color": colour, "dash": dash})
    figure.update_xaxes(title_text="time from the start of a window, ms")
    figure.update_yaxes(title_text="rms error of the platform, mm", **LOG_AXIS)
    figure.update_layout(height=380)
    return figure


def _by_regime(result: RolloutDocument) -> go.Figure:
    figure = go.Figure()
    labels = [[f"joint {entry.joint}" for entry in result.regimes], [entry.regime for entry in result.regimes]]
    for robot, colour in zip((*result.robots, result.floor), _colours(result), strict=True):
        values = [entry.joint_mrad[robot.robot] for entry in result.regimes]
        figure.add_bar(x=labels, y=values, name=robot.robot, marker_color=colour)
    figure.update_yaxes(title_text=f"rms after {1e3 * result.horizon_s:.0f} ms, mrad", **LOG_AXIS)
    figure.update_layout(barmode="group", height=420)
    return figure


def _colours(result: RolloutDocument) -> list[str]:
    return [COLOURS[number % len(COLOURS)] for number in range(len(result.robots))] + [FLOOR]
