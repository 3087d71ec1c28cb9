"""`import deltatwin`: it is light, keeps its promise, and says what the commands say."""

from __future__ import annotations

import doctest
import json
import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from typer.testing import CliRunner

import deltatwin as dt
import deltatwin.functions
import deltatwin.public_trace
from deltatwin.results import DiagnosisResult
from drivers.data_frames import pl
from replay.demo import LOG, ROBOT
from schemas.diagnosis import Diagnosis
from schemas.messages import SampleFlag
from service.cli.main import app
from tests.conftest import REPOSITORY

UNTYPED = cast("Any", dt)  # as who checks no types calls it
LONGEST_REPR = 1200  # characters that a notebook's cell takes without a scroll bar


@pytest.fixture(scope="module")
def demo() -> tuple[dt.Description, dt.Trace]:
    return dt.load_demo()


@pytest.fixture(scope="module")
def results(demo: tuple[dt.Description, dt.Trace]) -> dict[str, object]:
    robot, log = demo
    return {
        "identify": dt.identify(robot, log),
        "evaluate": dt.evaluate(robot, log),
        "payload": dt.payload(robot, log),
        "rollout": dt.rollout(robot, log),
    }


def said(command: str, *options: object) -> dict:
    done = CliRunner().invoke(app, [command, str(LOG), "--robot", str(ROBOT), *map(str, options), "--json"])
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


def test_nothing_large_is_imported_before_it_is_used() -> None:
    code = "import sys, deltatwin; print(sorted({'numpy', 'numba', 'polars', 'plotly', 'scipy'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_what_is_promised_is_there_and_no_more() -> None:
    assert all(getattr(dt, name) is not None for name in dt.__all__)
    assert set(dir(dt)) == {*dt.__all__, "__version__"}
    assert dt.__version__.split(".")[0].isdigit()
    for name in dt.__all__:
        assert getattr(dt, name).__doc__, name
    with pytest.raises(AttributeError, match="no attribute 'identfy'"):
        dt.identfy  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.parametrize("module", [deltatwin.functions, deltatwin.public_trace])
def test_the_examples_run_as_they_stand(module: object) -> None:
    failed, tried = doctest.testmod(module)  # type: ignore[arg-type]
    assert tried > 3
    assert not failed


def test_identify_is_the_command(results: dict, tmp_path: Path) -> None:
    document = said("identify", "--out", tmp_path / "found.toml")
    frame = results["identify"].to_frame()
    assert frame["name"].to_list() == [one["name"] for one in document["parameters"]]
    assert frame["value"].to_list() == [one["value"] for one in document["parameters"]]
    dt.save_robot(results["identify"].robot, tmp_path / "ours.toml", ROBOT)
    assert (tmp_path / "ours.toml").read_text() == (tmp_path / "found.toml").read_text()
    assert list(results["identify"].warnings) == document["warnings"]


def test_evaluate_is_the_command(results: dict) -> None:
    models = said("evaluate")["models"]
    assert {name: rms.tolist() for name, rms in results["evaluate"].models.items()} == {
        name: figures["rms_nm"] for name, figures in models.items()
    }
    frame = results["evaluate"].to_frame().filter(pl.col("model") == "full")
    assert frame["rms"].to_list() == models["full"]["rms_nm"]


def test_payload_is_the_command(results: dict) -> None:
    levels = said("payload")["traces"][0]["levels"]
    assert [one.mass for one in results["payload"].levels] == [one["mass"] for one in levels]
    frame = results["payload"].to_frame()
    assert frame.filter(pl.col("event") == 1).height == sum(one["event"] == "pick" for one in levels)
    error, unknown = frame["std_dev_kg"].to_numpy(), np.isnan(frame["mass_kg"].to_numpy())
    until = int(unknown.sum())
    assert 0 < until < 0.01 * len(error)
    assert unknown[:until].all(), "until the first estimate"
    np.testing.assert_array_equal(np.isnan(error), unknown)
    assert (error[~unknown] > 0.0).all()
    assert not frame["trusted"][:until].any()


def test_rollout_is_the_command(results: dict) -> None:
    document = said("rollout")
    assert [one["platform_mm"] for one in document["robots"]] == results["rollout"].to_frame()["platform_mm"][
        :-1
    ].to_list()


@pytest.mark.parametrize(("period", "said"), [(0.002, "500 Hz"), (1.0, "1 Hz"), (1 / 60, "60 Hz"), (1e-4, "10000 Hz")])
def test_a_trace_says_its_rate_in_hertz(period: float, said: str) -> None:
    time = period * np.arange(100)
    assert f", {said}, " in repr(dt.Trace.from_arrays(time, np.sin(time), np.cos(time)))


class Checked(HTMLParser):
    """Every tag that is opened is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_results_are_short_in_a_notebook_and_have_a_frame_and_a_plot(results: dict, demo: tuple) -> None:
    robot, log = demo
    assert repr(robot) == "<Robot 'demo': identified>"
    assert ", 1000 Hz, " in repr(log)
    for shown in (*results.values(), log):
        assert len(repr(shown)) < LONGEST_REPR
        Checked(shown._repr_html_())
        assert shown.to_frame().height > 0
        figure = shown.plot()
        assert figure.data
        assert all(len(axis.title.text) > 2 for axis in figure.select_yaxes())
    Checked(deltatwin.results.html("<script>", ["a < b"], ["&"], [["<b>"]]))


def test_a_payload_is_drawn_from_the_start_of_its_log(demo: tuple) -> None:
    """Whose clock may count from 1970."""
    robot, log = demo
    late = dt.Trace.from_arrays(log.time + 849321714.0, log.position, log.torque, robot=robot)
    time = dt.payload(robot, late).plot().data[0].x
    assert (time[0], time[-1]) == pytest.approx((0.0, log.time[-1] - log.time[0]), abs=1e-3)


def test_arrays_and_frames_are_the_trace_they_came_from(demo: tuple) -> None:
    robot, log = demo
    again = dt.Trace.from_dataframe(log.to_frame(), robot=robot)
    arrays = dt.Trace.from_arrays(
        log.time, log.position, log.torque, position_command=log.position_command, gripper=log.gripper, robot=robot
    )
    for other in (again, arrays):
        assert np.array_equal(other.time, log.time)
        assert np.array_equal(other.position, log.position)
        assert np.array_equal(other.torque, log.torque)
        assert other.position_command is not None
        assert log.position_command is not None
        assert np.array_equal(other.position_command, log.position_command)
        assert np.array_equal(other.flags, log.flags)
    assert dt.evaluate(robot, arrays).to_frame()["rms"].to_list() == dt.evaluate(robot, log).to_frame()["rms"].to_list()


def test_a_foreign_frame_takes_a_mapping(tmp_path: Path) -> None:
    time = np.arange(2000) * 1e-3
    frame = pl.DataFrame({"t": 1e3 * time, "phi": np.degrees(np.sin(time)), "M": np.cos(time), "note": "x"})
    mapping = tmp_path / "columns.toml"
    mapping.write_text(
        'joints = 1\ntime = { name = "t", unit = "ms" }\nposition = { name = "phi", unit = "deg" }\ntorque = "M"\n'
    )
    with pytest.raises(
        dt.TraceError, match="frame: no column position_1_rad; assign the columns with `columns`: t, phi"
    ):
        dt.Trace.from_dataframe(frame)
    found = dt.Trace.from_dataframe(frame, columns=mapping)
    np.testing.assert_allclose(found.position[:, 0], np.sin(time), atol=1e-12)
    np.testing.assert_allclose(found.time, time, atol=1e-12)


def test_what_is_wrong_with_arrays_is_one_line_or_a_flag() -> None:
    time, ones = np.arange(1000) * 1e-3, 0.1 * np.ones((1000, 3))
    for position, torque, what in (
        (ones[:-1], ones, r"position has shape \(999, 3\), but time has 1000 samples"),
        (ones, ones[:, :2], "arrays of different numbers of joints: {'position': 3, 'torque': 2}"),
        (ones, [["a"]] * 1000, "torque does not contain numbers"),
        (np.degrees(ones), ones, "degrees for radians"),
    ):
        with pytest.raises(dt.TraceError, match=what):
            dt.Trace.from_arrays(time, position, torque, name="bench")
    with pytest.raises(dt.TraceError, match="time does not rise"):
        dt.Trace.from_arrays(time[::-1], ones, ones)
    broken = ones.copy()
    broken[500, 1] = np.nan
    found = dt.Trace.from_arrays(time, ones, broken)
    assert found.flags[500] & SampleFlag.NOT_A_NUMBER
    assert "row 500" in found.findings[0].message
    assert "1 row flagged" in repr(found)


def test_what_is_no_trace_is_said(demo: tuple) -> None:
    robot, trace = demo
    with pytest.raises(dt.DataError, match="no trace is given"):
        dt.identify(robot, [])
    with pytest.raises(dt.DataError, match="no trace is given"):
        dt.evaluate(robot, [])
    with pytest.raises(dt.DataError, match=r"'picks.csv' is not a trace; read it with deltatwin.read_trace"):
        dt.identify(robot, ["picks.csv"])  # type: ignore[list-item]
    with pytest.raises(dt.DataError, match="give it only once"):
        dt.diagnose(robot, [trace], tests=[trace])


@pytest.mark.parametrize(
    ("wrong", "what"),
    [
        (lambda robot, log: UNTYPED.read_trace(LOG, "d3-1200"), "'d3-1200' is not a description; read it with"),
        (lambda robot, log: UNTYPED.read_trace(7), "7: a path is needed, as a str or a Path"),
        (lambda robot, log: UNTYPED.load_robot(None), "None: a path is needed"),
        (lambda robot, log: dt.load_robot("d3-1200", effects="none_there.py"), "none_there.py: "),
        (lambda robot, log: UNTYPED.save_robot(None, "a.toml"), "None is not a description"),
        (lambda robot, log: UNTYPED.identify("d3-1200", log), "'d3-1200' is not a description"),
        (lambda robot, log: UNTYPED.identify(robot, None), "None is not a trace"),
        (lambda robot, log: UNTYPED.identify(robot, log, method="foo"), "method: 'foo' is none of 'pooled', 'paper'"),
        (lambda robot, log: UNTYPED.evaluate("d3-1200", log), "'d3-1200' is not a description"),
        (lambda robot, log: UNTYPED.payload(robot, None), "None is not a trace"),
        (lambda robot, log: UNTYPED.payload(robot, [log]), "is not a trace"),
        (lambda robot, log: UNTYPED.diagnose(log, log), "is not a description"),
        (lambda robot, log: UNTYPED.rollout([robot, robot], log), "one robot, or several in a dict: .* is not a descr"),
        (lambda robot, log: UNTYPED.rollout(robot, log, horizon="a"), "horizon: 'a' is not a number of seconds"),
        (lambda robot, log: UNTYPED.Trace.from_dataframe(None), "a NoneType is not a data frame of Polars or pandas"),
        (lambda robot, log: UNTYPED.Trace.from_dataframe({"a": [1]}), "a dict is not a data frame"),
    ],
)  # fmt: skip
def test_a_wrong_kind_of_thing_is_an_error_of_one_line(demo: tuple, wrong: Callable, what: str) -> None:
    with pytest.raises(dt.DeltatwinError, match=what) as told:
        wrong(*demo)
    assert "\n" not in str(told.value)


def test_a_diagnosis_that_names_nothing_has_a_frame_with_its_columns(demo: tuple) -> None:
    found = DiagnosisResult(demo[0], Diagnosis.model_construct(effects=[]), cast("Any", None))
    keys = ["effect", "joints", "probability", "parameter", "value", "low", "high", "unit"]
    assert (found.to_frame().columns, found.to_frame().height) == (keys, 0)


def test_a_log_of_another_machine_is_refused(demo: tuple) -> None:
    robot, log = demo
    linear = dt.Trace.from_arrays(log.time, log.position, log.torque, angular=False, name="gantry")
    two = dt.Trace.from_arrays(log.time, log.position[:, :2], log.torque[:, :2], name="two")
    for do in (dt.identify, dt.evaluate, dt.payload, dt.diagnose, dt.rollout):
        with pytest.raises(dt.DataError, match="gantry: 3 joints in m, but demo has 3 in rad"):
            do(robot, linear)
        with pytest.raises(dt.DataError, match="two: 2 joints in rad, but demo has 3 in rad"):
            do(robot, two)


def test_a_sample_without_a_time_is_left_out_and_said() -> None:
    time, ones = np.arange(1000) * 1e-3, 0.1 * np.ones(1000)
    time[[10, 20]] = np.nan
    found = dt.Trace.from_arrays(time, ones, ones)
    assert len(found) == 998
    assert found.time[10] == time[11]
    assert any("left out 2 rows without a possible time stamp: rows 10, 20" in one.message for one in found.findings)
    with pytest.raises(dt.TraceError, match="arrays: no sample has a time"):
        dt.Trace.from_arrays(np.full(100, np.nan), ones[:100], ones[:100])


def test_stamps_of_the_calendar_keep_their_nanoseconds() -> None:
    begin = np.datetime64("2026-01-31T08:00:00.123456789")
    stamps = begin + np.arange(1000) * np.timedelta64(1_000_000, "ns")
    found = dt.Trace.from_arrays(stamps, 0.1 * np.ones(1000), np.ones(1000))
    expected = int(datetime(2026, 1, 31, 8, tzinfo=UTC).timestamp()) * 10**9 + 123_456_789
    assert found.time_ns[0] == expected
    assert found.time_ns[-1] == expected + 999_000_000
