"""Logs of any machine to its identified description: what the command `identify` and `deltatwin.identify` do."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from schemas.axes_description import Axes, Description
from schemas.chain_description import Chain
from schemas.errors import DataError, RobotError, TraceError
from schemas.robot import Method, Robot
from schemas.trace import Trace
from service.identification.calibration import CalibratedFigure, calibrate
from service.identification.copies import refuse_copies
from service.identification.from_traces import identify, refuse
from service.identification.joint_machines import identify_axes, recorded
from service.identification.pooled import Identification
from service.identification.regression import NormalEquations, summarise
from service.identification.rigs import Rig
from service.model.nominal import pack


def identify_logs(
    description: Description,
    logs: Iterable[Trace],
    method: Method = "pooled",
    carried: Sequence[tuple[float, Trace]] = (),
    rigs: Sequence[Rig | None] = (),
) -> tuple[Identification, Sequence[CalibratedFigure]]:
    """Fit `description` to `logs`; of a Delta each log is read once and not kept.

    method: of a Delta. carried: mass in kg and log of each known load that hangs on a Delta throughout; the figures
    say what it tells of torque constants and platform. rigs: of axes, what one of them moves in each log.

    Raises:
        RobotError: `carried` or the paper's method for what is no Delta, `rigs` for what are no axes.
        DataError, TraceError: the data cannot give an answer, naming the log.
    """
    return _WAYS[type(description)](description, logs, method, carried, rigs)


class Asked:
    """Whether `description` can be identified on logs, asked before anybody proposes it; of a Delta no log is kept."""

    def __init__(self, description: Description) -> None:
        self._description = description
        self._taken, self._refuse = _ASKED[type(description)]
        self._logs: list[Any] = []

    def add(self, log: Trace) -> None:
        """
        Raises:
            DataError, TraceError: `log` alone is of no use.
        """
        self._logs.append(self._taken(self._description, log))

    def refusal(self) -> str | None:
        """Why `identify_logs` refuses the logs before it fits anything; None where it does not."""
        try:
            self._refuse(self._description, self._logs)
        except (DataError, TraceError) as error:
            return str(error)
        return None


def refusal(description: Description, logs: Iterable[Trace]) -> str | None:
    """Why `identify_logs` refuses these logs before it fits anything; None where it does not."""
    asked = Asked(description)
    try:
        for log in logs:
            asked.add(log)
    except (DataError, TraceError) as error:
        return str(error)
    return asked.refusal()


def _of_joints(
    description: Axes | Chain, logs: Iterable[Trace], method: Method, carried: Sequence[tuple[float, Trace]],
    rigs: Sequence[Rig | None],
) -> tuple[Identification, Sequence[CalibratedFigure]]:  # fmt: skip
    if carried:
        raise RobotError(f"{description.origin}: --carried: it needs the platform of a Delta robot")
    if method == "paper":
        raise RobotError(f"{description.origin}: --method paper: the paper's method is for a Delta robot")
    logs = list(logs)
    refuse_copies(logs)
    return identify_axes(description, logs, rigs), ()


def _of_delta(
    description: Robot, logs: Iterable[Trace], method: Method, carried: Sequence[tuple[float, Trace]],
    rigs: Sequence[Rig | None],
) -> tuple[Identification, Sequence[CalibratedFigure]]:  # fmt: skip
    if any(rigs):
        raise RobotError(f"{description.origin}: --rig: it needs servo axes; for a known load of a Delta use --carried")
    if not carried:
        model = pack(description)
        return identify(description, [summarise(model, trace) for trace in logs], method), ()
    logs = list(logs)
    found = calibrate(description, logs, carried)
    model = pack(found.robot)
    result = identify(found.robot, [summarise(model, found.true(trace)) for trace in logs], method)
    warnings = (*found.warnings, *result.warnings)
    return Identification(found.carried(result.robot), result.fit, warnings), found.figures


def _equations(description: Robot, log: Trace) -> NormalEquations:
    return summarise(pack(description), log)


def _refuse_of_joints(description: Axes | Chain, logs: Sequence[Trace]) -> None:
    refuse_copies(logs)
    recorded(description, logs)


_OF_JOINTS = (lambda description, log: log), _refuse_of_joints
# What is kept of each log, and what refuses all of them.
_ASKED: dict[type, tuple[Callable[..., Any], Callable[..., object]]] = {
    Robot: (_equations, refuse),
    Axes: _OF_JOINTS,
    Chain: _OF_JOINTS,
}
_WAYS: dict[type, Callable[..., tuple[Identification, Sequence[CalibratedFigure]]]] = {  # a line a kind
    Robot: _of_delta,
    Axes: _of_joints,
    Chain: _of_joints,
}
