"""The corrected robot inside MuJoCo, without a plugin: effects that MuJoCo cannot express act in every step.

    import mujoco
    from deltatwin.mujoco import attach, model_of

    model = model_of(corrected)
    data = mujoco.MjData(model)
    with attach(model, corrected):
        mujoco.mj_step(model, data)

It runs the same code as the Python file of the export.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's compiled modules carry no types)

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mujoco

from schemas.axes_description import Description
from schemas.errors import DataError
from schemas.questions import Question, as_delta
from service.machines import machine_of
from service.rollout.simulator_files import to_mjcf


def model_of(robot: Description) -> mujoco.MjModel:
    """The machine as `deltatwin export --to mjcf` writes it.

    Raises:
        RobotError: an unknown effect, or physically impossible parameters.

    Example:
        >>> import deltatwin as dt
        >>> from deltatwin.mujoco import model_of
        >>> model_of(dt.load_robot("d3-1200")).nu  # drives
        3
    """
    delta = robot.answering(Question.CALLBACK)
    if delta is not None:
        return to_mjcf(delta).spec.compile()
    return mujoco.MjModel.from_xml_string(machine_of(robot).to_mjcf().text)


@contextmanager
def attach(model: mujoco.MjModel, robot: Description) -> Iterator[Any]:
    """Let the effects of a corrected Delta robot act on every step of `model`, which is `model_of` it.

    MuJoCo has one control callback per process. While the effects are attached, nothing else may use it, and no other
    model can be compiled, since MuJoCo would call it for a model that Python does not know. The callback sets
    `data.qfrc_applied` of the joints and the platform. Yields the conversion from true values to those of a log
    (`torque(values)` and `angle(values)`, three each), or None if they are the same.

    Raises:
        UnansweredError: not a Delta. DataError: the callback is already in use; the integrator uses several calls per
            step; an effect has no form in MuJoCo. RobotError: an unknown effect.

    Example:
        >>> import deltatwin as dt, mujoco
        >>> from deltatwin.mujoco import attach, model_of
        >>> robot = dt.load_robot("d3-1200")
        >>> model = model_of(robot)
        >>> with attach(model, robot):
        ...     mujoco.mj_step(model, mujoco.MjData(model))
    """
    delta = as_delta(robot, Question.CALLBACK)
    if mujoco.get_mjcb_control() is not None:
        raise DataError(f"{robot.name}: MuJoCo's control callback is already in use")
    made = to_mjcf(delta)
    if made.left_out:
        raise DataError(f"{robot.name}: " + "; ".join(f"{name}: {why}" for name, why in made.left_out.items()))
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        raise DataError(f"{robot.name}: effects with a state need one call per step: use another integrator than RK4")
    scope: dict[str, Any] = {}
    if made.callback is not None:
        exec(made.callback, scope)  # the text that `export` writes
    effects = scope["Effects"](model) if scope else None

    def control(stepped: mujoco.MjModel, data: mujoco.MjData) -> None:
        if effects is not None and stepped is model:
            effects.apply(data)

    mujoco.set_mjcb_control(control)
    try:
        yield scope["Measurement"](model) if "Measurement" in scope else None
    finally:
        mujoco.set_mjcb_control(None)
