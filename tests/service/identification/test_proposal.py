"""How to read a foreign table: a known robot's log written in other units, signs and on the motor's side, read back."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.trace import read_trace
from drivers.trace.quality import ANY_JOINT, MAX_SPEED
from drivers.trace.tables import Table
from schemas.axes_description import Axes
from schemas.columns import Columns
from schemas.errors import DataError
from schemas.robot import Drive, Robot
from schemas.trace import Trace
from service.identification import evidence, proposal, readings
from service.identification.channels import Channels
from service.identification.proposal import Proposal, propose
from service.identification.readings import Stated
from tests.service.world import stub

GEAR = 25.0
UP = (1.0, 1.0, 1.0)


@pytest.fixture(scope="module")
def geared(robot: Robot) -> Robot:
    return robot.model_copy(update={"drive": Drive(gear_ratio=GEAR)})


@pytest.fixture(scope="module")
def log(record: Callable[..., Trace]) -> Trace:
    """Two seconds of a robot that carries nothing."""
    return record(3, seconds=2.0)


def written(
    log: Trace,
    position: float | tuple[float, ...] = 1.0,
    torque: float | tuple[float, ...] = 1.0,
    names: tuple[str, str] = ("q{}", "tau{}"),
    order: tuple[int, ...] = (0, 1, 2),
) -> Table:
    """The log as a table whose numbers are `position` and `torque` times as large."""
    columns = {"t": log.time}
    columns |= {names[0].format(j + 1): (log.position * position)[:, j] for j in range(3)}
    columns |= {names[1].format(j + 1): (log.torque * torque)[:, order[j]] for j in range(3)}
    return Table(Path("log.csv"), "text", columns)


def entries(found: Proposal, role: str) -> list[dict[str, Any]]:
    """What the channels of a role have beside their names."""
    return [{key: value for key, value in entry.items() if key != "name"} for entry in found.columns[role]]


def turned(*signs: float) -> list[dict[str, int]]:
    return [{"sign": -1} if sign < 0 else {} for sign in signs]


@pytest.mark.parametrize(
    ("degrees", "side", "says"),
    [(False, "joint", False), (True, "joint", False), (True, "joint", True), (False, "motor", False)],
)
def test_units_and_side_of_the_positions(geared: Robot, log: Trace, degrees: bool, side: str, says: bool) -> None:
    scale = (180 / np.pi if degrees else 1.0) * (GEAR if side == "motor" else 1.0)
    made = written(log, scale, names=("angle {} [deg]" if says else "q{}", "tau{}"))
    found = propose(made, geared, Stated())
    unit = {"unit": "deg" if degrees else "rad"} | ({"side": "motor"} if side == "motor" else {})
    assert entries(found, "position") == [unit] * 3
    assert entries(found, "torque") == [{"unit": "N m"}] * 3
    assert found.columns["time"] == {"name": "t", "unit": "s"}
    assert ("positions are deg: the file says so" in found.reasons) == says


def test_degrees_that_no_file_states_are_told(robot: Robot, log: Trace) -> None:
    """Nothing else is possible without a gear, so that nothing is compared."""
    told = "positions are deg: as rad no joint moves that far or that fast"
    scale = 180 / np.pi
    assert told in propose(written(log, scale), robot, Stated()).reasons
    assert told not in propose(written(log, scale, names=("q{} [deg]", "tau{}")), robot, Stated()).reasons
    assert told not in propose(written(log), robot, Stated()).reasons


@pytest.mark.parametrize("turn", [(1, -1, -1)])
@pytest.mark.parametrize("where", ["position", "torque"])
def test_signs(geared: Robot, log: Trace, where: str, turn: tuple[float, ...]) -> None:
    position, torque = (turn, 1.0) if where == "position" else (1.0, turn)
    found = propose(written(log, position, torque), geared, Stated())
    other = "torque" if where == "position" else "position"
    assert [e.get("sign", 1) for e in entries(found, where)] == list(turn)
    assert [e.get("sign", 1) for e in entries(found, other)] == [1, 1, 1]
    assert f"the {where} of joints 2 and 3 has the other sign" in found.reasons


def test_a_sign_of_the_torque_that_is_said_takes_nothing_from_what_is_told_of_positions(
    geared: Robot, log: Trace
) -> None:
    found = propose(written(log, (1, -1, -1), 1.0), geared, Stated(sign=[-1]))
    assert [e.get("sign", 1) for e in entries(found, "torque")] == [-1, -1, -1]
    assert "the position of joints 2 and 3 has the other sign" in found.reasons
    assert not [line for line in found.reasons if "torque of joints" in line]
    assert "the signs given by --sign contradict the motion" in found.doubts


def test_the_motors_torque_is_told_by_the_gear(geared: Robot, log: Trace) -> None:
    found = propose(written(log, torque=1 / GEAR), geared, Stated())
    assert entries(found, "torque") == [{"unit": "N m", "side": "motor"}] * 3
    assert "torques are of the motor: they fit when multiplied by the gear ratio 25" in found.reasons


@pytest.mark.parametrize(("unit", "per"), [("N m", 1.0), ("A", 1.0), ("permille", 1000.0)])
def test_an_unknown_constant_is_what_the_masses_say(geared: Robot, log: Trace, unit: str, per: float) -> None:
    """Five newton metres a unit of the table; what the file says of the unit decides what that is called."""
    stated = Stated() if unit == "N m" else Stated(torque_unit=(unit, None))
    found = propose(written(log, torque=0.2), geared, stated)
    (first, *_) = entries(found, "torque")
    key = "rated" if unit == "permille" else "constant"
    assert first[key] == pytest.approx(5.0 * per, rel=0.15)
    assert any("from the masses of the description" in doubt for doubt in found.doubts)


@pytest.mark.parametrize(("unit", "factor"), [("A", 0.2), ("", 2.0), ("", 0.4)])
def test_what_the_model_lacks_shrinks_no_constant(geared: Robot, log: Trace, unit: str, factor: float) -> None:
    """A tenth of the load as friction, which the model has not; nor is that taken for torques in N m."""
    speed = np.gradient(log.position, log.time, axis=0)
    rough = replace(log, torque=log.torque + 0.1 * np.abs(log.torque) * np.sign(speed))
    found = propose(written(rough, torque=factor), geared, Stated(torque_unit=(unit, None)) if unit else Stated())
    assert [e["constant"] for e in entries(found, "torque")] == pytest.approx([1 / factor] * 3, rel=0.05)
    assert any("from the masses of the description" in doubt for doubt in found.doubts)


def test_torque_with_stamps_of_its_own_is_read_at_those_of_the_positions(geared: Robot, log: Trace) -> None:
    made = written(log, torque=1 / GEAR)
    columns, half = dict(made.columns), len(log.time) // 2
    for name in ("t", "tau1", "tau2", "tau3"):  # every other sample, from the hundredth on
        kept = made.columns[name][100::2]
        columns["clock" if name == "t" else name] = np.r_[kept, np.full(2 * half - len(kept), np.nan)]
    own = replace(made, columns=columns, time_of=dict.fromkeys(("tau1", "tau2", "tau3"), "clock"))
    found = propose(own, geared, Stated())
    assert entries(found, "torque") == [{"unit": "N m", "side": "motor", "time": "clock"}] * 3
    assert not any("uncertain" in doubt or "determine" in doubt for doubt in found.doubts)


def test_a_constant_that_is_told_is_taken(geared: Robot, log: Trace) -> None:
    found = propose(written(log, torque=1000 / 40.0), geared, Stated(torque_unit=("permille", 40.0)))
    assert entries(found, "torque") == [{"unit": "permille", "rated": 40.0}] * 3
    assert not any("from the masses" in doubt for doubt in found.doubts)
    assert any("25 times less: is the rated torque right?" in doubt for doubt in found.doubts), (
        "as drives are of motors"
    )
    found = propose(written(log, torque=1000 / 40.0 / GEAR), geared, Stated(torque_unit=("permille", 40.0)))
    assert entries(found, "torque") == [{"unit": "permille", "rated": 40.0, "side": "motor"}] * 3
    assert not any("rated torque" in doubt for doubt in found.doubts)
    found = propose(written(log, torque=1 / 0.8 / GEAR), geared, Stated(torque_unit=("A", 0.8)))
    assert entries(found, "torque") == [{"unit": "A", "constant": 0.8, "side": "motor"}] * 3


def test_cables_that_are_swapped_are_doubted_and_not_put_right(geared: Robot, log: Trace) -> None:
    found = propose(written(log, order=(1, 0, 2)), geared, Stated())
    assert any("in the order 2, 1, 3: are cables swapped?" in doubt for doubt in found.doubts)
    assert [entry["name"] for entry in found.columns["torque"]] == ["tau1", "tau2", "tau3"]


def test_of_noise_nothing_can_be_told(geared: Robot, log: Trace) -> None:
    made = written(log)
    random = np.random.default_rng(0)
    noise = {
        name: v if name[0] != "t" or name == "t" else random.normal(0, 9, len(v)) for name, v in made.columns.items()
    }
    found = propose(Table(made.path, made.kind, noise), geared, Stated())
    assert any("this log does not determine signs and gear side" in doubt for doubt in found.doubts)
    assert entries(found, "torque") == [{"unit": "N m"}] * 3


def test_a_joint_that_rests_leaves_nothing_to_tell(geared: Robot, log: Trace) -> None:
    """Where only one of several readings hardly moves, as degrees do in radians, the others tell: above, in amperes."""
    made = written(log)
    still = {name: np.full(len(v), 0.4) if name == "q3" else v for name, v in made.columns.items()}
    stated = Stated(position=["q1", "q2", "q3"])
    found = propose(Table(made.path, made.kind, still), geared, stated)
    assert any("are not poses of known, or hardly change: is the zero" in doubt for doubt in found.doubts)
    with pytest.raises(DataError, match=r"torques are A: how many N m per unit\? Give it with --torque-unit"):
        propose(Table(made.path, made.kind, still), geared, Stated(position=stated.position, torque_unit=("A", None)))


def test_increments_take_a_number_that_has_to_be_said(geared: Robot, log: Trace) -> None:
    made = written(log)
    counts = {n: np.round(v * 65536 / (2 * np.pi) * GEAR) if n[0] == "q" else v for n, v in made.columns.items()}
    made = Table(made.path, made.kind, counts)
    with pytest.raises(DataError, match=r"positions are increments: .* Give --counts-per-rev"):
        propose(made, geared, Stated())
    found = propose(made, geared, Stated(counts_per_rev=65536.0))
    assert entries(found, "position") == [{"unit": "counts", "counts_per_rev": 65536.0, "side": "motor"}] * 3
    assert "positions are increments, 65536 per turn" in found.reasons


@pytest.mark.parametrize(
    ("drop", "stated", "words"),
    [
        (
            ("q3",),
            Stated(),
            r"it is unclear which 3 columns are the positions; give --position NAME,.*columns: t, q1, q2",
        ),
        (("tau1", "tau2", "tau3"), Stated(), "no torque was recorded: no column is a torque .*--torque NAME"),
        (("tau2", "tau3"), Stated(), "it is unclear which 3 columns are the torques"),
        (("t",), Stated(), "no column of time stamps: give --rate HZ, or --time NAME"),
        ((), Stated(time="T"), "no column 'T'; it has: t, q1"),
        ((), Stated(torque=["tau1", "tau2", "x"]), "no column 'x'; it has"),
    ],
)
def test_what_cannot_be_told_names_the_option(
    geared: Robot, log: Trace, drop: tuple[str, ...], stated: Stated, words: str
) -> None:
    made = written(log)
    left = Table(made.path, made.kind, {n: v for n, v in made.columns.items() if n not in drop})
    with pytest.raises(DataError, match=words) as said:
        propose(left, geared, stated)
    assert str(said.value).startswith("log.csv: ")


def test_what_is_told_is_not_guessed(geared: Robot, log: Trace) -> None:
    stated = Stated(rate_hz=1000.0, position=["q3", "q2", "q1"], torque=["tau3", "tau2", "tau1"], position_unit="rad")
    found = propose(written(log), None, stated)
    assert found.columns["time"] == {"rate_hz": 1000.0}
    assert [entry["name"] for entry in found.columns["position"]] == ["q3", "q2", "q1"]
    assert "positions are rad: given by the user" in found.reasons
    assert "columns are recognised by their names" not in found.reasons
    assert "signs and the side of the gear cannot be checked without --robot" in found.doubts
    assert "torques are assumed to be N m: the file does not say" in found.doubts
    with pytest.raises(DataError, match=r"2 positions .* with 3 torques .*; give --position and --torque"):
        propose(written(log), None, Stated(position=["q1", "q2"], torque=stated.torque))
    with pytest.raises(
        DataError, match=r"torques are A; the torque per unit is unknown: give --torque-unit 'A NUMBER'"
    ):
        propose(written(log), None, Stated(torque_unit=("A", None)))


AXIS = Axes.model_validate({"name": "slide", "kind": "axes", "axis": [{"unit": "m"}]})


def slide(force: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray], scale: float = 1.0) -> Table:
    """A slide on sines; force (N,) of position, speed, acceleration."""
    time = np.arange(4000) * 1e-3
    size, rate = np.array([0.2, 0.02])[:, None], np.array([6.0, 19.0])[:, None]
    wave = rate * time
    x, v, a = (
        np.sum(part, axis=0)
        for part in (size * np.sin(wave), size * rate * np.cos(wave), -size * rate**2 * np.sin(wave))
    )
    return Table(Path("slide.csv"), "text", {"t": time, "pos": scale * x, "force": force(x, v, a)})


@pytest.mark.parametrize(
    ("force", "sign"),
    [
        (lambda x, v, a: 95 * a + 20 * np.sign(v), 1),
        (lambda x, v, a: -95 * a - 20 * np.sign(v), -1),
        (lambda x, v, a: -0.5 * a + 20 * np.sign(v) - 30, 1),  # what is told by friction, inertia may not overrule
        (lambda x, v, a: 0.5 * a - 20 * np.sign(v) + 300, -1),
    ],
)
def test_an_axis_takes_force_to_accelerate_and_against_friction(force: Callable[..., np.ndarray], sign: int) -> None:
    found = propose(slide(force), AXIS, Stated())
    assert [entry.get("sign", 1) for entry in entries(found, "torque")] == [sign]
    assert any("the other sign" in reason for reason in found.reasons) == (sign < 0)


def test_a_force_that_shows_nothing_is_doubted() -> None:
    found = propose(slide(lambda x, v, a: np.sin(80e-3 * np.arange(len(x)))), AXIS, Stated())
    assert any("inertia and friction are too small in this log" in doubt for doubt in found.doubts)


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "m"), (1000.0, "mm")])
def test_a_linear_axis_is_in_metres_or_millimetres_by_its_range(scale: float, unit: str) -> None:
    found = propose(slide(lambda x, v, a: 95 * a, scale), AXIS, Stated())
    assert entries(found, "position") == [{"unit": unit}]
    assert entries(found, "torque") == [{"unit": "N"}]
    assert f"positions are assumed to be {unit}, by their range" in found.doubts


@pytest.mark.parametrize(
    ("name", "per_metre", "unit"),
    [("set pos", 1.0, "m"), ("set pos", 1e3, "mm"), ("set pos [mm]", 1e3, "mm"), ("set pos [deg]", 1.0, None),
     ("set pos", 10.0, None), ("set pos [mm]", 1.0, None)],
)  # fmt: skip
def test_a_command_is_in_the_unit_in_which_it_goes_as_far(name: str, per_metre: float, unit: str | None) -> None:
    """Or it is left out: taken in another it would be a position error that no loop has."""
    made = slide(lambda x, v, a: 95 * a + 20 * np.sign(v))
    command = per_metre * np.roll(made.columns["pos"], -3)
    found = propose(replace(made, columns={**made.columns, name: command}), AXIS, Stated())
    assert entries(found, "position") == [{"unit": "m"}]
    assert found.columns.get("position_command") == (None if unit is None else [{"name": name, "unit": unit}])
    assert found.channels.position_command == (() if unit is None else [name])
    assert any(f"{name!r} are not in the unit" in doubt for doubt in found.doubts) == (unit is None)
    assert any(f"{name!r} are mm of the joint" in reason for reason in found.reasons) == (unit == "mm")


def test_where_torque_was_only_commanded_that_stands_in_for_it_and_is_doubted() -> None:
    made = slide(lambda x, v, a: 95 * a + 20 * np.sign(v))
    columns = {**made.columns, "force cmd": made.columns["force"]}
    del columns["force"]
    commanded = replace(made, columns=columns)
    for stated in (Stated(), Stated(torque=["force cmd"])):
        found = propose(commanded, AXIS, stated)
        assert found.columns["torque"] == [{"name": "force cmd", "unit": "N"}]
        assert "torque_command" not in found.columns
    assert any("no torque was measured" in doubt for doubt in propose(commanded, AXIS, Stated()).doubts)


def test_a_torque_command_in_another_unit_than_the_torque_is_left_out() -> None:
    made = slide(lambda x, v, a: 95 * a + 20 * np.sign(v))
    columns = {**made.columns, "force cmd [%]": made.columns["force"] / 8}
    found = propose(replace(made, columns=columns), AXIS, Stated())
    assert "torque_command" not in found.columns
    assert any("'force cmd [%]' are not in the unit" in doubt for doubt in found.doubts)


def test_increments_of_a_linear_axis_are_so_many_a_metre(tmp_path: Path) -> None:
    made = slide(lambda x, v, a: 95 * a + 20 * np.sign(v))
    counts = replace(made, columns={**made.columns, "pos": np.round(1e6 * made.columns["pos"])})
    with pytest.raises(DataError, match=r"slide\.csv: .* increments of an axis in m: .* Give --counts-per-m, or"):
        propose(counts, AXIS, Stated())
    found = propose(counts, AXIS, Stated(counts_per_m=1e6))
    assert found.columns["position"] == [{"name": "pos", "unit": "counts", "counts_per_m": 1e6}]
    rows = np.column_stack(list(counts.columns.values()))
    np.savetxt(tmp_path / "slide.csv", rows, delimiter=",", header=",".join(counts.columns), comments="")
    trace = read_trace(tmp_path / "slide.csv", AXIS, Columns.model_validate(found.columns))
    np.testing.assert_allclose(trace.position[:, 0], made.columns["pos"], atol=0.6e-6)


def test_of_the_rows_that_count_the_longest_run_is_taken() -> None:
    mode = np.array([1.0, 0, 1, 1, 0, 1, 1, 1, 0, 1, 1])
    made = Table(Path("log.csv"), "text", {"mode": mode, "row": np.arange(11.0)})
    assert proposal._stretch(made, "mode", 1.0).columns["row"].tolist() == [5, 6, 7]
    with pytest.raises(DataError, match=r"log\.csv: no row has 2 in column 'mode'"):
        proposal._stretch(made, "mode", 2.0)


WAVE = np.round(20_000 * np.sin(np.arange(400) / 40))


@pytest.mark.parametrize(
    ("values", "unsigned"),
    [
        (WAVE % 65536, True), (WAVE / 1e3 % 65536 // 1, True), ([0, 65535], True), ([np.inf, 0, 65535], True),
        (WAVE + 30_000, False), (np.abs(WAVE), False), (65_000 + WAVE[:40] / 100 // 1, False), (WAVE, False),
        ([0, 65536], False), ([-1, 65535], False), ([0.5, 65535], False), ([np.nan], False), ([0, 32767], False),
    ],
)  # fmt: skip
def test_numbers_that_lost_their_sign_leap_and_hardly_do_with_it(values: np.ndarray, unsigned: bool) -> None:
    assert proposal._without_sign(np.array(values, float), 16) is unsigned


def test_a_byte_that_lost_its_sign_is_told() -> None:
    made = slide(lambda x, v, a: 95 * a + 20 * np.sign(v))
    force = np.round(100 * made.columns["force"] / np.abs(made.columns["force"]).max())
    found = propose(replace(made, columns={**made.columns, "force": force % 256}), AXIS, Stated())
    assert entries(found, "torque") == [{"unit": "N", "bits": 8}]
    assert "'force' are 8-bit numbers read without sign: 255 means -1" in found.reasons


def test_where_one_joint_lost_its_sign_all_did(geared: Robot, log: Trace) -> None:
    """Of a joint that pushes one way only no reading leaps."""
    counts = np.round(20000 * log.torque / np.abs(log.torque).max())
    counts[:, 2] = -np.abs(counts[:, 2]) - 1
    made = written(log)
    columns = {**made.columns, **{f"tau{j + 1}": counts[:, j] % 65536 for j in range(3)}}
    found = propose(replace(made, columns=columns), geared, Stated(torque_unit=("A", 0.001)))
    assert [entry["bits"] for entry in entries(found, "torque")] == [16, 16, 16]
    assert "'tau1', 'tau2', 'tau3' are 16-bit numbers read without sign: 65535 means -1" in found.reasons


def units(values: np.ndarray, rate: float = 1.0, robot: Robot | None = None) -> readings.Candidates:
    made = Table(Path("log.csv"), "text", {"q": values})
    return readings.Candidates([made], Channels(position=("q",)), robot, rate, Stated())


def test_positions_are_what_a_joint_could_do() -> None:
    """No further than half a turn, and all but one in a hundred no faster than any Delta."""
    ramp = np.linspace(0.0, -1.0, 1001)
    jumps = ramp.copy()
    jumps[::300] *= 0.5
    assert units(ramp)._plausible(0.99 * ANY_JOINT)
    assert not units(ramp)._plausible(1.01 * ANY_JOINT)
    for values in (ramp, jumps):
        assert units(values, 0.99 * MAX_SPEED * 1000 / 2)._plausible(2.0)
        assert not units(values, 1.01 * MAX_SPEED * 1000 / 2)._plausible(2.0)


@pytest.mark.parametrize(
    ("values", "increments"),
    [
        (np.arange(0, 1002.0), True), (np.arange(0, 9.0), True), (np.tile(np.arange(0, 8.0), 9), False),
        (np.arange(0, 1002.0) + 0.3, False), (np.arange(0, 999.5, 0.5), False),
        (np.r_[np.arange(0, 1002.0), 1e4, np.nan], True),
        (np.where(np.arange(1200) % 8, 0.3, 0) + np.arange(1200), True),
        (np.where(np.arange(1200) % 12, 0.3, 0) + np.arange(1200), False),
    ],
)  # fmt: skip
def test_increments_are_many_whole_numbers(values: np.ndarray, increments: bool) -> None:
    assert units(values)._integers() is increments


@pytest.mark.parametrize(
    ("farthest", "sides"), [(3.0, ["", "motor"]), (3.2, ["motor"]), (78.0, ["motor"]), (79.0, [""])]
)
def test_a_side_of_the_gear_is_one_on_which_a_joint_could_turn_so_far(
    geared: Robot, farthest: float, sides: list[str]
) -> None:
    found = units(np.array([-farthest / 2, 0.0]), 1.0, geared)._sides({"unit": "counts", "counts_per_rev": np.pi})
    assert [entry.get("side", "") for entry in found] == sides


def test_the_part_of_a_log_that_moves_most_is_tried() -> None:
    """Ten seconds of thirty, evenly stamped; a row that is no number is flagged."""
    time = np.arange(300) * 0.1
    position = (
        np.where(time < 12.0, 0.1, np.where(time < 22.0, 1.0, 0.3))[:, None] * np.sin(5 * time)[:, None] * np.ones(3)
    )
    torque = position.copy()
    torque[150, 1] = position[160, 2] = np.nan
    found = evidence.trial(evidence.Run(position, torque, 10.0))
    first = int(np.flatnonzero((position == found.position[0]).all(axis=1))[0])
    assert 118 <= first <= 122
    assert len(found.time) == 100
    np.testing.assert_allclose(found.time, np.arange(100) * 0.1)
    np.testing.assert_array_equal(found.torque, torque[first : first + 100])
    assert np.flatnonzero(found.flags).tolist() == [150 - first, 160 - first]
    early = 1e-3 * position[::-1] * (time < 9.0)[:, None]
    found = evidence.trial(evidence.Run(early, torque, 10.0))
    np.testing.assert_array_equal(found.position, early[:100])


@pytest.mark.parametrize(
    ("position", "scale"),
    [
        ({"unit": "deg"}, np.pi / 180), ({"unit": "turns", "side": "motor"}, 2 * np.pi / GEAR), ({"unit": "mm"}, 1e-3),
        ({"unit": "counts", "counts_per_rev": 4096.0}, 2 * np.pi / 4096),
        ({"unit": "counts", "counts_per_rev": 4096.0, "side": "motor"}, 2 * np.pi / 4096 / GEAR),
    ],
)  # fmt: skip
def test_the_scale_of_a_position(position: dict[str, Any], scale: float) -> None:
    assert readings.scale_of(position, GEAR) == pytest.approx(scale)


def test_a_drive_that_is_described_says_its_counts_and_its_rated_torque(robot: Robot) -> None:
    drive: Any = stub(joint=[stub(counts_per_turn=4096, torque=stub(full_scale_nm=7.0))])
    described = robot.model_copy(update={"drive": drive})
    assert (described.counts_per_turn, described.full_scale_nm) == (4096.0, 7.0)
    assert (robot.counts_per_turn, robot.full_scale_nm) == (None, None)
    assert (AXIS.counts_per_turn, AXIS.full_scale_nm) == (None, None)


def test_of_several_ways_to_read_positions_it_is_said_how_well_each_fits(geared: Robot, log: Trace) -> None:
    found = propose(written(log), geared, Stated())
    (line,) = (one for one in found.reasons if one.startswith("positions are rad of the joint"))
    assert float(re.findall(r"\(([0-9.]+) times likelier\)", line)[0]) > 1000
    assert float(re.findall(r"([0-9.e+-]+) % of the torque remains unexplained on held-out rows", line)[0]) < 5.0
    assert any(one.startswith("torques are assumed to be N m: the file does not say") for one in found.reasons)


def test_the_rows_that_count_are_told_with_the_columns(geared: Robot, log: Trace) -> None:
    made = written(log)
    mode = np.where(np.arange(len(log.time)) < 50, 0.0, 3.0)
    found = propose(Table(made.path, made.kind, {**made.columns, "mode": mode}), geared, Stated(where=("mode", 3.0)))
    assert found.columns["where"] == {"name": "mode", "equals": 3.0}


def test_torques_are_read_with_their_sign_and_times_what_is_said() -> None:
    """Of 16 bits, whose sign was lost; commands stand as they are."""
    meant = 900.0 * np.sin(np.arange(300) * 0.05)
    rounded = np.round(meant)
    columns = {"y": rounded % 2**16, "z": rounded, "k": np.full(300, 0.25)}
    reasons: list[str] = []
    channels = Channels(torque=("y",), torque_command=("z",))
    table, keys = proposal._readings(Table(Path("log.csv"), "text", columns), channels, "k", reasons)
    np.testing.assert_array_equal(table.columns["y"], 0.25 * rounded)
    np.testing.assert_array_equal(table.columns["z"], rounded)
    assert keys == {"y": {"bits": 16, "times": "k"}, "z": {}}
    assert reasons == ["'y' are 16-bit numbers read without sign: 65535 means -1"]


def test_of_a_second_no_sign_is_told() -> None:
    """Of three independent pieces it is."""
    made = slide(lambda x, v, a: -95 * a)
    for rows, sign in ((99, None), (1000, None), (2000, -1)):
        few = {name: np.where(np.arange(4000) < rows, values, np.nan) for name, values in made.columns.items()}
        found = propose(Table(made.path, made.kind, few | {"t": made.columns["t"]}), AXIS, Stated())
        assert entries(found, "torque")[0].get("sign") == sign


def test_degrees_under_a_header_that_says_radians_are_degrees_and_doubted(geared: Robot, log: Trace) -> None:
    """Not the motor's radians, which go as far."""
    found = propose(written(log, 180 / np.pi, names=("q{} [rad]", "tau{} [Nm]")), geared, Stated())
    assert entries(found, "position") == [{"unit": "deg"}] * 3
    assert any("positions are deg of the joint, although the file says rad" in doubt for doubt in found.doubts)


def test_a_gear_ratio_of_twice_the_true_one_is_doubted(geared: Robot, log: Trace) -> None:
    twice = geared.model_copy(update={"drive": Drive(gear_ratio=2 * GEAR)})
    for robot, told in ((twice, True), (geared, False)):
        found = propose(written(log, GEAR, names=("q{} [rad]", "tau{} [Nm]")), robot, Stated())
        assert any("times the gear ratio or increments per turn" in doubt for doubt in found.doubts) is told


def test_half_of_the_torque_is_not_blamed_on_the_gear(robot: Robot, log: Trace) -> None:
    """Of a gear of two and a half, whose motor side it might be; nor is it taken for N m without a word."""
    for gear in (1.0, 2.5):
        described = robot.model_copy(update={"drive": Drive(gear_ratio=gear)})
        found = propose(written(log, torque=0.5, names=("q{} [rad]", "tau{} [Nm]")), described, Stated())
        assert any("torque" in doubt for doubt in found.doubts), (gear, found.reasons)
        assert not any("torques are of the motor" in reason for reason in found.reasons)


def test_few_increments_are_no_radians() -> None:
    """Of a small motion, below a thousand of them."""
    made = slide(lambda x, v, a: 95 * a + 20 * np.sign(v))
    turning = Axes.model_validate({"name": "axis", "kind": "axes", "axis": [{}]})
    counts = replace(made, columns={**made.columns, "pos": np.round(300 * made.columns["pos"])})
    with pytest.raises(DataError, match=r"positions are increments: how many per turn"):
        propose(counts, turning, Stated())


def test_many_turns_are_no_degrees() -> None:
    """Of an axis that winds, without a weight: radians as recorded, and it is said that nothing tells."""
    made = slide(lambda x, v, a: 0.5 * a + 3 * np.sign(v), scale=1.0)
    time = made.columns["t"]
    wound = 40.0 * time + made.columns["pos"]
    force = 0.5 * np.gradient(np.gradient(wound, time), time) + 3 * np.sign(np.gradient(wound, time))
    turning = Axes.model_validate({"name": "axis", "kind": "axes", "axis": [{"gravity": False}]})
    found = propose(Table(made.path, made.kind, {"t": time, "pos": wound, "force": force}), turning, Stated())
    assert entries(found, "position") == [{"unit": "rad"}]
    assert any(line.startswith("positions are rad of the joint, as recorded") for line in found.doubts)


@pytest.mark.parametrize("stroke", [1.0, 0.004])
def test_the_sign_of_an_axis_of_little_stroke_is_told(stroke: float) -> None:
    """What moves is told by metres a second, not by radians."""
    made = slide(lambda x, v, a: -(95 * a + 20 * np.sign(v)) / stroke, scale=stroke)
    found = propose(made, AXIS, Stated(position_unit="m"))
    assert entries(found, "torque")[0].get("sign") == -1


def test_turns_that_nothing_tells_from_radians_are_to_be_checked() -> None:
    """Of a motor's encoder whose log states no unit."""
    made = slide(lambda x, v, a: 0.5 * a + 0.2 * v + 3 * np.sign(v) + 2.0 * np.sin(x))
    turning = Axes.model_validate({"name": "axis", "kind": "axes", "axis": [{}]})
    found = propose(
        replace(made, columns={**made.columns, "pos": made.columns["pos"] / (2 * np.pi)}), turning, Stated()
    )
    assert any("this is ambiguous" in line for line in found.doubts), found.reasons


def test_runs_whose_stamps_are_in_other_units_are_not_one_mapping() -> None:
    made = slide(lambda x, v, a: 95 * a + 20 * np.sign(v))
    other = replace(made, path=Path("other.csv"), columns={**made.columns, "t": 1e3 * made.columns["t"]})
    with pytest.raises(DataError, match=r"other.csv: stamps in 't' are ms, those of slide.csv s: import it separately"):
        propose([made, other], AXIS, Stated(position_unit="m"))
