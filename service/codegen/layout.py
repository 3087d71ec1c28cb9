"""What the generated code calls the service's records, and how much of them one robot at one sample rate needs."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from schemas.messages import OPTIONAL, TOPICS
from schemas.robot import Robot
from service.codegen.c import nested
from service.codegen.program import Layout
from service.codegen.source import CodegenError
from service.estimator import kalman, turning
from service.estimator.branch import BRANCH
from service.estimator.named_effects import MAX_EFFECTS, MEMORY
from service.estimator.payload import payload_state as payload
from service.estimator.state import SETTINGS, STATE, STEP

WIRE = ("cdr_header", "frame_id")  # of a message, which no controller has to do with
_FOURTH = "fourth_position"
_HOMES = ("service.", "schemas.")


def layout_of(robot: Robot, settings: np.ndarray) -> Layout:
    """settings: (1,) SETTINGS, as the estimator has them.

    The lag line keeps no more samples than the look back needs, and there is room for the robot's own effects. A robot
    without a fourth axis has no angle of it, so no load is ever looked for off its axis, and nothing is remembered of
    that; one with a fourth axis has its own store of what friction does.

    Raises:
        CodegenError: a record of the service has no such fields any more.
    """
    (given,) = settings
    lag, first = int(given["motion"]["lag"]), int(given["readout"]["first"]) if given["readout"]["active"] else 0
    longest = lag - min(0, first)
    if longest > kalman.MAX_LAG:
        raise CodegenError(f"a look back of {longest} samples, {kalman.MAX_LAG} are remembered")
    line, carried = 2 * longest + 1, max(1, int((given["effect"]["number"] >= 0).sum()))
    shapes: dict[tuple[np.dtype, str], tuple[int, ...]] = {
        (STATE, "slots"): (longest + 1,),
        (STATE, "past"): (longest + 1,),
        (STATE, "turn"): (line,),
        (SETTINGS, "effect"): (carried,),
        (BRANCH, "memory"): (carried, *MEMORY[1:]),
    }
    turns = robot.fourth_axis is not None
    fields: dict[tuple[np.dtype, str], float] = {
        (one, "turns"): int(turns) for one in (payload.STATE, payload.SETTINGS)
    }
    if not turns:
        fields[TOPICS["sample"].dtype, _FOURTH] = np.nan
        shapes[STATE, "turn"] = (1,)
    unused = ("bin_drag",) if turns else ("swing_information", "swing_moment", "swing_drag", "swing_step")
    shapes |= {(payload.STATE, name): (1, *_shape(payload.STATE, name)[1:]) for name in unused}
    for dtype, name in shapes:
        _shape(dtype, name)
    hidden = frozenset((message.dtype, name) for message in TOPICS.values() for name in WIRE)
    constants = {
        "MAX_LAG": (kalman.MAX_LAG, longest),
        "LINE": (turning.LINE, line),
        "MAX_EFFECTS": (MAX_EFFECTS, carried),
    }
    return Layout(_names(), constants, shapes, fields, hidden)


def _shape(dtype: np.dtype, name: str) -> tuple[int, ...]:
    if name not in (dtype.names or ()):
        raise CodegenError(f"a record of the estimator has no field {name!r} any more")
    return dtype[name].shape


def _names() -> dict[np.dtype, str]:
    """Each record in a step by the constant that defines it: `TRACK` of `kalman` is kalman_track, `STATE` of
    `payload.state` payload_state. One that no constant does is named after the record and field that hold it."""
    names = {message.dtype: name for name, message in TOPICS.items()}
    for module_name, module in sorted(sys.modules.items()):
        if module_name.startswith(_HOMES):
            for name, value in vars(module).items():
                if isinstance(value, np.dtype) and value.fields and name.isupper() and value not in names:
                    names[value] = _name(_home(module_name, name, value), name)
    found: dict[np.dtype, str] = {}
    for dtype in nested(STEP):
        name = names.get(dtype, f"part_{len(found)}")
        found[dtype] = f"{name}_{len(found)}" if name in found.values() else name
    return found


def _home(module_name: str, name: str, value: Any) -> str:
    """The module that defines the constant, not one that imports it."""
    for other, module in sorted(sys.modules.items()):
        text = getattr(getattr(module, "__spec__", None), "origin", None)
        if other.startswith(_HOMES) and text and getattr(module, name, None) is value and _defines(text, name):
            return other
    return module_name


def _defines(path: str, name: str) -> bool:
    with open(path, encoding="utf-8") as file:
        return any(line.startswith(f"{name} = np.dtype") for line in file)


def _name(module: str, name: str) -> str:
    parts = module.split(".")
    home = parts[-2] if parts[-1] in ("state", "base") else parts[-1]
    return f"{home.strip('_')}_{name.strip('_')}".lower()


def optional(dtype: np.dtype) -> list[str]:
    """Fields of a message that are no number where a source does not have them."""
    return [name for name in dtype.names or () if name in OPTIONAL or name.endswith("_command")]
