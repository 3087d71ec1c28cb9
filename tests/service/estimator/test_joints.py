"""The estimator of joints: an arm's torque and load against MuJoCo, axes against their formula; what it never does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from schemas.axes_description import Axes, load_description
from schemas.chain_description import Chain
from schemas.errors import DataError, RobotError
from schemas.messages import (
    JOINT_REFERENCE,
    JOINT_SAMPLE,
    NANOSECONDS,
    FeedforwardSource,
    Gripper,
    HealthFlag,
    PayloadEvent,
    SampleFlag,
    set_stamp,
)
from service.estimator.joints import joints_state
from service.estimator.joints.joints_estimator import JointEstimator
from service.estimator.online import estimator_of, left_out
from service.model.description import torque_along
from tests.hostile import hostile, not_finite, reference
from tests.service.arms import FOUR, SIX, Kind, Load
from tests.service.sines import sines

PERIOD, ENCODER = 1e-3, 1e-5
LOAD = Load(1.4, (0.02, -0.03, 0.08), (2e-3, 2.6e-3, 1.6e-3))
AXES = """name = "bench"
kind = "axes"
[limits]
torque = [20.0, 60.0]
speed = [6.0, 3.0]
[[axis]]
[[axis]]
unit = "m"
[identified]
inertia = { value = [0.4, 2.5] }
offset = { value = [0.2, -1.0] }
gravity_sin = { value = [3.0, 0.0] }
gravity_cos = { value = [0.5, 0.0] }
viscous_friction = { value = [0.8, 5.0] }
coulomb_friction = { value = [1.5, 2.0] }
friction_transition = 0.01
"""


def known(kind: Kind, folder: Path, more: str = "") -> Path:
    """A description with the truth, masses of the URDF as they are and standard errors of 1 %."""
    (folder / "arm.urdf").write_text(kind.urdf())
    size = 40 * np.array(kind.noise)

    def table(name: str, share: float) -> str:
        return f"{name} = {{ value = {(share * size).tolist()}, std_error = {(0.01 * share * size).tolist()} }}\n"

    rigid = "".join(
        f"{name}_{joint + 1} = {{ value = {share * size[joint]}, std_error = {0.01 * share * size[joint]} }}\n"
        for name, share in (("rotor", 0.02), ("offset", 0.05))
        for joint in range(kind.count)
    )
    friction = table("viscous_friction", 0.2) + table("coulomb_friction", 0.25) + "friction_transition = 0.001\n"
    text = f'{kind.description()}masses = "known"\n{more}[identified]\n{friction}[identified.rigid]\n{rigid}'
    (folder / "arm.toml").write_text(text)
    return folder / "arm.toml"


def records(position: np.ndarray, torque: np.ndarray, command: np.ndarray | None = None) -> np.ndarray:
    """JOINT_SAMPLE records at 1 kHz."""
    count, joints = position.shape
    result = JOINT_SAMPLE.empty(count)
    set_stamp(result, np.rint(np.arange(count) * PERIOD * NANOSECONDS).astype(np.int64))
    result["sequence"], result["joints"] = np.arange(count), joints
    result["position"][:, :joints], result["torque"][:, :joints] = position, torque
    result["torque_command"] = np.nan
    result["position_command"] = np.nan
    if command is not None:
        result["position_command"][:, :joints] = command
    return result


def moving(kind: Kind, seconds: float, load: Load | None = None, seed: int = 3, commands: bool = True) -> np.ndarray:
    """The arm's own motion, with noise of encoders and torque."""
    signals = kind.motion(seed, np.arange(round(seconds / PERIOD)) * PERIOD)
    draw = np.random.default_rng(seed)
    torque = kind.needed(signals, load) + draw.normal(0, 1, signals[0].shape) * kind.noise
    read = signals[0] + draw.normal(0, ENCODER, signals[0].shape)
    return records(read, torque, signals[0] if commands else None)


@pytest.fixture(scope="module")
def four(tmp_path_factory: pytest.TempPathFactory):
    return described(known(FOUR, tmp_path_factory.mktemp("four")))


def described(path: Path) -> Axes | Chain:
    """The description of an arm or axes."""
    found = load_description(path)
    assert isinstance(found, Axes | Chain)
    return found


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.nanmean(values**2, axis=0))


@pytest.mark.parametrize("commands", [True, False])
def test_the_torque_of_an_arm_is_what_mujoco_says_that_it_needs(four, commands) -> None:
    samples = moving(FOUR, 3.0, commands=commands)
    signals = FOUR.motion(3, np.arange(3000) * PERIOD)
    answers = JointEstimator(four, PERIOD).run(samples).feedforward[500:]
    source = FeedforwardSource.COMMAND if commands else FeedforwardSource.ESTIMATE
    assert (answers["source"] == source).all()
    needed = FOUR.needed(signals)[500:]
    turns = np.abs(signals[1][500:]) < 0.05  # friction changes sign there
    off = np.where(turns, np.nan, answers["torque"][:, : FOUR.count] - needed)
    assert (rms(off) < (0.02 if commands else 0.25) * rms(needed)).all()


def test_a_plan_ahead_is_answered_exactly(four) -> None:
    samples = moving(FOUR, 0.5)
    signals = FOUR.motion(3, np.arange(500) * PERIOD)
    estimator, plan = JointEstimator(four, PERIOD), JOINT_REFERENCE.empty()[0]
    needed = FOUR.needed(signals)
    for n in range(499):
        plan["sequence"] = n + 1
        for name, signal in zip(("position", "velocity", "acceleration"), signals, strict=True):
            plan[name][: FOUR.count] = signal[n + 1]
        estimator.plan(plan)
        estimator.step(samples[n].tobytes())
        if n > 50 and (np.abs(signals[1][n + 1]) > 0.05).all():
            answer = estimator.feedforward[0]
            assert (answer["source"], answer["target_sequence"]) == (FeedforwardSource.REFERENCE, n + 1)
            np.testing.assert_allclose(answer["torque"][: FOUR.count], needed[n + 1], rtol=1e-4, atol=1e-3)


def test_a_load_is_found_with_its_errors_said_apart_and_fed_forward(four) -> None:
    samples = moving(FOUR, 9.0, LOAD)
    estimator = JointEstimator(four, PERIOD)
    out = estimator.run(samples)
    first, last = out.payload[0], out.payload[-1]
    assert (first["trusted"], first["motion"]) == (0, 0.0)
    assert np.isnan(first["mass"])
    assert (last["trusted"], last["centre_trusted"], last["inertia_trusted"]) == (1, 1, 1)
    xx, yy, zz = LOAD.inertia
    for name, truth in (("mass", LOAD.mass), ("centre", LOAD.centre), ("inertia", np.array([xx, 0, yy, 0, 0, zz]))):
        error = np.hypot(last[f"{name}_random"], last[f"{name}_common"])
        assert (np.abs(last[name] - truth) < 3.5 * error).all(), name
        assert (last[f"{name}_random"] > 0).all()
    assert abs(last["mass"] - LOAD.mass) < 0.02 * LOAD.mass
    assert np.abs(last["centre"] - LOAD.centre).max() < 0.01
    full = rms(out.error["full"][-2000:, : FOUR.count])
    assert (full < 0.5 * rms(out.error["friction"][-2000:, : FOUR.count]))[1:].all()
    assert not out.payload["event"].any()


def test_the_same_samples_give_the_same_bits_in_any_batches(four) -> None:
    samples = moving(FOUR, 4.0, LOAD)
    whole, estimator = JointEstimator(four, PERIOD).run(samples), JointEstimator(four, PERIOD)
    parts = [estimator.run(part) for part in np.array_split(samples, 37)]
    for name in ("feedforward", "payload", "error"):
        assert np.concatenate([getattr(part, name) for part in parts]).tobytes() == getattr(whole, name).tobytes()


def test_a_release_and_a_pick_are_seen_and_a_collision_is_not(four) -> None:
    samples, empty = moving(FOUR, 16.0, LOAD), moving(FOUR, 16.0)
    samples["torque"][7300:12300] = empty["torque"][7300:12300]
    samples["torque"][5000:5100, 1] += 60.0  # for 0.1 s
    out = JointEstimator(four, PERIOD).run(samples).payload
    rows = np.flatnonzero(out["event"])
    assert [PayloadEvent(int(out["event"][row])) for row in rows] == [PayloadEvent.RELEASE, PayloadEvent.PICK]
    assert (np.abs(out["sequence"][rows].astype(int) - (7300, 12300)) < 1800).all()
    before = out[out["sequence"] == 7200][0]
    assert abs(before["mass"] - LOAD.mass) < 0.05
    assert before["trusted"]


def test_a_gripper_that_says_so_ends_what_was_known_at_once(four) -> None:
    samples = moving(FOUR, 4.0, LOAD)
    samples["gripper"][:3500], samples["gripper"][3500:] = Gripper.CLOSED, Gripper.OPEN
    out = JointEstimator(four, PERIOD).run(samples).payload
    (row,) = np.flatnonzero(out["event"])
    assert (out["sequence"][row], out["event"][row]) == (3500, PayloadEvent.RELEASE)
    assert (out["trusted"][row - 1], out["trusted"][row]) == (1, 0)


def test_a_long_hole_ends_what_was_known_and_a_short_one_does_not(four) -> None:
    """Nobody saw what became of the load."""
    samples = moving(FOUR, 5.0, LOAD)
    for missing, kept in ((300, 1), (700, 0)):
        out = JointEstimator(four, PERIOD).run(np.delete(samples, np.arange(4000, 4000 + missing))).payload
        after = np.searchsorted(out["sequence"], 4000 + missing + 60)
        assert (out["trusted"][after - 200], out["trusted"][after]) == (1, kept), missing
        assert not out["event"].any()


@pytest.mark.parametrize("still", [True, False], ids=["at rest", "turning about the weight"])
def test_motion_that_does_not_tell_says_not_yet(four, still) -> None:
    """At rest friction is anything; the first axis is upright, and nothing lifts the load."""
    position = np.tile([0.2, 0.4, -0.3, 0.1], (6000, 1))
    signals = [position, np.zeros_like(position), np.zeros_like(position)]
    if not still:
        time = np.arange(6000) * PERIOD
        for order, wave in enumerate((np.sin(time), np.cos(time), -np.sin(time))):
            signals[order][:, 0] = 0.3 * wave + (0.2 if order == 0 else 0.0)
    torque = FOUR.needed(signals, LOAD) + np.random.default_rng(1).normal(0, 1, position.shape) * FOUR.noise
    out = JointEstimator(four, PERIOD).run(records(signals[0], torque)).payload
    assert not out["trusted"].any()
    assert not out["event"].any()
    assert not out["centre_trusted"].any()


def test_axes_are_answered_by_their_formula(tmp_path: Path) -> None:
    (tmp_path / "axes.toml").write_text(AXES)
    axes = described(tmp_path / "axes.toml")
    time = np.arange(2500) * PERIOD
    q, v, a = (signal[:, :2] * (1.0, 0.3) for signal in sines(1, time, ((0.9, 0.4), (0.3, 1.1))))
    torque = a * (0.4, 2.5) + v * (0.8, 5.0) + np.tanh(v / 0.01) * (1.5, 2.0) + (0.2, -1.0)
    torque[:, 0] += 3.0 * np.sin(q[:, 0]) + 0.5 * np.cos(q[:, 0])
    out = JointEstimator(axes, PERIOD).run(records(q, torque, q))
    fast = np.where(np.abs(v[300:]).min(axis=1) > 0.05, 1.0, np.nan)[:, None]
    assert (rms(fast * (out.feedforward["torque"][300:, :2] - torque[300:])) < 0.02 * rms(torque)).all()
    assert (rms(out.error["full"][500:, :2]) < 0.02 * rms(torque)).all()
    assert len(out.payload) == 0


def test_a_jump_a_hole_and_a_wrong_number_of_joints_are_flagged_and_the_torque_fades(four) -> None:
    samples = moving(FOUR, 2.0, commands=False)
    samples["position"][700, 2] += 0.5
    samples["torque"][800, 0] = np.nan
    samples["position"][900, 1] = 4.0  # beyond the URDF
    samples["joints"][1000] = 3
    samples = np.delete(samples, np.arange(1200, 1205))
    samples["position"][-300:] = np.nan
    out = JointEstimator(four, PERIOD).run(samples).feedforward
    for row, flag in ((700, SampleFlag.JUMP), (800, SampleFlag.NOT_A_NUMBER), (900, SampleFlag.OUT_OF_RANGE),
                      (1000, SampleFlag.NOT_A_NUMBER), (1200, SampleFlag.GAP_BEFORE)):  # fmt: skip
        assert out["flags"][row] & flag, row
    clean = np.setdiff1d(np.arange(len(out) - 300), [0, 700, 800, 900, 1000, 1200])
    assert not (out["flags"][clean] & ~np.uint32(SampleFlag.NO_COMMAND | SampleFlag.LIMITED)).any()
    assert out["flags"][-250] & SampleFlag.FADING
    assert (out["torque"][-200:] == 0.0).all()
    assert (out["source"][-200:] == FeedforwardSource.NONE).all()


def strike(robot, good: np.ndarray, random: np.random.Generator, rounds: int) -> int:
    """Rounds of a hostile stream and a good one; how many samples that were."""
    peak = np.array(JointEstimator(robot, PERIOD)._steps["settings"]["full"][0])
    slope = 100.0 * peak * PERIOD
    estimator, count, last = JointEstimator(robot, PERIOD), 0, np.zeros((1, len(peak)))
    peak[robot.count :] = slope[robot.count :] = 0.0
    expected = JointEstimator(robot, PERIOD).run(good).feedforward["torque"]
    for _ in range(rounds):
        bad = hostile(random, good, int(random.integers(50, 1000)))
        for samples in np.split(bad, [len(bad) // 2]):
            out = estimator.run(samples)
            torque = out.feedforward["torque"]
            assert np.isfinite(torque).all()
            assert (np.abs(torque) <= peak).all()
            jump = np.abs(np.diff(np.concatenate([last, torque]), axis=0))
            unbroken = out.feedforward["flags"] & SampleFlag.GAP_BEFORE == 0
            assert (jump[unbroken] <= slope * 1.001).all()
            last = torque[-1:]
            estimator.plan(reference(random, int(samples["sequence"][-1]), JOINT_REFERENCE))
            assert [name for name in not_finite(estimator._steps["state"][0]) if "reported" not in name] == []
        begin = int(random.integers(0, len(good) - 400))
        well = good[begin : begin + 400].copy()
        well["sequence"] += random.integers(2**64, dtype=np.uint64)
        well["stamp_sec"] += random.integers(0, 2**20, dtype=np.int32)
        out = estimator.run(well)
        last = out.feedforward["torque"][-1:]
        off = np.abs(out.feedforward["torque"] - expected[begin : begin + 400])
        assert off[50:].max() < 0.1 * np.abs(expected).max(), "recovered in 50 ms"
        count += len(bad) + len(well)
    return count


def test_hostile_streams_leave_the_torque_bounded_and_the_state_whole(four) -> None:
    """Also a bench of a million: tests/bench/bench_hostile_step.py."""
    strike(four, moving(FOUR, 2.0), np.random.default_rng(7), rounds=25)


def test_the_largest_torque_and_its_slope_are_those_of_the_description(tmp_path: Path) -> None:
    four = described(known(FOUR, tmp_path, "limits = { torque = [30.0, 25.0, 20.0, 1.0] }\n"))
    out = JointEstimator(four, PERIOD).run(moving(FOUR, 3.0)).feedforward
    torque = out["torque"][:, : FOUR.count]
    assert (np.abs(torque).max(axis=0) <= (30.0, 25.0, 20.0, 1.0)).all()
    assert np.abs(torque[:, 1]).max() == 25.0
    assert out["flags"][np.abs(torque[:, 1]) == 25.0].all()
    turns = 2 * 0.25 * 40 * np.array(FOUR.noise)  # a reversal of Coulomb friction is a step by nature
    most = np.maximum(np.array((30.0, 25.0, 20.0, 1.0)) * 0.1, turns)
    assert (np.abs(np.diff(torque, axis=0)) <= most * 1.001).all()


def test_effects_of_a_joints_own_motion_are_carried_as_in_the_offline_prediction(tmp_path: Path) -> None:
    path = known(FOUR, tmp_path)
    described_effects = "".join(
        f'[[effect]]\nname = "{name}"\njoints = [{joint}]\n[effect.parameters]\n{parameters}'
        for name, joint, parameters in (
            ("stribeck_friction", 2, "f_s = { value = 9.0 }\nv_s = { value = 0.2 }\n"),
            ("joint_spring", 3, "k = { value = 12.0 }\npreload = { value = 3.0 }\n"),
        )
    )
    path.write_text(path.read_text() + described_effects)
    four = described(path)
    assert left_out(four, PERIOD) == {}
    assert estimator_of(four, PERIOD).findings() == HealthFlag(0)
    time = np.arange(2000) * PERIOD
    signals = FOUR.motion(3, time)
    wanted = torque_along(four, time, *signals)[300:]
    without = FOUR.needed(signals)[300:]
    answer = JointEstimator(four, PERIOD).run(moving(FOUR, 2.0)).feedforward["torque"][300:, : FOUR.count]
    turns = np.where(np.abs(signals[1][300:]) < 0.05, np.nan, 1.0)
    off, added = rms(turns * (answer - wanted)), rms(turns * (wanted - without))
    assert (off[1:3] < 0.1 * added[1:3]).all()


def test_effects_that_are_left_out_are_named_and_in_health(tmp_path: Path) -> None:
    names = {"half": 0.001, "contact_hz": 80.0, "contact_damping": 0.5, "motor_share": 0.5}
    effect = '[[effect]]\nname = "backlash"\njoints = [1]\n[effect.parameters]\n'
    effect += "".join(f"{name} = {{ value = {value} }}\n" for name, value in names.items())
    path = known(FOUR, tmp_path)
    path.write_text(path.read_text() + effect)
    four = described(path)
    assert list(left_out(four, PERIOD)) == ["backlash"]
    assert estimator_of(four, PERIOD).findings() == HealthFlag.EFFECT_LEFT_OUT


def test_what_is_missing_for_going_online_is_named(tmp_path: Path) -> None:
    (tmp_path / "axes.toml").write_text(AXES.replace("speed = [6.0, 3.0]\n", ""))
    with pytest.raises(RobotError, match=r"axes\.toml: limits\.speed: none for joint 1: .* \[limits\] speed = "):
        joints_state.check(described(tmp_path / "axes.toml"))
    (tmp_path / "arm.urdf").write_text(SIX.urdf().replace('effort="300"', 'effort="0"', 1))
    (tmp_path / "arm.toml").write_text(SIX.description())
    with pytest.raises(DataError, match=r"arm\.toml: no \[identified\] parameters"):
        joints_state.check(described(tmp_path / "arm.toml"))
    (tmp_path / "axes.toml").write_text(AXES.replace("[20.0, 60.0]", "[20.0]"))
    with pytest.raises(RobotError, match=r"limits\.torque: 1 values for 2 joints"):
        described(tmp_path / "axes.toml")
