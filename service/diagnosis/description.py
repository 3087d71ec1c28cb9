"""Hypotheses to and from the robot description, so that what was found runs wherever the description does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from schemas.axes import Axes, AxesIdentified, Description
from schemas.errors import DataError
from schemas.robot import Effect as EffectEntry
from schemas.robot import EffectParameter, Identified, JointParameter, Parameter, Robot
from service.diagnosis.hypothesis import Hypothesis, Term, predict
from service.model.effects import by_name, catalogue
from service.model.effects.base import Effect
from service.model.mechanism import mechanism_of
from service.model.scene import Base, Recording, Scene
from service.model.signals import Segment


def names(term: Term) -> list[tuple[str, str]]:
    """(key, unit) of a term's parameters, amplitudes joint by joint, then shapes; keys end in a joint where many."""
    effect = term.effect
    keys = []
    for joint in term.joints or (None,):
        suffix = f"_{joint + 1}" if joint is not None and len(term.joints) > 1 else ""
        keys += [(name + suffix, amplitude.unit) for name, amplitude in effect.amplitudes.items()]
    return keys + [(name, shape.unit) for name, shape in effect.shapes.items()]


def values(term: Term) -> np.ndarray:
    """Parameters in the order of `names`."""
    return np.concatenate([term.amplitude.ravel(), np.array(term.shape)])


def entry(term: Term, errors: np.ndarray, robot: Description) -> EffectEntry:
    """The `[[effect]]` table of a term."""
    parameters = {
        key: EffectParameter(value=digits(value), unit=in_units_of(robot, unit), std_error=digits(error))
        for (key, unit), value, error in zip(names(term), values(term), errors, strict=True)
    }
    return EffectEntry(name=term.effect.name, joints=[joint + 1 for joint in term.joints], parameters=parameters)


def in_units_of(robot: Description, unit: str) -> str:
    """A unit of angle and torque as that of the description's axes."""
    if isinstance(robot, Axes) and robot.linear:
        return unit.replace("kg m^2", "kg").replace("N m", "N").replace("rad", "m")
    return unit


def digits(value: float) -> float:
    """Seven significant digits: what a reader can use, and more than the data hold."""
    return float(f"{value:.7g}")


def term(entry_: EffectEntry, effects: dict[str, Effect], robot: str) -> Term:
    """The term that an `[[effect]]` table stands for.

    Raises:
        DataError: an unknown effect, a missing or an extra parameter, naming it.
    """
    effect = effects.get(entry_.name)
    if effect is None:
        raise DataError(f"robot {robot}: effect {entry_.name!r} is not in the catalogue")
    joints = tuple(joint - 1 for joint in entry_.joints) if effect.per_joint else ()
    shapes = len(effect.shapes)
    blank = Term(effect, joints, np.zeros((max(1, len(joints)), len(effect.amplitudes))), (0.0,) * shapes)
    keys = [key for key, _ in names(blank)]
    for key in keys:
        if key not in entry_.parameters:
            raise DataError(f"robot {robot}: effect {entry_.name}: parameter {key!r} is missing")
    for key in entry_.parameters:
        if key not in keys:
            raise DataError(f"robot {robot}: effect {entry_.name}: unknown parameter {key!r}")
    numbers = np.array([entry_.parameters[key].value for key in keys])
    amplitude = numbers[: blank.amplitude.size].reshape(blank.amplitude.shape)
    return replace(blank, amplitude=amplitude, shape=tuple(float(v) for v in numbers[blank.amplitude.size :]))


def base_of(identified: Identified | None) -> Base:
    """The base model that a Delta's description carries."""
    identified = identified or Identified()
    rigid = [identified.rho_1.value, identified.rho_2.value, identified.forearm_inertia_kg.value]
    return Base(
        np.array(rigid),
        np.array(identified.viscous_friction_nms.value),
        np.array(identified.coulomb_friction_nm.value),
        identified.friction_transition_radps,
        identified.torque_timing_s,
    )


def base_of_axes(axes: Axes) -> Base:
    """The base model that a description of axes carries; without one nothing is known but that they move."""
    zero = [0.0] * len(axes.axis)
    if axes.identified is None:
        return Base(np.array(zero + zero), np.array(zero), np.array(zero))
    known = axes.identified
    return Base(
        np.array(known.inertia.value + known.offset.value),
        np.array(known.viscous_friction.value),
        np.array(known.coulomb_friction.value),
        known.friction_transition,
        known.torque_timing_s,
    )


def hypothesis_of(robot: Description) -> Hypothesis:
    """Base model and effects of a description.

    Raises:
        DataError: an effect that is not known, or not described in full.
    """
    effects = by_name(catalogue())
    terms = tuple(term(effect, effects, robot.name) for effect in robot.effect)
    base = base_of_axes(robot) if isinstance(robot, Axes) else base_of(robot.identified)
    return Hypothesis(base, terms)


def described(robot: Robot, hypothesis: Hypothesis, errors: np.ndarray, noise: np.ndarray) -> Robot:
    """The description with a hypothesis and its standard errors (in the order of `errors_of`'s vector) written in."""
    base, n = hypothesis.base, 3
    shown = [digits(value) for value in np.concatenate([base.rigid, base.viscous, base.coulomb])]
    doubt = [digits(value) for value in errors[: 3 + 2 * n]]
    identified = Identified(
        rho_1=Parameter(value=shown[0], std_error=doubt[0]),
        rho_2=Parameter(value=shown[1], std_error=doubt[1]),
        forearm_inertia_kg=Parameter(value=shown[2], std_error=doubt[2]),
        viscous_friction_nms=JointParameter(value=shown[3:6], std_error=doubt[3:6]),
        coulomb_friction_nm=JointParameter(value=shown[6:9], std_error=doubt[6:9]),
        torque_noise_nm=JointParameter(value=[digits(value) for value in noise]),
        friction_transition_radps=digits(base.transition),
        torque_timing_s=digits(base.timing),
    )
    at, entries = 3 + 2 * n, []
    for term_ in hypothesis.terms:
        count = len(names(term_))
        entries.append(entry(term_, errors[at : at + count], robot))
        at += count
    return robot.model_copy(update={"identified": identified, "effect": entries})


def described_axes(axes: Axes, hypothesis: Hypothesis, errors: np.ndarray) -> Axes:
    """The same for decoupled axes."""
    base, n = hypothesis.base, len(axes.axis)
    shown = [digits(value) for value in np.concatenate([base.rigid, base.viscous, base.coulomb])]
    doubt = [digits(value) for value in errors[: 4 * n]]
    inertia, offset, viscous, coulomb = (
        JointParameter(value=shown[at : at + n], std_error=doubt[at : at + n]) for at in range(0, 4 * n, n)
    )
    identified = AxesIdentified(
        inertia=inertia,
        offset=offset,
        viscous_friction=viscous,
        coulomb_friction=coulomb,
        friction_transition=digits(base.transition),
        torque_timing_s=digits(base.timing),
    )
    at, entries = 4 * n, []
    for term_ in hypothesis.terms:
        count = len(names(term_))
        entries.append(entry(term_, errors[at : at + count], axes))
        at += count
    return axes.model_copy(update={"identified": identified, "effect": entries})


def torque_along(
    robot: Description, time: np.ndarray, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray
) -> np.ndarray:
    """Reported torque (N, n) N m that a description expects along a smoothed motion, effects included.

    time: (N,) s. theta, theta_dot, theta_ddot: (N, n) rad, rad/s, rad/s^2; m and N of linear axes.

    Raises:
        DataError: an effect that is not known, or not described in full.
        PoseError: a pose out of reach.
    """
    hypothesis = hypothesis_of(robot)
    period = float(np.median(np.diff(time)))
    still = np.zeros(theta.shape)
    segment = Segment(
        np.arange(len(time)), time, period, theta, theta_dot, theta_ddot, still, np.ones(theta.shape, bool)
    )
    recording = Recording(segment, mechanism_of(robot), 0, robot.name)
    return predict(Scene(recording, hypothesis.base), hypothesis)
