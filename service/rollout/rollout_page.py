"""What a rollout says: as a document and as a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from schemas.robot import Robot
from schemas.rollout_document import LogInterruption, Reached, RegimeReached, RolloutDocument
from schemas.words import counted, significant
from service.pages import Headline, logarithmic, write_page
from service.pages.palette import EFFECTS, Colour
from service.rollout.gap import REGIMES, Deviation, Rollout, rms
from service.rollout.packed import left_out
from service.rollout.recognise import over_identified

TIMES = 21  # of the growth over the horizon
NAMED = 5  # interruptions of logs that are told one by one
AT_FLOOR = 1.5  # times the error that noise alone makes, up to which a robot moves as the real one
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


def write_rollout(
    result: RolloutDocument, path: Path, given: Mapping[str, Sequence[object]], logs: Sequence[object] = ()
) -> None:
    """Write the page of a rollout. given, logs: see `headline`."""
    plots = {"growth": growth(result), "by_regime": _by_regime(result)}
    write_page("rollout", path, headline(result, given, logs), document=result, in_figures=in_figures, **plots)


def in_figures(value: float | None) -> str:
    """An error, mrad, mm or N m, as it is read."""
    if value is None:
        return "ran away"
    return significant(value) if value < 1000.0 else f"{value:.0f}"


def headline(result: RolloutDocument, given: Mapping[str, Sequence[object]], logs: Sequence[object]) -> Headline:
    """How far the best description is from the robot, after the horizon. given: name -> each
    description as words of a command. logs: those that were compared, and how they are read, as words of one."""
    lines, horizon = tuple(sentences(result)), f"{1e3 * result.horizon_s:.0f} ms"
    floor, shown = result.floor.platform_mm, _simulated(result)
    if not shown:
        step = "give a shorter --horizon, or a description that was identified on logs of this robot."
        said = f"Every simulated robot leaves the workspace within {horizon}."
        return Headline("bad", said, "0", f"of {counted(result.windows, 'window')} simulated to the end", step, lines)
    *others, (best, error) = shown
    robot = given.get(best) or next(iter(given.values()), ("FILE",))
    number, of = f"{significant(error)} mm", f"rms error of the platform after {horizon}, {best}"
    if strange(result):
        step = (
            f"check units and payload of these logs; {best} was identified on others. To see where the torque differs:"
        )
        said = f"'{best}' does not describe the robot of these logs."
        return Headline("bad", said, number, of, step, lines, ("evaluate", *logs, "--robot", *robot))
    near = "" if floor is None else f" {AT_FLOOR:g} times the {significant(floor)} mm that noise alone causes."
    if floor is not None and error < AT_FLOOR * floor:
        said = f"'{best}' moves as the robot does: its error is less than{near}"
        command = ("export", *robot, "--to", "mjcf", "--out", "robot.xml")
        return Headline("good", said, number, of, f"write {best} for a simulator:", lines, command)
    if others and error < others[-1][1]:
        other, its = others[-1]
        said = f"'{best}' is {significant(its / error, 2)} times nearer to the robot than '{other}'"
        said += f", but its error is more than{near}" if near else "."
    else:
        said = f"'{best}' does not move as the robot does."
    command = ("diagnose", *logs, "--robot", *robot, "--out", "diagnosis")
    return Headline("bad", said, number, of, "find out which effect is missing:", lines, command)


def _simulated(result: RolloutDocument) -> list[tuple[str, float]]:
    """Name and error of the platform, mm, of the robots that stayed in the workspace in some window."""
    return [(robot.robot, robot.platform_mm) for robot in result.robots if robot.platform_mm is not None]


def strange(result: RolloutDocument) -> bool:
    """Whether the last description leaves far more unexplained than in the logs that it was identified on."""
    return any(over is not None and over > STRANGE for over in result.over_identified or ())


def sentences(result: RolloutDocument) -> list[str]:
    """What a reader should know first."""
    return [*_of_errors(result), *_of_payload(result), *_of_windows(result), *_of_robots(result)]


def _of_errors(result: RolloutDocument) -> list[str]:
    """How far the platform goes astray, from what."""
    horizon = f"{1e3 * result.horizon_s:.0f} ms"
    shown = _simulated(result)
    lines = []
    if result.over_identified is None:
        lines.append(f"{result.robots[-1].robot} was not identified on logs: these logs may be of another robot.")
    elif strange(result):
        times = ", ".join("-" if over is None else significant(over) for over in result.over_identified)
        lines.append(
            f"{result.robots[-1].robot} leaves {times} times as much torque unexplained, by joint, as on the logs it "
            "was identified on: these logs are of another robot or in another unit, or the robot has changed since."
        )
    if len(shown) > 1:
        (first, before), (last, after) = shown[-2:]
        lines.append(
            f"In the simulator the platform's error after {horizon} goes from {significant(before)} mm "
            f"({first}) to {significant(after)} mm ({last})."
        )
    elif shown:
        lines.append(
            f"In the simulator the platform is off by {significant(shown[0][1])} mm ({shown[0][0]}) after {horizon}."
        )
    if result.servo is not None:
        gains, speeds = (
            ", ".join(f"{value:.3g}" for value in values)
            for values in (result.servo.position_gain_ps, result.servo.velocity_gain_nms)
        )
        lines.append(
            f"Position commands drive the simulation, through drives with a position gain of {gains} 1/s and a "
            f"velocity gain of {speeds} N m s/rad."
        )
    if result.floor.platform_mm is not None:
        lines.append(
            f"Torque noise and start state alone give {significant(result.floor.platform_mm)} mm; "
            f"the platform moves {significant(result.path_mm)} mm in that time."
        )
    return lines


def _of_payload(result: RolloutDocument) -> list[str]:
    lines = []
    masses = [mass for mass in result.payload_kg if mass]
    if masses:
        least, most = f"{min(masses):.3g}", f"{max(masses):.3g}"
        span = least if least == most else f"{least} to {most}"
        lines.append(
            f"In {len(masses)} of {counted(result.windows, 'window')} every simulated robot carries {span} kg: "
            "the payload estimated with the last description."
        )
    if len(masses) == result.windows:
        lines.append("No window is without payload: a tool that the description lacks would look the same.")
    return lines


def _of_windows(result: RolloutDocument) -> list[str]:
    """What of the logs is not in it."""
    lines = []
    if result.untold_s:
        lines.append(f"{significant(result.untold_s)} s are left out, as the data do not show the payload there.")
    if result.interruptions:
        shown = result.interruptions[:NAMED]
        where = ", ".join(f"{one.trace} at {one.from_s:.3f} to {one.until_s:.3f} s" for one in shown)
        more = f" and {len(result.interruptions) - NAMED} more" if len(result.interruptions) > NAMED else ""
        lines.append(
            f"No window spans an interruption of a log; {counted(result.windows_lost, 'window')} lost for this reason: "
            f"{where}{more}."
        )
    return lines


def _of_robots(result: RolloutDocument) -> list[str]:
    lines = []
    for robot in result.robots:
        if robot.ran_away:
            lines.append(
                f"{robot.robot} leaves the workspace in {robot.ran_away} of "
                f"{counted(result.windows, 'window')}: these are not in any value here."
            )
        elif robot.platform_mm is not None and robot.platform_mm > result.path_mm:
            lines.append(f"{robot.robot} predicts the motion no better than a robot at rest.")
        if robot.left_out:
            lines.append(f"{robot.robot}: the simulation leaves out {', '.join(robot.left_out)}.")
    return lines


def growth(result: RolloutDocument) -> go.Figure:
    """How the platform's error grows over the horizon."""
    figure = go.Figure()
    times = [1e3 * time for time in result.times_s[1:]]  # at first they are where the log is: zero has no logarithm
    for robot, colour in zip((*result.robots, result.floor), _colours(result), strict=True):
        dash = "dot" if robot is result.floor else "solid"
        figure.add_scatter(x=times, y=robot.growth_mm[1:], name=robot.robot, line={"color": colour, "dash": dash})
    figure.update_xaxes(title_text="time from the start of a window, ms")
    figure.update_yaxes(title_text="rms error of the platform, mm")
    logarithmic(figure, "y")
    figure.update_layout(height=380)
    return figure


def _by_regime(result: RolloutDocument) -> go.Figure:
    figure = go.Figure()
    labels = [[f"joint {entry.joint}" for entry in result.regimes], [entry.regime for entry in result.regimes]]
    for robot, colour in zip((*result.robots, result.floor), _colours(result), strict=True):
        values = [entry.joint_mrad[robot.robot] for entry in result.regimes]
        figure.add_bar(x=labels, y=values, name=robot.robot, marker_color=colour)
    figure.update_xaxes(ticklabelstandoff=0)  # the inner of its two rows of labels alone would move
    figure.update_yaxes(title_text=f"rms after {1e3 * result.horizon_s:.0f} ms, mrad")
    logarithmic(figure, "y")
    figure.update_layout(barmode="group", height=420)
    return figure


def _colours(result: RolloutDocument) -> list[Colour]:
    """Of the robots, as drawn up first and best last, and of the floor."""
    between = len(result.robots) - 2
    last = [Colour.BEFORE] * (between > 0) + [Colour.AFTER] * (between >= 0)
    others = [EFFECTS[number % len(EFFECTS)] for number in range(between - 1)]
    return [Colour.TEXTBOOK, *others, *last, Colour.NOISE]
