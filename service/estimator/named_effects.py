"""The named effects of a robot description inside the online step.

An effect declares in its own file what it is here: a torque from the present sample, with a memory of its own where
it needs the past (`online`, `memory`); a true angle in place of the measured one (`encoder`); a gear between motor and
link (`Transmission`); a part of the way from the torque that acts to the one that is reported (`read_out`); or a change
of the model itself (`correct`). `form_of` says which.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from schemas.errors import RobotError
from schemas.kernels import kernel
from schemas.robot import Robot
from service.model.description import terms_of
from service.model.effects import CATALOGUE
from service.model.effects.base import Effect, Readout
from service.model.effects.transmission import Transmission
from service.model.hypothesis import Term, correction_of, read_out
from service.model.nominal import pack

MAX_EFFECTS = 12
_AMPLITUDES, _NONLINEAR = 4, 2

# A form's number in the record of an effect: torques without a memory, torques with one, encoders.
_INSTANT = {effect.name: effect.online for effect in CATALOGUE if effect.online is not None and not effect.memory}
_REMEMBERING = {effect.name: effect.online for effect in CATALOGUE if effect.online is not None and effect.memory}
_ENCODERS = {effect.name: effect.encoder for effect in CATALOGUE if effect.encoder is not None}
_FORMS = _INSTANT | _REMEMBERING | _ENCODERS
_NUMBER = {name: number for number, name in enumerate(_FORMS)}

# What effects carry from sample to sample: of each effect and joint.
MEMORY = (MAX_EFFECTS, 3, max(effect.memory for effect in CATALOGUE))

EFFECT = np.dtype(
    [
        ("number", "i8"),  # of the form that the kernel runs, -1: none
        ("joint", "i8", 3),  # 1 where it acts
        ("amplitude", "f8", (3, _AMPLITUDES)),  # row 0 where it is of the whole robot
        ("nonlinear", "f8", _NONLINEAR),
    ],
    align=True,
)


Form = Literal["present_sample", "state", "settings", "report", "no_online_form"]


def form_of(effect: Effect) -> Form:
    """How the online model has the effect: from the present sample, as a state from sample to sample, in its settings,
    or between the torque that acts and its report."""
    kind = type(effect)
    if isinstance(effect, Transmission) or effect.name in _REMEMBERING:
        return "state"
    if effect.name in _FORMS:
        return "present_sample"
    if kind.correct is not Effect.correct:
        return "settings"
    return "report" if kind.read_out is not Effect.read_out else "no_online_form"


def carried(effect: Effect) -> bool:
    """Whether the online model has the effect."""
    return form_of(effect) != "no_online_form"


def remembers(terms: Sequence[Term]) -> bool:
    """Whether one of the effects carries a state from sample to sample."""
    return any(form_of(term.effect) == "state" for term in terms)


def has_encoders(terms: Sequence[Term]) -> bool:
    """Whether one of the effects makes true angles of the measured ones."""
    return any(term.effect.encoder is not None for term in terms)


def goes_by_load(terms: Sequence[Term]) -> bool:
    """Whether one of the effects depends on the load of the gears."""
    return any(term.effect.by_load for term in terms)


def readout_of(robot: Robot, terms: Sequence[Term]) -> Readout:
    """What lies between the torque that acts on `robot` and the one that is reported, of `terms` among its effects."""
    return read_out(terms, 0.0 if robot.identified is None else robot.identified.torque_timing_s)


def of_own_joint(effect: Effect) -> bool:
    """Whether the online form needs the joint's own motion alone, and nothing of a Delta."""
    own = effect.per_joint and effect.own_joint and not effect.by_load
    return effect.name in _INSTANT and own and len(effect.kinds) > 1


def pack_effects(terms: Sequence[Term], record: np.dtype = EFFECT) -> np.ndarray:
    """(MAX_EFFECTS,) of `record`, EFFECT or the same of more joints, the unused ones with number -1.

    Raises:
        RobotError: more effects than fit.
    """
    records = np.zeros(MAX_EFFECTS, record)
    records["number"] = -1
    kept = [term for term in terms if term.effect.name in _FORMS]
    if len(kept) > MAX_EFFECTS:
        raise RobotError(f"effect: {len(kept)} tables, the online model holds at most {MAX_EFFECTS}")
    for one, term in zip(records, kept, strict=False):
        one["number"] = _NUMBER[term.effect.name]
        one["nonlinear"][: len(term.nonlinear)] = term.nonlinear
        one["joint"][list(term.joints) or slice(None)] = 1
        one["amplitude"][list(term.places), : term.amplitude.shape[1]] = term.amplitude
    return records


def corrected(robot: Robot) -> tuple[Robot, np.ndarray, np.ndarray]:
    """`robot` with the geometry and gravity its effects say it has; (3,) true over drawn length of its active links;
    (3,) reported over true torque.

    Raises:
        RobotError: an effect that is not known, or not described in full.
    """
    correction, drawn = correction_of(terms_of(robot)), pack(robot).active_length
    return correction.geometry(robot), (drawn + correction.length) / drawn, correction.scale


def _dispatcher(forms, arguments: str, otherwise: str):
    """One compiled function that runs the form an effect's number stands for.

    Written out as a chain of comparisons, which the compiler turns into a jump and inlines; a table of function
    pointers could be neither inlined nor kept in Numba's cache.
    """
    lines = [f"def online({arguments}):"]
    for name in forms:
        lines += [f"    if effect.number == {_NUMBER[name]}:", f"        return {name}({arguments})"]
    lines.append(f"    return {otherwise}")
    text, scope = "\n".join(lines), {"__name__": __name__, **forms}
    exec(compile(text, __file__, "exec"), scope)
    scope["online"].source = text  # for the generator of C, which reads kernels
    return kernel(scope["online"])


_instant = _dispatcher(_INSTANT, "effect, now, i", "0.0")
_remembering = _dispatcher(_REMEMBERING, "effect, now, i, memory", "0.0")
_encoder = _dispatcher(_ENCODERS, "effect, gear_ratio, i, motion", "None")


@kernel
def effects_kernel(effects, now, torque):
    """Add the effects' torque at the Instant `now` to `torque` (n,), N m, which holds the base model's; but of those
    that remember."""
    for n in range(MAX_EFFECTS):
        effect = effects[n]
        if effect.number < 0:
            break
        for i in range(len(torque)):
            if effect.joint[i] != 0:
                torque[i] += _instant(effect, now, i)


@kernel
def remembering_kernel(effects, now, memory, torque):
    """The same of those that do. memory: as MEMORY."""
    for n in range(MAX_EFFECTS):
        effect = effects[n]
        if effect.number < 0:
            break
        for i in range(3):
            if effect.joint[i] != 0:
                torque[i] += _remembering(effect, now, i, memory[n, i])


@kernel
def encoder_kernel(effects, gear_ratio, motion):
    """True angles, speeds and accelerations of the measured ones, in place: motion (3, 3), a row an order."""
    for n in range(MAX_EFFECTS):
        effect = effects[n]
        if effect.number < 0:
            break
        for i in range(3):
            if effect.joint[i] != 0:
                _encoder(effect, gear_ratio, i, motion)


@kernel
def _true_batch(effects, gear_ratio, measured, angles):
    motion = np.zeros((3, 3))
    for n in range(len(measured)):
        for i in range(3):
            motion[0, i] = measured[n, i]
            motion[1, i] = motion[2, i] = 0.0
        encoder_kernel(effects, gear_ratio, motion)
        for i in range(3):
            angles[n, i] = motion[0, i]


def true_angles(effects: np.ndarray, gear_ratio: float, measured: np.ndarray) -> np.ndarray:
    """True angles of measured ones, (..., 3) rad. effects: as `pack_effects`."""
    rows = np.ascontiguousarray(measured, float).reshape(-1, 3)
    angles = np.empty_like(rows)
    _true_batch(effects, gear_ratio, rows, angles)
    return angles.reshape(np.shape(measured))
