"""Hypotheses to and from the robot description, so that what was found runs wherever the description does."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from difflib import get_close_matches
from typing import Any

import numpy as np

from schemas.axes_description import Axes, AxesIdentified, Description
from schemas.chain_description import Chain, ChainIdentified
from schemas.errors import RobotError
from schemas.joints_description import Machine
from schemas.robot import EffectEntry, EffectParameter, Identified, JointParameter, Robot
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
    kept = {name: searched.grid[0] for name, searched in effect.nonlinear.items() if searched.fixed}
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
    return replace(blank, amplitude=amplitude, nonlinear=tuple(float(v) for v in numbers[blank.amplitude.size :]))


def _meant(name: str, known: Iterable[str]) -> str:
    near = get_close_matches(name, known, 1)
    return f" (is {near[0]!r} meant?)" if near else ""


def base_of(robot: Description) -> Base:
    """The base model that a description carries. Without one a Delta is as drawn, and of axes and arms nothing is known
    but that they move, and what a URDF says.

    Raises:
        RobotError: a coefficient of the arm is missing or none of its; a transition is missing.
    """
    if isinstance(robot, Machine):
        return _base_of_machine(robot)
    identified = robot.identified or Identified()
    rigid = [identified.rho_1.value, identified.rho_2.value, identified.forearm_inertia_kg.value]
    return Base(
        np.array(rigid),
        np.array(identified.viscous_friction_nms.value),
        np.array(identified.coulomb_friction_nm.value),
        identified.friction_transition_radps,
        identified.torque_timing_s,
    )


def _base_of_machine(machine: Axes | Chain) -> Base:
    mechanism, known = mechanism_of(machine), machine.identified
    if known is None:
        zero = np.zeros(len(mechanism.frictions))
        return Base(mechanism.start, zero, zero)
    shared = machine.shared_motors

    def with_motors(values: JointParameter, motors: JointParameter | None) -> np.ndarray:
        return np.array(values.value + [0.0 if motors is None else motors.value[number] for number in shared])

    transition = known.friction_transition
    if isinstance(transition, list) and len(transition) != len(mechanism.frictions):
        raise RobotError(
            f"robot {machine.name}: identified.friction_transition has {len(transition)} values, one or "
            f"{len(mechanism.frictions)} are needed: {', '.join(mechanism.frictions)}"
        )
    return Base(
        _rigid(machine, mechanism),
        with_motors(known.viscous_friction, known.motor_viscous_friction),
        with_motors(known.coulomb_friction, known.motor_coulomb_friction),
        np.array(transition) if isinstance(transition, list) else transition,
        known.torque_timing_s,
        band_hz=np.inf if known.torque_band_hz is None else known.torque_band_hz,
    )


def _rigid(machine: Axes | Chain, mechanism: Mechanism) -> np.ndarray:
    """(k,) coefficients of a description that has them."""
    if isinstance(machine, Chain):
        found = {} if machine.identified is None else machine.identified.rigid
        for name in mechanism.coefficients:
            if name not in found:
                raise RobotError(f"robot {machine.name}: identified.rigid: {name!r} is missing")
        for name in found:
            if name not in mechanism.coefficients and machine.masses == "identified":
                raise RobotError(
                    f"robot {machine.name}: identified.rigid: {name!r} is not a parameter of {machine.urdf}"
                )
        return np.array([found[name].value for name in mechanism.coefficients])
    known = machine.identified
    assert known is not None
    groups = {
        "inertia": known.inertia, "offset": known.offset, "gravity_sin": known.gravity_sin,
        "gravity_cos": known.gravity_cos, "inertia_motor": known.motor_inertia,
    }  # fmt: skip
    values = []
    for name in mechanism.coefficients:
        group, _, number = name.rpartition("_")
        of_joints = groups[group]
        values.append(0.0 if of_joints is None else of_joints.value[int(number) - 1])
    return np.array(values)


def base_errors(robot: Description) -> np.ndarray:
    """(P,) standard errors of the base parameters that a description carries, as in `base_parameters`; 0: not known."""
    if robot.identified is None:
        return np.zeros(len(base_parameters(mechanism_of(robot))))
    known = robot.identified.model_dump()
    for figure in (*known.values(), *known.get("rigid", {}).values()):
        if isinstance(figure, dict) and "value" in figure:
            value, error = figure["value"], figure["std_error"]
            figure["value"] = (error or [0.0] * len(value)) if isinstance(value, list) else error
    base = base_of(robot.model_copy(update={"identified": type(robot.identified).model_validate(known)}))
    return np.concatenate([base.rigid, base.viscous, base.coulomb])


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
    if isinstance(robot, Robot):
        before = robot.identified or Identified()
        kept = {name: getattr(before, name) for name in ("torque_commanded", "torque_constant_error")}
        noise_nm = JointParameter(value=_digits(noise))
        identified = identified.model_copy(update={"torque_noise_nm": noise_nm} | kept)
    return robot.model_copy(update={"identified": identified, "effect": entries})


def identified_of(
    robot: Description, figures: dict[str, tuple[float, float]], base: Base, verdicts: dict[str, str] | None = None
) -> Identified | AxesIdentified | ChainIdentified:
    """The `[identified]` section with a fitted base model. figures: name as in `base_parameters` -> value, standard
    error; what a coefficient does not stand for on a joint is zero."""
    told = verdicts or {}

    def one(name: str) -> dict[str, Any]:
        value, error = figures[name]
        return {"value": digits(value), "std_error": digits(error), "verdict": told.get(name, "identifiable")}

    def joints(name: str) -> dict[str, Any] | None:
        keys = [name.format(number) for number in range(1, robot.count + 1)]
        if not any(key in figures for key in keys):
            return None
        values, errors = ([figures.get(key, (0.0, 0.0))[part] for key in keys] for part in (0, 1))
        said = [told.get(key, "identifiable") for key in keys] if verdicts else []
        return {"value": _digits(values), "std_error": _digits(errors), "verdict": said}

    timing = {"torque_timing_s": digits(base.timing)}
    if isinstance(robot, Robot):
        return Identified.model_validate(
            {name: one(name) for name in ("rho_1", "rho_2", "forearm_inertia_kg")}
            | {"viscous_friction_nms": joints("f_v_{}"), "coulomb_friction_nm": joints("f_c_{}")}
            | {"friction_transition_radps": digits(float(base.transition))}
            | timing
        )
    transition = base.transition
    band = {"torque_band_hz": digits(base.band_hz)} if np.isfinite(base.band_hz) else {}
    friction = (
        timing
        | band
        | {
            "viscous_friction": joints("f_v_{}"),
            "coulomb_friction": joints("f_c_{}"),
            "motor_viscous_friction": joints("f_v_motor_{}"),
            "motor_coulomb_friction": joints("f_c_motor_{}"),
            "friction_transition": _digits(transition) if isinstance(transition, np.ndarray) else digits(transition),
        }
    )
    if isinstance(robot, Chain):
        given = {} if robot.identified is None or robot.masses == "identified" else robot.identified.rigid
        rigid = {name: one(name) for name in figures if not name.startswith(("f_v_", "f_c_"))}
        return ChainIdentified.model_validate({"rigid": given | rigid} | friction)
    names = {"motor_inertia": "inertia_motor_{}"} | {
        name: f"{name}_{{}}" for name in ("inertia", "offset", "gravity_sin", "gravity_cos")
    }
    return AxesIdentified.model_validate({key: joints(name) for key, name in names.items()} | friction)


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
