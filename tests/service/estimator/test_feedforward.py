"""The feed-forward torque, rule by rule: for which motion, how far and how fast it may go, how it fades."""

import numpy as np
import pytest

from schemas.messages import FEEDFORWARD, FeedforwardSource, SampleFlag
from service.estimator import departure, feedforward, state, stream
from service.estimator import wanted as rules
from service.model.dynamics import torque_terms
from service.model.nominal import pack
from tests.known import PERIOD

S, F = FeedforwardSource, SampleFlag
HERE = np.array([0.3, 0.5, -0.2])
NUMBER = 2**64 - 3  # of the sample: the sequence runs over


@pytest.fixture
def step(robot):
    """One STEP record behind 50 good samples, commanded and measured."""
    record = state.fresh(state.settings(robot, PERIOD, 2))
    now = record["state"][0]
    now["started"], now["reference_valid"], now["reference_sequence"] = 1, 1, (NUMBER + 4) % 2**64
    for offset, track in enumerate(("measured", "commanded")):
        now[track]["state"] = HERE[:, None] + offset + 10.0 * np.arange(4)
        now[track]["seen"], now[track]["used"], now[track]["idle"] = HERE, 50, 0
    now["reference"] = HERE + 100.0 * np.arange(3)[:, None]
    record["sample"]["sequence"] = NUMBER
    return record


def chosen(step):
    answer = FEEDFORWARD.empty(1)[0]
    source, flags = rules.choose_kernel(step["settings"][0], step["state"][0], step["sample"][0], answer)
    return S(source), F(flags), int(answer["target_sequence"]), step["state"]["trajectory"][0]


def test_a_plan_that_lies_ahead_goes_before_the_command_and_the_command_before_the_estimate(step):
    source, flags, target, motion = chosen(step)
    assert (source, flags, target) == (S.REFERENCE, F(0), (NUMBER + 4) % 2**64)
    np.testing.assert_array_equal(motion, step["state"]["reference"][0])
    step["state"]["reference_valid"] = 0
    for number, (track, expected) in enumerate((("commanded", S.COMMAND), ("measured", S.ESTIMATE), (None, S.NONE))):
        source, flags, target, motion = chosen(step)
        assert (source, flags, target) == (expected, F(0), NUMBER)
        if track is not None:
            np.testing.assert_array_equal(motion, step["state"][track]["state"][0].T[:3])
            step["state"][track]["idle"] = 21 if number else 0
            step["state"][track]["used"] = 20


@pytest.mark.parametrize("track", ["commanded", "measured"])
def test_a_motion_is_followed_once_it_has_settled_and_while_it_may_be_coasted_over(step, track):
    step["state"]["reference_valid"] = 0
    other = {"commanded": "measured", "measured": "commanded"}[track]
    step["state"][other]["used"] = 0
    expected = S.COMMAND if track == "commanded" else S.ESTIMATE
    for used, idle, follows in ((21, 20, True), (20, 0, False), (21, 21, False)):
        step["state"][track]["used"], step["state"][track]["idle"] = used, idle
        assert chosen(step)[0] == (expected if follows else S.NONE)


@pytest.mark.parametrize(("ahead", "taken"), [(0, False), (1, True), (16, True), (17, False), (-1, False)])
def test_a_plan_is_for_the_next_eight_cycles(step, ahead, taken):
    """Of two sequence numbers each."""
    step["state"]["reference_sequence"] = np.uint64((NUMBER + ahead) % 2**64)
    source, flags, *_ = chosen(step)
    assert (source == S.REFERENCE, flags) == (taken, F(0))
    step["state"]["started"] = 0
    assert chosen(step)[0] != S.REFERENCE


@pytest.mark.parametrize("share", [0.99, 1.01, -1.01])
def test_a_plan_for_another_place_is_none(step, share):
    """4 sequence numbers ahead, 3 cycles coasted over."""
    step["state"]["measured"]["idle"] = 3
    reach = rules.REFERENCE_DISTANCE + step["settings"]["speed"][0] * PERIOD * 7
    step["state"]["reference"][0, 0, 1] = HERE[1] + share * reach
    source, flags, *_ = chosen(step)
    assert (source, flags) == ((S.REFERENCE, F(0)) if abs(share) < 1 else (S.COMMAND, F.COMMAND_JUMP))


def test_what_is_wrong_with_a_plan_is_told_once(step):
    low, high = step["settings"]["range"][0]
    speed, change = step["settings"]["speed"][0], stream.COMMAND_ACCELERATION
    good = {"position": low, "velocity": -speed, "acceleration": change}
    for name, value, flag in (
        ("position", low - 1e-9, F.COMMAND_OUT_OF_RANGE), ("position", high + 1e-9, F.COMMAND_OUT_OF_RANGE),
        ("velocity", 1.001 * speed, F.COMMAND_JUMP), ("acceleration", -1.001 * change, F.COMMAND_JUMP),
        ("acceleration", np.nan, F.COMMAND_JUMP), ("position", high, F(0)),
    ):  # fmt: skip
        step["reference"]["sequence"] = 77
        for key, fine in good.items():
            step["reference"][key] = [0.1, 0.2, fine]
        step["reference"][name][0, 2] = value
        step["state"]["reference_sequence"], step["state"]["reference"] = 5, 9.0
        step["state"]["reference_valid"] = 0
        feedforward.plan_kernel(step)
        assert step["state"]["reference_faults"][0] == flag
        taken = [step["reference"][key][0] for key in good] if flag == 0 else 9.0
        np.testing.assert_array_equal(step["state"]["reference"][0], np.broadcast_to(taken, (3, 3)))
        assert (step["state"]["reference_valid"][0], step["state"]["reference_sequence"][0]) == (
            (1, 77) if flag == 0 else (0, 5)
        )
        assert [chosen(step)[1], chosen(step)[1]] == [flag, F(0)]


def test_the_torque_keeps_to_its_peak_and_slope_but_for_a_reversal(step):
    now, settings, answer = step["state"][0], step["settings"][0], FEEDFORWARD.empty(1)[0]
    settings["peak"], settings["slope"], settings["coulomb"], settings["scale"] = 50.0, 1e3, 4.0, [1.0, 2.0, 1.0]
    now["payload"]["departure"]["sure"][departure.OWN] = 1.0
    now["direction"], now["direction_before"] = [1.0, -1.0, 0.5], [1.0, 1.0, 0.5]
    now["faded"], now["held"] = 0.3, 7
    for before, wanted, expected in (
        ([10.0, 10.0, 10.0], [11.9, 29.9, 8.1], None),
        ([10.0, 10.0, 10.0], [12.1, 31.0, 7.0], [12.0, 30.0, 8.0]),  # joint 2: 2 x (4 + 1) N m either way
        ([49.0, -49.0, 0.0], [60.0, -60.0, 0.0], [50.0, -50.0, 0.0]),
    ):
        now["torque"], now["wanted"], now["direction_before"] = before, wanted, [1.0, 1.0, 0.5]
        feedforward._note_reversals(settings, now)
        flags = rules.bound_kernel(settings, now, 0.002, answer)
        np.testing.assert_allclose(answer["torque"], wanted if expected is None else expected)
        assert flags == (0 if expected is None else F.LIMITED)
        np.testing.assert_array_equal(now["direction_before"], now["direction"])
        assert (now["faded"], now["held"]) == (0.0, 0)


def test_a_torque_fades_in_a_straight_line_and_stays_away(step):
    now, settings, answer = step["state"][0], step["settings"][0], FEEDFORWARD.empty(1)[0]
    settings["fade"], now["torque"], now["direction_before"] = 0.05, [8.0, 0.0, -4.0], 1.0
    for number in range(1, 60):
        flags = rules.fade_kernel(settings, now, PERIOD, answer)
        now["torque"] = answer["torque"]
        left = max(0.0, 1 - number / 50)
        np.testing.assert_allclose(answer["torque"], np.array([8.0, 0.0, -4.0]) * left, atol=1e-12)
        assert flags == (F.FADING if np.abs(answer["torque"]).max() > 0 else 0)
        assert not now["direction_before"].any()


def test_a_stray_sample_gets_the_answer_of_before_until_nothing_else_comes(step):
    now, settings, answer = step["state"][0], step["settings"][0], FEEDFORWARD.empty(1)[0]
    now["torque"], now["source"], settings["fade"] = [8.0, 0.0, -4.0], S.COMMAND, 0.05
    for number in range(1, 30):
        flags = feedforward.hold_kernel(settings, now, step["sample"][0], answer)
        held = number <= 20
        assert (answer["source"], flags) == ((S.COMMAND, 0) if held else (S.NONE, F.FADING))
        left = 1.0 if held else 1 - (number - 20) / 50
        np.testing.assert_allclose(answer["torque"], np.array([8.0, 0.0, -4.0]) * left)
        np.testing.assert_array_equal(now["torque"], answer["torque"])
        assert answer["target_sequence"] == NUMBER


def test_learnt_friction_is_reported_as_the_drives_report_torque(step):
    """Dry and viscous parts through the torque constant, an offset as it is."""
    now, settings = step["state"][0], step["settings"][0]
    sure = np.arange(1.0, 13.0).reshape(3, departure.OWN)
    settings["scale"], now["direction"], now["trajectory"][1] = [1.0, 1.1, 0.9], [1.0, -1.0, 0.5], [3.0, -2.0, 0.4]
    now["balls"] = [2.0, -1.0, 4.0]
    now["payload"]["departure"]["sure"] = np.append(sure, 0.3)
    for i in range(3):
        rubbed = sure[i, 0] * now["direction"][i] + sure[i, 1] * now["trajectory"][1, i] + 0.3 * now["balls"][i]
        expected = settings["scale"][i] * rubbed
        assert feedforward._learnt_friction(settings, now, i) == pytest.approx(expected + sure[i, 2])
    now["push"] = [2.0, 3.0, 4.0]
    assert [feedforward.load_kernel(settings, now, i) for i in range(3)] == pytest.approx([2.0, 3.3, 3.6])


def test_friction_turns_as_sharply_as_identified_where_the_motion_is_commanded(step, robot):
    """Where it is measured, not sharper than the noise of its speed at rest."""
    sharp = robot.identified.model_copy(update={"friction_transition_radps": 0.002})
    record = state.fresh(state.settings(robot.model_copy(update={"identified": sharp}), PERIOD, 2))
    settings, now = record["settings"][0], record["state"][0]
    assert settings["wanted_transition"] == 0.002
    for source, speed, share in ((S.COMMAND, 0.006, np.tanh(3.0)), (S.ESTIMATE, 0.006, 0.6), (S.COMMAND, 0.0, 0.0)):
        torque = []
        for direction in (1.0, -1.0):
            for track in ("measured", "commanded"):
                now[track]["state"][:, 0], now[track]["state"][:, 1:] = HERE, [direction * speed, 0.0, 0.0]
                now[track]["seen"], now[track]["used"] = HERE, 50 * (track == "measured" or source == S.COMMAND)
            answer = FEEDFORWARD.empty(1)[0]
            feedforward.feedforward_kernel(settings, now, record["sample"][0], 1000, answer)
            assert answer["source"] == source
            torque.append(np.array(answer["torque"]))
        dry = 0.5 * (torque[0] - torque[1]) - settings["viscous"] * speed
        np.testing.assert_allclose(dry, share * settings["coulomb"], atol=1e-3)


def test_what_is_wanted_is_the_models_torque_a_payload_and_learnt_friction(step, robot):
    now, settings, found = step["state"][0], step["settings"][0], robot.identified
    settings["scale"], now["trajectory"] = [1.0, 1.1, 0.9], [[0.3, 0.4, 0.5], [2.0, -1.0, 3.0], [10.0, 20.0, -30.0]]
    sure = np.arange(13.0)
    sure[[3, 7, 11]] = scale = [0.05, -0.03, 0.0]
    now["payload"]["usable"], now["payload"]["departure"]["sure"] = 1.5, sure
    assert feedforward._for_motion(settings, now, step["sample"][0], 1, False, 0.0)
    inertia, gravity, platform, forearm, load = torque_terms(pack(robot), *now["trajectory"])
    rigid = found.rho_1.value * inertia + found.rho_2.value * gravity + platform
    rigid += found.forearm_inertia_kg.value * forearm
    way = np.sign(now["trajectory"][1])
    rubs = found.viscous_friction_nms.value * now["trajectory"][1] + found.coulomb_friction_nm.value * way
    np.testing.assert_allclose(now["full"], settings["scale"] * (rigid + rubs), rtol=1e-9)
    learnt = [feedforward._learnt_friction(settings, now, i) for i in range(3)]
    moved = (1 + np.array(scale)) * (now["full"] + 1.5 * settings["scale"] * load)
    np.testing.assert_allclose(now["wanted"], moved + learnt, rtol=1e-9)
    now["payload"]["usable"] = np.inf
    assert not feedforward._for_motion(settings, now, step["sample"][0], 1, False, 0.0), "no torque that is none"
    now["trajectory"][0] = 3.0
    assert not feedforward._for_motion(settings, now, step["sample"][0], 1, False, 0.0), "no pose"
