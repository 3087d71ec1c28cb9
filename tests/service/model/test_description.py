"""Effects of a description become terms, those of the user's own wherever the description is read; what is written
into a description is read from it again.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from schemas.axes_description import Axes, AxesIdentified, Description, load_axes
from schemas.chain_description import Chain, ChainIdentified
from schemas.errors import RobotError
from schemas.fitted import JointParameter, Parameter
from schemas.robot import EffectEntry, EffectParameter, Robot
from service.model.arm import A_LINK
from service.model.description import (
    base_errors,
    described,
    digits,
    hypothesis_of,
    in_units_of,
    terms_of,
    torque_along,
)
from service.model.effects import CATALOGUE, by_name
from service.model.hypothesis import Hypothesis, Term
from service.model.mechanism import Mechanism, mechanism_of
from service.model.parameters import Parameters, base_parameters
from service.model.scene import Base
from tests.service import arm
from tests.service.world import ROBOT

AXES = """
name = "bench"
kind = "axes"
[[axis]]
[identified]
inertia = {value = [2.0]}
offset = {value = [0.0]}
viscous_friction = {value = [0.0]}
coulomb_friction = {value = [0.0]}
[[effect]]
name = "bump"
joints = [1]
parameters = {height = {value = 3.0}}
"""
OWN = """
from __future__ import annotations
from dataclasses import dataclass
from service.model.effects.base import Amplitude, Effect
@dataclass(frozen=True)
class Bump(Effect):
    height: Amplitude = Amplitude("N m", "height")
    name = "bump"
    settles = "a slow sweep"
    def regressors(self, scene, joint, nonlinear):
        return scene.segment.theta[:, [joint]] ** 2
"""


@pytest.fixture
def files(tmp_path):
    (tmp_path / "axes.toml").write_text(AXES)
    (tmp_path / "own.py").write_text(OWN)
    return tmp_path


def test_an_effect_of_ones_own_is_in_the_torque(files):
    axes = load_axes(files / "axes.toml", files / "own.py")
    time = np.arange(2000) * 1e-3
    theta, speed, acceleration = np.sin(time)[:, None], np.cos(time)[:, None], -np.sin(time)[:, None]
    assert np.allclose(torque_along(axes, time, theta, speed, acceleration), 2.0 * acceleration + 3.0 * theta**2)
    assert terms_of(axes)[0].effect == terms_of(axes)[0].effect, "the file is run once"


def test_a_missing_effect_is_named(files):
    with pytest.raises(RobotError, match=r"axes\.toml: effect bump: not in the catalogue; .* --effects"):
        terms_of(load_axes(files / "axes.toml"))


def test_a_joint_that_is_none_is_named(files):
    (files / "axes.toml").write_text(AXES.replace("joints = [1]", "joints = [2]"))
    with pytest.raises(RobotError, match="effect bump: joint 2 of 1"):
        terms_of(load_axes(files / "axes.toml", files / "own.py"))


def coupled(folder: Path, more: str = "") -> Axes:
    """Three axes, of which two share motors."""
    path = folder / "coupled.toml"
    path.write_text(
        'name = "coupled"\nkind = "axes"\ncoupling = [[1, 0, 0], [0, 1, 0], [0, 1, 1]]\n'
        "[[axis]]\n[[axis]]\ngravity = false\n[[axis]]\n" + more
    )
    axes = load_axes(path)
    assert isinstance(axes, Axes)
    return axes


def own_numbers(mechanism: Mechanism, transition: float | np.ndarray) -> Base:
    """Every figure of a base model another one."""
    count, frictions = len(mechanism.coefficients), len(mechanism.frictions)
    return Base(
        1.0 + np.arange(count), 20.0 + np.arange(frictions), 30.0 + np.arange(frictions), transition, timing=2e-4
    )


def returns(robot: Description, transition: float | np.ndarray) -> Description:
    """A base model is the same, errors too, after it was written into a description and read again."""
    mechanism = mechanism_of(robot)
    base = own_numbers(mechanism, transition)
    errors = 0.1 + 0.01 * np.arange(len(Parameters(Hypothesis(base)).values))
    written = described(robot, Hypothesis(base), errors, 0.7 * np.ones(mechanism.joints))
    found = hypothesis_of(written).base
    assert type(found.transition) is type(base.transition)
    for name in ("rigid", "viscous", "coulomb", "transition", "timing"):
        np.testing.assert_array_equal(getattr(found, name), getattr(base, name), err_msg=name)
    np.testing.assert_allclose(base_errors(written), errors[: len(base_parameters(mechanism))])
    assert not base_errors(robot).any()
    assert len(base_errors(robot)) == len(base_parameters(mechanism))
    return written


def test_a_delta_is_read_as_it_was_written() -> None:
    written = returns(ROBOT, 0.004)
    assert isinstance(written, Robot)
    assert written.identified is not None
    assert written.identified.torque_noise_nm == JointParameter(value=[0.7, 0.7, 0.7])


def test_axes_with_shared_motors_are_read_as_they_were_written(tmp_path: Path) -> None:
    written = returns(coupled(tmp_path), np.array([0.01, 0.02, 0.03, 0.04]))
    identified = written.identified
    assert isinstance(identified, AxesIdentified)
    assert identified.motor_inertia == JointParameter(value=[0, 0, 11], std_error=[0, 0, 0.2])
    assert identified.motor_coulomb_friction == JointParameter(value=[0, 0, 33], std_error=[0, 0, 0.28])
    assert identified.gravity_sin is not None
    assert identified.gravity_sin.value == [7.0, 0.0, 8.0], "the second axis bears no weight"
    bare = hypothesis_of(coupled(tmp_path)).base
    assert [len(bare.rigid), len(bare.viscous), len(bare.coulomb)] == [11, 4, 4]
    assert not np.concatenate([bare.rigid, bare.viscous, bare.coulomb]).any()


def test_transitions_are_one_or_one_each(tmp_path: Path) -> None:
    written = returns(coupled(tmp_path), 0.004)
    assert written.identified is not None
    wrong = written.identified.model_copy(update={"friction_transition": [0.1, 0.2]})
    with pytest.raises(RobotError, match=r"friction_transition has 2 values, one or 4 are needed: 1, 2, 3, motor_3"):
        hypothesis_of(written.model_copy(update={"identified": wrong}))


def test_an_arm_is_read_as_it_was_written(tmp_path: Path) -> None:
    pytest.importorskip("pinocchio")
    written = returns(load_axes(arm.write(tmp_path)), np.array([0.01, 0.02, 0.03]))
    assert isinstance(written, Chain)
    identified = written.identified
    assert identified is not None
    rigid = dict(identified.rigid)
    units = {name: known.unit for name, known in mechanism_of(written).coefficients.items()}
    assert {units[name] for name in units if name.startswith("m")} == {"kg m"}
    assert {units[name] for name in units if name[0] in "Ir"} == {"kg m^2"}
    first = next(iter(rigid))

    def changed(figures: dict[str, Parameter]) -> Chain:
        return written.model_copy(update={"identified": ChainIdentified.model_validate(
            identified.model_dump() | {"rigid": {k: v.model_dump() for k, v in figures.items()}}
        )})  # fmt: skip

    with pytest.raises(RobotError, match=f"identified.rigid: '{first}' is missing"):
        hypothesis_of(changed({name: figure for name, figure in rigid.items() if name != first}))
    with pytest.raises(RobotError, match=r"identified.rigid: 'Ixx_9' is not a parameter of small.urdf"):
        hypothesis_of(changed(rigid | {"Ixx_9": Parameter(value=1.0)}))


def test_known_masses_of_an_arm_stay_beside_what_is_found(tmp_path: Path) -> None:
    """What an arm with known masses was identified with before is kept, and stands for the URDF's."""
    pytest.importorskip("pinocchio")
    told = load_axes(arm.write(tmp_path))
    before = returns(told, 0.01).identified
    known = load_axes(arm.write(tmp_path, more='masses = "known"\n')).model_copy(update={"identified": before})
    assert isinstance(before, ChainIdentified)
    mechanism = mechanism_of(known)
    hypothesis = Hypothesis(own_numbers(mechanism, 0.01))
    written = described(known, hypothesis, np.zeros(len(Parameters(hypothesis).values)), np.zeros(3)).identified
    assert isinstance(written, ChainIdentified)
    expected = {name: figure.value for name, figure in before.rigid.items()}
    expected |= dict(zip(mechanism.coefficients, 1.0 + np.arange(len(mechanism.coefficients)), strict=True))
    assert {name: figure.value for name, figure in written.rigid.items()} == expected
    # the links' figures weigh as they did when they were asked for
    motion = np.random.default_rng(3).uniform(-1.0, 1.0, (3, 5, 3))
    links = [name for name in before.rigid if name.split("_")[0] in A_LINK]
    asked = mechanism_of(told)
    place = [list(asked.coefficients).index(name) for name in links]
    weighed = asked.rigid(*motion).columns[..., place] @ [before.rigid[name].value for name in links]
    np.testing.assert_allclose(mechanism.rigid(*motion).known, weighed, atol=1e-9)


def test_effects_are_read_as_they_were_written() -> None:
    effects = by_name(CATALOGUE)
    terms = (
        Term(effects["stribeck_friction"], (0, 2), np.array([[1.5], [2.5]]), (0.3,)),
        Term(effects["torque_delay"], (), np.zeros((1, 0)), (0.003,)),
    )
    hypothesis = Hypothesis(own_numbers(mechanism_of(ROBOT), 0.004), terms)
    errors = 0.01 * np.arange(len(Parameters(hypothesis).values))
    written = described(ROBOT, hypothesis, errors, np.ones(3))
    first, second = written.effect
    assert (first.name, first.joints, second.joints) == ("stribeck_friction", [1, 3], [])
    assert first.parameters["f_s_3"] == EffectParameter(value=2.5, unit="N m", std_error=0.12)
    assert first.parameters["v_s"] == EffectParameter(value=0.3, unit="rad/s", std_error=0.13)
    for found, given in zip(terms_of(written), terms, strict=True):
        assert (found.effect, found.joints, found.nonlinear) == (given.effect, given.joints, given.nonlinear)
        np.testing.assert_array_equal(found.amplitude, given.amplitude)
    parameters = first.parameters

    def wrong(**update: object) -> Description:
        return written.model_copy(update={"effect": [first.model_copy(update=update)]})

    with pytest.raises(RobotError, match=r"effect stribeck_friction: joints \[1, 4\]: the joints are 1 to 3"):
        terms_of(wrong(joints=[1, 4]))
    with pytest.raises(RobotError, match="parameter 'v_s' is missing"):
        terms_of(wrong(parameters={name: parameters[name] for name in ("f_s_1", "f_s_3")}))
    with pytest.raises(RobotError, match=r"unknown parameter 'slope'$"):
        terms_of(wrong(parameters=parameters | {"slope": parameters["v_s"]}))
    misspelt = {("vs" if name == "v_s" else name): one for name, one in parameters.items()}
    with pytest.raises(RobotError, match=r"unknown parameter 'vs' \(is 'v_s' meant\?\)"):
        terms_of(wrong(parameters=misspelt))
    with pytest.raises(RobotError, match=r"effect stribek_friction: .* \(is 'stribeck_friction' meant\?\)"):
        terms_of(wrong(name="stribek_friction"))
    slow = parameters["v_s"].model_copy(update={"unit": "deg/s"})
    with pytest.raises(RobotError, match="v_s: unit 'deg/s': it is 'rad/s'"):
        terms_of(wrong(parameters=parameters | {"v_s": slow}))


def test_a_quantity_that_is_never_searched_may_be_left_out() -> None:
    mu = EffectParameter(value=0.1, unit="")
    entry = EffectEntry(name="load_dependent_friction", joints=[2], parameters={"mu": mu})
    (term,) = terms_of(ROBOT.model_copy(update={"effect": [entry]}))
    assert term.nonlinear == (0.0,)


def test_units_are_those_of_the_axes(tmp_path: Path) -> None:
    linear = tmp_path / "linear.toml"
    linear.write_text('name = "rail"\nkind = "axes"\n[[axis]]\nunit = "m"\n')
    rail = load_axes(linear)
    assert [in_units_of(rail, unit) for unit in ("kg m^2", "N m s/rad", "rad/s")] == ["kg", "N s/m", "m/s"]
    assert in_units_of(coupled(tmp_path), "N m s/rad") == "N m s/rad"
    assert digits(0.123456789) == 0.1234568
