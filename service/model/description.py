"""Hypotheses to and from the robot description, so that what was found runs wherever the description does."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from difflib import get_close_matches

import numpy as np

from schemas.axes_description import AxesIdentified, Description
from schemas.chain_description import ChainIdentified
from schemas.errors import RobotError
from schemas.fitted import Figures, Fitted, JointParameter
from schemas.robot import EffectEntry, EffectParameter, Identified
from service.model.effects import by_name, catalogue
from service.model.effects.base import Effect
from service.model.hypothesis import Hypothesis, Term
from service.model.mechanism import Mechanism, mechanism_of
from service.model.parameters import Parameters, base_parameters, parameters_of
from service.model.scene import Base, Recording
from service.model.signals import Segment
from service.model.torque import predict


def entry(term: Term, errors: np.ndarray, robot: Description) -> EffectEntry:
    """The `[[effect]]` table of a term."""
    values = np.append(term.amplitude.ravel(), term.nonlinear)
    parameters = {
        known.name: EffectParameter(value=digits(value), unit=in_units_of(robot, known.unit), std_error=digits(error))
        for known, value, error in zip(parameters_of(term), values, errors, strict=True)
    }
    return EffectEntry(name=term.effect.name, joints=[joint + 1 for joint in term.joints], parameters=parameters)


def in_units_of(robot: Description, unit: str) -> str:
    """A unit of angle and torque as that of the description's axes."""
    if robot.linear:
        return unit.replace("kg m^2", "kg").replace("N m", "N").replace("rad", "m")
    return unit


def gain_unit(robot: Description, joint: int) -> str:
    """Unit of torque over position of one joint, from 0, in words."""
    return "N per m" if robot.joint_linear(joint) else "N m per rad"


def digits(value: float) -> float:
    """Seven significant digits: what a reader can use, and more than the data hold."""
    return float(f"{value:.7g}")


def terms_of(robot: Description) -> tuple[Term, ...]:
    """The effects of a description.

    Raises:
        RobotError: an effect that is not known, a joint that is none, a missing or an extra parameter, naming it; or
            the description's own effects cannot be run.
    """
    effects = by_name(catalogue(robot.effects_file)) if robot.effect else {}
    return tuple(_term(entry, effects, robot) for entry in robot.effect)


def _term(entry_: EffectEntry, effects: dict[str, Effect], robot: Description) -> Term:
    effect, at = effects.get(entry_.name), f"{robot.origin}: effect {entry_.name}"
    if effect is None:
        hint = f"nor in {robot.effects_file}" if robot.effects_file else "give the file that defines it with --effects"
        raise RobotError(f"{at}: not in the catalogue{_meant(entry_.name, effects)}; {hint}")
    if any(joint > robot.count for joint in entry_.joints):
        raise RobotError(f"{at}: joints {entry_.joints}: the joints are 1 to {robot.count}")
    joints = tuple(joint - 1 for joint in entry_.joints) if effect.per_joint else ()
    blank = Term.blank(effect, joints, (0.0,) * len(effect.nonlinear))
    units = {parameter.name: parameter.unit for parameter in parameters_of(blank)}
    keys = list(units)
    kept = {name: one.tried[0] for name, one in effect.nonlinear.items() if one.fixed or one.late}
    for key, parameter in entry_.parameters.items():
        if key not in units:
            raise RobotError(f"{at}: unknown parameter {key!r}{_meant(key, units)}")
        unit = in_units_of(robot, units[key])
        if parameter.unit not in ("", unit):
            raise RobotError(f"{at}: {key}: unit {parameter.unit!r}: {f'it is {unit!r}' if unit else 'it has none'}")
    for key in keys:
        if key not in entry_.parameters and key not in kept:
            raise RobotError(f"{at}: parameter {key!r} is missing")
    given = {key: parameter.value for key, parameter in entry_.parameters.items()}
    numbers = np.array([(kept | given)[key] for key in keys])
    amplitude = numbers[: blank.amplitude.size].reshape(blank.amplitude.shape)
    nonlinear = tuple(float(v) for v in numbers[blank.amplitude.size :])
    return replace(blank, amplitude=amplitude, nonlinear=nonlinear, found=True)


def _meant(name: str, known: Iterable[str]) -> str:
    near = get_close_matches(name, known, 1)
    return f" (is {near[0]!r} meant?)" if near else ""


def base_of(robot: Description) -> Base:
    """The base model that a description carries. Without one a Delta is as drawn, and of axes and arms nothing is known
    but that they move, and what a URDF says.

    Raises:
        RobotError: a coefficient of the arm is missing or none of its; a transition is missing.
    """
    mechanism, known = mechanism_of(robot), robot.known
    if known is None:
        zero = np.zeros(len(mechanism.frictions))
        return Base(mechanism.start, zero, zero)
    transition = known.transition
    if isinstance(transition, list) and len(transition) != len(mechanism.frictions):
        raise RobotError(
            f"robot {robot.name}: identified.friction_transition has {len(transition)} values, one or "
            f"{len(mechanism.frictions)} are needed: {', '.join(mechanism.frictions)}"
        )
    robot.check_rigid(mechanism.coefficients)
    return replace(
        _base(mechanism, known.figures, np.array(transition) if isinstance(transition, list) else transition),
        timing=known.torque_timing_s,
        band_hz=known.band_hz,
    )


def _base(mechanism: Mechanism, figures: Figures, transition: float | np.ndarray) -> Base:
    """Of `figures` by name; one that is not there is zero."""
    values = {name: value for name, (value, _) in figures.items()}
    rigid, viscous, coulomb = (
        np.array([values.get(f"{kind}{name}", 0.0) for name in names])
        for kind, names in (("", mechanism.coefficients), ("f_v_", mechanism.frictions), ("f_c_", mechanism.frictions))
    )
    return Base(rigid, viscous, coulomb, transition)


def base_errors(robot: Description) -> np.ndarray:
    """(P,) standard errors of the base parameters that a description carries, as in `base_parameters`; 0: not known."""
    known = {} if robot.identified is None else robot.identified.figures
    names = [parameter.name for parameter in base_parameters(mechanism_of(robot))]
    return np.array([known.get(name, (0.0, 0.0))[1] for name in names])


def hypothesis_of(robot: Description) -> Hypothesis:
    """Base model and effects of a description.

    Raises:
        RobotError: an effect that is not known, or not described in full.
    """
    return Hypothesis(base_of(robot), terms_of(robot))


def described(robot: Description, hypothesis: Hypothesis, errors: np.ndarray, noise: np.ndarray) -> Description:
    """The description with a hypothesis and its standard errors (P,) written in. noise: (n,) N m a sample."""
    parameters = Parameters(hypothesis)
    entries = [entry(term, errors[mine], robot) for term, mine in zip(hypothesis.terms, parameters.terms, strict=True)]
    known = base_parameters(mechanism_of(robot))
    figures = {p.name: (float(v), float(e)) for p, v, e in zip(known, parameters.values, errors, strict=False)}
    identified = identified_of(robot, figures, hypothesis.base)
    identified = robot.refitted(identified, JointParameter(value=_digits(noise)))
    return robot.model_copy(update={"identified": identified, "effect": entries})


def identified_of(
    robot: Description, figures: Figures, base: Base, verdicts: dict[str, str] | None = None
) -> Identified | AxesIdentified | ChainIdentified:
    """The `[identified]` section with a fitted base model. figures: by name as in `base_parameters`;
    what a coefficient does not stand for on a joint is zero."""
    transition = base.transition
    fitted = Fitted(
        count=robot.count,
        figures={name: (digits(value), digits(error)) for name, (value, error) in figures.items()},
        verdicts=verdicts or {},
        transition=_digits(transition) if isinstance(transition, np.ndarray) else digits(transition),
        timing_s=digits(base.timing),
        band_hz=digits(base.band_hz) if np.isfinite(base.band_hz) else None,
    )
    return robot.identified_as(fitted)


def _digits(values: np.ndarray | list[float]) -> list[float]:
    return [digits(value) for value in values]


def torque_along(
    robot: Description, time: np.ndarray, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray
) -> np.ndarray:
    """Reported torque (N, n) N m that a description expects along a smoothed motion, effects included.

    time: (N,) s. theta, theta_dot, theta_ddot: (N, n) rad, rad/s, rad/s^2; m and N of linear axes.

    Raises:
        RobotError: an effect that is not known, or not described in full.
        PoseError: a pose out of reach.
    """
    hypothesis = hypothesis_of(robot)
    period = float(np.median(np.diff(time)))
    still = np.zeros(theta.shape)
    segment = Segment(
        np.arange(len(time)), time, period, theta, theta_dot, theta_ddot, still, np.ones(theta.shape, bool)
    )
    recording = Recording(segment, mechanism_of(robot), 0, robot.name)
    return predict(hypothesis.seen(recording), hypothesis)
