"""Elasticity and backlash against other code: the ideal spring's closed form, a simulation with small steps, and the
MuJoCo plant with a rotor and a link of their own in closed loop.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from drivers.motion import MotionLimits, Planner
from drivers.simulated.plant.effects import two_mass_effects
from drivers.simulated.plant.plant import Plant
from drivers.simulated.plant.plant_trace import simulate
from service.model.elastic import inertias
from service.model.two_masses import relative_motion, two_masses
from tests.service.axis import INERTIA, loose_axis, spring_axis
from tests.service.subject import (
    EFFECTS,
    Band,
    Base,
    Delta,
    Hypothesis,
    Recording,
    Scene,
    Term,
    added,
    predict,
    segments,
    thin,
)
from tests.service.world import BASE, PERIOD, ROBOT, TRUTH


def relative(found: np.ndarray, truth: np.ndarray, band: Band) -> float:
    """rms difference in the analysis band, of the truth's, once the start is forgotten."""
    found, truth = (band(values)[80:-20] for values in (found, truth))
    return float(np.sqrt(np.mean((found - truth) ** 2) / np.mean(truth**2)))


@pytest.mark.parametrize(("hz", "ratio", "share"), [(12.0, 0.2, 0.3), (22.0, 0.1, 0.15), (35.0, 0.4, 0.5)])
def test_a_spring_is_the_closed_form(hz, ratio, share):
    axis = spring_axis(2.0, hz, ratio, share)
    term = Term(EFFECTS["joint_elasticity"], (0,), np.zeros((1, 0)), (hz, ratio, share))
    found = added(axis.scene(), term)[:, 0]
    assert relative(found, axis.extra, Band.of(PERIOD)) < 0.05


@pytest.mark.parametrize(("half", "share"), [(0.0015, 0.2), (0.004, 0.45)])
def test_lost_motion_is_what_small_steps_give(half, share):
    axis = loose_axis(2.0, half, 120.0, 2.0, share)
    term = Term(EFFECTS["backlash"], (0,), np.zeros((1, 0)), (half, 120.0, 2.0, share))
    found = added(axis.scene(), term)[:, 0]
    assert relative(found, axis.extra, Band.of(PERIOD)) < 0.15
    still = Term(EFFECTS["backlash"], (0,), np.zeros((1, 0)), (1e-4, 120.0, 2.0, share))
    assert relative(added(axis.scene(), still)[:, 0], axis.extra, Band.of(PERIOD)) > 0.5


def test_too_much_to_follow_is_no_torque_at_all():
    axis = spring_axis(0.5, 12.0, 0.2, 0.3)
    term = Term(EFFECTS["joint_elasticity"], (0,), np.zeros((1, 0)), (0.2, 0.01, 0.02))
    assert not added(axis.scene(), term).any()


@pytest.mark.parametrize(
    ("name", "effect", "joint", "rings", "left_over"),
    [
        ("joint_elasticity", two_mass_effects.JointElasticity([0.0, 2000.0, 0.0], 0.1), 1, True, 0.05),
        ("backlash", two_mass_effects.Backlash([0.002, 0.0, 0.0]), 0, False, 0.35),  # impacts, but not their chatter
        ("backlash", two_mass_effects.Backlash([0.002, 0.0, 0.0]), 0, True, 0.12),
    ],
)
def test_on_the_robot_it_is_what_the_plant_does(name, effect, joint, rings, left_over):
    """Rotor and link as two bodies in closed loop; the other joints feel what the link does."""
    viscous = 2.0
    truth = TRUTH.model_copy(update={"viscous_friction_nms": [viscous] * 3, "peak_torque_nm": 250.0})
    planner = Planner(ROBOT, PERIOD, MotionLimits(speed=10.0, acceleration=240.0, torque=85.0))
    plant = Plant(ROBOT, truth, (effect,), PERIOD)
    trace = simulate(plant, planner.multisine(np.random.default_rng(4), 2.5, 1.0))
    (part,) = segments(trace)
    base = Base(BASE.rigid, np.full(3, viscous), np.zeros(3), 0.002)
    here = Scene(Recording(thin(part), Delta.of(ROBOT), 0, "plant"), base)
    band = Band.of(PERIOD)
    whole = inertias(here.delta.model, base.rigid)[0][joint]
    share = TRUTH.rotor_inertia_kgm2[joint] / whole
    link = (1 - share) * whole
    if name == "joint_elasticity":
        spring, ratio, gap = effect.stiffness_nmprad[joint], effect.damping_ratio, ()
    else:
        spring, ratio, gap = two_mass_effects.TOOTH_STIFFNESS, two_mass_effects.TOOTH_DAMPING_RATIO, (0.002,)
    damper = 2 * ratio * math.sqrt(spring * TRUTH.rotor_inertia_kgm2[joint])
    swing = (math.sqrt(spring / link) / (2 * math.pi), damper / (2 * math.sqrt(spring * link)))
    shape = (*gap, *(swing if rings else (120.0, 2.0)), share)
    term = Term(EFFECTS[name], (joint,), np.zeros((1, 0)), shape)
    inside = slice(60, -60)
    left = [band(here.segment.torque - predict(here, Hypothesis(base, terms)))[inside] for terms in ((), (term,))]
    rms = [np.sqrt(np.mean(values**2, axis=0)) for values in left]
    assert rms[0][joint] > 1.0
    assert (rms[1] < left_over * rms[0]).all()


def test_several_gears_swing_as_each_alone():
    """Play and springs, one that comes apart and one that swings too far for a slope among them."""
    here = loose_axis(1.0, 0.004, 120.0, 2.0, 0.45).scene()
    figures = [(0.0005 * (i + 1), 120.0, 2.0, 0.1 + 0.05 * i) for i in range(9)]
    figures += [(0.0, 12.0, 0.2, 0.3), (0.0, 0.2, 0.01, 0.02), (0.0, 2.5, 0.3, 0.3)]
    swing = np.abs(relative_motion(here, 0, figures).angle).max(axis=0)
    assert swing[-2] == 0.0
    assert swing[-1] > 0.01 > swing[0] > 0.0
    together = two_masses(here, 0, figures)
    for number, one in enumerate(figures):
        alone = two_masses(here, 0, [one])[..., 0]
        np.testing.assert_allclose(together[..., number], alone, rtol=0, atol=1e-9 * np.abs(alone).max())
    for name, points in (("backlash", figures[:9]), ("joint_elasticity", [one[1:] for one in figures[9:]])):
        effect, expected = EFFECTS[name], together[..., :9] if name == "backlash" else together[..., 9:]
        for found in (effect.columns(here, 0, points), effect.torques(here, 0, np.zeros(0), points)):
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(("share", "link"), [(0.3, 0.7), (0.99, 0.02)])
def test_a_link_has_what_the_motor_leaves_of_the_inertia(share, link):
    found = relative_motion(spring_axis(0.2, 12.0, 0.2, 0.3).scene(), 0, [(0.001, 10.0, 0.3, share)])
    stiffness = link * INERTIA * (20 * math.pi) ** 2
    damping = 2 * 0.3 * math.sqrt(stiffness * link * INERTIA)
    assert np.concatenate(found.gears) == pytest.approx([0.001, stiffness, damping, share * INERTIA])


@pytest.mark.parametrize("way", [1, -1])
def test_a_link_begins_where_it_hangs_by_its_spring_on_the_flank_that_carries_it(way):
    here = spring_axis(0.2, 12.0, 0.2, 0.3).scene()
    here = replace(here, base=replace(here.base, rigid=np.array([INERTIA, way * 8.0])))
    found = relative_motion(here, 0, [(0.001, 10.0, 0.3, 0.3)])
    need = here.load[0, 0] - 0.3 * INERTIA * here.segment.theta_ddot[0, 0]
    assert np.sign(need) == way
    assert found.angle[0] == pytest.approx(-need / found.gears.stiffness - way * 0.001)
    assert found.speed[0] == 0.0


def test_without_inertia_nothing_swings():
    axis = spring_axis(0.2, 12.0, 0.2, 0.3).scene()
    bare = replace(axis, base=replace(axis.base, rigid=np.array([0.0, 1.0])))
    found = relative_motion(bare, 0, [(0.001, 10.0, 0.3, 0.3)])
    assert not np.any([found.angle, found.speed, found.change])
    assert [figure[0] for figure in found.gears] == [0.001, 0.0, 0.0, 0.0]
