"""Which points of a curve does a page need? Those that a screen can show, to the digits that it can show.

A curve takes two points per pixel: the least and the largest value of what is drawn there, so that peaks stay.
"""

from __future__ import annotations

import math
from base64 import b64decode, b64encode
from collections.abc import Mapping
from typing import Any

import numpy as np

WIDTH = 1080  # px, of a page's text in look.css: no plot is wider
STEPS = 4000  # that the range of a curve is divided into: several per pixel of the highest plot
SINGLE = 1e-7  # of the range of an axis: what single precision tells apart
BY_POINT = ("x", "y", "customdata")  # what a curve has for each of its points


def kept(values: np.ndarray, pixels: int) -> np.ndarray:
    """Rows of a curve (N,) to draw on so many pixels: its ends, the least and the largest value of each pixel and,
    where it is broken (NaN), the first row of the break in that pixel."""
    count = len(values)
    if count <= 2 * pixels:
        return np.arange(count)
    starts = np.arange(pixels) * count // pixels
    pixel = np.repeat(np.arange(pixels), np.diff(starts, append=count))
    chosen = [np.isnan(values)]
    chosen += [values == extreme.reduceat(values, starts)[pixel] for extreme in (np.fmin, np.fmax)]
    rows = [np.array([0, count - 1])]
    for mine in map(np.flatnonzero, chosen):
        rows.append(mine[np.diff(pixel[mine], prepend=-1) > 0])
    return np.unique(np.concatenate(rows))


def reduced(drawn: dict[str, Any], width: int) -> list[dict[str, Any]]:
    """The traces of a figure, as Plotly has it for JSON, with the points of each curve that a plot `width` px wide
    shows: of the range that it shows first, and as many of the rest."""
    return [_curve(trace, drawn["layout"], width) if _is_curve(trace) else single(trace) for trace in drawn["data"]]


def _is_curve(trace: Mapping[str, Any]) -> bool:
    known = [trace[name] for name in BY_POINT if trace.get(name) is not None]
    lines = trace["type"] == "scatter" and trace.get("mode", "lines") == "lines" and trace.get("y") is not None
    return lines and all(np.issubdtype(numbers(values).dtype, np.number) for values in known)


def _curve(trace: Mapping[str, Any], layout: Mapping[str, Any], width: int) -> dict[str, Any]:
    x_axis, y_axis = (_axis(trace, layout, letter) for letter in "xy")
    low, high = x_axis.get("domain", (0.0, 1.0))
    points = {name: numbers(trace[name]).astype(float) for name in BY_POINT if trace.get(name) is not None}
    rows = _rows(points, x_axis, max(1, round(width * (high - low))))
    told = {name: values[rows] for name, values in points.items()}
    return dict(trace) | {
        name: _digits(values, _step(values, name) if name != "y" or y_axis.get("type") != "log" else None)
        for name, values in told.items()
    }


def _axis(trace: Mapping[str, Any], layout: Mapping[str, Any], letter: str) -> Mapping[str, Any]:
    """What is known of the x or y axis of a trace, which "x3" names."""
    return layout.get(f"{letter}axis{trace.get(f'{letter}axis', letter)[1:]}", {})


def _rows(points: Mapping[str, np.ndarray], axis: Mapping[str, Any], pixels: int) -> np.ndarray:
    """Rows to draw of what the axis shows first, and of what it does not."""
    y, shown = points["y"], axis.get("range")
    if "x" not in points or not shown or axis.get("type") == "log":
        return kept(y, pixels)
    inside = (points["x"] >= shown[0]) & (points["x"] <= shown[1])
    parts = [np.flatnonzero(inside), np.flatnonzero(~inside)]
    return np.sort(np.concatenate([rows[kept(y[rows], pixels)] for rows in parts if len(rows)]))


def _step(values: np.ndarray, name: str) -> float:
    """To what values are rounded: the screen's steps of the range; what lies along the curve, so that its points stay
    apart too."""
    known = values[np.isfinite(values)]
    most = float(np.ptp(known)) if len(known) else 0.0
    if name == "y" or not most:
        return most / STEPS
    apart = np.abs(np.diff(known))
    return min(most / STEPS, max(float(apart[apart > 0].min()), SINGLE * most))


def _digits(values: np.ndarray, step: float | None) -> list[float | None]:
    """Values as a page has them: to the digit below `step`, or where there is none to so many digits each."""
    if step is None:
        told = [float(f"{value:.6g}") for value in values.tolist()]
    else:
        told = np.round(values, -math.floor(math.log10(step)) if step else 12).tolist()
    return [value if math.isfinite(value) else None for value in told]


def numbers(values: Any) -> np.ndarray:
    """An array of a figure, which Plotly has packed or not."""
    if not isinstance(values, dict):
        return np.asarray(values)
    packed = np.frombuffer(b64decode(values["bdata"]), values["dtype"])
    return packed.reshape([int(length) for length in str(values.get("shape", packed.size)).split(",")])


def single(values: Any) -> Any:
    """Data of a figure, its arrays of numbers in single precision: a screen shows less."""
    if isinstance(values, dict):
        if values.get("dtype") == "f8":
            packed = np.frombuffer(b64decode(values["bdata"]), np.float64).astype(np.float32)
            return values | {"dtype": "f4", "bdata": b64encode(packed.tobytes()).decode("ascii")}
        return {key: single(value) for key, value in values.items()}
    return [single(value) for value in values] if isinstance(values, (list, tuple)) else values
