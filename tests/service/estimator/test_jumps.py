"""A pose that jumps (the seam of a looped log, an axis homed anew) is no motion: no derivative is taken across it.

At every rate, with and without commands, with plans too. The robot of these tests has no Coulomb friction, whose
reversal is a step by nature: all bounds hold without an exception.
"""

import numpy as np
import pytest

from schemas.messages import REFERENCE, SAMPLE, SampleFlag, set_stamp
from service.estimator import state, stream
from service.estimator.bounds import bounds_of, growth_of
from service.estimator.estimator import Estimator
from service.model.dynamics import torque_terms
from service.model.nominal import pack

RATES = [100, 125, 200, 250, 300, 333, 500, 1000, 4000, 8000]  # Hz
QUICK = (100, 300, 1000)
AT_EVERY_RATE = [pytest.param(rate, marks=() if rate in QUICK else pytest.mark.slow) for rate in RATES]
FLAGGED = SampleFlag.JUMP | SampleFlag.COMMAND_JUMP | SampleFlag.GAP_BEFORE
HERE = np.array([0.3, 0.5, 0.2])
SEAM = np.array([0.091, -0.374, 0.278])  # rad, of the demo log in a loop
SECONDS = 0.5


@pytest.fixture(scope="module")
def smooth(robot):
    dry = robot.identified.coulomb_friction_nm.model_copy(update={"value": [0.0, 0.0, 0.0]})
    return robot.model_copy(update={"identified": robot.identified.model_copy(update={"coulomb_friction_nm": dry})})


def stream_of(robot, position, command, period):
    """Samples of (N, 3) positions and commands, rad; the torque is nobody's business here."""
    samples = SAMPLE.empty(len(position))
    set_stamp(samples, np.rint(np.arange(len(position)) * period * 1e9).astype(np.int64))
    samples["sequence"] = np.arange(len(position))
    resolution = robot.drive.position_resolution_rad
    samples["position"], samples["position_command"] = np.round(position / resolution) * resolution, command
    samples["torque"], samples["torque_command"] = 1.0, np.nan
    return samples


def weight(robot, position):
    """Torque, N m, (N, 3) that holds the empty robot still."""
    still, found = np.zeros_like(position), robot.identified
    _, gravity, platform, forearm, _ = np.moveaxis(torque_terms(pack(robot), position, still, still), 1, 0)
    return found.rho_2.value * gravity + platform + found.forearm_inertia_kg.value * forearm


def answers(robot, samples, period, plans=None):
    """Feed-forward records; plans: (N,) positions, rad, that are planned to stand for the cycle after each sample."""
    estimator = Estimator(robot, period)
    if plans is None:
        return estimator.run(samples).feedforward
    told = []
    for n, sample in enumerate(samples):
        plan = REFERENCE.empty(1)[0]
        plan["sequence"], plan["position"] = sample["sequence"] + 1, plans[min(n + 1, len(plans) - 1)]
        plan["velocity"] = plan["acceleration"] = 0.0
        estimator.plan(plan)
        told.append(estimator.run(samples[n : n + 1]).feedforward)
    return np.concatenate(told)


def within_bounds(robot, out, period):
    """Peak; slope; and a slope that grows by so much a cycle, ends at once and does not turn while it does: the second
    difference."""
    bounds, cycles = bounds_of(robot), np.maximum(1, np.diff(out["sequence"].astype(np.int64)))[:, None]
    torque = out["torque"]
    slope = np.diff(torque, axis=0) / (cycles * period)
    growth = growth_of(robot, period) * cycles[1:]
    assert np.isfinite(torque).all()
    assert np.abs(torque).max() <= bounds.peak_nm
    assert np.abs(slope).max() <= bounds.slope_nmps * (1 + 1e-9)
    slack = 1e-9 * bounds.slope_nmps
    fades = (out["flags"][2:] & SampleFlag.FADING != 0)[:, None]  # in a straight line, whatever was before
    assert (fades | (slope[1:] <= np.maximum(0.0, slope[:-1] + growth) + slack)).all()
    assert (fades | (slope[1:] >= np.minimum(0.0, slope[:-1] - growth) - slack)).all()


def between(robot, out, poses, margin):
    """Standing here or there, fading or coming back: never beyond the weights by more than `margin` of them, N m."""
    held = weight(robot, np.atleast_2d(poses))
    low, high = np.minimum(0.0, held.min(axis=0)), np.maximum(0.0, held.max(axis=0))
    assert (out["torque"] >= low - margin).all()
    assert (out["torque"] <= high + margin).all()


def standing(count, jumps):
    """(N, 3) rad: standing, but for what is added from each row on."""
    position = np.tile(HERE, (count, 1))
    for row, by in jumps:
        position[row:] += by
    return position


# What jumps, and by what: rows from the middle on and rad.
JUMPS = {
    "the seam of a loop": [(0, SEAM)],
    "one axis homed anew": [(0, [0.0, 0.15, 0.0])],
    "one axis far": [(0, [0.0, 0.0, -1.0])],
    "there and back": [(0, SEAM), (1, -SEAM)],
    "several in a row": [(0, SEAM), (1, 0.5 * SEAM), (2, -SEAM), (3, SEAM), (7, -SEAM)],
    "twice while it settles": [(0, SEAM), (4, -0.8 * SEAM)],
}


@pytest.mark.parametrize("moved", ["both", "position", "command", "no commands", "with plans"])
@pytest.mark.parametrize("jump", JUMPS)
@pytest.mark.parametrize("rate", AT_EVERY_RATE)
def test_a_robot_that_stands_gets_its_weight_whatever_its_pose_jumps_by(smooth, rate, jump, moved):
    period = 1 / rate
    count = round(2 * SECONDS * rate)
    middle = count // 2
    after = standing(count, [(middle + row, by) for row, by in JUMPS[jump]])
    still = standing(count, [])
    position = still if moved == "command" else after
    command = {"position": still, "no commands": np.full_like(still, np.nan)}.get(moved, after)
    samples = stream_of(smooth, position, command, period)
    out = answers(smooth, samples, period, after if moved == "with plans" else None)
    within_bounds(smooth, out, period)
    between(smooth, out, np.concatenate([after, still]), 0.5)
    assert out["flags"][middle] & FLAGGED, "a jump is told as one"
    np.testing.assert_allclose(out["torque"][-1], weight(smooth, still if moved == "position" else after)[-1], atol=0.5)


@pytest.mark.parametrize("lost", [1, 3, 8, 20, 25, 30, 40, 45, 50, 60, 100])
@pytest.mark.parametrize("rate", AT_EVERY_RATE)
def test_behind_a_hole_too(smooth, rate, lost):
    """ms that were lost before the jump: the longer, the more a joint could have moved meanwhile."""
    period = 1 / rate
    count = round(2 * SECONDS * rate)
    middle, missing = count // 2, max(1, round(lost * 1e-3 * rate))
    for share in (1.0, 0.3, 0.1, -1.0):
        position = standing(count, [(middle, share * SEAM)])
        samples = np.delete(stream_of(smooth, position, position, period), np.arange(middle - missing, middle))
        out = answers(smooth, samples, period)
        within_bounds(smooth, out, period)
        assert out["flags"][middle - missing] & FLAGGED
        # a hole of a few samples of a slow stream may hide what a small jump would be: a move at 10 g
        hides = period * (missing + 1) <= stream.COAST_TIME + period and rate < 300
        margin = 0.3 * bounds_of(smooth).peak_nm if hides else 1.0
        between(smooth, out, position, margin)


def test_no_draw_of_jumps_gets_out_of_the_bounds(smooth, make):
    """Rates, places, joints, sizes (many just below what is taken as a jump), holes, the first samples, on the move."""
    random = np.random.default_rng(30)
    for _ in range(250):
        rate = int(random.choice(RATES))
        period = 1 / rate
        known = make(0.6, period=period, pace=float(random.uniform(0.5, 3.0)))
        samples = known.samples if random.random() < 0.6 else stream_of(
            smooth, standing(len(known.samples), []), standing(len(known.samples), []), period
        )  # fmt: skip
        settings = state.settings(smooth, period, 1)[0]
        step = state.fresh(settings.reshape(1))[0]
        stream.restart(settings, step["state"], samples[0])
        below = 2 * settings["acceleration"] * settings["motion"]["behind"]
        for _ in range(int(random.integers(1, 5))):
            row = int(random.choice([1, 2, 3, 5, len(samples) // 2, *random.integers(1, len(samples), 3)]))
            size = float(random.choice([0.3, 0.9, 0.99, 1.01, 2.0])) * below if random.random() < 0.6 else 0.4
            by = size * random.uniform(-1.0, 1.0, 3) * (random.random(3) < 0.7)
            for field in random.choice(["position", "position_command", "both"], 1):
                for name in ("position", "position_command") if field == "both" else (field,):
                    samples[name][row:] += by
        if random.random() < 0.4:
            samples["position_command"] = np.nan
        if random.random() < 0.4:
            row = int(random.integers(2, len(samples) - 2))
            samples = np.delete(samples, np.arange(row, min(len(samples) - 1, row + random.integers(1, 30))))
        plans = samples["position"] + random.uniform(-0.2, 0.2, 3) if rate < 500 and random.random() < 0.3 else None
        within_bounds(smooth, answers(smooth, samples, period, plans), period)


@pytest.mark.parametrize("commands", [True, False])
@pytest.mark.parametrize("rate", AT_EVERY_RATE)
@pytest.mark.parametrize("share", [0.1, 0.3, 0.6, 0.95, 1.3])
def test_a_jump_that_may_be_motion_is_stopped_by_the_next_sample(smooth, rate, share, commands):
    """At worst the torque sets out for what such a motion would ask, for the sample or two until it stands."""
    period = 1 / rate
    count = round(2 * SECONDS * rate)
    settings = state.settings(smooth, period, 1)[0]
    by = share * 2 * settings["acceleration"] * settings["motion"]["behind"] * np.array([1.0, -1.0, 0.5])
    position = standing(count, [(count // 2, by)])
    command = position if commands else np.full_like(position, np.nan)
    out = answers(smooth, stream_of(smooth, position, command, period), period)
    within_bounds(smooth, out, period)
    assert np.abs(out["torque"]).max() < 0.6 * bounds_of(smooth).peak_nm, "as a move of the empty robot at 10 g"


@pytest.mark.parametrize("rate", AT_EVERY_RATE)
def test_a_move_at_ten_g_is_neither_a_jump_nor_held(smooth, make, rate):
    """Joints at 300 rad/s^2 and more."""
    period = 1 / rate
    known = make(1.0, period=period, pace=2.3)
    assert np.abs(known.theta_ddot).max() > 300
    for commands in (True, False):
        samples = known.samples.copy()
        if not commands:
            samples["position_command"] = np.nan
        out = Estimator(smooth, period).run(samples).feedforward
        begun = round(0.1 * rate)
        assert (out["flags"][begun:] & ~SampleFlag.NO_COMMAND == 0).all()
        off = np.abs(out["torque"] - known.torque)[begun:]
        assert np.median(off) < 0.05 * np.abs(known.torque).max()
