"""A sample in its stream, rule by rule, each just inside and just outside of it."""

import numpy as np
import pytest

from schemas.messages import SAMPLE, SampleFlag, set_stamp
from service.estimator import state, stream
from tests.known import PERIOD

SEEN = np.array([0.3, 0.5, -0.2])
FIRST = 2**64 - 2  # of the sequence, which runs over


@pytest.fixture
def begun(robot):
    """Settings, state behind 50 samples that stood still, and the sample after it."""
    return after(robot)


def after(robot, stride=1, period=PERIOD):
    step = state.fresh(state.settings(robot, period, stride))[0]
    now = step["state"]
    now["started"], now["sequence"], now["stamp_sec"], now["stamp_nanosec"] = 1, FIRST, 7, 999_000_000
    for track in ("measured", "commanded"):
        now[track]["state"][:, 0], now[track]["seen"], now[track]["used"], now[track]["idle"] = SEEN, SEEN, 50, 0
    sample = SAMPLE.empty(1)
    sample["sequence"], sample["position"], sample["position_command"], sample["torque"] = FIRST + 1, SEEN, SEEN, 1.0
    return step["settings"], now, sample


def at(sample, cycles, seconds):
    """The sample `cycles` and `seconds` after the newest."""
    sample["sequence"] = np.uint64((FIRST + cycles) % 2**64)
    set_stamp(sample, np.array([7_999_000_000 + round(seconds * 1e9)]))
    return sample[0]


@pytest.mark.parametrize(
    ("stride", "cycles", "seconds", "expected"),
    [
        (1, 3, 0.003, 3),
        (1, 0, 0.001, 0),
        (1, -5, 0.001, -5),
        (1, 3, 0.0, 3),  # a stamp that lags is jitter
        (1, 1, 0.0014, 1),
        (1, 1, 0.052, 52),  # no filter closes that
        (1, 2**40, 0.001, stream.FAR),
        (4, 4, 0.001, 1),
        (4, 1, 0.001, 1),
        (4, 6, 0.001, 2),
        (4, 5, 0.001, 1),
    ],
)
def test_cycles_are_counted_by_sequence_and_by_time_where_that_hides_a_hole(robot, stride, cycles, seconds, expected):
    settings, now, sample = after(robot, stride)
    assert stream.cycles_since(settings, now, at(sample, cycles, seconds)) == expected
    now["started"] = 0
    assert stream.cycles_since(settings, now, at(sample, cycles, seconds)) == 1


@pytest.mark.parametrize("seconds", [0.003, 0.021])
@pytest.mark.parametrize("moved", [True, False])
def test_a_hole_that_only_the_stamps_have_is_one_where_the_motion_bears_it_out(begun, seconds, moved):
    settings, now, sample = begun
    speed, change = np.array([2.0, 0.0, -1.0]), np.array([0.0, 300.0, 0.0])
    now["measured"]["state"][:, 1], now["measured"]["state"][:, 2] = speed, change
    time = seconds if moved else PERIOD
    sample["position"] = SEEN + speed * time + change * time**2 / 2
    assert stream.cycles_since(settings, now, at(sample, 1, seconds)) == (round(seconds / PERIOD) if moved else 1)


@pytest.mark.parametrize(("period", "coast", "restart"), [(1e-3, 20, 21), (0.03, 1, 2), (0.004, 5, 6)])
def test_how_long_the_filters_coast(robot, period, coast, restart):
    settings, _, _ = after(robot, period=period)
    assert (stream.coast_cycles(settings), stream.restart_cycles(settings)) == (coast, restart)


F = SampleFlag
NAN_, FAR_ = F.NOT_A_NUMBER, F.OUT_OF_RANGE


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("position", np.nan, NAN_), ("position", np.inf, NAN_), ("torque", np.nan, NAN_), ("torque", -np.inf, NAN_),
        ("position", "below", FAR_), ("position", "above", FAR_), ("torque", "broken", FAR_), ("torque", "great", F(0)),
        ("position_command", np.nan, F.NO_COMMAND), ("position_command", "below", F.COMMAND_OUT_OF_RANGE),
        ("position_command", "above", F.COMMAND_OUT_OF_RANGE), ("position_command", np.inf, F.COMMAND_OUT_OF_RANGE),
        ("flags", F.BUS_FAULT, F.BUS_FAULT),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_sample_itself(begun, field, value, expected):
    settings, now, sample = begun
    low, high = settings["range"]
    for track in ("measured", "commanded"):
        now[track]["seen"][1] = now[track]["state"][1, 0] = {"below": low, "above": high}.get(value, SEEN[1])
    sample["position"][0, 1] = sample["position_command"][0, 1] = now["measured"]["seen"][1]
    peak = stream.TORQUE_SENSE * settings["peak"]
    named = {"below": low - 1e-9, "above": high + 1e-9, "broken": -1.001 * peak, "great": -0.999 * peak}
    entry = sample[field] if field == "flags" else sample[field][:, 1]
    entry[...] = named.get(value, value)
    assert stream.faults(settings, now, sample[0], 1) == expected
    now["started"] = 0
    assert stream.faults(settings, now, sample[0], 0) == expected


@pytest.mark.parametrize(("gap", "expected"), [(1, F(0)), (2, F.GAP_BEFORE), (0, F.REPEATED), (-3, F.TIME_BACKWARDS)])
def test_what_is_wrong_with_its_place(begun, gap, expected):
    settings, now, sample = begun
    assert stream.faults(settings, now, sample[0], gap) == expected


@pytest.mark.parametrize("share", [0.99, 1.01, -1.01])
def test_no_joint_is_faster_than_declared(begun, share):
    """2 cycles bridged and 3 more: a position in reach of 5. Of its speed nothing is known."""
    settings, now, sample = begun
    for track in ("measured", "commanded"):
        now[track]["covariance"][1, 1] = 1e6
    reach = settings["speed"] * PERIOD * 5
    now["measured"]["idle"] = now["commanded"]["idle"] = 2
    sample["position"][0, 2] += share * reach
    torn = abs(share) > 1
    assert stream.faults(settings, now, sample[0], 3) == F.GAP_BEFORE | torn * F.JUMP
    sample["position"] = SEEN
    now["commanded"]["used"] = 1
    sample["position_command"][0, 0] += share * reach
    assert stream.faults(settings, now, sample[0], 3) == F.GAP_BEFORE | torn * F.COMMAND_JUMP
    now["commanded"]["used"] = 0
    assert stream.faults(settings, now, sample[0], 3) == F.GAP_BEFORE


@pytest.mark.parametrize("share", [0.99, 1.01, -1.01])
@pytest.mark.parametrize(("gap", "idle", "strays"), [(1, 0, 0), (2, 1, 0), (1, 2, 2)])
def test_no_command_asks_for_more_than_a_joint_can_accelerate(begun, share, gap, idle, strays):
    """Since it was last seen; behind strays since the newest of them."""
    settings, now, sample = begun
    track = now["commanded"]
    track["idle"], track["state"][:, 1], track["state"][:, 2] = idle, [1.0, -2.0, 0.5], [100.0, 0.0, -50.0]
    time = gap * PERIOD
    cycles = gap if strays else gap + idle
    late = settings["motion"]["behind"] + ((cycles * PERIOD) ** 2 - PERIOD**2) / 2
    reach = 2 * settings["acceleration"] * late + stream.EXPECTED * settings["motion"]["resolution"]
    now["command_stray"] = strays
    sample["position_command"] = SEEN + track["state"][:, 1] * time + track["state"][:, 2] * time**2 / 2
    sample["position_command"][0, 1] += share * reach
    hole = F.GAP_BEFORE if gap > 1 else F(0)
    assert stream.faults(settings, now, sample[0], gap) == hole | (abs(share) > 1) * F.COMMAND_JUMP
    track["covariance"][1, 1], now["command_stray"] = 1e6, 0  # nothing is known of its speed yet
    assert stream.faults(settings, now, sample[0], gap) == hole
    track["covariance"][1, 1], track["idle"] = 0.0, stream.restart_cycles(settings)  # longer ago than counts
    assert stream.faults(settings, now, sample[0], gap) == hole


def test_strays_that_continue_each_other_are_a_new_stream(robot):
    settings, now, sample = after(robot, stride=2)
    step = settings["speed"] * PERIOD
    place, number = np.array([1.0, 1.1, 1.2]), 10

    def next_one(cycles, moved):
        nonlocal number
        number += 2 * cycles
        place[1] += moved * step
        sample["sequence"], sample["position"] = number, place
        return stream.is_new_stream(settings, now, sample[0])

    assert [next_one(*way) for way in ((1, 0), (1, 0.99), (stream.STRAY_STEP, 7.9))] == [False, False, True]
    for broken in ((0, 0), (-1, 0), (stream.STRAY_STEP + 1, 0), (1, 1.01), (2, -2.01)):
        assert not next_one(*broken), broken
        assert now["stray"] == 1
        assert [next_one(1, 0), next_one(1, 0)] == [False, True]


def test_commands_that_go_on_from_where_they_jumped_to_are_new_ones(begun):
    settings, now, sample = begun
    step, place = settings["speed"] * PERIOD, np.array([1.0, 1.1, 1.2])

    def next_one(gap, moved):
        place[2] += moved * step
        sample["position_command"] = place
        return stream.is_new_command(settings, now, sample[0], gap)

    assert [next_one(1, 0), next_one(1, 0.99), next_one(3, -2.9)] == [False, False, True]
    assert not next_one(1, 1.01)
    assert now["command_stray"] == 1
    assert [next_one(2, 1.9), next_one(1, 0)] == [False, True]


def test_a_stream_begins_at_rest_where_it_is(begun):
    settings, now, sample = begun
    now["filled"], now["stray"], now["command_stray"], now["measured"]["state"][:] = 9, 2, 2, 5.0
    sample["position"] = SEEN + 1.0
    stream.restart(settings, now, at(sample, 40, 3.5))
    assert (now["stamp_sec"], now["stamp_nanosec"], now["started"]) == (11, 499_000_000, 1)
    assert (now["filled"], now["stray"], now["command_stray"], now["commanded"]["used"]) == (0, 0, 0, 0)
    np.testing.assert_array_equal(now["measured"]["state"][:, 0], SEEN + 1)
    assert not now["measured"]["state"][:, 1:].any()
