"""What an effect cannot be is never named: signs, the end of a search, friction that drives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.simulated.plant.effects.out_of_catalogue import CableMemory
from service.diagnosis.fit.sound import fault_of
from tests.service.subject import EFFECTS, Hypothesis, Problem, Regressors, Split, Term, fit, selection
from tests.service.world import BASE, COULOMB, PERIOD, VISCOUS, course, problem, stub

NOISE = 0.3
RUNS = [course(seed, 4.0) for seed in (1, 2, 3)]


def logs(*extra: np.ndarray) -> Problem:
    """Three runs with a torque (N, 3) more each."""
    random = np.random.default_rng(5)
    return problem(
        RUNS, [r.torque + e + NOISE * random.standard_normal(e.shape) for r, e in zip(RUNS, extra, strict=True)]
    )


def on(joint: int, values: list[np.ndarray]) -> list[np.ndarray]:
    return [np.where(np.arange(3) == joint, v[:, None], 0.0) for v in values]


def named(made: Problem, *names: str) -> selection.Selection:
    effects = [EFFECTS[name] for name in names]
    return selection.search(Regressors(made, Split.of(made), effects, Hypothesis(BASE)), lambda _: None)


def test_a_spring_that_pushes_is_no_spring():
    angle = [run.motion[0][:, 1] for run in RUNS]
    assert named(logs(*on(1, [4.0 * (a - 0.4) for a in angle])), "joint_spring").best.names == ("joint_spring",)
    found = named(logs(*on(1, [-4.0 * (a - 0.4) for a in angle])), "joint_spring")
    assert found.best.names == ()


def crept(run, stiffness: float, relaxation: float) -> np.ndarray:
    """(N,) N m of a cable bundle on the first joint, as the plant has it."""
    cable, seen = CableMemory([stiffness, 0.0, 0.0], relaxation), stub(theta=run.motion[0][0], step=PERIOD)
    cable.start(seen)
    return np.array([-cable.joint_torque(stub(theta=theta, step=PERIOD))[0] for theta in run.motion[0]])


@pytest.mark.parametrize("relaxation", [0.25, 0.33])
def test_a_cable_that_creeps_is_no_presliding_friction(relaxation):
    """It is as a friction that builds up over 0.23 and 0.29 rad, as nearly as to leave 1.3 times the noise."""
    found = named(logs(*on(0, [crept(run, 4.5, relaxation) for run in RUNS])), "presliding_friction", "cogging")
    assert found.best.names == ()
    assert found.fault is not None
    assert (found.fault.code, found.fault.quantity) == ("at_limit", "distance")


def test_less_than_no_friction_is_no_stribeck_friction():
    speed = [run.motion[1][:, 0] for run in RUNS]
    bump = [1.5 * np.tanh(s / 0.004) * np.exp(-((s / 0.2) ** 2)) for s in speed]
    assert named(logs(*on(0, bump)), "stribeck_friction").best.names == ("stribeck_friction",)
    assert named(logs(*on(0, [-b for b in bump])), "stribeck_friction").best.names == ()


@pytest.mark.parametrize(("coulomb", "viscous", "none_left"), [(0.0, 0.0, True), (0.1, 0.0, False), (0.0, 0.1, False)])
def test_friction_that_falls_to_none_is_no_stribeck_friction(coulomb, viscous, none_left):
    """As a drive that lags its logged command makes it look."""
    base = replace(BASE, coulomb=BASE.coulomb.copy(), viscous=BASE.viscous.copy())
    base.coulomb[0], base.viscous[0] = coulomb, viscous
    term = Term(EFFECTS["stribeck_friction"], (0,), np.array([[1.5]]), (0.2,))
    found = fault_of(logs(*[np.zeros_like(r.torque) for r in RUNS]), Hypothesis(base, (term,)), 0)
    assert ((found.code, found.quantity) if found else None) == (
        ("at_limit", "coulomb_friction") if none_left else None
    )


@pytest.mark.parametrize(("transition", "code"), [(0.004, None), (0.03, None), (0.12, "does_not_fall")])
def test_stribeck_friction_falls_by_at_least_half_of_itself(transition, code):
    """3 tanh(v / w) + 1.5 tanh(v / w) exp(-(v / 0.1)^2) reaches 4.5, 3.9 and no more than 3 N m before it is 3."""
    term = Term(EFFECTS["stribeck_friction"], (0,), np.array([[1.5]]), (0.1,))
    hypothesis = Hypothesis(replace(BASE, transition=transition), (term,))
    found = fault_of(logs(*[np.zeros_like(r.torque) for r in RUNS]), hypothesis, 0)
    assert (found.code if found else None) == code


@pytest.mark.parametrize("end", ["low", "high"])
def test_a_shape_at_the_end_of_its_search_is_no_finding(end):
    made = logs(*[np.zeros_like(r.torque) for r in RUNS])
    cutoff = EFFECTS["torque_filter"].nonlinear["cutoff"]

    def fault(value):
        return fault_of(made, Hypothesis(BASE, (Term(EFFECTS["torque_filter"], (), np.zeros((1, 0)), (value,)),)), 0)

    found = fault(getattr(cutoff, end))
    assert found is not None
    assert (found.code, found.quantity) == ("at_limit", "cutoff")
    assert fault(0.5 * (cutoff.low + cutoff.high)) is None


def test_what_cannot_be_and_leads_ends_the_search_and_is_told():
    """A ripple of so low an order that the search ends before it."""
    slow = [2.0 * np.sin(0.3 * EFFECTS["cogging"].nonlinear["order"].low * 25.0 * r.motion[0][:, 1]) for r in RUNS]
    found = named(logs(*on(1, slow)), "cogging")
    assert found.best.names == ()
    assert found.fault is None or found.fault.code == "at_limit"


def test_the_base_models_parameters_are_what_they_can_be():
    """More viscous torque and inertia taken away than there is."""
    less = [-2.0 * VISCOUS * r.motion[1] - 2.0 * COULOMB * np.tanh(r.motion[1] / 0.004) for r in RUNS]
    base = fit(logs(*less), Hypothesis(BASE)).hypothesis.base
    assert (base.viscous >= 0).all()
    assert (base.coulomb >= 0).all()
    assert (base.rigid >= 0).all()
    assert (base.viscous == 0).any()
    assert (base.coulomb == 0).any()


@pytest.mark.parametrize(("half", "code"), [(2.0, None), (4.0, "drives")])
def test_friction_takes_energy_in_either_direction(half, code):
    """A difference between the directions larger than the friction itself drives the joint in one of them."""
    made = logs(*[np.zeros_like(r.torque) for r in RUNS])
    term = Term(EFFECTS["asymmetric_friction"], (1,), np.array([[half, 0.0]]), ())
    fault = fault_of(made, Hypothesis(BASE, (term,)), 0)
    assert (fault.code if fault else None) == code
    assert fault_of(made, Hypothesis(BASE, (term,)), 1) is None  # what the description says is its own affair
