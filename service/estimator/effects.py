"""The named effects of a robot description inside the online step: those whose torque follows from the present sample,
and those that change the model itself.

What needs the past of the motor (backlash, elasticity, presliding) or belongs to the measurement alone (delay, filter
of the reported torque) is not carried: `carried` says which are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from schemas.errors import RobotError
from schemas.kernels import kernel
from schemas.robot import Robot
from service.model.description import terms_of
from service.model.effects import CATALOGUE
from service.model.effects.base import Effect
from service.model.hypothesis import Term, correction_of
from service.model.nominal import pack

MAX_EFFECTS = 12
_AMPLITUDES, _NONLINEAR = 4, 2

_ONLINE = {effect.name: effect.online for effect in CATALOGUE if effect.online is not None}
_NUMBER = {name: number for number, name in enumerate(_ONLINE)}

EFFECT = np.dtype(
    [
        ("number", "i8"),  # of the form that the kernel runs, -1: none
        ("joint", "i8", 3),  # 1 where it acts
        ("amplitude", "f8", (3, _AMPLITUDES)),  # row 0 where it is of the whole robot
        ("nonlinear", "f8", _NONLINEAR),
    ],
    align=True,
)


def carried(effect: Effect) -> bool:
    """Whether the online model has the effect."""
    return effect.name in _ONLINE or _in_settings(effect)


def _in_settings(effect: Effect) -> bool:
    return type(effect).correct is not Effect.correct


def pack_effects(terms: Sequence[Term]) -> np.ndarray:
    """(MAX_EFFECTS,) EFFECT records, the unused ones with number -1.

    Raises:
        RobotError: more effects than fit.
    """
    records = np.zeros(MAX_EFFECTS, EFFECT)
    records["number"] = -1
    kept = [term for term in terms if term.effect.name in _ONLINE]
    if len(kept) > MAX_EFFECTS:
        raise RobotError(f"effect: {len(kept)} tables, the online model has room for {MAX_EFFECTS}")
    for record, term in zip(records, kept, strict=False):
        record["number"] = _NUMBER[term.effect.name]
        record["nonlinear"][: len(term.nonlinear)] = term.nonlinear
        record["joint"][list(term.joints) or slice(None)] = 1
        record["amplitude"][list(term.places), : term.amplitude.shape[1]] = term.amplitude
    return records


def corrected(robot: Robot) -> tuple[Robot, np.ndarray, np.ndarray]:
    """`robot` with the geometry and gravity its effects say it has; (3,) true over drawn length of its active links;
    (3,) reported over true torque.

    Raises:
        RobotError: an effect that is not known, or not described in full.
    """
    correction, drawn = correction_of(terms_of(robot)), pack(robot).active_length
    return correction.geometry(robot), (drawn + correction.length) / drawn, correction.scale


def _dispatcher():
    """One compiled function that runs the form an effect's number stands for.

    Written out as a chain of comparisons, which the compiler turns into a jump and inlines; a table of function
    pointers could be neither inlined nor kept in Numba's cache.
    """
    lines = ["def online(effect, now, i):"]
    for number in range(len(_ONLINE)):
        lines += [f"    if effect.number == {number}:", f"        return form_{number}(effect, now, i)"]
    forms = {f"form_{number}": form for number, form in enumerate(_ONLINE.values())}
    scope = {"__name__": __name__, **forms}
    exec(compile("\n".join([*lines, "    return 0.0"]), __file__, "exec"), scope)
    return kernel(scope["online"])


_online = _dispatcher()


@kernel
def effects_kernel(effects, now, torque):
    """Add the effects' torque at the Instant `now` to `torque` (3,), N m, which holds the base model's."""
    for n in range(MAX_EFFECTS):
        effect = effects[n]
        if effect.number < 0:
            break
        for i in range(3):
            if effect.joint[i] != 0:
                torque[i] += _online(effect, now, i)
