"""Logs as the field has them: each is read as it was, or refused in one line that says why and what to do.

The inputs are those of `tests/data/field`, each beside a README that says what is right.
"""

from __future__ import annotations

import re
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.trace import read_trace
from drivers.trace.tables import read_table
from schemas.axes_description import Description, load_description
from schemas.columns import load_columns
from schemas.errors import DeltatwinError
from service.cli.main import app


@pytest.fixture
def field(data: Path) -> Path:
    return data / "field"


def imported(log: Path, robot: Path, folder: Path, *options: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """Stamps, positions and torques of the log that `import` makes of `log`, and what it says."""
    arguments = ["import", str(log), "--robot", str(robot), "--yes", "--out", str(folder / "log.csv"), *options]
    done = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    trace = read_trace(folder / "log.csv")
    return trace.time, trace.position, trace.torque, " ".join(done.output.split())


def refused(log: Path, robot: Path, folder: Path) -> str:
    """What `import` says of a log that it does not take."""
    arguments = ["import", str(log), "--robot", str(robot), "--yes", "--out", str(folder / "log.csv")]
    with pytest.raises(DeltatwinError) as said:
        CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert "\n" not in str(said.value)
    return str(said.value)


def test_joints_go_by_name(field: Path, tmp_path: Path) -> None:
    folder = field / "bag_joint_order"
    _, position, _, said = imported(folder / "ur.mcap", folder / "arm.toml", tmp_path)
    names = [entry.name for entry in load_columns(tmp_path / "log.columns.toml").channel("torque")]
    assert names == ["shoulder_pan_joint.effort", "shoulder_lift_joint.effort", "elbow_joint.effort"]
    assert np.ptp(position[:, 0]) == pytest.approx(1.324 + 1.3177, abs=1e-3)  # of the pan joint, by the README's table
    assert "joints are assigned by the names of the description: 1 is 'shoulder_pan_joint.position'" in said
    assert "check: torques are N m by the definition of the message" in said  # a UR's driver publishes currents
    assert "--torque-unit 'A CONSTANT" in said


def test_only_a_driver_that_is_known_for_currents_is_doubted(field: Path, tmp_path: Path) -> None:
    *_, said = imported(field / "bag_compressed" / "msg_bag", field / "bag_compressed" / "robot.toml", tmp_path)
    assert "torques are N m by the definition of the message, which not every driver follows" in said
    assert "check: torques" not in said


def test_a_velocity_is_no_torque(field: Path, tmp_path: Path) -> None:
    folder = field / "effort_missing"
    assert "no torque was recorded" in refused(folder / "bag.mcap", folder / "robot.toml", tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["back", "swapped", "forward"])
def test_a_clock_set_back_splits_the_run(field: Path, name: str, tmp_path: Path) -> None:
    folder = field / "time_back_not_split"
    arguments = ["identify", str(folder / f"{name}.csv"), "--robot", str(folder / "robot.toml")]
    done = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "found.toml")], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    found = tomllib.loads((tmp_path / "found.toml").read_text())["identified"]
    assert found["inertia"]["value"] == pytest.approx([0.8, 0.3], abs=0.01)
    assert found["gravity_sin"]["value"] == pytest.approx([0.0, 5.0], abs=0.05)


@pytest.mark.parametrize(
    ("name", "rows"),
    [
        ("bag_split_order/bag", 500),
        ("bag_split_order/bag/metadata.yaml", 500),
        ("bag_compressed/file_bag", 500),
        ("bag_compressed/msg_bag", 500),
        ("bag_compressed/plain_bag/metadata.yaml", 500),
        ("ros1/ros1.bag", 100),
        ("ros1/ros1.mcap", 100),
    ],
)
def test_bags_are_read_whole_and_in_their_order(field: Path, name: str, rows: int, tmp_path: Path) -> None:
    robot = field / name.split("/")[0] / "robot.toml"
    stamps, position, torque, _ = imported(field / name, robot, tmp_path)
    assert len(stamps) == rows
    np.testing.assert_allclose(np.diff(stamps), 0.004, atol=1e-6)
    assert np.abs(np.diff(position, axis=0)).max() < 0.1  # rad in a cycle: no leap between parts
    assert np.ptp(torque, axis=0).min() > 1.0


def test_a_database_without_end_is_refused(field: Path, tmp_path: Path) -> None:
    said = refused(field / "db3_hostile" / "infview.db3", field / "ros1" / "robot.toml", tmp_path)
    assert "messages is a view" in said


@pytest.mark.parametrize("name", ["bridge.pcapng", "mirror.pcap"])
def test_a_frame_captured_twice_is_one(field: Path, name: str) -> None:
    folder = field / "ethercat_bridge_duplicates"
    trace = read_trace(folder / name, load_description(folder / "robot.toml"))
    assert len(trace) == 1500
    np.testing.assert_allclose(np.diff(trace.time), 1e-3, atol=1e-6)
    said = " ".join(finding.message for finding in trace.findings)
    assert "frames captured twice" in said
    assert "lost" not in said


@pytest.mark.parametrize("command", ["identify", "evaluate", "diagnose"])
@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("time_unit/ms.csv", r"1 samples per second by its time stamps, read as s; are they in ms \(1000 Hz\)"),
        (
            "noise_only/rand.csv",
            "rows are usable, but hardly any two in succession: this is not the motion of a machine",
        ),
    ],
)
def test_what_no_machine_wrote_is_one_line(field: Path, name: str, says: str, command: str, tmp_path: Path) -> None:
    out = [] if command == "evaluate" else ["--out", str(tmp_path / "out.toml")]
    with pytest.raises(DeltatwinError, match=says) as said:
        CliRunner().invoke(
            app, [command, str(field / name), "--robot", "d3-1200", *out], catch_exceptions=False, standalone_mode=False
        )
    assert "\n" not in str(said.value)


@pytest.mark.parametrize("scale", [1e300, 1e308, 1e-300, 1e-20])
@pytest.mark.parametrize("column", [1, 4])
def test_magnitudes_of_no_machine_are_one_line(tmp_path: Path, scale: float, column: int) -> None:
    values = np.random.default_rng(1).standard_normal(6)
    stamps = np.arange(3000) / 1000
    block = np.column_stack([stamps, *(0.3 * np.sin(2 * np.pi * stamps + k) + 0.01 * values[k] for k in range(6))])
    block[:, column : column + 3] *= scale
    names = [f"{what}_{j}_{unit}" for what, unit in (("position", "rad"), ("torque", "nm")) for j in (1, 2, 3)]
    np.savetxt(tmp_path / "log.csv", block, delimiter=",", header=",".join(["time_s", *names]), comments="")
    arguments = [str(tmp_path / "log.csv"), "--robot", "d3-1200"]
    with pytest.raises(DeltatwinError) as said:
        CliRunner().invoke(
            app,
            ["identify", *arguments, "--out", str(tmp_path / "o.toml")],
            catch_exceptions=False,
            standalone_mode=False,
        )
    assert "\n" not in str(said.value)


def test_inspect_says_that_a_rate_is_none(field: Path) -> None:
    done = CliRunner().invoke(app, ["inspect", str(field / "time_unit" / "ms.csv")], catch_exceptions=False)
    assert "are they in ms (1000 Hz)" in " ".join(done.output.split())
    assert "nothing wrong found" not in done.output


@pytest.mark.parametrize(
    "name", ["filetime_column/log.csv", "twincat_eof/scope.csv", "twincat_full_timestamp/scope.csv"]
)
def test_tables_with_stamps_of_windows_and_an_end_tag(field: Path, name: str, tmp_path: Path) -> None:
    folder = field / name.split("/")[0]
    stamps, position, _, _ = imported(field / name, folder / "robot.toml", tmp_path, "--torque-unit", "N m")
    lines = (field / name).read_text("latin-1").splitlines()
    numbers = [line for line in lines if line[:1].isdigit()]
    assert len(stamps) == len(numbers)
    np.testing.assert_allclose(np.diff(stamps), 0.004, atol=1e-6)
    last = numbers[-1].replace(",", ".").split("\t") if "scope" in name else numbers[-1].split(",")
    expected = (last[1], last[3]) if "scope" in name else last[1:3]
    assert position[-1] == pytest.approx([float(value) for value in expected], abs=1e-6)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("json_hostile/sq.json", "records: no table"),
        ("json_hostile/listlist.json", "nested more than 12 deep"),
    ],
)
def test_json_that_would_take_all_memory_is_one_line(field: Path, name: str, says: str, tmp_path: Path) -> None:
    begin = time.monotonic()
    assert says in refused(field / name, field / "ros1" / "robot.toml", tmp_path)
    assert time.monotonic() - begin < 5.0


def test_a_description_of_open_quotes_is_one_line_at_once(field: Path) -> None:
    begin = time.monotonic()
    with pytest.raises(DeltatwinError, match="not TOML"):
        load_description(field / "toml_hostile" / "q.toml")
    assert time.monotonic() - begin < 1.0


def test_a_small_motor_has_significant_digits(field: Path, tmp_path: Path) -> None:
    folder = field / "small_figures"
    arguments = ["identify", str(folder / "log.csv"), "--robot", str(folder / "robot.toml")]
    done = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "found.toml")], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    (inertia,) = [line for line in done.output.splitlines() if "inertia_1" in line]
    numbers = re.findall(r"\d+\.\d+", inertia)
    assert float(numbers[0]) == pytest.approx(1.94e-4, rel=0.02)
    assert float(numbers[1]) > 0


def found_of(log: Path, robot: Path, folder: Path) -> dict[str, float]:
    """Value of each parameter that `identify` finds of a single axis."""
    arguments = ["identify", str(log), "--robot", str(robot), "--out", str(folder / "found.toml")]
    done = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    found = tomllib.loads((folder / "found.toml").read_text())["identified"]
    return {name: entry["value"][0] for name, entry in found.items() if isinstance(entry, dict)}


def test_a_linear_axis_of_little_stroke_moves(field: Path, tmp_path: Path) -> None:
    folder = field / "linear_axis_small_stroke"
    found = found_of(folder / "log.csv", folder / "robot.toml", tmp_path)
    assert found["inertia"] == pytest.approx(12.0, rel=0.02)
    assert found["viscous_friction"] == pytest.approx(150.0, rel=0.05)
    assert found["coulomb_friction"] == pytest.approx(20.0, rel=0.02)


@pytest.mark.parametrize("rate", [1000.0, 125.0])
@pytest.mark.parametrize("stroke", [0.4, 0.01, 0.001])
def test_an_axis_is_found_whatever_its_stroke(tmp_path: Path, stroke: float, rate: float) -> None:
    """A tenth of the stroke with ten times the inertia and damping takes the same force."""
    time, rng = np.arange(0, 16, 1 / rate), np.random.default_rng(1)
    wave = np.outer(time, 2 * np.pi * np.array([0.31, 0.83, 1.9])) + [0.1, 1.0, 2.0]
    size = stroke / 3 * np.array([1.0, 0.5, 0.25])
    pulse = 2 * np.pi * np.array([0.31, 0.83, 1.9])
    x, v, a = np.sin(wave) @ size, np.cos(wave) @ (size * pulse), -np.sin(wave) @ (size * pulse**2)
    mass, viscous = 2.0 / stroke, 5.0 / stroke
    force = mass * a + viscous * v + 6.0 * np.tanh(v / (0.003 * stroke)) + 0.1 * rng.standard_normal(len(time))
    block = np.column_stack([time, x + 1e-6 * stroke * rng.standard_normal(len(time)), force])
    np.savetxt(tmp_path / "log.csv", block, delimiter=",", header="time_s,position_1_m,torque_1_n", comments="")
    (tmp_path / "robot.toml").write_text('name = "lin"\nkind = "axes"\n[[axis]]\nunit = "m"\n')
    found = found_of(tmp_path / "log.csv", tmp_path / "robot.toml", tmp_path)
    assert found["inertia"] == pytest.approx(mass, rel=0.02)
    assert found["viscous_friction"] == pytest.approx(viscous, rel=0.05)
    assert found["coulomb_friction"] == pytest.approx(6.0, rel=0.05)


def test_what_only_a_combination_tells_is_given_as_that(field: Path, tmp_path: Path) -> None:
    folder = field / "asymmetric_offset_split"
    logs = [str(path) for path in sorted(folder.glob("dir_*.csv"))]
    arguments = ["diagnose", *logs, "--robot", str(folder / "robot.toml"), "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    corrected = tomllib.loads((tmp_path / "out" / "corrected.toml").read_text())
    (effect,) = [one for one in corrected["effect"] if one["name"] == "asymmetric_friction"]
    assert effect["parameters"]["delta_v"]["value"] == pytest.approx(0.040, abs=1e-3)
    assert effect["parameters"]["delta_c"]["value"] == 0.0
    assert corrected["identified"]["offset"]["value"] == pytest.approx([0.012], abs=1e-3)
    assert "Coulomb levels" not in done.output


@pytest.mark.parametrize("options", [(), ("--position-unit", "rad")])
def test_the_sign_of_an_axis_that_is_moved_by_hand_stays_as_recorded(
    field: Path, options: tuple[str, ...], tmp_path: Path
) -> None:
    folder = field / "sign_of_backdriven_axis"
    _, position, torque, said = imported(folder / "log.csv", folder / "robot.toml", tmp_path, *options)
    assert np.corrcoef(np.sin(position[:, 0]), torque[:, 0])[0, 1] > 0.99  # 3.3 sin q, by the README
    assert "the other sign" not in said
    assert "check: sign of the torque of joint 1" in said


def read_or_refused(path: Path, robot: Description | None) -> str:
    """Reads a file of any kind; "" or what is said of it."""
    try:
        if path.suffix == ".toml":
            load_description(path)
        elif path.suffix in (".pcap", ".pcapng"):
            assert len(read_trace(path, robot)) > 0
        elif path.suffix != ".urdf":
            assert len(read_table(path)) > 0
    except DeltatwinError as error:
        return str(error)
    return ""


def test_every_file_is_read_or_refused_in_a_line(field: Path) -> None:
    """And every folder has its own test here, but seam_250hz: test_jumps.py of the estimator tries every rate."""
    told = Path(__file__).read_text()
    for folder in sorted(path for path in field.iterdir() if path.is_dir()):
        assert folder.name in told
        found = folder / "robot.toml"
        robot = load_description(found) if found.exists() else None
        for path in sorted(path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("README")):
            assert "\n" not in read_or_refused(path, robot)
