"""Curves as a page has them: what a screen shows of them, peaks and breaks included."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
import pytest

from service.pages.curves import STEPS, WIDTH, kept, reduced

ROWS = 100_000


def drawn(figure: go.Figure, width: int = WIDTH) -> list[dict[str, Any]]:
    return reduced(figure.to_plotly_json(), width)


def shown(values: Any) -> np.ndarray:
    """Numbers of a curve, NaN where it is broken."""
    return np.array([np.nan if value is None else value for value in values])


def test_a_curve_keeps_its_ends_and_the_least_and_largest_of_every_pixel() -> None:
    values = np.random.default_rng(1).standard_normal(ROWS)
    rows = kept(values, 500)
    assert (np.diff(rows) > 0).all()
    assert rows[0] == 0
    assert rows[-1] == ROWS - 1
    assert len(rows) <= 2 * 500 + 2
    for pixel in np.array_split(np.arange(ROWS), 500):
        mine = values[np.intersect1d(rows, pixel)]
        assert mine.min() == values[pixel].min()
        assert mine.max() == values[pixel].max()


def test_a_short_curve_stays_as_it_is() -> None:
    np.testing.assert_array_equal(kept(np.zeros(1000), 500), np.arange(1000))
    assert len(kept(np.zeros(0), 500)) == 0


def test_a_break_stays_a_break() -> None:
    values = np.sin(np.arange(float(ROWS)))
    values[41_234] = np.nan
    values[60_000:70_000] = np.nan
    rows = kept(values, 500)
    assert 41_234 in rows
    hole = rows[(rows >= 60_000) & (rows < 70_000)]
    assert 0 < len(hole) <= 51
    assert len(kept(np.full(ROWS, np.nan), 500)) <= 502


def test_what_is_shown_first_is_whole_and_the_rest_is_there() -> None:
    """The worst second of a log of 1000 s: its samples, a thousand, all of them."""
    time = np.arange(0.0, 1000.0, 1e-3)
    torque = np.random.default_rng(0).standard_normal(len(time))
    figure = go.Figure(go.Scatter(x=time, y=torque, customdata=time - 5.0))
    figure.update_xaxes(range=[400.0, 401.0])
    (trace,) = drawn(figure)
    x, y = shown(trace["x"]), shown(trace["y"])
    inside = (x >= 400.0) & (x <= 401.0)
    np.testing.assert_allclose(x[inside], time[400_000:401_001], atol=1e-6)
    np.testing.assert_allclose(y[inside], torque[400_000:401_001], atol=np.ptp(torque) / STEPS)
    assert 0.9 * 2 * WIDTH < np.count_nonzero(~inside) <= 2 * WIDTH + 2
    assert y.max() == pytest.approx(torque.max(), abs=np.ptp(torque) / STEPS)
    np.testing.assert_allclose(shown(trace["customdata"]), x - 5.0, atol=1e-3)


def test_a_narrow_plot_has_fewer_points() -> None:
    figure = go.Figure(go.Scatter(x=np.arange(ROWS), y=np.random.default_rng(0).standard_normal(ROWS)))
    figure.update_xaxes(domain=[0.5, 0.75])
    (trace,) = drawn(figure)
    assert len(trace["y"]) == pytest.approx(2 * WIDTH / 4, rel=0.02)


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_digits_are_those_that_a_screen_shows(size: float) -> None:
    """Of the curve's own range, however small or large: a small motor's torque is no staircase."""
    values = size * np.random.default_rng(0).uniform(-1.0, 1.0, 500)
    (trace,) = drawn(go.Figure(go.Scatter(x=np.arange(500), y=values)))
    np.testing.assert_allclose(shown(trace["y"]), values, atol=2 * size / STEPS)
    assert np.mean([len(repr(value)) for value in trace["y"]]) < 11, "not the digits of double precision"
    magnitudes = go.Figure(go.Scatter(x=np.arange(500), y=np.geomspace(size, 1e-7 * size, 500)))
    magnitudes.update_yaxes(type="log")
    (trace,) = drawn(magnitudes)
    np.testing.assert_allclose(shown(trace["y"]), np.geomspace(size, 1e-7 * size, 500), rtol=1e-4)


def test_what_is_no_curve_stays() -> None:
    figure = go.Figure([go.Bar(x=["a", "b"], y=[1.0, 2.0]), go.Scatter(x=["a", "b"], y=[1.0, 2.0])])
    assert [list(trace["x"]) for trace in drawn(figure)] == [["a", "b"], ["a", "b"]]


def test_no_plot_is_wider_than_that() -> None:
    look = Path("service/pages/templates/look.css").read_text(encoding="utf-8")
    assert re.search(rf"body\{{[^}}]*max-width:{WIDTH}px", look)
