"""Readings that are something else than they are called: one line, before anything is computed from them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.trace import find_columns, read_trace, write_trace
from schemas.axes_description import Axes, load_axes
from schemas.errors import TraceError
from schemas.robot import load_robot
from tests.service import arm

COLUMNS = """joints = 3
time = "t"
position = { name = "q{joint}", unit = "counts", counts_per_rev = 65536 }
torque = { name = "y{joint}", unit = "permille", rated = 2.0 }
"""


def table(folder: Path, position: np.ndarray, torque: np.ndarray, columns: str = COLUMNS) -> Path:
    (folder / "columns.toml").write_text(columns)
    values = np.column_stack([np.arange(len(position)) * 1e-3, np.round(position), np.round(torque)])
    np.savetxt(folder / "log.csv", values, "%.10g", ",", header="t,q1,q2,q3,y1,y2,y3", comments="")
    return folder / "log.csv"


def waves() -> tuple[np.ndarray, np.ndarray]:
    """Counts and per mille of a slow swing."""
    phase = np.arange(2000)[:, None] * 2 * np.pi / 1000 + np.arange(3)
    return 9000 * np.sin(phase), 400 * np.cos(phase)


def test_sixteen_bits_that_wrap(tmp_path: Path) -> None:
    position, torque = waves()
    log = table(tmp_path, position, np.where(torque < 0, np.round(torque) + 65536, torque))
    with pytest.raises(TraceError, match=r"log.csv: torque_1 \('y1'\) steps by 2\^16 4 times .*line.*: bits = 16"):
        read_trace(log, columns=find_columns(tmp_path / "columns.toml"))
    signed = COLUMNS.replace("rated = 2.0", "rated = 2.0, bits = 16")
    table(tmp_path, position, np.where(torque < 0, np.round(torque) + 65536, torque), signed)
    trace = read_trace(log, columns=find_columns(tmp_path / "columns.toml"))
    np.testing.assert_allclose(trace.torque, np.round(torque) * 2e-3)
    log = table(tmp_path, (position + 28e3 + 32768) % 65536 - 32768, torque)
    with pytest.raises(TraceError, match=r"position_1 \('q1'\) steps by 2\^16 .*unwrap it first"):
        read_trace(log, columns=find_columns(tmp_path / "columns.toml"))


def test_a_fast_motor_does_not_wrap(tmp_path: Path) -> None:
    """65 536 counts in a millisecond, steadily, and one sample that is off by as many."""
    position, torque = waves()
    position = position + np.arange(len(position))[:, None] * 65536.0
    position[700, 1] += 65536
    fine = COLUMNS.replace("65536 }", "16777216 }")
    log = table(tmp_path, position, torque, fine)
    axes = Axes.model_validate({"name": "fast", "kind": "axes", "axis": [{}] * 3})
    trace = read_trace(log, axes, find_columns(tmp_path / "columns.toml"))
    assert len(trace) == 2000


def test_a_column_named_twice(tmp_path: Path) -> None:
    twice = COLUMNS.replace('"y{joint}"', '"q{joint}"')
    log = table(tmp_path, *waves(), twice)
    with pytest.raises(TraceError, match="column 'q1' is named twice: position of joint 1 and torque of joint 1"):
        read_trace(log, columns=find_columns(tmp_path / "columns.toml"))


def test_a_map_of_one_value_a_count_is_a_slow_turn(tmp_path: Path) -> None:
    """Every second count measured, 0 in between, from the last to the first: what is left has its time and its row."""
    values = np.zeros(4096)
    values[1::2] = 2 + np.cos(np.arange(1, 4096, 2))
    np.save(tmp_path / "map.npy", values)
    (tmp_path / "columns.toml").write_text(
        'joints = 1\ntime = { rate_hz = 400, backwards = true }\ntorque = "value"\n'
        'position = { name = "row", unit = "counts", counts_per_rev = 4096 }\n'
        'where = { name = "value", unlike = 0 }\n'
    )
    trace = read_trace(tmp_path / "map.npy", columns=find_columns(tmp_path / "columns.toml"))
    rows = np.arange(4095, 0, -2)
    np.testing.assert_allclose(trace.position[:, 0], rows * 2 * np.pi / 4096)
    np.testing.assert_allclose(trace.torque[:, 0], values[rows])
    np.testing.assert_allclose(trace.time, np.arange(2048) / 200)
    assert "2048 of 4096 rows have 0 in column 'value' and were left out" in [f.message for f in trace.findings]
    np.save(tmp_path / "map.npy", np.zeros(4096))
    with pytest.raises(TraceError, match=r"map.npy: all rows have 0 in column 'value'"):
        read_trace(tmp_path / "map.npy", columns=find_columns(tmp_path / "columns.toml"))


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (
            COLUMNS.replace('"t"', '{ name = "t", backwards = true }'),
            "backwards is only for a table without time stamps",
        ),
        (COLUMNS + 'where = { name = "t", equals = 1, unlike = 0 }\n', "equals 1 and unlike 0: give one of them"),
    ],
)
def test_keys_that_do_not_go_together(tmp_path: Path, columns: str, said: str) -> None:
    table(tmp_path, *waves(), columns)
    with pytest.raises(TraceError, match=said):
        find_columns(tmp_path / "columns.toml")


def test_torque_that_is_a_command(tmp_path: Path) -> None:
    log = arm.record(tmp_path / "log.csv", 1)
    header, *lines = log.read_text().splitlines()
    header += "".join(f",torque_command_{j}_nm" for j in (1, 2, 3))
    rows = [[*line.split(","), "0.5", *line.split(",")[5:]] for line in lines]
    log.write_text("\n".join([header, *(",".join(row) for row in rows)]) + "\n")
    told = [finding.message for finding in read_trace(log, load_axes(arm.write(tmp_path))).findings]
    assert told == [
        f"torque of joint {j} equals its torque_command to the last digit: it was not measured" for j in (2, 3)
    ]


def test_a_log_that_the_urdf_does_not_fit(tmp_path: Path) -> None:
    robot = load_axes(arm.write(tmp_path))
    log = arm.record(tmp_path / "log.csv", 1, unit=np.pi / 180)
    with pytest.raises(
        TraceError, match=r"log.csv: position of joint 1 .* 'j1' of small.urdf .*: degrees for radians\?"
    ):
        read_trace(log, robot)
    with pytest.raises(TraceError, match=r"log.csv: 3 joints, small is described with 2$"):
        read_trace(arm.record(tmp_path / "log.csv", 1), load_axes(_two(tmp_path)))


@pytest.mark.parametrize(
    ("joints", "angle", "force", "said"),
    [
        (6, "rad", "nm", "6 joints, d3-1200 is described with 3"),
        (3, "m", "n", "an axis in m, d3-1200 is described otherwise"),
    ],
)
def test_a_log_of_another_machine_than_the_delta_described(
    tmp_path: Path, joints: int, angle: str, force: str, said: str
) -> None:
    time = np.arange(100) * 1e-3
    wave = 0.1 * np.sin(time)[:, None] * np.ones(joints)
    names = [
        f"{name}_{joint + 1}_{unit}"
        for name, unit in (("position", angle), ("torque", force))
        for joint in range(joints)
    ]
    log = tmp_path / "log.csv"
    np.savetxt(log, np.column_stack([time, wave, wave]), "%.10g", ",", header=",".join(["time_s", *names]), comments="")
    with pytest.raises(TraceError, match=f"log.csv: {said}"):
        read_trace(log, load_robot("d3-1200"))


@pytest.mark.parametrize("name", ["log.csv", "log.mcap"])
def test_a_log_without_the_joints_that_rest(tmp_path: Path, name: str) -> None:
    """As `init` names them all: said before any joint is looked at."""
    path = arm.write(tmp_path)
    path.write_text(path.read_text().replace(', "j3"]\nheld = ["grip"]', ', "j3", "grip"]'))
    log = arm.record(tmp_path / "log.csv", 1)
    if name == "log.mcap":
        write_trace(read_trace(log), tmp_path / name)
    said = rf"{name}: 3 joints, small is described with 4; move joints that rest at zero from `joints` to `held`$"
    with pytest.raises(TraceError, match=said):
        read_trace(tmp_path / name, load_axes(path))


def _two(folder: Path) -> Path:
    path = arm.write(folder)
    path.write_text(path.read_text().replace(', "j3"', "").replace('["grip"', '["j3", "grip"'))
    return path
