"""The whole catalogue: each effect against other code that makes it, its slopes against differences."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.simulated.plant.effects import mechanics
from drivers.simulated.plant.mujoco_delta import Design
from service.model.effects.geometry import GeometryError
from service.model.hypothesis import inside_of
from service.model.nominal import lengthened
from tests.service.injected import BY_TWO_MASSES, INJECTED, reports
from tests.service.subject import (
    EFFECTS,
    Delta,
    Hypothesis,
    Parameters,
    Recording,
    Scene,
    Term,
    added,
    on_joint,
    predict,
    reported,
    tangent,
)
from tests.service.world import BASE, PERIOD, ROBOT, TRUTH, course, problem, rigid_torque, scene, segment, stub

SECONDS = 3.0


def test_the_whole_catalogue_is_put_to_the_test():
    assert {*INJECTED, *BY_TWO_MASSES} == set(EFFECTS)


@pytest.mark.parametrize("name", INJECTED)
def test_its_torque_is_that_of_the_independent_effect(name):
    injected, run = INJECTED[name], course(1, SECONDS)
    here, term = scene(run), injected.term(name)
    truth = reports(name, 1, SECONDS) - run.torque
    found = reported(here, Hypothesis(BASE, (term,)), run.torque + (0 if term.effect.measured else added(here, term)))
    found = found - run.torque
    counts = (np.abs(run.motion[1]) > 0.1) & (np.arange(len(truth)) > 300)[:, None]  # no reversal, no start
    truth, found = np.where(counts, truth, 0.0), np.where(counts, found, 0.0)
    size = np.sqrt(np.mean(truth**2))
    assert size > 0.05
    assert np.sqrt(np.mean((found - truth) ** 2)) < injected.close * size
    if term.effect.own_joint and term.joints:
        spared = [joint for joint in range(3) if joint not in injected.joints]
        assert not found[:, spared].any()


def test_the_seat_of_a_ball_joint_gives_before_it_slips():
    """In motion so slow that a forearm turns by less than `SOFT` for a good part of it."""
    injected, run = INJECTED["passive_joint_friction"], course(1, SECONDS, low=0.1, high=0.5)
    truth = injected.measured(run, 0.0) - run.torque
    found = added(scene(run), injected.term("passive_joint_friction"))
    assert np.sqrt(np.mean((found - truth) ** 2)) < injected.close * np.sqrt(np.mean(truth**2))


def test_masses_found_beside_a_tilt_lean_with_it():
    run = course(1, 0.6)
    terms = tuple(INJECTED[name].term(name) for name in ("base_tilt", "tool_mass", "arm_mass"))
    tilt, tool, arm = mechanics.BaseTilt(0.03, -0.04), mechanics.ToolMass(0.3), mechanics.ArmMass([0.0, 0.0, 0.4])
    changed = arm.shape(tool.shape(Design(TRUTH)))
    product = rigid_torque(tilt.shape(changed), run.motion) - rigid_torque(changed, run.motion)
    product -= rigid_torque(tilt.shape(Design(TRUTH)), run.motion) - rigid_torque(Design(TRUTH), run.motion)
    here = scene(run)
    seen = Hypothesis(BASE, terms).seen(here.recording)
    found = sum(added(seen, term) - added(here, term) for term in terms)
    assert np.sqrt(np.mean((found - product) ** 2)) < 0.03 * np.sqrt(np.mean(product**2))  # of small angles


def test_a_base_on_a_wall_tilts_about_its_level_axes():
    run, wall = course(1, 0.6), [-9.81, 0.0, 0.0]
    robot = ROBOT.model_copy(update={"gravity_mps2": wall})
    here = Scene(Recording(segment(run), Delta.of(robot), 0, "wall"), BASE)
    found = EFFECTS["base_tilt"].torque(here, 0, np.array([0.02, -0.03]), ())
    # the base's x axis came to lie along -z, its y axis stayed
    leaning = Rotation.from_rotvec([0.0, -0.03, -0.02]).inv().apply(wall)
    truth = rigid_torque(Design(TRUTH).change(gravity_mps2=leaning.tolist()), run.motion)
    truth -= rigid_torque(Design(TRUTH).change(gravity_mps2=wall), run.motion)
    assert np.sqrt(np.mean((found - truth) ** 2)) < 0.03 * np.sqrt(np.mean(truth**2))


@pytest.mark.parametrize("name", [name for name in EFFECTS if EFFECTS[name].amplitudes])
def test_regressors_are_the_slope_of_its_torque(name):
    effect, here = EFFECTS[name], scene(course(1, 0.4))
    injected = INJECTED[name]
    joint, nonlinear = (injected.joints or (0,))[-1], injected.nonlinear
    linear = not isinstance(effect, GeometryError)
    amplitude = np.array(injected.amplitude[-1]) * linear  # a linearisation holds at zero
    step = 1e-3 * np.abs(injected.amplitude[-1])
    columns = effect.regressors(here, joint, nonlinear)
    columns = on_joint(columns, joint, 3) if effect.own_joint else columns
    assert columns.shape == (len(here.time), 3, len(effect.amplitudes))
    for k, h in enumerate(np.diag(step)):
        if effect.measured:
            above, below = (effect.report(here, joint, here.total, amplitude + s * h, nonlinear) for s in (1, -1))
        else:
            above, below = (effect.torque(here, joint, amplitude + s * h, nonlinear) for s in (1, -1))
        slope = (above - below) / (2 * step[k])
        assert np.abs(columns[..., k] - slope).max() < 1e-5 * np.abs(slope).max()
        assert np.abs(slope).max() > 0.0


@pytest.mark.parametrize("name", ["torque_delay", "torque_filter", "drive_lag"])
def test_a_measured_effects_column_is_what_it_changes_of_the_base(name):
    effect, here, nonlinear = EFFECTS[name], scene(course(1, 0.4)), INJECTED[name].nonlinear
    change = effect.report(here, 0, here.total, np.zeros(0), nonlinear) - here.total
    np.testing.assert_array_equal(effect.regressors(here, 0, nonlinear)[..., 0], change)
    assert np.abs(change).max() > 1.0


PAIRS = [
    (), *[(name,) for name in INJECTED],
    ("stribeck_friction", "torque_scale"), ("torque_filter", "tool_mass"), ("torque_delay", "cogging"),
    ("torque_scale", "torque_delay"), ("link_length_error", "warmup_friction"), ("joint_offset", "torque_filter"),
    ("position_dependent_friction", "encoder_eccentricity"), ("base_tilt", "nonlinear_viscous_friction"),
    ("stribeck_friction", "torque_filter"), ("presliding_friction", "asymmetric_friction"),
    ("drive_lag", "torque_scale"),
]  # fmt: skip


@pytest.mark.parametrize("names", PAIRS, ids="+".join)
def test_tangents_are_slopes_of_the_prediction(names):
    logs = problem([course(1, 1.5)], [course(1, 1.5).torque])
    recording, band = logs.recordings[0], logs.band
    hypothesis = Hypothesis(BASE, tuple(INJECTED[name].term(name) for name in names))
    here, known = Scene(recording, hypothesis.base), Parameters(hypothesis)

    def at(values: np.ndarray) -> np.ndarray:
        """The prediction, effects seen from the same operating point."""
        moved = known.at(values)
        torque = Scene(recording, moved.base).total
        torque = torque + sum(added(here, term) for term in moved.terms if not term.effect.measured)
        shifted = EFFECTS["torque_delay"].report(here, 0, torque, np.zeros(0), (moved.base.timing,))
        return band(reported(here, moved, shifted))

    prediction, slopes = tangent(here, hypothesis, band)
    values = known.values[known.free]
    inside = slice(40, -40)  # the ends are held by a shift in time
    assert slopes.shape[2] == len(values)
    assert np.abs(prediction - at(values))[inside].max() < 1e-9 * np.abs(prediction).max()
    # exact where the prediction is linear; else one-sided differences over 5 % of the transition, 1 % of others (which
    # turns a ripple's phase by half a radian) and central ones over a sample of the timing
    bound = np.full(len(values), 1e-6)
    bound[9] = 0.04
    if hypothesis.fits_timing:
        bound[10] = 0.02
    bound[10 + hypothesis.fits_timing :] = np.concatenate([approximate(term) for term in hypothesis.terms] or [[]])
    for index, value in enumerate(values):
        step = 1e-3 * max(abs(value), 1e-4)
        change = np.eye(len(values))[index] * step
        slope = ((at(values + change) - at(values - change)) / (2 * step))[inside]
        error = np.sqrt(np.mean((slopes[inside, :, index] - slope) ** 2) / np.mean(slope**2))
        assert error < bound[index], f"parameter {index}: {error:.2g}"


def approximate(term: Term) -> list[float]:
    """How far each slope of a term may be off, amplitudes before nonlinear parameters that are searched."""
    name = term.effect.name
    amplitude = {"torque_scale": 0.06}.get(name, 1e-6)
    nonlinear = 0.13 if name in ("cogging", "encoder_eccentricity") else 0.03
    searched = sum(not one.fixed for one in term.effect.nonlinear.values())
    return [amplitude] * term.amplitude.size + [nonlinear] * searched


def test_torque_is_sampled_later_by_a_fraction_of_a_sample():
    here = replace(scene(course(1, 0.4)), base=replace(BASE, timing=2e-4))
    band = problem([course(1, 0.4)], [course(1, 0.4).torque]).band
    hypothesis = Hypothesis(here.base, (INJECTED["stribeck_friction"].term("stribeck_friction"),))
    expected = predict(here, hypothesis)
    np.testing.assert_allclose(tangent(here, hypothesis, band)[0], band(expected), atol=1e-9)
    early = predict(here, Hypothesis(BASE, hypothesis.terms))
    slope = np.gradient(early, here.period, axis=0)
    error = np.abs(expected - (early - 2e-4 * slope)) / np.abs(expected - early)
    assert np.median(error) < 0.01  # apart from reversals


@pytest.mark.parametrize(
    ("name", "amplitude", "nonlinear"),
    [("torque_filter", (), (15.0,)), ("drive_lag", (), (15.0,)), ("torque_scale", (0.1,), ())],
)
def test_what_a_drive_does_to_its_report_is_turned_round(name, amplitude, nonlinear):
    effect, of = EFFECTS[name], np.array(amplitude)
    time = np.arange(1000) * PERIOD  # 25 Hz and below, settled
    torque = np.sin(2 * np.pi * time[:, None] * [3.0, 10.0, 25.0]) * np.minimum(1.0, time[:, None] / 0.3) ** 3
    here = stub(period=PERIOD)
    reported = effect.report(here, 1, torque, of, nonlinear)
    assert np.abs(reported - torque)[:, 1].max() > 0.05
    error = effect.restore(reported, PERIOD, 1, of, nonlinear) - torque
    assert np.abs(error[:-2]).max() < 3e-3


@pytest.mark.parametrize("rate", [250.0, 1000.0])
@pytest.mark.parametrize("hertz", [4.0, 25.0])
def test_a_filter_is_as_late_as_it_is_whatever_the_rate_of_the_log(hertz, rate):
    """A sine through 1 / (1 + j f / f_c), to half a percent; held from sample to sample it is half a sample off."""
    time = np.arange(0.0, 2.0, 1 / rate)
    for frequency in (1.0, 10.0):
        passed = 1 / (1 + 1j * frequency / hertz)
        wave, here = np.exp(2j * np.pi * frequency * time)[:, None], stub(period=1 / rate)
        true, settled = np.imag(passed * wave), slice(round(rate), -3)
        late = EFFECTS["torque_filter"].report(here, 0, np.imag(wave), np.zeros(0), (hertz,))
        np.testing.assert_allclose(late[settled], true[settled], atol=6e-3 * abs(passed))
        early = EFFECTS["drive_lag"].report(here, 0, true, np.zeros(0), (hertz,))
        np.testing.assert_allclose(early[settled], np.imag(wave)[settled], atol=3e-3)


def test_rotor_and_gear_do_not_grow_with_the_link():
    """rho_1 I is a link's inertia and a rotor's; a link r times as long has r^2 of the first, r of its weight."""
    ratio = np.array([0.5, 1.0, 2.0])
    rho_1, rho_2 = lengthened(1.7, 1.3, ratio)
    np.testing.assert_allclose(rho_1 * ratio**2, ratio**2 + 0.7)
    np.testing.assert_allclose(rho_2 * ratio, ratio + 0.3)


def test_what_only_a_simulation_carries_is_put_inside_the_robot():
    """Wear on joint 2 and, of the springs, on joint 3; the robot's own masses grow."""
    figures = {
        "tool_mass": ((0.4,), ()), "arm_mass": ((0.2,), ()), "rotor_inertia": ((0.03,), ()),
        "backlash": ((), (0.001, 120.0, 2.0, 0.2)), "presliding_friction": ((1.5,), (0.002,)),
    }  # fmt: skip
    terms = [
        Term(EFFECTS[name], (1,), np.array([amplitude]), nonlinear) for name, (amplitude, nonlinear) in figures.items()
    ]
    terms.append(Term(EFFECTS["joint_elasticity"], (2,), np.zeros((1, 0)), (20.0, 0.1, 0.3)))
    inside = inside_of(terms)
    assert inside.tool == 0.4
    assert inside.arm.tolist() == [0.0, 0.2, 0.0]
    assert inside.rotor.tolist() == [0.0, 0.03, 0.0]
    assert inside.two_masses == {1: (0.001, 120.0, 2.0, 0.2), 2: (0.0, 20.0, 0.1, 0.3)}
    assert (inside.bristle.tolist(), inside.distance.tolist()) == ([0.0, 1.5, 0.0], [1.0, 0.002, 1.0])


def test_a_wobble_moves_as_its_own_derivatives():
    """What an encoder off its centre adds to angle, speed and acceleration, one by differences of the other."""
    here, seen = scene(course(1, 0.5)), []
    place = stub(segment=here.segment, mechanism=here.mechanism, perturbed=lambda _, *m: seen.extend(m))
    EFFECTS["encoder_eccentricity"].regressors(place, 0, (1.0,))
    assert [part.shape for part in seen] == [(500, 2)] * 3
    for value, slope in pairwise(seen):
        near = np.gradient(value, here.period, axis=0, edge_order=2)
        np.testing.assert_allclose(near, slope, atol=0.02 * np.abs(slope).max())


@pytest.mark.parametrize("ripple", [0.0, 1.0])
def test_orders_are_looked_for_that_stand_out(ripple):
    """13 a motor turn is not among the usual ones."""
    run = course(1, 3.0)
    torque = run.torque.copy()
    torque[:, 1] += ripple * np.cos(13 * ROBOT.drive.gear_ratio * run.motion[0][:, 1])
    here = Scene(Recording(segment(run, torque), Delta.of(ROBOT), 0, "run"), BASE)
    assert ((13.0,) in EFFECTS["cogging"].grid(here)) == bool(ripple)


@pytest.mark.parametrize(
    ("order", "travel", "weight"), [(0.04, 20.0, True), (0.05, 10.0, False), (0.05, 7.0, True), (0.035, 12.0, False)]
)
def test_a_ripple_once_a_turn_or_that_hardly_comes_round_is_a_weight(order, travel, weight):
    """A gear of 25: once a turn of the joint at 0.04; one and a half periods at least."""
    turns = order * 25.0 * travel / (2 * np.pi)
    assert (turns < 1.5 or abs(order * 25.0 - 1) < 0.1) == weight
    assert EFFECTS["cogging"].is_weight(25.0, travel, (order,)) == weight
    assert not EFFECTS["torque_offset"].is_weight(25.0, travel, ())


def test_a_gap_is_looked_for_on_both_sides_of_the_grid():
    low, middle, high = EFFECTS["backlash"].starts((0.001, 120.0, 2.0, 0.2))
    assert middle == (0.001, 120.0, 2.0, 0.2)
    assert 0.8e-3 < low[0] < 0.95e-3
    assert 1.05e-3 < high[0] < 1.25e-3
    assert low[1:] == high[1:] == middle[1:]
