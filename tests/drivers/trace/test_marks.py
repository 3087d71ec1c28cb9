"""Tables as spreadsheets and loggers write them: marks between thousands, the day beside the time of day, topics that
share one column of stamps."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from drivers.trace import read_trace
from drivers.trace.tables import read_table
from schemas.columns import Columns
from schemas.errors import RobotError, TraceError
from schemas.toml import validate

POSITION = {"name": "q", "unit": "counts", "counts_per_rev": 4096}


@pytest.mark.parametrize(
    ("cells", "marks"),
    [
        (("1.234,5", "-12.345.678,25", "7,5"), {"separator": ";", "decimal": ",", "thousands": "."}),
        (("1,234.5", "-12,345,678.25", "7.5"), {"separator": ";", "thousands": ","}),
        (("1'234.5", "-12'345'678.25", "7.5"), {"separator": ";", "thousands": "'"}),
        (("1 234.5", "-12 345 678.25", "7.5"), {"separator": ";", "thousands": " "}),
    ],
)
def test_marks_between_thousands(tmp_path: Path, cells: tuple[str, ...], marks: dict[str, str]) -> None:
    path = tmp_path / "log.csv"
    point = "," if marks.get("decimal") == "," else "."
    path.write_text("t;q\n" + "".join(f"0{point}0{k}0;{cells[k % 3]}\n" for k in range(9)))
    table = read_table(path)
    np.testing.assert_allclose(table.columns["q"][:3], [1234.5, -12345678.25, 7.5])
    np.testing.assert_allclose(np.diff(table.columns["t"]), 0.01)
    assert {key: table.layout.get(key) for key in marks} == marks
    again = read_table(path, table.layout)
    np.testing.assert_array_equal(again.columns["q"], table.columns["q"])


def test_the_first_mark_may_stand_far_down(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t;q\n" + "".join(f"0.{k:04};{900.5 + k - (800 if k < 800 else 0):,.7f}\n" for k in range(900)))
    table = read_table(path)
    assert table.layout["thousands"] == ","
    np.testing.assert_allclose(table.columns["q"], np.where(np.arange(900) < 800, 100.5, 900.5) + np.arange(900))


def test_a_space_that_does_not_break_is_one(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t;q\n" + "".join(f"0,0{k}0;1\u202f234\u00a0567,5\n" for k in range(9)))
    table = read_table(path)
    assert table.layout["thousands"] == " "
    np.testing.assert_allclose(table.columns["q"], 1234567.5)


@pytest.mark.parametrize("form", ["%H:%M:%S.%f", "%H:%M:%S,%f", "%m/%d/%Y %I:%M:%S.%f %p"])
def test_times_of_day_go_on_over_midnight(tmp_path: Path, form: str) -> None:
    path, clock = tmp_path / "log.csv", np.arange(500) * 0.004
    begin = datetime(2026, 11, 26, 23, 59, 59)
    cells = [(begin + timedelta(seconds=float(t))).strftime(form) for t in clock]
    path.write_text("Time;q1;tau1\n" + "".join(f"{cell};{k}.5;1.5\n" for k, cell in enumerate(cells)))
    table = read_table(path)
    assert table.units["Time"] == "datetime"
    np.testing.assert_allclose(table.columns["Time"], clock, atol=1e-6)
    columns = {"separator": ";", "joints": 1, "time": {"name": "Time", "unit": "datetime"}, "position": "q1"}
    trace = read_trace(path, columns=validate(Columns, columns | {"torque": "tau1"}, path, TraceError))
    np.testing.assert_allclose(np.diff(trace.time), 0.004, atol=1e-6)


@pytest.mark.parametrize("cells", [("1.234", "2.345", "10.500"), ("1,234", "2,345", "10,500")])
def test_three_decimals_are_no_thousands(tmp_path: Path, cells: tuple[str, ...]) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t;q\n" + "".join(f"{k};{cells[k % 3]}\n" for k in range(9)))
    table = read_table(path)
    assert "thousands" not in table.layout
    np.testing.assert_allclose(table.columns["q"][:3], [1.234, 2.345, 10.5])


def test_a_mark_is_not_the_decimal_mark_too() -> None:
    with pytest.raises(TraceError, match=r"thousands '\.' is also the decimal mark"):
        validate(Columns, {"thousands": "."}, Path("c.toml"), TraceError)


@pytest.mark.parametrize("ending", [".csv", ".csv.gz"])
@pytest.mark.parametrize("day", ["2026-11-26", "26.11.2026"])
def test_the_day_stands_beside_the_time_of_day(tmp_path: Path, day: str, ending: str) -> None:
    """Over midnight."""
    path, clock = tmp_path / f"log{ending}", 86_399.9 + np.arange(100) * 0.004
    other = {"2026-11-26": "2026-11-27", "26.11.2026": "27.11.2026"}[day]
    lines = [
        f"{day if t < 86400 else other},{int(t % 86400 // 3600):02}:{int(t // 60 % 60):02}:{t % 60:09.6f},{k},1.5"
        for k, t in enumerate(clock)
    ]
    text = "\n".join(["Date,Time,q,tau", *lines]) + "\n"
    if ending.endswith("gz"):
        import gzip

        path.write_bytes(gzip.compress(text.encode()))
    else:
        path.write_text(text)
    table = read_table(path)
    assert table.units["Time"] == "datetime"
    assert table.layout["date"] == "Date"
    assert table.columns["Time"][0] == 0.0  # so that float64 keeps its nanoseconds
    np.testing.assert_allclose(np.diff(table.columns["Time"]), 0.004, atol=1e-6)
    columns = Columns.model_validate(
        {"time": {"name": "Time", "date": "Date", "unit": "datetime"}, "position": POSITION, "torque": "tau"}
    )
    trace = read_trace(path, None, columns)
    np.testing.assert_allclose(np.diff(trace.time), 0.004, atol=1e-6)
    assert trace.time_ns[0] == np.datetime64("2026-11-26T23:59:59.9", "ns").astype(int)


def test_a_day_goes_with_a_time_of_day_alone() -> None:
    with pytest.raises(RobotError, match=r"date 'd' with unit 's'"):
        validate(Columns, {"time": {"name": "t", "date": "d"}}, Path("c.toml"), RobotError)


def test_topics_on_rows_of_their_own_share_a_column_of_stamps(tmp_path: Path) -> None:
    """The torque's topic comes half as often, half a millisecond later: straight lines between its own rows."""
    rows = []
    for k in range(400):
        rows.append((0.002 * k, f"{k}", ""))
        if k % 2 == 0:
            rows.append((0.002 * k + 0.0005, "", f"{1000 * (0.002 * k + 0.0005):.6f}"))
    path = tmp_path / "log.csv"
    path.write_text("time,q,tau\n" + "".join(f"{t:.6f},{q},{m}\n" for t, q, m in rows))
    trace = read_trace(path, None, Columns.model_validate({"time": "time", "position": POSITION, "torque": "tau"}))
    assert len(trace) == 400
    np.testing.assert_allclose(trace.position[:, 0], np.arange(400) * 2 * np.pi / 4096)
    np.testing.assert_allclose(trace.torque[1:399, 0], 1000 * trace.time[1:399], atol=1e-6)
    assert np.isnan(trace.torque[0, 0])
    assert any("is sampled every 4 ms, interpolated linearly" in finding.message for finding in trace.findings)


def test_a_column_with_holes_is_no_topic_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time,q,tau\n" + "".join(f"{0.002 * k:.3f},{k},{'' if k % 3 else 1.0}\n" for k in range(300)))
    trace = read_trace(path, None, Columns.model_validate({"time": "time", "position": POSITION, "torque": "tau"}))
    assert np.isnan(trace.torque[:, 0]).sum() == 200
