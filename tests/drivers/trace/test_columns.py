"""Foreign tables become joint-side SI through a mapping; the real files read as they are."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, decimate, sosfiltfilt

from drivers.trace import find_columns, read_trace
from schemas.columns import Columns, load_columns
from schemas.errors import TraceError
from schemas.messages import SampleFlag
from schemas.robot import load_robot


def test_plant_and_payload_logs_read_clean_and_fast(data: Path) -> None:
    paths = [*data.glob("plant_logs/*/*.csv"), *data.glob("payload_logs/*/*.csv")]
    assert len(paths) == 24
    for path in paths:
        trace = read_trace(path, load_robot(path.parent / "robot.toml"))
        raw = np.loadtxt(path, delimiter=",", skiprows=1, max_rows=50)
        assert trace.position_command is not None
        assert trace.torque_command is not None
        stacked = np.hstack(
            [trace.time[:, None], trace.position_command, trace.position, trace.torque_command, trace.torque]
        )
        assert np.array_equal(stacked[:50], raw), path
        assert not trace.findings, path
        assert not trace.flags.any()


@pytest.mark.parametrize("name", ["emps", "emps_pulses"])
def test_emps_gives_the_published_dynamics(data: Path, name: str) -> None:
    """Least squares on the mapped columns meets the published fit, which it can only in metres and newtons.

    emps_pulses adds a known force to the motor's, so its fit is looser. Filter and decimation as in the benchmark:
    fourth-order Butterworth there and back, central differences, the same low-pass on both sides.
    """
    trace = read_trace(data / "real" / "emps" / f"{name}.csv", columns=find_columns("emps"))
    assert trace.position.shape == (24841, 1)
    assert trace.position_command is not None
    position = sosfiltfilt(butter(4, 150, fs=1 / trace.period, output="sos"), trace.position[:, 0])
    speed = np.gradient(position, trace.period)
    regressors = np.column_stack([np.gradient(speed, trace.period), speed, np.sign(speed), np.ones(len(trace))])
    regressors = decimate(regressors, 10, ftype="iir", axis=0)
    force = decimate(trace.torque[:, 0], 10, ftype="iir")
    fit = np.linalg.lstsq(regressors, force, rcond=None)[0]
    tolerance = [0.001, 0.01, 0.01, 0.01] if name == "emps" else [0.02, 0.05, 0.05, 0.05]
    assert np.all(np.abs(fit / [95.1089, 203.5034, 20.3935, -3.1648] - 1) < tolerance), fit


@pytest.mark.parametrize("export", ["default", "decimal_comma"])
def test_twincat_scope_exports(data: Path, export: str) -> None:
    """The exports hold counters: var_REAL64 = n at n ms, func_OS = t at t ms (0.2 ms), func_freesample = t (5 ms)."""
    path = data / "captures" / f"twincat_scope_{export}.csv"
    trace = read_trace(path, columns=find_columns("twincat_scope"))
    n = np.arange(1000.0)
    assert np.array_equal(trace.time, n / 1000)
    turn = 2 * np.pi / 65536
    assert np.allclose(trace.position, np.column_stack([n, -n / 10, n - 500]) * turn, rtol=0, atol=1e-15)
    assert np.allclose(trace.torque[:, 0], n * 2 / 1000)  # func_OS at whole milliseconds is n, to the digit
    assert np.allclose(trace.torque[:, 1], n * 0.1)
    # func_freesample: 997 at -3 ms (the counter had run on), then t at 2, 7, ... 997 ms, nothing after
    assert np.allclose(trace.torque[2:998, 2], n[2:998] * 2 / 1000 * 10)
    assert np.isnan(trace.torque[998:, 2]).all()
    assert (np.flatnonzero(trace.flags) == [998, 999]).all()
    told = " | ".join(f.message for f in trace.findings)
    assert "'func_OS') is sampled every 0.2 ms, interpolated linearly at the 1 ms stamps of position_1" in told
    assert "'func_freesample') is sampled every 5 ms" in told
    assert "2 of 1000 rows outside" in told


def test_hold_keeps_the_last_sample(data: Path, tmp_path: Path) -> None:
    text = (Path(__file__).parents[3] / "drivers/trace/mappings/twincat_scope.toml").read_text()
    mapping = tmp_path / "hold.toml"
    mapping.write_text(text.replace('name = "func_freesample",', 'name = "func_freesample", between = "hold",'))
    trace = read_trace(data / "captures" / "twincat_scope_default.csv", columns=load_columns(mapping))
    n = np.arange(2, 998)
    assert np.allclose(trace.torque[2:998, 2], (n - (n - 2) % 5) * 2 / 1000 * 10)


def kuka_like(count: int = 200) -> tuple[str, np.ndarray, np.ndarray]:
    """A German table of motor-side values, with the joint-side truth it was made from."""
    time = np.arange(count) * 0.012
    position = 0.5 * np.sin(2 * np.pi * 0.5 * time)[:, None] * [1.0, -0.6, 0.3]
    torque = 20 * np.cos(2 * np.pi * 0.5 * time)[:, None] * [1.0, 0.5, -0.7]
    turns = position * 55 / (2 * np.pi)
    rows = [
        [
            t * 1e3,
            np.degrees(p[0]) * 55,
            -np.degrees(p[1]) * 55 + 90,
            k[2] * 4096 + 1000,
            m[0] / 55 / 2.39e-3,
            m[1],
            m[2] / 1.7,
        ]
        for t, p, k, m in zip(time, position, turns, torque, strict=True)
    ]
    lines = ["KUKA Trace;Größen", "Zeit;Achse 1 [°];Achse 2 [°];Achse 3 [Ink];M1 [‰];M2 [Nm];M3 [A]"]
    lines += [";".join(repr(float(v)).replace(".", ",") for v in row) for row in rows]
    return "\r\n".join(lines) + "\r\n", position, torque


KUKA_COLUMNS = """
separator = ";"
decimal = ","
encoding = "cp1252"
header_line = 2
time = { name = "Zeit", unit = "ms" }
position = [
    { name = "Achse 1 [°]", unit = "deg", side = "motor", gear_ratio = 55 },
    { name = "Achse 2 [°]", unit = "deg", side = "motor", gear_ratio = 55, sign = -1, zero = 90 },
    { name = "Achse 3 [Ink]", unit = "counts", counts_per_rev = 4096, side = "motor", gear_ratio = 55, zero = 1000 },
]
torque = [
    { name = "M1 [‰]", unit = "permille", rated = 2.39, side = "motor", gear_ratio = 55 },
    "M2 [Nm]",
    { name = "M3 [A]", unit = "A", constant = 1.7 },
]
"""


@pytest.mark.parametrize("ending", ["csv", "csv.gz"])
@pytest.mark.parametrize("place", ["file", "robot"])
def test_every_unit_comes_to_the_joint(tmp_path: Path, robot_text: str, ending: str, place: str) -> None:
    text, position, torque = kuka_like()
    raw = text.encode("cp1252")
    path = tmp_path / f"kuka.{ending}"
    path.write_bytes(gzip.compress(raw) if ending == "csv.gz" else raw)
    if place == "file":
        (tmp_path / "c.toml").write_text(KUKA_COLUMNS, encoding="utf-8")
        trace = read_trace(path, columns=load_columns(tmp_path / "c.toml"))
    else:
        (tmp_path / "r.toml").write_text(robot_text + "\n[columns]" + KUKA_COLUMNS, encoding="utf-8")
        trace = read_trace(path, load_robot(tmp_path / "r.toml"))
    assert np.allclose(trace.time, np.arange(200) * 0.012, rtol=1e-15)
    assert np.allclose(trace.position, position, rtol=1e-12, atol=1e-14)
    assert np.allclose(trace.torque, torque, rtol=1e-12, atol=1e-13)
    assert trace.position_command is None
    assert not trace.findings


def test_own_header_is_seen_beside_a_robots_mapping(tmp_path: Path, robot_text: str, own_csv: Path) -> None:
    (tmp_path / "r.toml").write_text(robot_text + "\n[columns]" + KUKA_COLUMNS, encoding="utf-8")
    assert len(read_trace(own_csv, load_robot(tmp_path / "r.toml"))) == 200


def test_joint_pattern_names_all_joints_and_the_robot_gives_the_gear(tmp_path: Path, robot_text: str) -> None:
    (tmp_path / "a.csv").write_text(
        "t,q1,q2,q3,m1,m2,m3\n" + "".join(f"{i / 1000},{i / 10},0,{-i / 10},1,2,3\n" for i in range(5))
    )
    columns = Columns.model_validate(
        {
            "time": "t",
            "position": {"name": "q{joint}", "unit": "deg", "side": "motor"},
            "torque": {"name": "m{joint}", "side": "motor"},
        }
    )
    (tmp_path / "r.toml").write_text(robot_text)  # gear_ratio = 5
    trace = read_trace(tmp_path / "a.csv", load_robot(tmp_path / "r.toml"), columns)
    assert np.allclose(trace.position[:, 0], np.radians(np.arange(5) / 10) / 5)
    assert np.array_equal(trace.torque[0], [5, 10, 15])
    with pytest.raises(TraceError, match=r"position_1 \('q1'\) is motor side: give its gear_ratio"):
        read_trace(tmp_path / "a.csv", None, columns)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("separater = ';'", r"c\.toml: separater: unknown key \(value ';'\)"),
        ("decimal = ';'", r"c\.toml: decimal: .*'\.' or ','.*got ';'"),
        ("decimal = ','", r"c\.toml: decimal ',' is also the separator"),
        ("position = [{ name = 'a', unit = 'inch' }]", r"c\.toml: position\.0\.unit: .*got 'inch'"),
        ("position = [{ name = 'a', unit = 'counts' }]", r"position\.0: unit 'counts' with counts_per_rev None"),
        ("torque = [{ name = 'a', unit = 'V' }]", r"torque\.0: unit 'V' with constant None"),
        ("torque = ['a', 'b']", r"as many position as torque columns.*'torque': 2"),
        ("header_line = 3\ndata_line = 2", r"data_line 2 is not behind header_line 3"),
        ("time = ", r"c\.toml: not TOML"),
    ],
)
def test_a_wrong_mapping_names_file_key_and_value(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(TraceError, match=message):
        load_columns(tmp_path / "c.toml")


def test_an_unknown_mapping_name_lists_those_there_are() -> None:
    with pytest.raises(TraceError, match=r"nope: no such mapping file.*emps, twincat_scope"):
        find_columns("nope")


def test_a_command_column_the_mapping_names_must_be_there(own_csv: Path) -> None:
    columns = Columns.model_validate({"position_command": "soll_{joint}"})
    with pytest.raises(TraceError, match=r"column 'soll_1' is missing; line 1 has: time_s, "):
        read_trace(own_csv, None, columns)


def test_no_flag_is_set_by_units_alone(own_csv: Path) -> None:
    assert read_trace(own_csv).flags.tolist() == [SampleFlag(0)] * 200
