"""Foreign files of known machines on known motions: every format, unit, order, time base and fault of the field.

Machines: two axes of which one bears a weight, a Delta behind gears, an arm of three joints by its URDF. What a file
says is drawn from `DIMENSIONS` by a seed; what is right is known with it.
"""

from __future__ import annotations

import gzip
import json
import sqlite3
import struct
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, fields
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
from mcap.writer import Writer

from drivers.motion import Planner
from drivers.simulated.plant.plant import Plant
from drivers.simulated.plant.plant_trace import simulate
from drivers.simulated.plant.truth import PlantTruth
from schemas.axes_description import Axes, Description, load_description
from schemas.columns import FILETIME_S
from schemas.robot import load_robot
from tests.service import arm

RATE, SECONDS = 250.0, 12.0
START = 1_764_150_000.0  # s since 1970
TRUTH = {
    "inertia": (0.8, 0.3),
    "viscous_friction": (1.2, 0.6),
    "coulomb_friction": (2.0, 0.9),
    "gravity_sin": (0.0, 5.0),
}
ROBOT = Axes.model_validate({"name": "two", "kind": "axes", "axis": [{"gravity": False}, {}]})
POSITION = {"rad": 1.0, "deg": 180 / np.pi, "turns": 0.5 / np.pi}
DIMENSIONS: dict[str, tuple[str, ...]] = {
    "form": (
        "csv", "semicolon", "comma_decimal", "tab", "space", "gz", "records", "lists", "lines", "npy", "npz", "mat",
        "db3", "mcap", "fox_json", "fox_protobuf", "twincat", "codesys", "kuka",
    ),
    "position": (*POSITION, "counts"),
    "torque": ("Nm", "%", "A"),
    "says": ("unit", "row", "nothing"),
    "order": ("as_is", "turned", "mixed"),
    "names": ("numbers", "dotted", "german", "words", "none"),
    "time": ("s", "ms", "us", "ns", "filetime", "datetime", "date_and_time", "epoch", "rate"),
    "fault": (
        "none", "none", "none", "back", "gap", "doubled", "cut", "nan", "no_torque", "still_torque", "thousands",
        "noise", "late_start", "two_topics",
    ),
    "sign": ("as_is", "as_is", "first", "second"),
    "others": ("none", "velocity", "status"),
    "stated": ("none", "what_is_asked", "what_is_asked", "what_is_asked"),
    "machine": ("axes", "axes", "delta", "arm"),
    "side": ("joint", "motor"),
    "turned": ("no", "no", "no", "second"),
}  # fmt: skip
TEXTS = ("csv", "semicolon", "comma_decimal", "tab", "gz")
BAGS = ("db3", "mcap", "fox_json", "fox_protobuf")
BINARY = ("npy", "npz", "mat", *BAGS, "kuka", "codesys", "records", "lists", "lines")
NO_TORQUE = ("no_torque", "still_torque", "noise")  # faults of files that hold no torque of a machine


@dataclass(frozen=True)
class Case:
    """What a file is, one entry a dimension."""

    form: str
    position: str
    torque: str
    says: str
    order: str
    names: str
    time: str
    fault: str
    sign: str
    others: str
    stated: str
    machine: str
    side: str
    turned: str

    def __str__(self) -> str:
        return " ".join(f"{one.name}={getattr(self, one.name)}" for one in fields(self))


@dataclass(frozen=True)
class Written:
    """A file and what it holds. rows: of the truth, in the file's order. time: s, of each. lacks: (N, n) cells of
    position or torque that are missing."""

    path: Path
    rows: np.ndarray
    time: np.ndarray
    lacks: np.ndarray


def draw(seed: int) -> Case:
    """A case by its number, as far as its format can hold it."""
    random = np.random.default_rng(seed)
    found = {name: str(random.choice(values)) for name, values in DIMENSIONS.items()}
    if found["form"] in BAGS:  # joint states say themselves what they are
        found |= {"position": "rad", "torque": "Nm", "says": "unit", "time": "s", "names": "dotted", "others": "none"}
        found["fault"] = found["fault"] if found["fault"] in ("none", "gap", "no_torque", "still_torque") else "none"
    if found["form"] in ("npy", "space"):
        found |= {"names": "none", "says": "nothing", "others": "none", "order": "as_is"}
    if found["form"] in BINARY:
        found["says"] = "unit" if found["says"] == "row" else found["says"]
        found["fault"] = "none" if found["fault"] in ("thousands", "cut") else found["fault"]
        if found["time"] in ("datetime", "date_and_time") and found["form"] not in ("records", "lines"):
            found["time"] = "s"
        found["time"] = "datetime" if found["time"] == "date_and_time" else found["time"]
    if found["form"] in ("twincat", "codesys", "kuka"):
        found |= {"time": "ms", "fault": found["fault"] if found["fault"] in ("none", "nan", "noise") else "none"}
        found["names"] = "numbers" if found["names"] == "none" else found["names"]
        found["others"] = "none"
    if found["form"] in ("npz", "mat"):
        found["fault"] = "none" if found["fault"] == "back" and found["time"] == "rate" else found["fault"]
    if found["names"] == "none":
        found |= {"says": "nothing", "others": "none", "order": "as_is"}
        found["fault"] = "none" if found["fault"] == "no_torque" else found["fault"]
    if found["fault"] == "two_topics" and (found["form"] not in TEXTS or found["names"] == "none"):
        found["fault"] = "none"
    if found["time"] == "rate" and found["fault"] in ("back", "gap", "doubled", "late_start", "two_topics"):
        found["fault"] = "none"
    if found["fault"] == "thousands" and found["form"] not in ("semicolon", "comma_decimal", "tab"):
        found["fault"] = "none"
    if found["fault"] == "no_torque":
        found["others"] = "velocity" if found["form"] not in BAGS else "none"
    if found["machine"] != "arm":
        found["turned"] = "no"
    if found["machine"] != "delta" or found["form"] in BAGS:
        found["side"] = "joint"
    elif found["position"] == "counts":  # of a Delta they are its motors'
        found["side"] = "motor"
    return Case(**found)


@dataclass(frozen=True)
class Subject:
    """A machine and what it did. time: (N,) s. position, velocity, torque: (N, n) of the joints. counts: of the encoder
    a turn. rated, constant: N m, N m/A of a motor. joints: as the description calls them, if it does."""

    robot: Description
    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray
    counts: float = 65536.0
    rated: float = 12.5
    constant: float = 0.8
    joints: tuple[str, ...] = ()


@cache
def subject(name: str) -> Subject:
    """One of the machines."""
    return {"axes": _axes, "delta": _delta, "arm": _arm}[name]()


def _axes() -> Subject:
    random = np.random.default_rng(5)
    time = np.arange(round(SECONDS * RATE)) / RATE
    hz = np.array([[0.23, 0.71, 1.7, 3.1], [0.31, 0.83, 1.9, 2.7]])
    size = np.array([[0.9, 0.3, 0.1, 0.04], [0.8, 0.35, 0.12, 0.05]])
    phase = random.uniform(0, 2 * np.pi, hz.shape)
    pulse = 2 * np.pi * hz
    wave = time[:, None, None] * pulse + phase
    position, velocity = (size * np.sin(wave)).sum(axis=2), (size * pulse * np.cos(wave)).sum(axis=2)
    acceleration = -(size * pulse**2 * np.sin(wave)).sum(axis=2)
    torque = acceleration * TRUTH["inertia"] + velocity * TRUTH["viscous_friction"]
    torque += np.tanh(velocity / 0.02) * TRUTH["coulomb_friction"] + np.sin(position) * TRUTH["gravity_sin"]
    position += 1e-6 * random.standard_normal(position.shape)
    return Subject(ROBOT, time, position, velocity, torque + 0.02 * random.standard_normal(torque.shape))


def _delta() -> Subject:
    robot = load_robot("d3-1200")
    plant = Plant(robot, PlantTruth.nominal(robot), period=1e-3, seed=1)
    trace = simulate(plant, Planner(robot, 1e-3).multisine(np.random.default_rng(1), SECONDS))
    rows = np.arange(0, round(SECONDS * 1000), round(1000 / RATE))
    position, torque = trace.position[rows], trace.torque[rows]
    velocity = np.gradient(position, 1 / RATE, axis=0)
    return Subject(robot, np.arange(len(rows)) / RATE, position, velocity, torque, 1048576.0, 2.4, 0.05)


def _arm() -> Subject:
    joints = {"j1": "shoulder", "j2": "elbow", "j3": "wrist"}
    with tempfile.TemporaryDirectory() as folder:
        path = arm.write(Path(folder))
        for file in (path, path.with_suffix(".urdf")):
            text = file.read_text()
            for old, new in joints.items():
                text = text.replace(f'"{old}"', f'"{new}"')
            file.write_text(text)
        robot = load_description(path)
        log = np.loadtxt(arm.record(Path(folder) / "log.csv", 3), delimiter=",", skiprows=1)
    position, torque = log[:, 1:4], log[:, 4:]
    velocity = np.gradient(position, log[:, 0], axis=0)
    return Subject(robot, log[:, 0], position, velocity, torque, joints=tuple(joints.values()))


def stated_of(case: Case) -> dict[str, Any]:
    """What the user says at once, as `Stated` has it."""
    said: dict[str, Any] = {"rate_hz": RATE} if case.time == "rate" and case.form not in BAGS else {}
    if case.stated == "none":
        return said
    answers = ["counts_per_rev"] * (case.position == "counts") + ["torque_unit"] * (case.torque != "Nm")
    answers += ["position_unit"] * (case.says == "nothing")
    return said | {answer: answer_of(case, answer) for answer in answers}


def answer_of(case: Case, option: str) -> Any:
    """What is true of a file, as the user would say it to a line that asks."""
    made = subject(case.machine)
    units = {"Nm": ("N m", None), "%": ("percent", made.rated), "A": ("A", made.constant)}
    signs = [1] * made.position.shape[1]
    if case.sign != "as_is":
        signs[0 if case.sign == "first" else 1] = -1
    return {
        "counts_per_rev": made.counts,
        "torque_unit": units[case.torque],
        "position_unit": case.position,
        "sign": signs,
        "rate_hz": RATE,
    }[option]


def write(case: Case, folder: Path) -> Written:
    """The file of a case."""
    made = subject(case.machine)
    time, position, velocity, torque = made.time, made.position, made.velocity, made.torque
    rows = np.arange(len(time))
    clock = time.copy()
    if case.fault == "gap":
        rows = np.r_[rows[:1400], rows[1440:]]
    elif case.fault == "doubled":
        rows = np.sort(np.r_[rows, rows[600:640]])
    clock = clock[rows]
    if case.fault == "back":
        clock[len(clock) // 2 :] -= 0.1
    elif case.fault == "late_start":
        clock += 4321.5
    gear = made.robot.gear_ratios[0] if case.side == "motor" else 1.0
    scale = made.counts / (2 * np.pi) if case.position == "counts" else POSITION[case.position]
    places = position[rows] * scale * gear
    forces = torque[rows] / gear * {"Nm": 1.0, "%": 100 / made.rated, "A": 1 / made.constant}[case.torque]
    if case.position == "counts":
        places = np.round(places)
    if case.turned == "second":
        places[:, 1] *= -1
    if case.fault == "still_torque":
        forces = np.zeros_like(forces)
    if case.fault == "noise":
        forces = np.random.default_rng(9).normal(0, 5, forces.shape)
    if case.sign != "as_is":
        forces[:, 0 if case.sign == "first" else 1] *= -1
    lacks = np.zeros(places.shape, bool)
    if case.fault == "nan":
        lacks[500:510] = True
        places[500:510], forces[500:510] = np.nan, np.nan
    columns = _columns(case, places, forces, velocity[rows])
    if case.fault == "two_topics":  # torques come a millisecond later, on rows of their own
        clock = np.stack([clock, clock + 1e-3], axis=1).ravel()
        columns = [(name, unit, _on_own_rows(values, name)) for name, unit, values in columns]
    path = _FORMS[case.form](case, folder, clock, columns)
    if case.fault == "two_topics":
        clock = clock[::2]
    return Written(path, rows, clock, lacks)


def _on_own_rows(values: np.ndarray, name: str) -> np.ndarray:
    """Every other row: of the second topic where it is a torque."""
    second = any(word in name for word in ("tau", "effort", "Drehmoment", "torque"))
    blank = np.full(len(values), np.nan)
    return np.stack([blank, values] if second else [values, blank], axis=1).ravel()


def names_of(case: Case) -> list[tuple[str, str]]:
    """Of the position and torque of each joint."""
    made = subject(case.machine)
    joints = range(1, 1 + made.position.shape[1])
    words = made.joints or ("base", "elbow", "tip")
    return {
        "numbers": [(f"q{j}", f"tau{j}") for j in joints],
        "dotted": [(f"{joint}.position", f"{joint}.effort") for joint in made.joints or map("joint_{}".format, joints)],
        "german": [(f"A{j} Lageistwert", f"A{j} Drehmoment") for j in joints],
        "words": [(f"{words[j - 1]} position", f"{words[j - 1]} torque") for j in joints],
        "none": [("", "") for _ in joints],
    }[case.names]


def _columns(case: Case, places: np.ndarray, forces: np.ndarray, speed: np.ndarray) -> list[tuple[str, str, Any]]:
    """(name, unit, values) of all columns but the clock, in the order of the file."""
    position_unit = {"rad": "rad", "deg": "deg", "turns": "rev", "counts": "inc"}[case.position]
    own = []
    for joint, (at, pushes) in enumerate(names_of(case)):
        own += [[(at, position_unit, places[:, joint])], [(pushes, case.torque, forces[:, joint])]]
        if case.others == "velocity":
            own.append([(f"vel{joint + 1}", "rad/s", speed[:, joint])])
    kinds = len(own) // places.shape[1]
    wanted = range(kinds) if case.fault != "no_torque" else [k for k in range(kinds) if k != 1]
    joints = range(places.shape[1])[:: -1 if case.order == "turned" else 1]
    if case.order == "mixed":
        found = [column for joint in joints for k in wanted for column in own[joint * kinds + k]]
    else:
        found = [column for k in wanted for joint in joints for column in own[joint * kinds + k]]
    if case.others == "status":
        found.append(("status", "", np.full(len(places), 39.0)))
    if case.says == "unit":
        found = [(f"{name} [{unit}]" if unit else name, unit, values) for name, unit, values in found]
    return found


def _stamps(case: Case, clock: np.ndarray) -> list[tuple[str, str, Any]]:
    """(name, unit, values or texts) of the columns of stamps."""
    scale = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
    if case.time == "rate":
        return []
    if case.time in scale:
        name = f"time [{case.time}]" if case.says == "unit" else "time"
        return [(name, case.time, np.round(clock * scale[case.time], 9))]
    if case.time == "epoch":
        return [("timestamp", "s", START + clock)]
    if case.time == "filetime":
        return [("Time", "", np.round((START + FILETIME_S) * 1e7 + clock * 1e7))]
    texts = [(datetime.fromtimestamp(START, UTC) + timedelta(seconds=float(t))).isoformat(" ")[:26] for t in clock]
    texts = [text if "." in text else f"{text[:19]}.000000" for text in texts]
    if case.time == "datetime":
        return [("timestamp", "", texts)]
    return [("Date", "", [text[:10] for text in texts]), ("Time", "", [text[11:] for text in texts])]


def _cell(value: Any, decimal: str, thousands: str) -> str:
    if isinstance(value, str):
        return value.replace(".", decimal) if decimal == "," and ":" in value else value
    if not np.isfinite(value):
        return ""
    text = f"{value:.0f}" if abs(value) >= 1e15 else f"{value:.7f}"
    whole, _, part = text.partition(".")
    if thousands:
        sign, whole = ("-", whole[1:]) if whole.startswith("-") else ("", whole)
        groups = []
        while len(whole) > 3:
            whole, group = whole[:-3], whole[-3:]
            groups.insert(0, group)
        whole = sign + thousands.join([whole, *groups])
    return f"{whole}{decimal}{part}" if part else whole


def _text(separator: str, decimal: str = ".", thousands: str = ",", ending: str = ".csv") -> Callable[..., Path]:
    def write_text(case: Case, folder: Path, clock: np.ndarray, columns: list[tuple[str, str, Any]]) -> Path:
        every = [*_stamps(case, clock), *columns]
        lines = []
        if case.names != "none":
            lines.append(separator.join(name for name, _, _ in every))
            if case.says == "row":
                lines.append(separator.join(unit for _, unit, _ in every))
        mark = thousands if case.fault == "thousands" else ""
        for row in zip(*(values for _, _, values in every), strict=True):
            lines.append(separator.join(_cell(value, decimal, mark) for value in row))
        text = "\n".join(lines) + "\n"
        if case.fault == "cut":
            text = text[: -len(lines[-1]) // 2]
        path = folder / f"log{ending}"
        path.write_bytes(gzip.compress(text.encode()) if ending.endswith("gz") else text.encode())
        return path

    return write_text


def _named_arrays(case: Case, clock: np.ndarray, columns: list[tuple[str, str, Any]]) -> dict[str, Any]:
    every = [*_stamps(case, clock), *columns]
    return {name or f"c{k}": values for k, (name, _, values) in enumerate(every)}


def _records(case: Case, folder: Path, clock: np.ndarray, columns: list[tuple[str, str, Any]]) -> Path:
    named = _named_arrays(case, clock, columns)
    plain = {
        name: [v if isinstance(v, str) else float(v) if np.isfinite(v) else None for v in values]
        for name, values in named.items()
    }
    if case.form == "lists":
        path = folder / "log.json"
        path.write_text(json.dumps(plain))
        return path
    rows = [dict(zip(plain, row, strict=True)) for row in zip(*plain.values(), strict=True)]
    path = folder / ("log.jsonl" if case.form == "lines" else "log.json")
    path.write_text("\n".join(map(json.dumps, rows)) if case.form == "lines" else json.dumps(rows))
    return path


def _numpy(case: Case, folder: Path, clock: np.ndarray, columns: list[tuple[str, str, Any]]) -> Path:
    named = _named_arrays(case, clock, columns)
    path = folder / f"log.{case.form}"
    if case.form == "npy":
        np.save(path, np.column_stack(list(named.values())))
    elif case.form == "npz":
        np.savez(path, **named)
    else:
        keys = {"".join(c if c.isalnum() else "_" for c in name).strip("_"): values for name, values in named.items()}
        scipy.io.savemat(path, keys)
    return path


def _joint_states(case: Case, clock: np.ndarray, columns: list[tuple[str, str, Any]]) -> list[tuple[int, bytes]]:
    """Messages with the time at which they were recorded, joints in the order of the columns."""
    at = {name.split(" ")[0]: values for name, _, values in columns}
    joints = list(dict.fromkeys(name.split(".")[0] for name in at))
    encoded = {"fox_json": _in_json, "fox_protobuf": _in_protobuf}.get(case.form, _in_cdr)
    found = []
    for k, t in enumerate(clock):
        values = {
            what: [(joint, float(at[f"{joint}.{what}"][k])) for joint in joints if f"{joint}.{what}" in at]
            for what in ("position", "velocity", "effort")
        }
        nanoseconds = round((START + t) * 1e9)
        found.append((nanoseconds, encoded(nanoseconds // 10**9, nanoseconds % 10**9, joints, values)))
    return found


Values = dict[str, list[tuple[str, float]]]  # of each field: joint and number


def _in_cdr(seconds: int, nanoseconds: int, joints: list[str], fields: Values) -> bytes:
    out = struct.pack("<III5s", seconds, nanoseconds, 5, b"base\0")
    out += b"\0" * (-len(out) % 4) + struct.pack("<I", len(joints))
    for joint in joints:
        text = joint.encode() + b"\0"
        out += b"\0" * (-len(out) % 4) + struct.pack("<I", len(text)) + text
    for values in fields.values():
        out += b"\0" * (-len(out) % 4) + struct.pack("<I", len(values))
        out += (b"\0" * (-len(out) % 8) if values else b"") + np.array([v for _, v in values], "<f8").tobytes()
    return b"\0\1\0\0" + out


def _in_json(seconds: int, nanoseconds: int, joints: list[str], fields: Values) -> bytes:
    states = [{"name": joint} | {what: dict(v)[joint] for what, v in fields.items() if v} for joint in joints]
    return json.dumps({"timestamp": {"sec": seconds, "nsec": nanoseconds}, "joints": states}).encode()


def _in_protobuf(seconds: int, nanoseconds: int, joints: list[str], fields: Values) -> bytes:
    def whole(value: int) -> bytes:
        more = value >> 7
        return bytes([value & 0x7F | 0x80 * bool(more)]) + (whole(more) if more else b"")

    def inside(number: int, content: bytes) -> bytes:
        return whole(number << 3 | 2) + whole(len(content)) + content

    out = inside(1, b"\x08" + whole(seconds) + b"\x10" + whole(nanoseconds))
    for joint in joints:
        state = inside(1, joint.encode())
        for number, what in ((2, "position"), (3, "velocity"), (5, "effort")):
            if fields[what]:
                state += whole(number << 3 | 1) + struct.pack("<d", dict(fields[what])[joint])
        out += inside(2, state)
    return out


def _bag(case: Case, folder: Path, clock: np.ndarray, columns: list[tuple[str, str, Any]]) -> Path:
    states = _joint_states(case, clock, columns)
    path = folder / ("log.db3" if case.form == "db3" else "log.mcap")
    if case.form == "db3":
        with sqlite3.connect(path) as bag:
            bag.execute("CREATE TABLE topics(id INTEGER, name TEXT, type TEXT, serialization_format TEXT)")
            bag.execute("CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB)")
            bag.execute("INSERT INTO topics VALUES (1, '/joint_states', 'sensor_msgs/msg/JointState', 'cdr')")
            bag.executemany(
                "INSERT INTO messages VALUES (?, 1, ?, ?)", [(k, at, data) for k, (at, data) in enumerate(states)]
            )
        bag.close()
        return path
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        ros = case.form == "mcap"
        kind = ("sensor_msgs/msg/JointState", "ros2msg") if ros else ("foxglove.JointStates", "")
        schema = writer.register_schema(*kind, b"")
        channel = writer.register_channel("/joint_states", "cdr" if ros else case.form.removeprefix("fox_"), schema)
        for at, data in states:
            writer.add_message(channel, at, data, at)
        writer.finish()
    return path


def _twincat(case: Case, folder: Path, clock: np.ndarray, columns: list[tuple[str, str, Any]]) -> Path:
    names = [name for name, _, _ in columns]
    head = f"Name\tScope\nFile\tscope.csv\nStarttime of export\t{round((START + FILETIME_S) * 1e7)}\n\n\n\n"
    for first, cells in (("Name", names), ("SymbolComment", [""] * len(names)), ("Data-Type", ["REAL64"] * len(names))):
        head += "\t".join([first, *cells]) + "\n"
    head += "\t".join(["SampleTime[ms]", *["4"] * len(names)]) + "\n\n"
    rows = zip(clock * 1e3, *(values for _, _, values in columns), strict=True)
    path = folder / "log.csv"
    path.write_text(head + "\n".join("\t".join(_cell(v, ",", "") for v in row) for row in rows) + "\n")
    return path


def _codesys(case: Case, folder: Path, clock: np.ndarray, columns: list[tuple[str, str, Any]]) -> Path:
    lines = ["[key]; [value]", "Version; 0x03050000", "Name; Application.Trace", "Flags; 16"]
    for k, (name, _, values) in enumerate(columns):
        lines += [f"{k}.Variable; PLC.{name}", f"{k}.Data; "]
        lines += [f"; {round(t * 1e3)}; {v:.9g}" for t, v in zip(clock, values, strict=True)]
    path = folder / "log.csv"
    path.write_text("\n".join(lines))
    return path


def _kuka(case: Case, folder: Path, clock: np.ndarray, columns: list[tuple[str, str, Any]]) -> Path:
    np.column_stack([values for _, _, values in columns]).astype("<f8").tofile(folder / "log.r64")
    count = len(clock)
    head = ["#BEGINCHANNELHEADER", "200,Zeit", "202,s", "210,IMPLIZIT", f"220,{count}", "240,0", f"241,{1 / RATE}"]
    for k, (name, unit, _) in enumerate(columns):
        head += ["#ENDCHANNELHEADER", "#BEGINCHANNELHEADER", f"200,{name.split(' [')[0]}"]
        head += [f"202,{unit}"] if case.says == "unit" else []
        head += ["210,EXPLIZIT", "211,LOG.R64", "213,BLOCK", "214,REAL64", f"220,{count}", f"221,{k + 1}"]
        head += ["240,0", "241,1"]
    path = folder / "log.dat"
    path.write_text("\n".join([*head, "#ENDCHANNELHEADER"]), encoding="latin-1")
    return path


_FORMS: dict[str, Callable[..., Path]] = {
    "csv": _text(","),
    "semicolon": _text(";"),
    "comma_decimal": _text(";", ",", "."),
    "tab": _text("\t"),
    "space": _text(" ", ending=".txt"),
    "gz": _text(",", ending=".csv.gz"),
    "records": _records,
    "lists": _records,
    "lines": _records,
    "npy": _numpy,
    "npz": _numpy,
    "mat": _numpy,
    "db3": _bag,
    "mcap": _bag,
    "fox_json": _bag,
    "fox_protobuf": _bag,
    "twincat": _twincat,
    "codesys": _codesys,
    "kuka": _kuka,
}
