"""The plots of results and traces, by Plotly, in the colours of the pages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from schemas.messages import PayloadEvent
from service.model.description import in_units_of
from service.pages import logarithmic, under_buttons
from service.pages.palette import JOINTS, Colour, faint

if TYPE_CHECKING:
    from deltatwin.public_trace import Trace
    from deltatwin.results import (
        EvaluationResult,
        IdentificationResult,
        JointRolloutResult,
        LoadResult,
        PayloadResult,
    )

EVENTS = {PayloadEvent.PICK: Colour.PICK, PayloadEvent.RELEASE: Colour.RELEASE}
HEIGHT = 190  # of a joint's row


def of_trace(trace: Trace) -> go.Figure:
    """Position and torque of every joint over time."""
    position, torque = ("rad", "N m") if trace.angular else ("m", "N")
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.05)
    for row, (name, values, unit) in enumerate(
        (("position", trace.position, position), ("torque", trace.torque, torque)), start=1
    ):
        for joint, channel in enumerate(values.T):
            figure.add_scatter(
                x=trace.time,
                y=channel,
                name=f"{name} {joint + 1}",
                line={"width": 1, "color": JOINTS[joint % 3]},
                row=row,
                col=1,
            )
        figure.update_yaxes(title_text=f"{name}, {unit}", row=row, col=1)
    figure.update_xaxes(title_text="time, s", row=2, col=1)
    return figure.update_layout(height=2 * HEIGHT + 80)


def of_identification(result: IdentificationResult) -> go.Figure:
    """Rms of each joint: torque, residual, the same of logs held out, noise."""
    fit, unit = result.fit, in_units_of(result.robot, "N m")
    shown = {
        "torque": (fit.torque, Colour.MEASURED),
        "residual": (fit.residual, Colour.AFTER),
        "held out": (fit.held_out, Colour.BEFORE),
    }
    joints = [f"joint {joint + 1}" for joint in range(len(fit.noise_floor))]
    figure = go.Figure()
    for name, (values, colour) in shown.items():
        known = np.isfinite(values)
        if known.any():
            rms = np.sqrt(np.nansum(values**2, axis=0) / np.maximum(known.sum(axis=0), 1))
            figure.add_bar(x=joints, y=rms, name=name, marker_color=colour)
    figure.add_bar(x=joints, y=fit.noise_floor, name="noise", marker_color=Colour.NOISE)
    figure.update_yaxes(title_text=f"rms, {unit}")
    logarithmic(figure, "y")
    return figure.update_layout(barmode="group", height=320)


def of_evaluation(result: EvaluationResult, number: int) -> go.Figure:
    """Measured torque and that of the fullest model over time, a row a joint."""
    one, unit = result.evaluations[number], in_units_of(result.robot, "N m")
    name, torque = list(one.torque.items())[-1]
    joints = torque.shape[1]
    figure = make_subplots(rows=joints, cols=1, shared_xaxes=True, vertical_spacing=0.04)
    for joint in range(joints):
        for label, values, colour in (("measured", one.trace.torque, Colour.MEASURED), (name, torque, Colour.AFTER)):
            figure.add_scatter(
                x=one.trace.time, y=values[:, joint], name=label, legendgroup=label, showlegend=joint == 0,
                line={"width": 1, "color": colour}, row=joint + 1, col=1,
            )  # fmt: skip
        figure.update_yaxes(title_text=f"joint {joint + 1}, {unit}", row=joint + 1, col=1)
    figure.update_xaxes(title_text=f"time in {one.trace.name}, s", row=joints, col=1)
    return figure.update_layout(under_buttons(HEIGHT * joints + 90))


def of_payload(result: PayloadResult) -> go.Figure:
    """The mass over time in its band, and its events."""
    found = result.history
    time = found.time - found.time[0]  # a log from the bus counts from 1970
    low, high = found.mass - 2 * found.std_dev, found.mass + 2 * found.std_dev
    figure = go.Figure()
    figure.add_scatter(x=time, y=high, line={"width": 0}, showlegend=False, hoverinfo="skip")
    figure.add_scatter(
        x=time, y=low, line={"width": 0}, fill="tonexty", fillcolor=faint(Colour.PAYLOAD),
        name="± 2 standard deviations", hoverinfo="skip",
    )  # fmt: skip
    figure.add_scatter(x=time, y=found.mass, name="mass", line={"width": 1.5, "color": Colour.PAYLOAD})
    for event, colour in EVENTS.items():
        rows = np.flatnonzero(found.event == event)
        figure.add_scatter(
            x=time[rows], y=found.mass[rows], mode="markers", name=event.name.lower(),
            marker={"color": colour, "size": 9, "symbol": "triangle-up"},
        )  # fmt: skip
    top = float(np.nanmax(found.mass, initial=0.0))
    figure.update_yaxes(title_text="mass, kg", range=[-0.1 * top - 0.1, 1.2 * top + 0.2])
    figure.update_xaxes(title_text=f"time since the start of {result.trace}, s")
    return figure.update_layout(height=340)


def of_load(result: LoadResult) -> go.Figure:
    """Rms residual of each joint without the load and with it."""
    one = result.load
    joints = [f"joint {joint + 1}" for joint in range(len(one.before))]
    figure = go.Figure()
    figure.add_bar(x=joints, y=one.before, name="without the load", marker_color=Colour.BEFORE)
    figure.add_bar(x=joints, y=one.after, name="with it", marker_color=Colour.AFTER)
    figure.update_yaxes(title_text=f"residual, rms, {in_units_of(result.robot, 'N m')}")
    logarithmic(figure, "y")
    return figure.update_layout(barmode="group", height=320)


def of_joint_rollout(result: JointRolloutResult) -> go.Figure:
    """Rms error of one joint over the horizon, a line a machine: of the joint that the last machine misses most."""
    found = result.found
    *machines, floor, _ = found.deviations
    joint = int(np.argmax(np.nan_to_num(machines[-1].growth[-1])))
    unit = "mrad" if found.angular else "mm"
    figure = go.Figure()
    for one in (*machines, floor):
        colour = Colour.NOISE if one is floor else Colour.AFTER if one is machines[-1] else Colour.BEFORE
        figure.add_scatter(
            x=1e3 * found.period * np.arange(len(one.growth)), y=1e3 * one.growth[:, joint], name=one.name,
            line={"width": 1.5, "color": colour},
        )  # fmt: skip
    figure.update_xaxes(title_text="time since the start of a window, ms")
    figure.update_yaxes(title_text=f"joint {joint + 1}, simulated minus measured, rms, {unit}")
    return figure.update_layout(height=340)
