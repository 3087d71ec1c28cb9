"""How a proposal decides: each rule just inside and just outside of it, on readings set by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.trace.tables import Table
from schemas.axes_description import Axes
from schemas.errors import DataError, RobotError, TraceError
from schemas.robot import Drive, Robot
from service.identification import evidence, proposal, readings
from service.identification.channels import Channels
from service.identification.checks import TorqueReading
from service.identification.evidence import DeltaFit, Left, Run
from service.identification.proposal import propose
from service.identification.readings import Lines, Reading, Stated
from tests.service.world import stub

GEAR = 25.0
ROWS = 300
AGAINST = "axis 2: as recorded, the torque pushes against the motion: the other sign is used"
UP, ORDER = (1, 1, 1), (0, 1, 2)
JOINTS = Channels("t", ("q1", "q2", "q3"), ("tau1", "tau2", "tau3"))
ANGLES, TORQUES = np.random.default_rng(0).standard_normal((2, ROWS, 3))


@pytest.fixture(scope="module")
def geared(robot: Robot) -> Robot:
    return robot.model_copy(update={"drive": Drive(gear_ratio=GEAR)})


def delta_table() -> Table:
    columns = {"t": np.arange(ROWS) * 1e-3}
    columns |= {f"q{j + 1}": ANGLES[:, j] for j in range(3)} | {f"tau{j + 1}": TORQUES[:, j] for j in range(3)}
    return Table(Path("log.csv"), "text", columns)


def fitting(
    share: float, scale: float = 1.0, signs: tuple[int, ...] = UP, by_masses: float | None = None, **torque: Any
) -> DeltaFit:
    """A way to read the log: what it leaves, the positions' signs, the torque's reading, its scale by the masses."""
    reading = TorqueReading(share, torque.get("order", ORDER), torque.get("turned", UP), scale)
    return DeltaFit(left_of(share), signs, reading, scale if by_masses is None else by_masses)


def left_of(share: float) -> Left:
    return Left(np.array([share]), np.array([20.0]))


def read(
    monkeypatch: pytest.MonkeyPatch, robot: Robot, *ranked: Any, torque: dict[str, Any] | None = None, told: bool = True
) -> Reading:
    """What is made of ways to read a log of degrees, the best first."""
    asked = torque or {"unit": "N m"}
    factor = {"percent": 0.01, "permille": 0.001}.get(asked["unit"], 1.0) * (
        asked.get("constant", asked.get("rated", 1.0)) or np.nan
    )

    def fits(model: Robot, runs: list[Run], known: bool, said: bool) -> list[DeltaFit]:
        (run,) = runs
        assert (run.rate, model, said) == (1e3, robot, told)
        np.testing.assert_allclose(run.position, np.radians(ANGLES))
        assert known is bool(np.isfinite(factor))
        np.testing.assert_allclose(run.torque, TORQUES * (factor if known else 1.0))
        return list(ranked)

    monkeypatch.setattr(readings, "delta_fits", fits)
    return readings._of_delta(robot, [Run(ANGLES, TORQUES, 1e3)], {"unit": "deg"}, asked, told)


def test_positions_that_are_no_poses_are_told_and_nothing_is_changed(
    monkeypatch: pytest.MonkeyPatch, geared: Robot
) -> None:
    found = read(monkeypatch, geared)
    assert (found.share, found.signs, found.torque) == (np.inf, UP, {"unit": "N m"})
    (doubt,) = found.doubts
    assert doubt.startswith("read as deg of the joint, the positions are not poses of known, or hardly change")
    assert found.reasons == []


@pytest.mark.parametrize(("share", "hopeless"), [(0.49, False), (0.51, True)])
def test_where_half_of_the_torque_is_left_nothing_is_told(
    monkeypatch: pytest.MonkeyPatch, geared: Robot, share: float, hopeless: bool
) -> None:
    found = read(monkeypatch, geared, fitting(share, signs=(1, -1, 1), turned=(-1, 1, -1)))
    assert found.share == share
    assert (found.signs, found.torque_signs) == ((UP, UP) if hopeless else ((1, -1, 1), [-1, 1, -1]))
    line = f"read like this, the robot's equations leave {100 * share:.2g} % of the torque unexplained"
    if hopeless:
        assert found.doubts == [f"{line}: this log does not determine signs and gear side"]
        assert found.reasons == []
    else:
        assert found.reasons == [line, "the position of joint 2 has the other sign"]
        assert found.of_signs == Lines(["the torque of joints 1 and 3 has the other sign"])
        assert found.doubts == []


@pytest.mark.parametrize(("second", "certain"), [(0.43, True), (0.42, False)])
def test_signs_are_certain_where_others_are_a_thousand_times_less_likely(
    monkeypatch: pytest.MonkeyPatch, geared: Robot, second: float, certain: bool
) -> None:
    """Of twenty pieces the square has to be twice as much, 1000^(1/10); the third and further do not matter."""
    found = read(monkeypatch, geared, fitting(0.3), fitting(second, signs=(1, -1, 1)), fitting(0.9, signs=(1, 1, -1)))
    line = "read like this, the robot's equations leave 30 % of the torque unexplained"
    doubt = f"{line}, with other signs of the positions {100 * second:.2g} %: the signs are uncertain"
    assert (found.reasons, found.doubts) == (([line], []) if certain else ([], [doubt]))


def test_signs_that_are_not_sure_stay_as_recorded(monkeypatch: pytest.MonkeyPatch, geared: Robot) -> None:
    for given, signs in ((0.42, UP), (0.43, (1, -1, 1))):
        found = read(monkeypatch, geared, fitting(0.3, signs=(1, -1, 1)), fitting(given))
        assert tuple(found.signs) == signs


@pytest.mark.parametrize("order", [(1, 0, 2), (0, 2, 1), (2, 1, 0)])
def test_torques_in_another_order_are_told_and_left(
    monkeypatch: pytest.MonkeyPatch, geared: Robot, order: tuple[int, ...]
) -> None:
    found = read(monkeypatch, geared, fitting(0.05, 5.0, (1, -1, 1), order=order, turned=(-1, 1, 1)))
    said = ", ".join(str(k + 1) for k in order)
    assert found.doubts == [
        f"the torques fit better in the order {said}: are cables swapped? Set the order with --torque"
    ]  # fmt: skip
    assert (found.signs, found.torque_signs, found.torque) == (UP, UP, {"unit": "N m"})


@pytest.mark.parametrize(
    ("scale", "read_as"),
    [
        (1.24, {"unit": "N m"}), (1 / 1.24, {"unit": "N m"}), (1.26, None), (1 / 1.26, None),
        (GEAR * 1.24, {"unit": "N m", "side": "motor"}), (GEAR / 1.24, {"unit": "N m", "side": "motor"}),
        (GEAR * 1.26, None), (GEAR / 1.26, None),
    ],
)  # fmt: skip
def test_a_scale_near_one_or_the_gear_is_that(
    monkeypatch: pytest.MonkeyPatch, geared: Robot, scale: float, read_as: dict[str, Any] | None
) -> None:
    """Within a quarter; any other is what a unit of the torque is worth by the masses."""
    found = read(monkeypatch, geared, fitting(0.05, scale))
    assert found.torque == (read_as or {"unit": "A", "constant": float(f"{scale:.4g}")})
    if read_as:
        assert found.doubts == []
        assert ("torques are of the motor: they fit when multiplied by the gear ratio 25" in found.reasons) == (
            "side" in read_as
        )
    else:
        joint = (
            f"one unit of torque is assumed to be {scale:.4g} N m at the joint ({scale / GEAR:.4g} N m of the motor)"
        )
        assert found.doubts == [f"{joint}, {readings.WHENCE}"]


@pytest.mark.parametrize(
    ("torque", "read_as"),
    [
        ({"unit": "percent", "rated": 40.0}, {"unit": "percent", "rated": 40.0}),
        ({"unit": "permille", "rated": 40.0}, {"unit": "permille", "rated": 40.0}),
        ({"unit": "A", "constant": 0.8}, {"unit": "A", "constant": 0.8}),
        ({"unit": "percent", "rated": None}, {"unit": "percent", "rated": 110.0}),
        ({"unit": "permille", "rated": None}, {"unit": "permille", "rated": 1100.0}),
        ({"unit": "A", "constant": None}, {"unit": "A", "constant": 1.1}),
    ],
)
def test_a_unit_without_its_constant_gets_it_by_the_masses(
    monkeypatch: pytest.MonkeyPatch, geared: Robot, torque: dict[str, Any], read_as: dict[str, Any]
) -> None:
    """A scale that would go as one."""
    found = read(monkeypatch, geared, fitting(0.05, 1.1), torque=torque)
    assert found.torque == read_as
    doubted = [doubt for doubt in found.doubts if "rated torque right?" not in doubt]  # at the joint, see test_proposal
    known = None not in torque.values()
    assert doubted == (
        []
        if known
        else [f"one {torque['unit']} is assumed to be 1.1 N m at the joint (0.044 N m of the motor), {readings.WHENCE}"]
    )


@pytest.mark.parametrize(
    ("share", "scale", "by_masses", "why"),
    [
        (0.09, 1.0, 1.24, "; the fit confirms it"), (0.09, 1.0, 1 / 1.24, "; the fit confirms it"),
        (0.09, 1.0, 1.26, "; from the masses one unit would be 1.26 N m"),
        (0.09, 1.0, 1 / 1.26, "; from the masses one unit would be 0.794 N m"),
        (0.09, GEAR, 2.0 * GEAR, "; from the masses one unit would be 2 N m"),
        (0.11, 1.0, 1.0, "; the fit is poor"),
    ],
)  # fmt: skip
def test_newton_metres_that_nobody_said_are_sure_where_the_fit_goes_with_them(
    monkeypatch: pytest.MonkeyPatch, geared: Robot, share: float, scale: float, by_masses: float, why: str
) -> None:
    ranked = fitting(share, scale, by_masses=by_masses)
    found = read(monkeypatch, geared, ranked, told=False)
    line = f"torques are assumed to be N m: the file does not say{why}"
    sure = why == "; the fit confirms it"
    assert (line in found.reasons, line in found.doubts) == (sure, not sure)
    told = read(monkeypatch, geared, ranked)
    said = f"read as N m, the torques are {scale / by_masses:.3g} times those that the masses need"
    contradicted = [one for one in told.doubts if one.startswith(said)]  # and a poor fit says nothing against the file
    assert len(contradicted) == (not sure and share < 0.1)
    assert not any(one.startswith("torques are assumed") for one in [*told.reasons, *told.doubts])


def fits_of(
    monkeypatch: pytest.MonkeyPatch, robot: Robot, share: dict[tuple[int, ...], float | None], named: float = 0.05,
    known: bool = True, told: bool = True, seconds: float = 0.51,
) -> list[tuple[float, tuple[int, ...], float, float]]:  # fmt: skip
    """(share, signs, scale, scale by the masses) of what a log is read as. share: of the positions' signs, with any
    scale; None: no pose. named: with the scale that there is."""

    def summarise(model: object, trace: Any) -> Any:
        signs = tuple(int(s) for s in np.sign(trace.position[0] / ANGLES[0]))
        assert len(trace.position) == ROWS
        np.testing.assert_array_equal(trace.position, ANGLES * signs)
        np.testing.assert_array_equal(trace.torque, TORQUES)
        if share.get(signs, 0.9) is None:
            raise TraceError("no pose")
        return stub(seconds=np.array([[9.0, seconds / 2, 9.0]] * 2), gram=np.array([[signs], [signs]]) / 2)

    def best_reading(gram: np.ndarray, gear: float, free_scale: bool = False) -> TorqueReading:
        assert gear == GEAR
        signs = tuple(int(s) for s in gram[0])
        left = share.get(signs, 0.9)
        assert left is not None
        return TorqueReading(left if free_scale else named, ORDER, UP, 7.0 if free_scale else 1.0)

    monkeypatch.setattr(evidence, "summarise", summarise)
    monkeypatch.setattr(evidence, "best_reading", best_reading)
    monkeypatch.setattr(evidence, "held_out_share", lambda gram, reading: reading.share)
    found = evidence.delta_fits(robot, [Run(ANGLES, TORQUES, 1e3)], known, told)
    return [(fit.share, tuple(fit.signs), fit.torque.scale, fit.by_masses) for fit in found]


def test_other_signs_are_tried_where_those_given_leave_a_tenth(monkeypatch: pytest.MonkeyPatch, geared: Robot) -> None:
    """With any scale, as its unit is not known; a motion that is no pose is out."""
    assert fits_of(monkeypatch, geared, {UP: 0.09}, known=False) == [(0.09, UP, 7.0, 7.0)]
    found = fits_of(monkeypatch, geared, {UP: 0.11, (1, -1, 1): 0.04, (-1, -1, -1): None}, known=False)
    assert found[:2] == [(0.04, (1, -1, 1), 7.0, 7.0), (0.11, UP, 7.0, 7.0)]
    assert [left for left, *_ in found[2:]] == [0.9] * 5
    assert len({signs for _, signs, *_ in found}) == 7
    found = fits_of(monkeypatch, geared, {UP: None}, known=False)
    assert len(found) == 7
    assert UP not in [signs for _, signs, *_ in found]


def test_each_joint_has_to_move_for_half_a_second(monkeypatch: pytest.MonkeyPatch, geared: Robot) -> None:
    assert fits_of(monkeypatch, geared, {UP: 0.01}, seconds=0.51) != []
    assert fits_of(monkeypatch, geared, {UP: 0.01}, seconds=0.49) == []


@pytest.mark.parametrize(
    ("free", "named", "told", "scale"),
    [
        (0.039, 0.05, False, 7.0), (0.041, 0.05, False, 1.0),  # less than 0.8 of it
        (0.099, 0.2, False, 7.0), (0.101, 0.2, False, 1.0),  # and than a tenth of the torque
        (0.001, 0.05, True, 1.0),
    ],
)  # fmt: skip
def test_another_scale_than_newton_metres_has_to_fit_far_better_and_nothing_say_otherwise(
    monkeypatch: pytest.MonkeyPatch, geared: Robot, free: float, named: float, told: bool, scale: float
) -> None:
    found = fits_of(monkeypatch, geared, {UP: free}, named, told=told)
    (mine,) = (one for one in found if one[1] == UP)
    assert mine == (free if scale == 7.0 else named, UP, scale, 7.0)


@pytest.mark.parametrize(
    ("others", "sure", "unit"), [(0.43, True, "rad"), (0.42, False, "rad"), (0.22, False, "rad"), (0.2, True, "deg")]
)
def test_of_two_ways_to_read_positions_that_recorded_is_left_but_for_one_that_is_sure(
    monkeypatch: pytest.MonkeyPatch, geared: Robot, others: float, sure: bool, unit: str
) -> None:
    """Radians of the joint leave 0.3; those of the motor, and degrees of the motor, more."""
    shares = {("rad", ""): 0.3, ("rad", "motor"): 0.8, ("deg", ""): others, ("deg", "motor"): 0.9}

    def of_delta(robot: Robot, runs: Any, position: dict[str, Any], *rest: Any) -> Reading:
        share = shares[position["unit"], position.get("side", "")]
        return Reading(position, {"unit": "N m"}, left_of(share), UP, UP, [f"reason {share}"], [f"doubt {share}"])

    monkeypatch.setitem(readings._WAYS, Robot, readings._WAYS[Robot]._replace(read=of_delta))
    made = delta_table()
    slow = {name: 0.01 * values if name[0] == "q" else values for name, values in made.columns.items()}
    found = propose(Table(made.path, made.kind, slow), geared, Stated(position=JOINTS.position))
    assert found.columns["position"][0]["unit"] == unit
    lines = found.reasons if sure else found.doubts
    assert any(line.startswith(f"positions are {unit} of the joint") for line in lines)
    taken = 0.3 if unit == "rad" else others
    assert f"reason {taken}" in found.reasons
    assert f"doubt {taken}" in found.doubts


TURNING = Axes.model_validate({"name": "arm", "kind": "axes", "axis": [{"unit": "rad"}, {"unit": "rad"}]})


def swings(*forces: Any, rows: int = 4000, period: float = 1e-3) -> Table:
    """Axes in degrees on two sines each; a torque (N,) of angle, speed and acceleration, rad, for each."""
    time = np.arange(4000) * period
    size, rate = np.array([0.6, 0.05])[:, None], np.array([5.0, 17.0])[:, None]
    wave = rate * time
    x = np.sum(size * np.sin(wave), axis=0)
    v, a = np.sum(size * rate * np.cos(wave), axis=0), -np.sum(size * rate**2 * np.sin(wave), axis=0)
    columns = {"t": time}
    for number, force in enumerate(forces, 1):
        columns |= {f"pos{number} [deg]": np.degrees(x), f"torque{number} [Nm]": force(x, v, a)}
    return Table(Path("log.csv"), "text", {name: values[:rows] for name, values in columns.items()})


def signs_of(*forces: Any, rows: int = 4000, period: float = 1e-3) -> tuple[list[int], list[str]]:
    found = propose(swings(*forces, rows=rows, period=period), TURNING, Stated())
    assert found.columns["position"][0]["unit"] == "deg"
    return [entry.get("sign", 1) for entry in found.columns["torque"]], [
        line for line in [*found.reasons, *found.doubts] if line.startswith(("axis", "sign of"))
    ]


def test_an_axis_sign_is_told_beside_its_weight_and_each_axis_for_itself() -> None:
    """Weight and a constant explain nothing of it, however they are turned; what shows nothing is passed by."""

    def weighed(inertia: float, dry: float) -> Any:
        return lambda x, v, a: inertia * a + dry * np.sign(v) + 30 * np.sin(x) - 20 * np.cos(x) + 90

    signs, said = signs_of(weighed(0.5, 0.0), weighed(-0.5, 0.0))
    assert signs == [1, -1]
    assert [line.split(" (")[0] for line in said] == [AGAINST]
    assert signs_of(weighed(0.0, -3.0), weighed(0.0, 3.0))[0] == [-1, 1]
    hum = np.sin(0.3 * np.arange(4000))
    signs, said = signs_of(lambda x, v, a: hum, weighed(-0.5, 0.0))
    assert signs == [1, -1]
    assert said[-1].startswith("sign of the torque of joint 1: inertia and friction are too small")


@pytest.mark.parametrize(("share", "told"), [(0.2, True), (0.02, False)])
def test_a_term_of_less_than_a_machine_follows_its_equations_decides_no_sign(share: float, told: bool) -> None:
    """Beside a weight, to the last digit: no noise says that the rest is not of the machine, nor that it is."""

    def weighed(x: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        weight = 5 * np.sin(x)
        return weight - share * np.std(weight) * a / np.std(a)

    signs, said = signs_of(weighed, weighed)
    assert signs == ([-1, -1] if told else [1, 1])
    assert any("sign of the torque of joints 1 and 2" in line for line in said) is not told


def test_rows_without_a_number_tell_no_sign_and_take_none() -> None:
    made = swings(lambda x, v, a: -5.0 * a, lambda x, v, a: -5.0 * a)
    for gone, name in ((500, "pos1 [deg]"), (900, "torque2 [Nm]")):
        made.columns[name][gone] = np.nan
    assert [entry["sign"] for entry in propose(made, TURNING, Stated()).columns["torque"]] == [-1, -1]


def test_signs_are_told_from_a_second_of_motion_on_where_nothing_else_is_in_it() -> None:
    against = [lambda x, v, a: -5.0 * a] * 2
    assert signs_of(*against, rows=100, period=0.01)[0] == [-1, -1]
    assert signs_of(*against, rows=50, period=0.01)[0] == [1, 1]


@pytest.mark.parametrize(
    ("farthest", "gear", "said"), [(2000.0, GEAR, True), (150.0, GEAR, False), (150.0, 1.0, False)]
)
def test_positions_that_no_joint_turns_are_said_to_be_the_motors(
    monkeypatch: pytest.MonkeyPatch, robot: Robot, farthest: float, gear: float, said: bool
) -> None:
    """Degrees, as the user says."""

    def of_delta(robot: Robot, runs: Any, position: dict[str, Any], *rest: Any) -> Reading:
        return Reading(position, {"unit": "N m"}, left_of(0.01 if "side" in position else 0.02), UP, UP)

    monkeypatch.setitem(readings._WAYS, Robot, readings._WAYS[Robot]._replace(read=of_delta))
    made = delta_table()
    far = {name: farthest * np.sin(values) if name[0] == "q" else values for name, values in made.columns.items()}
    described = robot.model_copy(update={"drive": Drive(gear_ratio=gear)})
    found = propose(Table(made.path, made.kind, far), described, Stated(position_unit="deg"))
    assert ("positions are of the motor: no joint turns that far" in found.reasons) is said


@pytest.mark.parametrize(
    ("unit", "name", "entry", "reason"),
    [
        (None, "torque [%]", {"unit": "percent", "rated": 12.0}, "torques are percent: the file says so"),
        (None, "torque [Nm]", {"unit": "N m"}, "torques are N m: the file says so"),
        (("percent", 5.0), "torque [Nm]", {"unit": "percent", "rated": 5.0}, None),
        (("permille", None), "torque", {"unit": "permille", "rated": 12.0}, None),
        (("V", 0.3), "torque", {"unit": "V", "constant": 0.3}, None),
        (("A", 0.2), "torque", {"unit": "A", "constant": 0.2}, None),
    ],
)
def test_a_torques_unit_stands_there_or_is_told_and_its_drive_says_what_is_rated(
    monkeypatch: pytest.MonkeyPatch, unit: Any, name: str, entry: dict[str, Any], reason: str | None
) -> None:
    monkeypatch.setattr(Axes, "full_scale_nm", property(lambda _: 12.0))
    made = Table(Path("log.csv"), "text", {"q": np.arange(9.0), name: np.arange(9.0)})
    units = readings.Candidates([made], Channels(None, ("q",), (name,)), TURNING, 1.0, Stated(torque_unit=unit))
    reasons: list[str] = []
    doubts: list[str] = []
    assert units.torque(reasons, doubts) == (entry, True)
    assert reasons == ([reason] if reason else [])
    assert doubts == []


def test_a_rated_torque_that_nobody_knows_is_asked_for() -> None:
    with pytest.raises(DataError, match=r"torques are percent; the rated torque is unknown: give --torque-unit 'perc"):
        propose(swings(lambda x, v, a: a, lambda x, v, a: a), TURNING, Stated(torque_unit=("percent", None)))


def test_an_axis_turns_as_far_as_it_likes_and_its_increments_are_said() -> None:
    """Positions far past half a turn are radians as recorded: an axis may turn many times."""
    geared = Axes.model_validate({"name": "table", "kind": "axes", "axis": [{"unit": "rad", "gear_ratio": 10.0}]})
    made = Table(Path("log.csv"), "text", {"q": np.linspace(0.0, 5000.0, 5001)})
    channels = Channels(None, ("q",))
    both = [{"unit": "rad"}, {"unit": "rad", "side": "motor"}]
    reasons: list[str] = []
    assert (
        readings.Candidates([made], channels, geared, 1.0, Stated(position_unit="rad")).positions(reasons, []) == both
    )
    assert reasons == ["positions are rad: given by the user"]
    for stated in (Stated(counts_per_rev=500.0), Stated(position_unit="counts", counts_per_rev=500.0)):
        first, *_ = readings.Candidates([made], channels, geared, 1.0, stated).positions([], [])
        assert first == {"unit": "counts", "counts_per_rev": 500.0}
    wound = Table(made.path, made.kind, {"q": np.linspace(0.0, 5000.5, 5002)})
    units = readings.Candidates([wound], channels, geared, 1.0, Stated()).positions([], [])
    assert units == [*both, *({"unit": unit} | side for unit in ("deg", "turns") for side in ({}, {"side": "motor"}))]


def test_stamps_of_a_channel_of_its_own_are_told_but_of_a_twincat_export(geared: Robot) -> None:
    made = delta_table()
    columns = {**made.columns, "clock": made.columns["t"], "other": made.columns["t"]}
    for kind, clocks, told in (
        ("text", {"q1": "clock", "tau1": "clock", "q2": "other"}, [None, "other", None]),
        ("TwinCAT Scope", {"q1": "clock", "tau1": "clock", "q2": "other"}, [None, None, None]),
    ):
        table = Table(made.path, kind, columns, time_of=clocks)
        entries = [proposal._entry(table, JOINTS, name, {"unit": "rad"}, 1) for name in ("q1", "q2", "tau1")]
        assert [entry.get("time") for entry in entries] == told
        assert all(entry["unit"] == "rad" and "sign" not in entry for entry in entries)
    assert proposal._entry(made, JOINTS, "q1", {}, -1) == {"name": "q1", "sign": -1}


@pytest.mark.parametrize(
    ("kind", "clock", "name"),
    [
        ("TwinCAT Scope export", "Name (4) (2)", "Name (4)"), ("TwinCAT Scope export", "Name", "Name"),
        ("table with a header", "Name (2)", "Name (2)"),
    ],
)  # fmt: skip
def test_stamps_of_a_twincat_export_are_known_by_the_name_that_all_its_channels_give_them(
    kind: str, clock: str, name: str
) -> None:
    """Which is the file's; the number that tells them apart is the reader's."""
    made = delta_table()
    columns = {**made.columns, clock: made.columns["t"]}
    table = Table(made.path, kind, columns, units={clock: "s"}, time_of={"q1": clock})
    found, rate = proposal._time(table, Channels("t", JOINTS.position, JOINTS.torque), Stated(), [], [])
    assert found["name"] == name
    assert rate == pytest.approx(1e3)


@pytest.mark.parametrize(
    ("unit", "step", "sure", "line"),
    [
        ("s", 1e-3, True, "stamps in 't' are s: 1000 Hz"),
        ("datetime", 1e-3, True, "stamps in 't' are datetime: 1000 Hz"),
        ("", 1e-3, False, "stamps in 't' are s: 1000 Hz, judged by the rate alone"),
        ("", 4.0, False, "stamps in 't' are ms: 250 Hz, judged by the rate alone"),
    ],
)
def test_it_is_said_in_what_stamps_are_and_doubted_where_only_their_rate_tells(
    unit: str, step: float, sure: bool, line: str
) -> None:
    made = delta_table()
    table = Table(made.path, "text", {**made.columns, "t": np.arange(ROWS) * step}, units={"t": unit})
    reasons: list[str] = []
    doubts: list[str] = []
    proposal._time(table, JOINTS, Stated(), reasons, doubts)
    assert (reasons, doubts) == (([line], []) if sure else ([], [line]))
    assert proposal._time(table, Channels(), Stated(rate_hz=500.0), reasons, doubts) == ({"rate_hz": 500.0}, 500.0)
    assert len(reasons + doubts) == 1


def test_an_arm_whose_masses_no_library_knows_is_read_as_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(robot: Any, runs: Any) -> None:
        raise RobotError("Pinocchio is not installed")

    monkeypatch.setattr(readings, "machine_sums", missing)
    found = propose(swings(lambda x, v, a: -5.0 * a, lambda x, v, a: 5.0 * a), TURNING, Stated())
    assert not any("sign" in entry for entry in found.columns["torque"])
    assert "units and signs were not checked: Pinocchio is not installed" in found.doubts
