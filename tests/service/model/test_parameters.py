"""One order for the parameters of a hypothesis: values, names, limits and places agree."""

from dataclasses import replace

import numpy as np
import pytest

from service.model.effects import CATALOGUE, by_name
from service.model.hypothesis import Hypothesis, Term
from service.model.mechanism import DecoupledAxes, Delta
from service.model.parameters import Parameters, base_parameters, parameters_of, shown_parameters
from service.model.scene import Base
from tests.service.world import ROBOT

EFFECTS = by_name(CATALOGUE)
BASE = Base(np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0]), np.array([7.0, 8.0, 9.0]), 0.002, 1e-4)
STRIBECK = Term(EFFECTS["stribeck_friction"], (0, 2), np.array([[10.0], [11.0]]), (0.3,))
BACKLASH = Term(EFFECTS["backlash"], (1,), np.zeros((1, 0)), (0.001, 120.0, 2.0, 0.2))
DELAY = Term(EFFECTS["torque_delay"], (), np.zeros((1, 0)), (0.003,))


def test_values_come_in_the_order_of_their_names():
    parameters = Parameters(Hypothesis(BASE, (STRIBECK, BACKLASH)))
    expected = [1, 2, 3, 4, 5, 6, 7, 8, 9, 0.002, 1e-4, 10, 11, 0.3, 0.001, 120, 2, 0.2]
    assert parameters.values.tolist() == expected
    assert [known.name for known in parameters.of_terms[0]] == ["f_s_1", "f_s_3", "v_s"]
    assert [known.name for known in parameters_of(BACKLASH)] == [
        "half", "contact_hz", "contact_damping", "motor_share",
    ]  # fmt: skip
    assert parameters.values[parameters.terms[1]].tolist() == [0.001, 120, 2, 0.2]
    assert parameters.values[parameters.coulomb].tolist() == [7, 8, 9]


def test_every_free_number_goes_where_it_came_from():
    parameters = Parameters(Hypothesis(BASE, (STRIBECK, BACKLASH)))
    assert not parameters.free[parameters.terms[1]][1:3].any(), "contact is kept"
    changed = parameters.values[parameters.free] + np.arange(1, parameters.free.sum() + 1)
    moved = parameters.at(changed)
    after = Parameters(moved)
    assert np.array_equal(after.values[after.free], changed)
    assert np.array_equal(after.values[~after.free], parameters.values[~parameters.free])
    assert moved.base.viscous.tolist() == [8.0, 10.0, 12.0]
    assert moved.terms[0].amplitude.tolist() == [[22.0], [24.0]]
    assert moved.terms[1].nonlinear[1:3] == (120.0, 2.0)


def test_limits_columns_and_roughness_are_of_the_free_ones():
    parameters = Parameters(Hypothesis(BASE, (STRIBECK, BACKLASH)))
    low, high = parameters.limits(Delta.of(ROBOT), 1e-3)
    assert (low[9], high[9]) == (2e-4, 2e-2), "transition"
    assert (low[10], high[10]) == (-2.5e-4, 2.5e-4), "timing"
    assert (low[13], high[13]) == (0.005, 2.0), "v_s"
    assert (low[14], high[14]) == (1e-4, 0.02), "half"
    assert parameters.columns(0).tolist() == [11, 12, 13]
    assert parameters.columns(1).tolist() == [14, 15]
    assert np.flatnonzero(parameters.rough).tolist() == [14, 15]
    spread = parameters.spread(np.arange(1.0, 17.0))
    assert spread[parameters.terms[1]].tolist() == [15.0, 0.0, 0.0, 16.0]


@pytest.mark.parametrize("hypothesis", [Hypothesis(BASE, (DELAY,)), Hypothesis(BASE, timed=False)])
def test_a_delay_or_one_instant_takes_the_timing_away(hypothesis):
    parameters = Parameters(hypothesis)
    assert not parameters.free[parameters.timing]
    assert parameters.at(parameters.values[parameters.free]).base.timing == 0.0


def test_a_delay_takes_the_place_of_the_timing():
    timed = Hypothesis(replace(BASE, timing=1e-4))
    assert timed.carrying((DELAY,)).base.timing == 0.0
    assert timed.carrying((BACKLASH,)) == replace(timed, terms=(BACKLASH,))


def test_the_base_is_named_by_its_mechanism(model):
    delta = base_parameters(Delta(model, np.ones(3)))
    assert [known.name for known in delta] == [
        "rho_1", "rho_2", "forearm_inertia_kg", "f_v_1", "f_v_2", "f_v_3", "f_c_1", "f_c_2", "f_c_3",
    ]  # fmt: skip
    axes = base_parameters(DecoupledAxes(np.ones(2)))
    assert [(known.name, known.low) for known in axes[:4]] == [
        ("inertia_1", 0.0), ("inertia_2", 0.0), ("offset_1", -np.inf), ("offset_2", -np.inf),
    ]  # fmt: skip


def test_a_slope_is_trusted_over_a_part_of_a_bent_value(model):
    parameters = Parameters(Hypothesis(BASE, (STRIBECK, BACKLASH)))
    low, high = parameters.limits(Delta.of(ROBOT), 1e-3)
    assert low[:9].tolist() == [0.0] * 9
    assert np.isinf(high[:9]).all()
    down, up = parameters.reach(Delta.of(ROBOT), 1e-3)
    values = parameters.values[parameters.free]
    linear = [*range(9), 10, 11, 12]  # the torque is straight in them: only their limits end a step
    np.testing.assert_allclose(down[linear], (low - values)[linear])
    np.testing.assert_allclose(up[linear], (high - values)[linear])
    # half a value and 2 % of its range, the transition's as a nonlinear one's
    assert (down[13], up[13]) == pytest.approx((-0.1899, 0.1899)), "v_s 0.3 of 0.005 to 2"
    assert (down[9], up[9]) == pytest.approx((-0.001396, 0.001396)), "0.002 of 2e-4 to 2e-2"
    assert (down[14], up[14]) == pytest.approx((-0.000898, 0.000898)), "half, 0.001 of 1e-4 to 0.02"
    close = Parameters(Hypothesis(BASE, (replace(BACKLASH, nonlinear=(1.2e-4, 120.0, 2.0, 0.2)),)))
    down, up = close.reach(Delta.of(ROBOT), 1e-3)
    assert (down[11], up[11]) == pytest.approx((-2e-5, 4.58e-4)), "ends at a limit"


def test_frictions_with_a_transition_each_may_turn_slowly():
    wide = replace(BASE, transition=np.array([0.01, 0.02, 0.03]), wanted=np.array([True, False, True]))
    parameters = Parameters(Hypothesis(wide))
    assert np.flatnonzero(~parameters.free).tolist() == [1], "a coefficient that is not wanted stays"
    low, high = parameters.limits(Delta.of(ROBOT), 1e-3)
    assert (low[8:11].tolist(), high[8:11].tolist()) == ([2e-4] * 3, [0.5] * 3)
    moved = parameters.at(parameters.values[parameters.free] * 2)
    assert moved.base.rigid.tolist() == [2.0, 2.0, 6.0]
    np.testing.assert_array_equal(moved.base.transition, [0.02, 0.04, 0.06])
    columns = parameters.widened(np.arange(11.0)[None], 4)
    assert columns.tolist() == [[0.0, 0.0, 1.0, 2.0]], "none for the one that is held"
    one = Parameters(Hypothesis(BASE))
    assert isinstance(one.at(one.values).base.transition, float)


def test_names_that_documents_show():
    axes = DecoupledAxes(np.ones(2), np.array([[1.0, 0.0], [1.0, 1.0]]))
    assert [known.name for known in shown_parameters(axes)][-4:] == [
        "f_c_motor_2", "transition_1", "transition_2", "transition_motor_2",
    ]  # fmt: skip
    assert [(known.low, known.high) for known in shown_parameters(axes)][-1] == (2e-4, 0.5)
    assert [known.name for known in shown_parameters(Delta.of(ROBOT))] == [
        known.name for known in base_parameters(Delta.of(ROBOT))
    ]
