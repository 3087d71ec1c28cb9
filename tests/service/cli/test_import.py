"""`import` of one log in ten foreign formats: read as it was, without an edited file or a question."""

from __future__ import annotations

import json
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from mcap.writer import Writer
from typer.testing import CliRunner

from drivers.motion import Planner
from drivers.simulated.plant.plant import Plant
from drivers.simulated.plant.plant_trace import simulate
from drivers.simulated.plant.truth import PlantTruth
from drivers.trace import read_trace
from replay.demo import LOG, ROBOT
from schemas.columns import load_columns
from schemas.robot import SHIPPED, load_robot
from schemas.trace import Trace
from service.cli.main import app
from tests.drivers.trace.test_tables import joint_state

GEAR = load_robot("d3-1200").drive.gear_ratio
NAMES = ["t", "q1", "q2", "q3", "tau1", "tau2", "tau3"]


@pytest.fixture(scope="module")
def log() -> Trace:
    """Four seconds of a simulated robot that carries nothing, from the time 5 s."""
    robot = load_robot("d3-1200")
    plant = Plant(robot, PlantTruth.nominal(robot), period=1e-3, seed=1)
    motion = Planner(robot, 1e-3).multisine(np.random.default_rng(1), 4.0)
    trace = simulate(plant, motion)
    part = slice(0, 4000)
    return Trace(LOG, 5.0 + np.arange(4000) / 1000, trace.position[part], trace.torque[part])


def text(path: Path, block: np.ndarray, separator: str = ",", head: str = "", decimal: str = ".") -> None:
    rows = "\n".join(separator.join(f"{v:.8f}" for v in row) for row in block)
    path.write_text(head + rows.replace(".", decimal) + "\n", encoding="latin-1")


def twincat(folder: Path, log: Trace) -> Path:
    """Degrees and the motor's torque, each group with a clock, decimal comma, joint 2 the other way round."""
    turned = np.array([1.0, -1.0, 1.0])
    cells = [
        [t * 1e3, *np.degrees(q * turned), t * 1e3, *(m * turned / GEAR)]
        for t, q, m in zip(log.time, log.position, log.torque, strict=True)
    ]
    head = "Name\tScope\nFile\tscope.csv\nStarttime of export\t132959733843760000\n\n\n\n"
    groups = [[f"Axis {j} {what}" for j in (1, 2, 3)] for what in ("ActPos [°]", "ActTorque")]
    for first, cells_of in (("Name", groups), ("SymbolComment", [[""] * 3] * 2), ("Data-Type", [["REAL64"] * 3] * 2)):
        head += "\t".join(cell for group in cells_of for cell in (first, *group)) + "\n"
    head += "\t".join(["SampleTime[ms]", *["1"] * 3] * 2) + "\n\n"
    text(folder / "log.csv", np.array(cells), "\t", head, ",")
    return folder / "log.csv"


def codesys(folder: Path, log: Trace) -> Path:
    lines = ["[key]; [value]", "Version; 0x03050000", "Name; Application.Trace", "Flags; 16"]
    columns = [(f"PLC.axis{j}.actPos", log.position[:, j]) for j in range(3)]
    columns += [(f"PLC.axis{j}.actTorque", log.torque[:, j]) for j in range(3)]
    for k, (name, values) in enumerate(columns):
        lines += [f"{k}.Variable; {name}", f"{k}.Data; "]
        lines += [f"; {round(t * 1e3)}; {v:.9g}" for t, v in zip(log.time, values, strict=True)]
    (folder / "log.csv").write_text("\n".join(lines))
    return folder / "log.csv"


def kuka(folder: Path, log: Trace) -> Path:
    np.column_stack([np.degrees(log.position), log.torque]).astype("<f8").tofile(folder / "log.r64")
    head = ["#BEGINCHANNELHEADER", "200,Zeit", "202,s", "210,IMPLIZIT", "220,4000", "240,5", "241,0.001"]
    for k in range(6):
        name, unit = (f"Winkel Achse {k + 1}", "°") if k < 3 else (f"Moment Achse {k - 2}", "Nm")
        head += ["#ENDCHANNELHEADER", "#BEGINCHANNELHEADER", f"200,{name}", f"202,{unit}", "210,EXPLIZIT"]
        head += ["211,LOG.R64", "213,BLOCK", "214,REAL64", "220,4000", f"221,{k + 1}", "240,0", "241,1"]
    (folder / "log.dat").write_text("\n".join([*head, "#ENDCHANNELHEADER"]), encoding="latin-1")
    return folder / "log.dat"


def block(log: Trace) -> np.ndarray:
    return np.column_stack([log.time, log.position, log.torque])


def german_table(folder: Path, log: Trace) -> Path:
    data = block(log) * [1e6, *[180 / np.pi] * 3, 1, 1, 1]
    head = "Zeit [us];A1 Winkel [°];A2 Winkel [°];A3 Winkel [°];A1 Moment [Nm];A2 Moment [Nm];A3 Moment [Nm]\n"
    text(folder / "log.csv", data, ";", head, ",")
    return folder / "log.csv"


def no_header(folder: Path, log: Trace) -> Path:
    """Positions of the motor in radians, torques in a unit of a fifth: neither stands anywhere."""
    text(folder / "log.txt", block(log) * [1, *[GEAR] * 3, *[0.2] * 3], " ")
    return folder / "log.txt"


def records(folder: Path, log: Trace) -> Path:
    """Stamps are dates."""
    rows = block(log).tolist()
    entries = [
        {"when": f"2026-11-22T09:30:{t:09.6f}Z", "q": q, "tau": m} for t, *q, m in ([*r[:4], r[4:]] for r in rows)
    ]
    (folder / "log.json").write_text(json.dumps({"robot": "d3", "entries": entries}))
    return folder / "log.json"


def matlab(folder: Path, log: Trace) -> Path:
    scipy.io.savemat(folder / "log.mat", {"t": log.time, "q": log.position, "tau": log.torque})
    return folder / "log.mat"


def npy(folder: Path, log: Trace) -> Path:
    np.save(folder / "log.npy", block(log).T)
    return folder / "log.npy"


def npz(folder: Path, log: Trace) -> Path:
    np.savez(folder / "log.npz", time=log.time, position=np.degrees(log.position), torque=log.torque)
    return folder / "log.npz"


def bag(folder: Path, log: Trace) -> Path:
    with sqlite3.connect(folder / "log.db3") as connection:
        connection.execute("CREATE TABLE topics(id INTEGER, name TEXT, type TEXT)")
        connection.execute("CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        connection.execute("INSERT INTO topics VALUES (1, '/joint_states', 'sensor_msgs/msg/JointState')")
        rows = [(k, joint_state(row)) for k, row in enumerate(block(log))]
        connection.executemany("INSERT INTO messages (id, topic_id, timestamp, data) VALUES (?, 1, 0, ?)", rows)
    return folder / "log.db3"


def imported(*arguments: object) -> str:
    done = CliRunner().invoke(app, ["import", *map(str, arguments)])
    assert done.exit_code == 0, done.output
    return done.output


@pytest.mark.parametrize(
    "write", [twincat, codesys, kuka, german_table, no_header, records, matlab, npy, npz, bag], ids=lambda w: w.__name__
)
def test_ten_formats_come_back_as_they_were(tmp_path: Path, log: Trace, write: Callable[[Path, Trace], Path]) -> None:
    path = write(tmp_path, log)
    imported(path, "--robot", "d3-1200", "--yes")
    back = read_trace(tmp_path / "log.mcap", load_robot("d3-1200"))
    np.testing.assert_allclose(back.time - back.time[0], log.time - 5.0, atol=2e-6)
    np.testing.assert_allclose(back.position, log.position, atol=1e-5)
    scale = 0.1 if write is no_header else 1e-6  # there it comes from the masses, to 10 %
    np.testing.assert_allclose(back.torque, log.torque, rtol=scale, atol=1e-4)
    again = read_trace(path, load_robot("d3-1200"), load_columns(tmp_path / "log.columns.toml"))
    np.testing.assert_array_equal(again.position, back.position)


def test_files_side_by_side_in_per_mille(tmp_path: Path, log: Trace) -> None:
    text(tmp_path / "pos.csv", log.position, ",", "J1,J2,J3\n")
    text(tmp_path / "torque.csv", log.torque / GEAR / 2.5 * 1000, ",", "J1,J2,J3\n")
    options = ["--rate", "1000", "--torque-unit", "permille 2.5", "--yes", "--out", tmp_path / "both.mcap"]
    imported(tmp_path / "pos.csv", tmp_path / "torque.csv", "--robot", "d3-1200", *options)
    back = read_trace(tmp_path / "both.mcap", load_robot("d3-1200"))
    np.testing.assert_allclose(back.torque, log.torque, atol=1e-3)


def test_files_with_stamps_of_their_own(tmp_path: Path, log: Trace) -> None:
    """The torque begins 0.2 s later and is sampled half as often: there it is what it was, before it is unknown."""
    for name, rows, values in (("Lage", slice(None), log.position), ("Moment", slice(200, None, 2), log.torque)):
        lines = ["Zeit;" + ";".join(f"{name} A{j} [{'rad' if name == 'Lage' else 'Nm'}]" for j in (1, 2, 3))]
        lines += [
            ";".join([f"22.11.2026 09:30:{t:09.6f}", *(f"{v:.6f}" for v in row)])
            for t, row in zip(log.time[rows], values[rows], strict=True)
        ]
        (tmp_path / f"{name}.csv").write_text("\n".join(lines) + "\n")
    said = imported(tmp_path / "Lage.csv", tmp_path / "Moment.csv", "--robot", "d3-1200", "--yes")
    assert "is sampled every 2 ms, interpolated linearly at the 1 ms stamps" in said
    back = read_trace(tmp_path / "Lage.mcap", load_robot("d3-1200"))
    np.testing.assert_allclose(back.position, log.position, atol=1e-6)
    assert np.isnan(back.torque[:200]).all()
    np.testing.assert_allclose(back.torque[200::2], log.torque[200::2], atol=1e-5)
    assert back.time_ns[0] == np.datetime64("2026-11-22T09:30:05", "ns").astype(int)


def test_sixteen_bits_without_sign_rows_that_count_and_a_product(tmp_path: Path, log: Trace) -> None:
    """Torque is a reading of 16 bits that lost its sign, times a column; rows in which the flag is 0 are rubbish."""
    raw = np.round(log.torque * 20)
    volts = np.where(np.arange(len(raw)) < 2000, 2.0, 4.0)
    readings = raw * (4 / volts)[:, None] % 65536
    data = np.column_stack([log.time, log.position, readings, np.ones(len(raw)), volts / 4])
    data[3500:, 1:4], data[3500:, 7] = 0.3, 0
    text(tmp_path / "log.csv", data, ",", ",".join([*NAMES, "ready", "u"]) + "\n")
    options = ["--torque-unit", "V 0.05", "--torque-times", "u", "--where", "ready=1", "--yes"]
    said = imported(tmp_path / "log.csv", "--robot", "d3-1200", *options)
    assert "'tau1', 'tau2', 'tau3' are 16-bit numbers read without sign: 65535 means -1" in said
    assert "500 of 4000 rows do not have 1 in column 'ready'" in said
    back = read_trace(tmp_path / "log.mcap")
    assert len(back) == 3500
    np.testing.assert_allclose(back.torque, raw[:3500] / 20, atol=1e-9)
    done = CliRunner().invoke(app, ["import", str(tmp_path / "log.csv"), "--yes", "--where", "redy"])
    assert "no column 'redy'; it has: t, q1" in str(done.exception)


def test_what_cannot_be_told_is_asked_for(tmp_path: Path, log: Trace) -> None:
    text(tmp_path / "log.csv", block(log)[:, 1:], ",", "a,b,c,d,e,f\n")
    done = CliRunner().invoke(app, ["import", str(tmp_path / "log.csv"), "--robot", "d3-1200", "--yes"])
    assert "give --rate HZ, or --time NAME (columns: a, b, c, d, e, f)" in str(done.exception)
    counts = np.round(log.position * 65536 / 2 / np.pi)
    text(tmp_path / "inc.csv", np.column_stack([log.time, counts, log.torque]), ",", ",".join(NAMES) + "\n")
    done = CliRunner().invoke(app, ["import", str(tmp_path / "inc.csv"), "--robot", "d3-1200", "--yes"])
    assert "--counts-per-rev" in str(done.exception)
    assert list(tmp_path.glob("*.mcap")) == []


def test_nothing_is_replaced_or_taken_without_a_word(tmp_path: Path, log: Trace) -> None:
    path = npy(tmp_path, log)
    asked = CliRunner().invoke(app, ["import", str(path), "--robot", "d3-1200"])
    assert asked.exit_code == 2
    assert "--yes accepts the proposal" in asked.output
    imported(path, "--robot", "d3-1200", "--yes")
    before = (tmp_path / "log.mcap").read_bytes()
    again = CliRunner().invoke(app, ["import", str(path), "--robot", "d3-1200", "--yes"])
    assert "exists already; --overwrite replaces it" in str(again.exception)
    assert (tmp_path / "log.mcap").read_bytes() == before


def test_what_is_read_is_never_written(tmp_path: Path, log: Trace) -> None:
    """A rosbag2 of the ending of our own logs, with --overwrite: it stays, and the log gets another name."""
    path = tmp_path / "run.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", b"")
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for k, row in enumerate(block(log)[:1500]):
            writer.add_message(channel, k, joint_state(row), k)
        writer.finish()
    before = path.read_bytes()
    imported(path, "--robot", "d3-1200", "--yes", "--overwrite")
    assert len(read_trace(tmp_path / "run.imported.mcap")) == 1500
    command = ["import", str(path), "--robot", "d3-1200", "--yes", "--overwrite", "--out"]
    done = CliRunner().invoke(app, [*command, str(tmp_path / "." / "run.mcap")])
    assert "run.mcap: is an input file" in str(done.exception)
    assert path.read_bytes() == before
    shutil.copy(SHIPPED / "d3-1200.toml", tmp_path / "run.columns.toml")
    command[3:4] = [str(tmp_path / "run.columns.toml")]
    done = CliRunner().invoke(app, [*command, str(tmp_path / "run.csv")])
    assert "run.columns.toml: is an input file" in str(done.exception)


def test_a_log_goes_into_a_folder(tmp_path: Path, log: Trace) -> None:
    path, out = npy(tmp_path, log), tmp_path / "imported"
    out.mkdir()
    imported(path, "--robot", "d3-1200", "--yes", "--out", str(out))
    assert sorted(file.name for file in out.iterdir()) == ["log.columns.toml", "log.mcap"]


def test_a_payload_is_no_other_unit(tmp_path: Path) -> None:
    """The demo's log carries products, which the empty robot's equations do not explain: N m stays N m."""
    demo = read_trace(LOG, load_robot(ROBOT))
    np.save(tmp_path / "log.npy", block(demo).T)
    imported(tmp_path / "log.npy", "--robot", ROBOT, "--yes")
    np.testing.assert_allclose(read_trace(tmp_path / "log.mcap").torque, demo.torque, atol=1e-9)


def test_json_has_channels_and_doubts(tmp_path: Path, log: Trace) -> None:
    shown = json.loads(imported(npy(tmp_path, log), "--robot", "d3-1200", "--yes", "--json"))
    assert shown["channels"][1]["taken_for"] == "position 1"
    assert shown["channels"][1]["rate_hz"] == pytest.approx(1000)
    assert any("by the rate alone" in doubt for doubt in shown["doubts"])


def test_axes_with_a_force_of_the_other_sign(tmp_path: Path) -> None:
    time = np.arange(4000) / 1000
    position = 0.2 * np.sin(2 * np.pi * time) + 0.02 * np.sin(2 * np.pi * 3.1 * time)
    speed = np.gradient(position, time)
    force = 95 * np.gradient(speed, time) + 200 * speed + 20 * np.sign(speed) - 3
    text(tmp_path / "axis.csv", np.column_stack([time, position, -force]), ",", "t,pos,force\n")
    (tmp_path / "axis.toml").write_text('name = "axis"\nkind = "axes"\n[[axis]]\nunit = "m"\n')
    said = imported(tmp_path / "axis.csv", "--robot", tmp_path / "axis.toml", "--yes")
    assert (
        "axis 1: as recorded, the torque pushes against the motion: the other sign is used (over 1 000 000 times"
        in said
    )
    back = read_trace(tmp_path / "axis.imported.csv")
    np.testing.assert_allclose(back.torque[:, 0], force, atol=1e-6)


def test_real_logs(data: Path, tmp_path: Path) -> None:
    """Six axes at a stated rate in two files; a servo whose 16 bit load is unsigned."""
    robot = tmp_path / "tx40.toml"
    robot.write_text('name = "tx40"\nkind = "axes"\n' + "[[axis]]\ngear_ratio = 32\n" * 6)
    real = data / "real"
    options = ["--rate", "5000", "--yes", "--torque-unit", "N m", "--out", tmp_path / "tx40.csv"]
    imported(real / "tx40" / "pos_read_data.csv", real / "tx40" / "curr_data.csv", "--robot", robot, *options)
    assert read_trace(tmp_path / "tx40.csv").torque.shape == (45000, 6)


def servo(path: Path, seed: int, sign: float, size: float, seconds: float = 4.0) -> np.ndarray:
    """A motor's run with friction and inertia, positions of 18 bits; returns its torque."""
    rng, time = np.random.default_rng(seed), np.arange(0, seconds, 1e-3)
    position = size * np.sin(np.outer(time, [3.1, 8.7, 21.0]) + rng.uniform(0, 6, 3)).sum(axis=1)
    speed = np.gradient(position, time)
    torque = 0.02 * np.gradient(speed, time) + 0.1 * speed + 0.3 * np.tanh(speed / 0.01)
    torque += 0.01 * rng.standard_normal(len(time))
    text(path, np.column_stack([time, position, sign * torque]), ",", "time_s,position [rad],torque [Nm]\n")
    return torque


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_runs_of_one_machine_are_judged_together_and_get_one_mapping(tmp_path: Path, sign: float) -> None:
    """Two of half a second, of which nothing can be told alone, and one of four."""
    (tmp_path / "motor.toml").write_text('name = "motor"\nkind = "axes"\n[[axis]]\ngravity = false\n')
    names = ["run1.csv", "run2.csv", "run3.csv"]
    torque = [servo(tmp_path / name, k, sign, 0.5, 4.0 if k == 2 else 0.9) for k, name in enumerate(names)]
    alone = imported(tmp_path / "run1.csv", "--robot", tmp_path / "motor.toml", "--yes", "--out", tmp_path / "a.csv")
    assert ("left as recorded, set it with --sign" in alone) or ("hardly any joint moves" in alone)
    stated = ["--sign", f"{sign:.0f}", "--yes", "--out", tmp_path / "b.csv"]
    confirmed = imported(tmp_path / "run1.csv", "--robot", tmp_path / "motor.toml", *stated)
    assert "set it with --sign" not in confirmed
    assert ("as --sign says; inertia and friction are too small" in confirmed) or (
        "hardly any joint moves" in confirmed
    )
    out = tmp_path / "runs"
    said = imported(*(tmp_path / name for name in names), "--robot", tmp_path / "motor.toml", "--yes", "--out", out)
    assert ("the other sign" in said) == (sign < 0)
    assert "check: sign" not in said
    for name, expected in zip(names, torque, strict=True):
        np.testing.assert_allclose(read_trace(out / name).torque[:, 0], expected, atol=1e-6)
    assert sorted(path.name for path in out.glob("*.toml")) == ["run1.columns.toml"]


def test_a_sign_that_is_said_is_taken_and_what_speaks_against_it_is_said(tmp_path: Path) -> None:
    (tmp_path / "motor.toml").write_text('name = "motor"\nkind = "axes"\n[[axis]]\ngravity = false\n')
    torque = servo(tmp_path / "run.csv", 1, 1.0, 0.5)
    options = ["--robot", tmp_path / "motor.toml", "--yes", "--out", tmp_path / "log.csv", "--overwrite"]
    said = imported(tmp_path / "run.csv", *options, "--sign", "-1")
    assert "check: the signs given by --sign contradict the motion" in said
    np.testing.assert_allclose(read_trace(tmp_path / "log.csv").torque[:, 0], -torque, atol=1e-6)
    assert "contradict" not in imported(tmp_path / "run.csv", *options, "--sign", "1")
    for wrong, message in (("1,1", "--sign has 2 numbers for 1 joints"), ("up", "1 or -1 per joint")):
        done = CliRunner().invoke(app, ["import", str(tmp_path / "run.csv"), *map(str, options), "--sign", wrong])
        assert message in f"{done.exception} {' '.join(done.output.split())}"


def test_a_constant_a_joint(tmp_path: Path, log: Trace) -> None:
    text(
        tmp_path / "log.csv", block(log) * [1, 1, 1, 1, *(1 / np.array([0.5, 0.4, 0.25]))], ",", ",".join(NAMES) + "\n"
    )
    options = ["--torque-unit", "A 0.5,0.4,0.25", "--yes", "--out", tmp_path / "out.csv"]
    imported(tmp_path / "log.csv", "--robot", "d3-1200", *options)
    np.testing.assert_allclose(read_trace(tmp_path / "out.csv").torque, log.torque, rtol=1e-6, atol=1e-6)
