"""A recording as a picture: measured against predicted torque, and the payload over time."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from schemas.messages import stamp_ns
from service.monitor.readback import Recorded
from service.pages import under_buttons
from service.pages.palette import Colour, faint


def errors_by_model(error: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Mean and standard deviation, (3,) N m each, of every model in (N,) MODEL_ERROR records; NaN rows are left out."""
    return {
        label: (np.nanmean(error[field], axis=0), np.nanstd(error[field], axis=0))
        for label, field in (("M_KH", "kh"), ("M_Id", "id"), ("M_Id+F", "id_friction"), ("full", "full"))
    }


def picture(recorded: dict[str, Recorded]) -> go.Figure:
    """Three joints and the payload over bus time, s."""
    samples, error, payload = (recorded[topic].records for topic in ("sample", "error", "payload"))
    _, mine, its = np.intersect1d(samples["sequence"], error["sequence"], return_indices=True)
    measured, error = samples["torque"][mine], error[its]
    begin = stamp_ns(samples)[0]
    time, payload_time = ((stamp_ns(records) - begin) * 1e-9 for records in (error, payload))
    figure = make_subplots(
        rows=4, cols=1, shared_xaxes=True, vertical_spacing=0.03, row_heights=[1, 1, 1, 0.8],
        subplot_titles=[*(f"joint {joint + 1}, torque" for joint in range(3)), "payload"],
    )  # fmt: skip
    for joint in range(3):
        lines = (
            ("measured", measured[:, joint], Colour.MEASURED),
            ("M_KH", measured[:, joint] - error["kh"][:, joint], Colour.TEXTBOOK),
            ("full model with payload", measured[:, joint] - error["full"][:, joint], Colour.AFTER),
        )
        for name, torque, colour in lines:
            figure.add_scatter(
                x=time, y=torque, name=name, legendgroup=name, showlegend=joint == 0,
                line={"color": colour, "width": 1.2}, row=joint + 1, col=1,
            )  # fmt: skip
        figure.update_yaxes(title_text="N m", row=joint + 1, col=1)
    for bound, fill in ((-2, None), (2, "tonexty")):
        figure.add_scatter(
            x=payload_time, y=payload["mass"] + bound * payload["std_dev"], line={"width": 0}, fill=fill,
            fillcolor=faint(Colour.PAYLOAD), name="± 2 standard deviations", showlegend=fill is not None,
            hoverinfo="skip", row=4, col=1,
        )  # fmt: skip
    figure.add_scatter(x=payload_time, y=payload["mass"], name="payload", line={"color": Colour.PAYLOAD}, row=4, col=1)
    figure.update_yaxes(
        title_text="kg", range=[-0.5, max(0.5, 1.2 * float(payload["mass"].max(initial=0.0)))], row=4, col=1
    )
    figure.update_xaxes(title_text="bus time, s", row=4, col=1)
    figure.update_layout(under_buttons(1000, titles=True))
    return figure
