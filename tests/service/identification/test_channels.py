"""Which column of a foreign table is what: tables made here, by the names and numbers that controllers write."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.trace.tables import Table
from schemas.errors import DataError
from schemas.units import POSITION_UNITS, TORQUE_UNITS, tokens
from service.identification import channels
from service.identification.channels import (
    clocks_of,
    guess,
    no_torque,
    rate_hz,
    time_unit,
)

ROWS = 400
STAMPS = np.arange(ROWS) * 1e-3  # s


def smooth(number: int) -> np.ndarray:
    return np.sin(2 * np.pi * (1 + 0.3 * number) * STAMPS + number)


def rough(number: int) -> np.ndarray:
    return smooth(number) + 0.3 * np.random.default_rng(number).standard_normal(ROWS)


def table(names: str, clock: np.ndarray | None = STAMPS, **said) -> Table:
    """A column a name, separated by commas; the first is the clock, if there is one."""
    columns = {name.strip(): smooth(k) if k % 2 else rough(k) for k, name in enumerate(names.split(","), 1)}
    if clock is not None:
        columns[next(iter(columns))] = clock
    return Table(Path(said.pop("path", "log.csv")), said.pop("kind", "text"), columns, **said)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("axis0.actPos", ["axis", "0", "act", "pos"]),
        ("A1 Winkel [°]", ["a", "1", "winkel", "°"]),
        ("MotorTRQ_12", ["motor", "trq", "12"]),
        ("IqActual%", ["iq", "actual", "%"]),
    ],
)
def test_names_fall_into_words(name: str, words: list[str]) -> None:
    assert tokens(name) == words


@pytest.mark.parametrize(
    ("names", "position", "torque", "commands"),
    [
        ("t,q1,q2,tau1,tau2", "q1,q2", "tau1,tau2", ("", "")),
        ("Zeit,Winkel 2,Winkel 1,Moment 2,Moment 1", "Winkel 1,Winkel 2", "Moment 1,Moment 2", ("", "")),
        ("time,pos_a,set_pos_a,effort_a,effort_ref_a", "pos_a", "effort_a", ("set_pos_a", "effort_ref_a")),
        ("time,pos,vel,acc,torque,status,following error", "pos", "torque", ("", "")),
        ("time,a [deg],b [Nm]", "a [deg]", "b [Nm]", ("", "")),
        ("time,qm,qg,vir", "qm", "vir", ("qg", "")),
        ("time,goal,position,load", "position", "load", ("goal", "")),
        ("Zeit,Sollposition,Istposition,Schleppfehler,Strom", "Istposition", "Strom", ("Sollposition", "")),
        ("Zeit,Lageistwert,Lagesollwert,Momentenistwert", "Lageistwert", "Momentenistwert", ("Lagesollwert", "")),
        ("time,pos act,pos nc,torque", "pos act", "torque", ("", "")),
        ("t,x pos,x force cmd", "x pos", "", ("", "x force cmd")),
        ("time,joint m,joint torque,joint angle", "joint angle", "joint m,joint torque", None),
    ],
)  # fmt: skip
def test_names_tell_what_a_column_is(names: str, position: str, torque: str, commands: tuple[str, str] | None) -> None:
    found = guess(table(names), None)
    assert found.time == names.split(",")[0]
    assert list(found.position) == position.split(",")
    if commands is None:  # another number of torques than of positions: which is meant is not said
        assert list(found.torque) == []
        return
    assert ",".join(found.torque) == torque
    assert [",".join(found.position_command), ",".join(found.torque_command)] == list(commands)
    assert found.reasons == ["columns are recognised by their names"]


@pytest.mark.parametrize(("joints", "position"), [(3, "q1,q2,q3"), (2, "q1,q2"), (None, "q1,q2")])
def test_a_joint_that_rests_is_one_where_the_others_alone_are_too_few(joints: int | None, position: str) -> None:
    made = table("t,q1,q2,q3,tau1,tau2,tau3")
    still = {name: np.full(ROWS, 0.3) if name in ("q3", "tau3") else v for name, v in made.columns.items()}
    assert ",".join(guess(Table(made.path, made.kind, still), joints).position) == position
    still["tau3"] = rough(6)  # its weight's torque
    position = "q1,q2,q3" if joints != 2 else "q1,q2"
    found = guess(Table(made.path, made.kind, still), joints)
    assert ",".join(found.position) == position
    assert len(found.torque) == (3 if joints != 2 else 0)


@pytest.mark.parametrize(
    ("names", "ordered"),
    [
        ("pos 3,pos 1,pos 2", "pos 1,pos 2,pos 3"),
        ("pos3 of 16,pos1 of 16,pos2 of 16", "pos1 of 16,pos2 of 16,pos3 of 16"),
        ("pos 7,pos 1,pos 2", "pos 7,pos 1,pos 2"),  # not one after the other: as they stand
        ("pos 1,pos 1 b,pos 0", "pos 1,pos 1 b,pos 0"),
    ],
)
def test_joints_are_in_the_order_of_their_numbers(names: str, ordered: str) -> None:
    torques = ",".join(f"torque {k}" for k in range(names.count(",") + 1))
    assert list(guess(table(f"t,{names},{torques}"), None).position) == ordered.split(",")


def test_only_as_many_as_the_robot_has_are_taken() -> None:
    made = table("t,pos1,pos2,torque1,torque2")
    assert list(guess(made, 2).torque) == ["torque1", "torque2"]
    assert list(guess(made, 3).torque) == []


def test_a_column_that_never_changes_is_no_channel() -> None:
    made = table("t,pos1,pos2,torque1,torque2")
    still = Table(made.path, made.kind, {**made.columns, "pos3": np.full(ROWS, 2.0), "torque3": np.full(ROWS, np.nan)})
    assert list(guess(still, 2).position) == ["pos1", "pos2"]


@pytest.mark.parametrize("order", ["abxy", "xyab", "axby"])
def test_where_names_say_nothing_the_smoother_half_are_positions(order: str) -> None:
    columns = {"clock": STAMPS} | {letter: smooth(k) if letter in "ab" else rough(k) for k, letter in enumerate(order)}
    found = guess(Table(Path("log.csv"), "text", columns), 2)
    assert (list(found.position), list(found.torque)) == (["a", "b"], ["x", "y"])
    assert "smoother" in found.doubts[0]


@pytest.mark.parametrize(("order", "joints"), [("axyb", 2), ("abxy", 3), ("abx", None)])
def test_a_layout_that_nobody_writes_is_not_guessed(order: str, joints: int | None) -> None:
    columns = {"clock": STAMPS} | {letter: smooth(k) if letter in "ab" else rough(k) for k, letter in enumerate(order)}
    assert list(guess(Table(Path("log.csv"), "text", columns), joints).position) == []


def test_the_clock_is_named_or_the_first_column_if_that_rises() -> None:
    other = {"u": smooth(1), "v": rough(2)}
    assert guess(Table(Path("a"), "text", {**other, "stamp": STAMPS}), 1).time == "stamp"
    assert guess(Table(Path("a"), "text", {"x0": STAMPS, **other}), 1).time == "x0"
    assert guess(Table(Path("a"), "text", {**other, "x0": STAMPS}), 1).time is None
    assert guess(Table(Path("a"), "text", {"x0": STAMPS, **other}, layout={"beside": ["b.csv"]}), 1).time is None
    assert guess(Table(Path("a"), "text", {"when": STAMPS[::-1], **other}), 1).time is None
    jumps = STAMPS.copy()
    jumps[::50] -= 1.0  # 2 % of the steps: a counter that starts anew, no clock
    assert guess(Table(Path("a"), "text", {"time": jumps, **other}), 1).time is None
    held = np.repeat(STAMPS[::20], 20)[:ROWS]
    assert guess(Table(Path("a"), "text", {"time": held, **other}), 1).time is None


@pytest.mark.parametrize(
    ("name", "step", "unit", "said"),
    [
        ("Zeit [us]", 1000.0, "us", True),
        ("t_ms", 1.0, "ms", True),
        ("t [µs]", 250.0, "us", True),
        ("time", 0.001, "s", False),
        ("time", 1.0, "ms", False),
        ("time", 250.0, "us", False),
        ("time", 1e6, "ns", False),
        ("time", 1 / 21, "s", False),
        ("time", 1 / 19, "ms", False),
        ("time", 1e8, "s", False),
    ],
)
def test_a_clocks_unit_is_said_or_gives_a_rate_that_logs_have(name: str, step: float, unit: str, said: bool) -> None:
    made = Table(Path("a"), "text", {name: np.arange(ROWS) * step})
    assert time_unit(made, name) == (unit, said)
    seconds = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit] * step
    assert rate_hz(made, name) == pytest.approx(1 / seconds)


def test_the_files_own_unit_goes_first() -> None:
    made = Table(Path("a"), "text", {"t_ms": STAMPS}, {"t_ms": "s"})
    assert time_unit(made, "t_ms") == ("s", True)
    assert (
        Table(Path("a"), "t", {"pos [deg]": STAMPS}, {"pos [deg]": "rad"}).said_unit("pos [deg]", POSITION_UNITS)
        == "rad"
    )


@pytest.mark.parametrize(
    ("name", "known", "unit"),
    [
        ("angle (deg)", POSITION_UNITS, "deg"),
        ("angle deg 1", POSITION_UNITS, "deg"),
        ("deg of freedom 1", POSITION_UNITS, None),  # too far from the end to be a unit
        ("axis m", POSITION_UNITS, None),
        ("axis [m]", POSITION_UNITS, "m"),
        ("load a", TORQUE_UNITS, None),
        ("torque ‰", TORQUE_UNITS, "permille"),
        ("torque Nm", TORQUE_UNITS, "N m"),
    ],
)  # fmt: skip
def test_a_unit_stands_in_brackets_or_at_the_end_of_a_name(name: str, known: dict[str, str], unit: str | None) -> None:
    assert Table(Path("a"), "text", {name: STAMPS}).said_unit(name, known) == unit


def test_files_side_by_side_say_what_they_hold_by_their_names() -> None:
    columns = {"J1": smooth(1), "J2": smooth(2), "curr:J1": rough(1), "curr:J2": rough(2)}
    made = Table(Path("pos_read.csv"), "text", columns, layout={"beside": ["curr.csv"]})
    found = guess(made, 2)
    assert (list(found.position), list(found.torque)) == (["J1", "J2"], ["curr:J1", "curr:J2"])
    assert found.time is None


def test_each_of_several_files_has_its_own_stamps() -> None:
    """The first as the user says it, if it has that; none where no column is called so."""
    tables = [
        Table(Path("a.csv"), "text", {"time [ms]": 1e3 * STAMPS, "count": 2e3 * STAMPS, "x": smooth(1)}),
        Table(Path("b.csv"), "text", {"y": rough(1)}),
        Table(Path("c.csv"), "text", {"z": rough(2), "t [ms]": 5e2 * STAMPS}),
    ]
    assert clocks_of(tables, None) == ["time [ms]", None, "t [ms]"]
    assert clocks_of(tables, "other") == ["time [ms]", None, "t [ms]"]
    assert clocks_of([*tables[:1], tables[1]], "count") == ["count", None]
    with pytest.raises(DataError, match=r"stamps of several units \(a\.csv: ms, d\.csv: s\): write all in one unit"):
        clocks_of([tables[0], Table(Path("d.csv"), "text", {"t [s]": STAMPS})], None)


CALLED = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")


@pytest.mark.parametrize(
    ("names", "position", "torque"),
    [
        (  # a JointState by the alphabet, with a gripper's joint that the description lacks
            "time,elbow_joint.position,finger_joint.position,shoulder_lift_joint.position,shoulder_pan_joint.position,"
            "elbow_joint.effort,finger_joint.effort,shoulder_lift_joint.effort,shoulder_pan_joint.effort",
            "{}.position", "{}.effort",
        ),
        (  # with the prefix of a cell, positions and torques in different orders
            "t,ur5/elbow_joint/pos,ur5/shoulder_pan_joint/pos,ur5/shoulder_lift_joint/pos,"
            "ur5/shoulder_pan_joint/tau,ur5/shoulder_lift_joint/tau,ur5/elbow_joint/tau",
            "ur5/{}/pos", "ur5/{}/tau",
        ),
        (
            "t,elbow_joint set pos,elbow_joint act pos,shoulder_lift_joint act pos,shoulder_pan_joint act pos,"
            "elbow_joint act trq,shoulder_lift_joint act trq,shoulder_pan_joint act trq",
            "{} act pos", "{} act trq",
        ),
    ],
)  # fmt: skip
def test_joints_go_by_the_names_of_the_description(names: str, position: str, torque: str) -> None:
    found = guess(table(names), 3, CALLED)
    assert list(found.position) == [position.format(joint) for joint in CALLED]
    assert list(found.torque) == [torque.format(joint) for joint in CALLED]
    assert found.order[0].startswith("joints are assigned by the names of the description: 1 is ")
    assert not found.doubts


def test_a_name_that_begins_another_is_not_it() -> None:
    found = guess(table("t,arm_2.pos,arm.pos,arm.trq,arm_2.trq"), 2, ("arm", "arm_2"))
    assert (list(found.position), list(found.torque)) == (["arm.pos", "arm_2.pos"], ["arm.trq", "arm_2.trq"])


def test_joints_may_go_by_the_paths_of_the_controllers_variables() -> None:
    made = table("t,x pos,x pos (2),x trq,x trq (2)")
    paths = [f"MAIN.{axis}.NcToPlc.{what}" for what in ("ActPos", "ActTorque") for axis in ("Elbow", "Shoulder")]
    made = Table(made.path, made.kind, made.columns, paths=dict(zip(list(made.columns)[1:], paths, strict=True)))
    found = guess(made, 2, ("shoulder", "elbow"))
    assert (list(found.position), list(found.torque)) == (["x pos (2)", "x pos"], ["x trq (2)", "x trq"])


def test_where_the_description_has_no_names_torques_go_with_positions_and_the_order_is_told() -> None:
    found = guess(table("t,elbow pos,lift pos,lift trq,elbow trq"), 2)
    assert (list(found.position), list(found.torque)) == (["elbow pos", "lift pos"], ["elbow trq", "lift trq"])
    assert found.order == [
        "joints are assigned by their order in the file: 1 is 'elbow pos', 2 is 'lift pos'; the description has no "
        "names for them"
    ]
    found = guess(table("t,a pos,b pos,a trq,b trq"), 2, ("elbow", "lift"))
    assert "the description has elbow, lift, the columns do not" in found.doubts[0]
    found = guess(table("t,pos 2,pos 1,trq 2,trq 1"), 2, ("elbow", "lift"))
    assert "joints are assigned by the numbers in the names: 1 is 'pos 1'" in found.order[0]


@pytest.mark.parametrize(
    ("names", "units"),
    [
        ("time,a.position,b.position,a.velocity,b.velocity", {}),
        ("time,a.position,b.position,a.x,b.x", {"a.x": "rad/s", "b.x": "rad/s"}),
        ("time,a.position,b.position,a.x [1/min],b.x [1/min]", {}),
        ("time,a.position,b.position,a.x [m/s²],b.x [m/s^2]", {}),
        ("time,a.position,b.position,a.x,b.x", {"a.x": "°C", "b.x": "W"}),
        ("time,a.position,b.position", {}),
    ],
)
def test_what_says_that_it_is_something_else_is_no_torque(names: str, units: dict[str, str]) -> None:
    """The second half is the rougher one, as torques are."""
    columns = {name: smooth(k) if "position" in name else rough(k) for k, name in enumerate(names.split(","))}
    made = Table(Path("log.csv"), "text", columns | {"time": STAMPS}, units)
    found = guess(made, None)
    assert list(found.torque) == []
    assert "no column is a torque by name or unit" in str(no_torque(made, found.torque))


def test_a_torque_that_never_changes_was_not_recorded() -> None:
    made = table("t,a.pos,b.pos,a.effort,b.effort")
    still = dict.fromkeys(("a.effort", "b.effort"), np.zeros(ROWS))
    made = Table(made.path, made.kind, {**made.columns, **still})
    assert no_torque(made, guess(made, 2).torque) == "'a.effort', 'b.effort' are 0 from the first to the last row"
    assert no_torque(Table(made.path, made.kind, {**made.columns, "b.effort": rough(1)}), list(still)) is None
    empty = Table(made.path, made.kind, {**made.columns, **dict.fromkeys(still, np.full(ROWS, np.nan))})
    assert "are empty" in str(no_torque(empty, list(still)))


def test_a_name_of_many_digits_is_no_joint() -> None:
    """Which Python does not even read as a number."""
    names = [f"q{digit * 5000}" for digit in "12"]
    assert channels._numbers_of(names) is None
    assert channels._numbers_of(["q1", "q2"]) == [1, 2]


@pytest.mark.parametrize(
    ("text", "position", "torque"),
    [
        ("mrad", "mrad", None), ("µm", "um", None), ("N·m", None, "N m"), ("mNm", None, "mN m"), ("N*cm", None, "N cm"),
        ("kNm", None, "kN m"), ("lbf-in", None, "lbf in"), ("ft lb", None, "lbf ft"), ("mA", None, "mA"),
    ],
)  # fmt: skip
def test_a_unit_with_a_prefix_is_not_the_unit_without(text: str, position: str | None, torque: str | None) -> None:
    for made in (
        Table(Path("a"), "text", {"x": STAMPS}, {"x": text}), Table(Path("a"), "text", {f"x [{text}]": STAMPS}),
    ):  # fmt: skip
        (name,) = made.columns
        assert made.said_unit(name, POSITION_UNITS) == position
        assert made.said_unit(name, TORQUE_UNITS) == torque
        assert made.unknown_unit(name) is None
    strange = Table(Path("a"), "text", {"x [stone furlong]": STAMPS, "y[0]": STAMPS, "z [datetime]": STAMPS})
    assert strange.unknown_unit("x [stone furlong]") == "stone furlong"
    assert strange.unknown_unit("y[0]") is None


@pytest.mark.parametrize("text", ["min", "h", "100ns", "cycles"])
def test_stamps_in_a_unit_that_is_not_read_are_refused(text: str) -> None:
    made = Table(Path("a.csv"), "text", {f"time [{text}]": STAMPS})
    with pytest.raises(
        DataError, match=rf"stamps in 'time \[{text}\]' are in '{text}': only s, ms, us and ns are read"
    ):
        time_unit(made, f"time [{text}]")


@pytest.mark.parametrize("name", ["index", "Sample", "cycle nr", "nanosec"])
def test_a_counter_is_no_clock(name: str) -> None:
    assert guess(Table(Path("a"), "text", {name: np.arange(ROWS), "q": smooth(1), "tau": rough(2)}), 1).time is None


@pytest.mark.parametrize(
    ("names", "position", "torque", "commands"),
    [
        ("time,q[0],q_d[0],dq[0],dq_d[0],tau_J[0],tau_J_d[0],dtau_J[0],tau_ext_hat[0]", "q[0]", "tau_J[0]",
         ("q_d[0]", "tau_J_d[0]")),
        ("t,q1,omega1,tau1,tau_des1", "q1", "tau1", ("", "tau_des1")),
        ("t,q1,w1,iq1,id1", "q1", "iq1", ("", "")),
        ("t,q1,torque1,torque limit 1,torque max 1", "q1", "torque1", ("", "")),
        ("t,q_a,q_d,tau_a,tau_d", "q_a,q_d", "tau_a,tau_d", ("", "")),  # axes a and d
        ("t,state.q[0],state.dq[0],state.tau_J[0],cmd.q_d[0],cmd.tau_J_d[0]", "state.q[0]", "state.tau_J[0]",
         ("cmd.q_d[0]", "cmd.tau_J_d[0]")),
        ("t,pos,motor.current.Iq_meas,motor.current.Iq_set,motor.current.Id_meas", "pos", "motor.current.Iq_meas",
         ("", "motor.current.Iq_set")),
        ("t,id1_pos,id1_current", "id1_pos", "id1_current", ("", "")),  # a motor's number
        ("t,pos,torque,torque b,torque set", "pos", "", ("", "")),  # a command stands for none of two
    ],
)  # fmt: skip
def test_what_stands_beside_a_torque_is_none(
    names: str, position: str, torque: str, commands: tuple[str, str]
) -> None:  # fmt: skip
    found = guess(table(names), None)
    assert (",".join(found.position), ",".join(found.torque)) == (position, torque)
    assert (",".join(found.position_command), ",".join(found.torque_command)) == commands


@pytest.mark.parametrize("order", [1, 2])
def test_a_speed_or_an_acceleration_without_a_name_is_none(order: int) -> None:
    at = np.sin(np.outer(STAMPS, 2 * np.pi * np.array([1.3, 3.1, 7.7]))).sum(axis=1)
    rate = at
    for _ in range(order):
        rate = np.gradient(rate, STAMPS)
    made = Table(Path("a"), "text", {"t": STAMPS, "a": at, "b": rate, "c": rate + 0.1 * np.std(rate) * np.sign(rate)})
    assert channels.is_rate(made, "b", "a", "t")
    assert channels.is_rate(made, "b", "a", None)
    assert not channels.is_rate(made, "c", "a", "t")


def test_a_command_is_not_taken_by_its_smoothness_for_what_was_measured() -> None:
    columns = {"t": STAMPS, "q set": smooth(1), "tau set": rough(2)}
    assert not guess(Table(Path("a"), "text", columns), 1).position


def test_joints_go_by_what_of_their_names_tells_them_apart() -> None:
    names = "t,Elbow pos,Shoulder Lift pos,Shoulder Pan pos,Elbow trq,Shoulder Lift trq,Shoulder Pan trq"
    assert list(guess(table(names), 3, CALLED).position) == ["Shoulder Pan pos", "Shoulder Lift pos", "Elbow pos"]
    found = guess(table("t,pos 2,pos 1,trq 2,trq 1"), 2, ("joint_1", "joint_2"))
    assert list(found.position) == ["pos 1", "pos 2"]


def test_names_of_one_of_both_are_kept_to_and_the_other_is_to_be_checked() -> None:
    names = "t,elbow_joint pos,shoulder_lift_joint pos,shoulder_pan_joint pos,tau1,tau2,tau3"
    found = guess(table(names), 3, CALLED)
    assert list(found.position) == [f"{joint} pos" for joint in CALLED]
    assert list(found.torque) == ["tau1", "tau2", "tau3"]
    assert "only the positions or only the torques bear names" in found.doubts[0]
    made = table("t,position0,position1,effort0,effort1")
    paths = {"position0": "zed", "position1": "alpha", "effort0": "zed", "effort1": "alpha"}
    made = Table(made.path, made.kind, made.columns, paths=paths)
    assert list(guess(made, 2, ("alpha", "zed")).position) == ["position1", "position0"]
    assert "the file has zed, alpha" in guess(made, 2, ("x", "y")).doubts[0]
